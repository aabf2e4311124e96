"""Pictures of responses: images on the ground, cuts through targets, and the panels of the PSF paper."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from sal_height.geometry import Grid
from sal_height.numeric import C64, F64, frequencies
from sal_height.picture import COLUMN_WIDTH, POWERS, colour_bar, page
from sal_height.response import (
    FINENESS,
    OVERSAMPLING,
    REACH,
    AxisSpectrum,
    AxisTransfer,
    Chip,
    CutResponse,
    ImpulseResponse,
    Pointing,
    PointSpread,
    PointTarget,
    PsfReport,
    estimate_transfer_function,
)

PIXELS_SHOWN = 300
"""Greatest number of interpolated rows or columns in the picture of a target; more would not be visible."""

HALF_POWER_DB = 10 * np.log10(0.5)

FAINTEST_DB = -50
"""Lowest level of chips and point-spread functions in the picture, dB of the peak."""

COLUMNS = 4
"""Panels side by side."""

TARGETS, SPECKLE, ONE_TARGET = "#0072b2", "#d55e00", "0.6"
"""Colours of measurements on all targets, on speckle and on a single target."""

DIRECTIONS = {"R": "range", "A": "azimuth"}
"""Axes of the responses R and A."""

Panel = Callable[[Axes], None]
"""Draws on a panel."""


def draw_image(image: C64, grid: Grid, title: str, path: Path) -> None:
    """Write a PNG of the power of a focused image in dB below its peak, where its pixels are on the ground, north up.

    Args:
        image: pixels, shape (rows, cols).
        grid: grid of the pixels; rows of a slant plane are laid out on level ground around its middle.
        title: title of the picture.
        path: path of the file.
    """
    power = np.abs(image) ** 2
    level = decibels(power / np.nanmax(power))
    # Targets are far above all else, and noise has no least power.
    black, white = np.percentile(level[np.isfinite(level)], (20.0, 99.9))
    with page(path, 0.88 * COLUMN_WIDTH, COLUMN_WIDTH) as figure:
        axes = figure.subplots()
        shown = axes.imshow(level, POWERS, vmin=black, vmax=white, origin="lower", interpolation="nearest")
        shown.set_transform(_to_ground(grid) + axes.transData)
        west, south = corners(grid).min(axis=0)
        east, north = corners(grid).max(axis=0)
        axes.set(title=title, xlabel="east (m)", ylabel="north (m)", facecolor="0.7")
        axes.set(xlim=(west, east), ylim=(south, north), aspect="equal")
        colour_bar(shown, axes, "power (dB of the peak)", level, shrink=0.8)


def ground_steps(grid: Grid) -> tuple[F64, F64]:
    """Way on level ground, east and north (m), from a row to the next and from a column to the next, each shape (2,).

    A step along the line of sight changes the range; on the ground, which is seen under the angle of incidence, the
    same change takes the step divided by the sine of that angle, which is the horizontal part of its direction.
    """
    sight, along = grid.row_direction[:2], grid.col_direction[:2]
    return grid.row_spacing * sight / (sight @ sight), grid.col_spacing * along / (along @ along)


def corners(grid: Grid) -> F64:
    """East and north of the outer corners of an image on the ground, m, shape (4, 2)."""
    down, across = ground_steps(grid)
    middle = grid.middle[:2]
    sides = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]]) * np.array(grid.shape)
    return np.asarray(middle + sides @ np.stack([down, across]))


def _to_ground(grid: Grid) -> Affine2D:
    """From column and row of an image to east and north, m."""
    down, across = ground_steps(grid)
    middle = grid.middle[:2]
    first = middle - (grid.rows - 1) / 2 * down - (grid.cols - 1) / 2 * across
    return Affine2D.from_values(*across, *down, *first)


@dataclass(frozen=True, eq=False)
class DrawnTarget:
    """A measured target to be drawn.

    Attributes:
        title: name of its image.
        axes: names of the directions of rows and of columns, for example range and azimuth.
        chip: the pixels around the target.
        response: measured impulse response of the target.
    """

    title: str
    axes: tuple[str, str]
    chip: Chip
    response: ImpulseResponse


def draw_responses(targets: Sequence[DrawnTarget], title: str, path: Path) -> None:
    """Write a PNG with a row for each target: its interpolated surroundings and both cuts through its peak."""
    with page(path, 0.6 + 2.0 * len(targets)) as figure:
        for panels, target in zip(figure.subplots(len(targets), 3, squeeze=False), targets, strict=True):
            _draw_target(panels, target)
        figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower right", ncols=2, frameon=False)
        figure.suptitle(title)


def _draw_target(panels: Sequence[Axes], target: DrawnTarget) -> None:
    """Draw the surroundings of a target, and the cuts down and across."""
    surroundings, down, across = panels
    chip, response = target.chip, target.response
    rows = _around(response.row, response.row_cut, chip.finite[0])
    cols = _around(response.col, response.col_cut, chip.finite[1])
    peak = chip.power(response.row, response.col)[0, 0]
    level = decibels(chip.power(_thinned(rows), _thinned(cols)) / peak)
    shown = surroundings.imshow(
        level, extent=(cols[0], cols[-1], rows[-1], rows[0]), vmin=-40, vmax=0, cmap="magma", aspect="auto"
    )
    surroundings.set(
        title=textwrap.fill(target.title, 42), xlabel=f"column ({target.axes[1]})", ylabel=f"row ({target.axes[0]})"
    )
    colour_bar(shown, surroundings, "power (dB of the peak)", level)
    _draw_cut(down, rows - response.row, chip.power(rows, response.col) / peak, response.row_cut, target.axes[0])
    _draw_cut(across, cols - response.col, chip.power(response.row, cols) / peak, response.col_cut, target.axes[1])


def _around(position: float, cut: CutResponse, finite: tuple[int, int]) -> F64:
    """Interpolated positions around a peak: REACH widths to both sides, as far as there are pixels."""
    reach = REACH * cut.width if np.isfinite(cut.width) else np.inf
    first, last = max(finite[0], position - reach), min(finite[1], position + reach)
    before, after = int((position - first) * OVERSAMPLING), int((last - position) * OVERSAMPLING)
    return position + np.arange(-before, after + 1) / OVERSAMPLING


def _thinned(positions: F64) -> F64:
    """At most PIXELS_SHOWN positions, evenly spaced from the first to the last."""
    return np.linspace(positions[0], positions[-1], min(len(positions), PIXELS_SHOWN))


def _draw_cut(axis: Axes, offset: F64, power: F64, cut: CutResponse, kind: str) -> None:
    """Draw one cut with its width at -3 dB and its highest sidelobe."""
    axis.plot(offset, decibels(power.ravel()), lw=1)
    axis.plot([-cut.width / 2, cut.width / 2], [HALF_POWER_DB] * 2, "|-", color="#d55e00", ms=6, label="width at -3 dB")
    if np.isfinite(cut.pslr_db):
        axis.axhline(cut.pslr_db, color="#009e73", ls="--", lw=1, label="highest sidelobe")
    axis.set(
        title=f"{kind}: {cut.width:.3f} px\nPSLR {cut.pslr_db:.1f} dB, ISLR {cut.islr_db:.1f} dB".replace("nan", "-"),
        xlabel=f"offset in {kind} (pixels)",
        ylabel="power (dB of the peak)",
        ylim=(-50, 3),
    )
    axis.grid()


def decibels(power: F64) -> F64:
    """Power ratio in dB; minus infinity for 0."""
    with np.errstate(divide="ignore"):
        return 10 * np.log10(power)


def draw_psf(report: PsfReport, title: str, reasons: Sequence[str], path: Path) -> None:
    """Write a PNG: chips, responses of targets and of speckle, point-spread function, pointing, and text.

    A quantity that is not determined has no panel, but its reason in the text.
    """
    panels, text = list(_panels(report)), _text(report, reasons)
    rows = math.ceil(len(panels) / COLUMNS)
    words = 0.2 + 0.12 * len(text.splitlines())
    with page(path, 0.4 + 1.8 * rows + words) as figure:
        grid = figure.add_gridspec(rows + 1, COLUMNS, height_ratios=(*[1.8] * rows, words))
        for index, draw in enumerate(panels):
            draw(figure.add_subplot(grid[divmod(index, COLUMNS)]))
        below = figure.add_subplot(grid[rows, :])
        below.axis("off")
        below.text(0.0, 1.0, text, va="top", ha="left", transform=below.transAxes, in_layout=False)
        figure.suptitle(title)


def _panels(report: PsfReport) -> Iterator[Panel]:
    """Functions that draw the panels, in their order."""
    shown = report.targets[:4]  # as in the paper
    for index, target in enumerate(shown):
        yield partial(_draw_chip, target=target, index=index)
    if report.transfer:
        singles = [estimate_transfer_function([target]) for target in shown] if len(report.targets) > 1 else []
        for letter, axis, own in (
            ("R", report.transfer.range, [one.range for one in singles]),
            ("A", report.transfer.azimuth, [one.azimuth for one in singles]),
        ):
            yield partial(_draw_modulus, letter=letter, axis=axis, singles=own)
            yield partial(_draw_phase, letter=letter, axis=axis, singles=own)
    if report.spectra:
        of_targets = (report.transfer.range, report.transfer.azimuth) if report.transfer else (None, None)
        spectra = report.spectra.range, report.spectra.azimuth
        for letter, spectrum, transfer, count in zip("RA", spectra, of_targets, report.chip, strict=True):
            yield partial(_draw_speckle, letter=letter, spectrum=spectrum, transfer=transfer, count=count)
    if report.spread:
        yield partial(_draw_spread, spread=report.spread)
    if any(len(one.cols) for one in report.pointing):
        yield partial(_draw_pointing, pointing=report.pointing)


def _draw_chip(axes: Axes, target: PointTarget, index: int) -> None:
    """Draw the power around a target (figure 3)."""
    chip = np.fft.fftshift(target.chip)
    rows, cols = chip.shape
    axes.imshow(
        _decibels(np.abs(chip)),
        extent=(-cols / 2, cols / 2, rows / 2, -rows / 2),
        vmin=FAINTEST_DB,
        vmax=0,
        cmap="gray",
        aspect="auto",
    )
    axes.set(
        title=f"target {index + 1}, {10 * np.log10(target.over_clutter):.1f} dB over clutter\n"
        f"(white: peak, black: {FAINTEST_DB} dB)",
        xlabel="azimuth (pixels)",
        ylabel="range (pixels)",
    )


def _draw_modulus(axes: Axes, letter: str, axis: AxisTransfer, singles: Sequence[AxisTransfer]) -> None:
    """Draw the modulus of R or A with its error (figures 6 to 15), and those of single targets."""
    for one in singles:
        axes.plot(frequencies(len(one.response)), np.abs(one.response), lw=0.6, color=ONE_TARGET)
    frequency, amplitude, error = frequencies(len(axis.response)), np.abs(axis.response), axis.sigma / np.sqrt(2)
    axes.plot(frequency, amplitude, color=TARGETS)
    axes.fill_between(frequency, np.maximum(0, amplitude - error), amplitude + error, alpha=0.3, color=TARGETS, lw=0)
    axes.set(title=f"|{letter}| of targets", ylabel="modulus", ylim=(0, None))
    _finish_response(axes, letter)


def _draw_phase(axes: Axes, letter: str, axis: AxisTransfer, singles: Sequence[AxisTransfer]) -> None:
    """Draw the phase of R or A with its error where it is known, and those of single targets."""
    for one in singles:
        axes.plot(frequencies(len(one.response)), _phase(one), ".", ms=1.5, color=ONE_TARGET)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = axis.sigma / np.sqrt(2) / np.abs(axis.response)
    frequency = frequencies(len(axis.response))
    axes.errorbar(frequency, _phase(axis), error, fmt=".", ms=2.5, elinewidth=0.6, color=TARGETS)
    axes.set(title=f"arg {letter} of targets", ylabel="rad", ylim=(-np.pi, np.pi))
    _finish_response(axes, letter)


def _phase(axis: AxisTransfer) -> F64:
    """Phase of a response, rad; NaN where it is not known."""
    known = np.abs(axis.response) > 3 * axis.sigma
    return np.where(known, np.angle(axis.response), np.nan)


def _draw_speckle(axes: Axes, letter: str, spectrum: AxisSpectrum, transfer: AxisTransfer | None, count: int) -> None:
    """Draw the modulus from speckle (figure 24) with its errors, and that from targets, both with an rms of 1."""
    power, sigma = spectrum.unfolded(count)
    low, middle, high = (np.sqrt(np.maximum(0, power + step * sigma)) for step in (-1, 0, 1))
    axes.plot(frequencies(count), middle, color=SPECKLE, ls="--", label="speckle")
    axes.fill_between(frequencies(count), low, high, alpha=0.3, color=SPECKLE, lw=0)
    if transfer:
        scale = np.sqrt(np.mean(np.abs(transfer.response) ** 2))
        axes.plot(frequencies(count), np.abs(transfer.response) / scale, color=TARGETS, lw=0.8, label="targets")
    title = f"|{letter}| of speckle, and of targets" if transfer else f"|{letter}| of speckle"
    axes.set(title=title, ylabel="modulus over its rms", ylim=(0, None))
    axes.legend()
    _finish_response(axes, letter)


def _finish_response(axes: Axes, letter: str) -> None:
    axes.set(xlabel=f"{DIRECTIONS[letter]} frequency (1/pixel)", xlim=(-0.5, 0.5))
    axes.grid()


def _draw_spread(axes: Axes, spread: PointSpread) -> None:
    """Draw the point-spread function (figure 26) and mark its anomalous sidelobes."""
    axes.set_title(f"point-spread function\n(brightest: peak, black: {FAINTEST_DB} dB)")
    rows, cols = (size / FINENESS for size in spread.pixels.shape)
    half = 0.5 / FINENESS
    axes.imshow(
        _decibels(np.abs(spread.pixels)),
        extent=(-cols / 2 - half, cols / 2 - half, rows / 2 - half, -rows / 2 - half),
        vmin=FAINTEST_DB,
        vmax=0,
        cmap="magma",
        aspect="auto",
    )
    for one in spread.range.sidelobes:
        axes.plot(0, one.position, "o", mfc="none", mec="cyan", ms=6)
    for one in spread.azimuth.sidelobes:
        axes.plot(one.position, 0, "o", mfc="none", mec="cyan", ms=6)
    axes.set(xlabel="azimuth (pixels)", ylabel="range (pixels)")


def _draw_pointing(axes: Axes, pointing: Sequence[Pointing]) -> None:
    for one in pointing:
        axes.errorbar(one.cols, one.displacement, one.sigma, fmt=".", ms=2.5, elinewidth=0.6)
    axes.set(title="pointing of the antenna", xlabel="azimuth (pixels)", ylabel="Doppler centroid (1/pixel)")
    axes.grid()


def _text(report: PsfReport, reasons: Sequence[str]) -> str:
    """The result of the test of superposition, and the reasons for undetermined quantities."""
    lines = [f"Not determined: {reason}" for reason in reasons]
    if report.linearity:
        found = report.linearity
        lines.insert(
            0,
            f"Superposition of targets and speckle: p = {found.p_value:.3g}, chi-square {found.chi_square:.1f} of "
            f"{found.freedom}, in chips of {report.linearity_rows} rows.",
        )
    return "\n".join(textwrap.fill(line, 135, subsequent_indent="    ") for line in lines)


def _decibels(amplitude: F64) -> F64:
    return 20 * np.log10(np.maximum(amplitude, 1e-10))
