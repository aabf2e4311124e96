"""Pictures of products: an adjustment, heights from several passes, and a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sal_height.adjustment import Adjustment
from sal_height.calibration import Calibration
from sal_height.graph.picture import HEIGHTS, colour_bar, page
from sal_height.numeric import C128, F64, Bool
from sal_height.passes import PassHeights
from sal_height.runs.products.passes_report import ReferenceComparison

mpl.use("Agg")

AXES = ("east", "north", "up")


def draw_adjustment(adjustment: Adjustment, path: Path) -> None:
    """Write a PNG: shifts of the dwells with their sigmas, and differences of comparisons before and after."""
    shifts, covariance = adjustment.shifts
    sigmas = np.sqrt([one.diagonal() for one in covariance])
    before, after = adjustment.differences
    figure = Figure(figsize=(13, 8), layout="constrained")
    for column, (axis, name) in enumerate(zip(figure.subplots(2, 3).T, AXES, strict=True)):
        top, below = axis
        top.errorbar(np.arange(len(shifts)), shifts[:, column], sigmas[:, column], fmt=".", ms=3, lw=0.8)
        top.set(title=f"How far {name} dwells were misaligned", xlabel="dwell", ylabel="m")
        top.axhline(0.0, color="k", lw=0.5)
        for values, label in ((before, "before"), (after, "after")):
            if len(values):
                size = np.sort(np.abs(values[:, column]))
                below.step(np.maximum(size, 1e-4), (np.arange(len(size)) + 1) / len(size), label=label, where="post")
        below.set(
            title=f"Differences {name} between dwells that overlap", xlabel="m", ylabel="share below", xscale="log"
        )
        if len(after):
            below.legend(loc="lower right")
    figure.savefig(path, dpi=110)


def draw_passes(result: PassHeights, comparisons: Sequence[ReferenceComparison], path: Path) -> None:
    """Write a PNG: the map of the points on the left; on the right heights over range, and the array response."""
    with page(path, 5.6) as figure:
        panels = figure.subplot_mosaic([["plan", "profile"], ["plan", "response"]], width_ratios=[1.2, 1.0])
        _draw_plan(panels["plan"], result, comparisons)
        _draw_profile(panels["profile"], result, comparisons)
        _draw_response(panels["response"], result)


def _draw_plan(axis: Axes, result: PassHeights, comparisons: Sequence[ReferenceComparison]) -> None:
    points = result.found.points
    east, north, height = points.positions.T
    limits = np.percentile(height, [1, 99]) if len(height) else (0.0, 1.0)
    size = 4 + 20 * np.clip(np.log10(np.maximum(points.power, 1.0)) / 4, 0, 1)
    drawn = axis.scatter(east, north, c=height, s=size, cmap=HEIGHTS, vmin=limits[0], vmax=limits[1], linewidths=0)
    for one in comparisons:
        axis.plot(*one.reference.position[:2], marker="+", color="k", ms=9)
    colour_bar(drawn, axis, "height (m)", height, orientation="horizontal", aspect=40, pad=0.02)
    axis.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title=f"{len(height)} points, + reference points")


def _draw_profile(axis: Axes, result: PassHeights, comparisons: Sequence[ReferenceComparison]) -> None:
    points, array = result.found.points, result.array
    sight = array.axes[0] * np.array([1.0, 1.0, 0.0])
    sight /= np.linalg.norm(sight)
    away = (points.positions - array.centre) @ sight
    axis.errorbar(away, points.height, 2 * points.total_sigma, fmt=".", ms=3, lw=0.6)
    for one in comparisons:
        axis.plot((one.reference.position - array.centre) @ sight, one.reference.position[2], "k+", ms=9)
    axis.set(xlabel="ground range (m)", ylabel="height (m), 2 sigma")


def _draw_response(axis: Axes, result: PassHeights) -> None:
    ambiguity = result.ambiguity
    axis.plot(ambiguity.offsets, ambiguity.response, lw=1.0)
    axis.set(
        xlabel="error of height (m)",
        ylabel="fraction of power",
        ylim=(0, 1),
        title=f"{len(result.array.passes)} passes: greatest sidelobe {ambiguity.sidelobe:.2g}",
    )


DECIBELS = 20 / np.log(10)
"""Decibels of a change of ln amplitude by 1."""

STYLES = ("-", "--", "-.", ":")


def draw_calibration(calibration: Calibration, sensor: str, path: Path) -> None:
    """Write a PNG: gain and phase of each channel over those described, and the shapes over the band that differ.

    Shapes over the band that are within their standard errors are not drawn; without any other there is no such panel.
    """
    gain = calibration.response.mean(axis=1)
    shapes = calibration.response / gain[:, None]
    found = beyond_error(shapes, calibration.response_sigma)
    with page(path, 5.2 if found.any() else 2.6) as figure:
        panels = figure.subplots(2 if found.any() else 1, 2, squeeze=False)
        level, turn = DECIBELS * np.log(np.abs(gain)), np.degrees(np.angle(gain))
        _draw_gains(panels[0, 0], level, DECIBELS * calibration.gain_sigma, "gain over that described (dB)")
        _draw_gains(panels[0, 1], turn, np.degrees(calibration.phase_sigma), "phase over that described (°)")
        if found.any():
            _draw_shapes(panels[1], shapes, calibration.response_sigma, found)
        figure.suptitle(
            f"{sensor}: receivers, from {calibration.dwells} dwells; beam width over that described: "
            f"{beam_width(calibration)}\n{_said_of_shapes(found, calibration.response_sigma)}"
        )


def beam_width(calibration: Calibration) -> str:
    """Width of the beams relative to the description, with its standard error, as text."""
    if not np.isfinite(calibration.width_sigma):
        return "not determined"
    return f"{calibration.width_factor:.4f} +- {calibration.width_sigma:.4f}"


def beyond_error(shapes: C128, sigma: F64) -> Bool:
    """True for channels whose responses differ from a flat one by more than their standard error, rms over the band.

    Args:
        shapes: responses over their own means, shape (channels, frequencies).
        sigma: standard error of a frequency, shape (channels,); NaN: not measured, which is no finding.
    """
    return np.sqrt(np.mean(np.abs(shapes - 1) ** 2, axis=1)) > np.nan_to_num(sigma, nan=np.inf)


def _draw_gains(axes: Axes, value: F64, sigma: F64, label: str) -> None:
    """Draw a number of each channel with its error bar, filled where it differs from that described."""
    channel = np.arange(len(value))
    significant = 2.0  # standard errors from the described value beyond which a value is marked as a finding
    with np.errstate(invalid="ignore"):
        differs = np.abs(value) > significant * sigma
    axes.axhline(0, color="0.5", lw=0.6)
    bars = np.nan_to_num(sigma)
    how: dict[str, Any] = {"fmt": "o", "color": "#0072b2", "elinewidth": 0.8, "capsize": 1.5}
    if differs.any():
        axes.errorbar(channel[differs], value[differs], bars[differs], label=f"beyond {significant:g} sigma", **how)
    if not differs.all():
        axes.errorbar(
            channel[~differs], value[~differs], bars[~differs], mfc="w", label=f"within {significant:g} sigma", **how
        )
    axes.set(xlabel="channel", ylabel=label)
    axes.grid()
    axes.legend()


def _draw_shapes(panels: Sequence[Axes], shapes: C128, sigma: F64, found: Bool) -> None:
    """Draw amplitude and phase over the band of the channels found to differ, each with its standard error."""
    place = (np.arange(shapes.shape[1]) - (shapes.shape[1] - 1) / 2) / shapes.shape[1]
    for number, channel in enumerate(np.flatnonzero(found)):
        # One part of the complex error: half of its power.
        error = sigma[channel] / np.sqrt(2)
        level, turn = DECIBELS * np.log(np.maximum(np.abs(shapes[channel]), 1e-6)), np.angle(shapes[channel])
        for axes, value, band in ((panels[0], level, DECIBELS * error), (panels[1], turn, error)):
            (line,) = axes.plot(place, value, ls=STYLES[number % len(STYLES)], label=str(channel))
            axes.fill_between(place, value - band, value + band, color=line.get_color(), alpha=0.25, lw=0)
    panels[0].set_ylabel("amplitude over its mean (dB)")
    panels[1].set_ylabel("phase over its mean (rad)")
    for axes in panels:
        axes.set_xlabel("fast-time frequency (bandwidths from the carrier)")
        axes.grid()
    panels[0].legend(title="channel, band: 1 sigma", ncols=4)


def _said_of_shapes(found: Bool, sigma: F64) -> str:
    """Note on the channels whose responses are flat."""
    if not np.isfinite(sigma).any():
        return "how receivers differ over the band was not determined"
    error = f"{DECIBELS * np.nanmedian(sigma) / np.sqrt(2):.2g} dB"
    if not found.any():
        return f"over the band all channels are flat within their standard error of {error}"
    return f"over the band {np.count_nonzero(found)} of {len(found)} channels differ by more than their standard error"
