"""Pictures of heights and their errors, of a calibration, and of focused images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import Grid
from sal_height.numeric import C64, F64
from sal_height.runs.irf_picture import decibels
from sal_height.runs.report import Mosaic
from sal_height.simulation import Preset, Scene

mpl.use("Agg")


def draw_heights(mosaics: Mapping[str, Mosaic], scene: Scene, preset: Preset, path: Path) -> None:
    """Write a PNG: the terrain and each estimator's height above, the geometry and each error below.

    All heights share one colour scale, all errors another, centred on zero.
    """
    first = next(iter(mosaics.values()))
    terrain = scene.heights(first.east, first.north[:, None])
    spread = {name: _s68(m.error[m.single]) for name, m in mosaics.items()}
    worst = 4 * max(spread.values())
    limits = height_limits(terrain, worst)
    shape = np.ptp(first.north) / np.ptp(first.east)
    figure = Figure(figsize=(5.4 * (len(mosaics) + 1), 2.0 + 2 * max(3.2, 5.0 * shape)), layout="constrained")
    axes = figure.subplots(2, len(mosaics) + 1, squeeze=False)

    truth = _show(axes[0, 0], first, terrain, limits, "terrain")
    axes[0, 0].set_title("truth: the terrain")
    for column, (name, result) in enumerate(mosaics.items(), start=1):
        title = ESTIMATORS[name].title if name in ESTIMATORS else name
        _show(axes[0, column], result, result.height, limits, "terrain")
        axes[0, column].set_title(f"height, {title}")
        error = _show(axes[1, column], result, result.error, (-worst, worst), "RdBu_r")
        axes[1, column].set_title(f"error, {title}\nhalf the 16-84 % width {spread[name]:.3g} m")
    figure.colorbar(truth, ax=axes[0], label="height above the reference sphere (m)")
    figure.colorbar(error, ax=axes[1], label="height error (m)")
    for axis in (*axes[0, 1:], *axes[1, 1:]):
        axis.set(xlim=axes[0, 0].get_xlim(), ylim=axes[0, 0].get_ylim())
    _draw_geometry(axes[1, 0], preset)
    flight = preset.flight
    figure.suptitle(
        f"{preset.name}: {preset.dwells} dwells, {preset.sensor.detectors} detectors, CNR {preset.cnr_db:g} dB, "
        f"{preset.looks[0]} x {preset.looks[1]} looks, slant range {flight.slant_range_m / 1e3:g} km. "
        "Grey: no valid height."
    )
    figure.savefig(path, dpi=110)


def draw_calibration(calibration: Calibration, sensor: str, path: Path) -> None:
    """Write a PNG: amplitude and phase of the response of each channel, relative to the description of the sensor."""
    channels, frequencies = calibration.response.shape
    place = (np.arange(frequencies) - (frequencies - 1) / 2) / frequencies
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    amplitude, phase = figure.subplots(2, 1, sharex=True)
    for channel, response in enumerate(calibration.response):
        shade = mpl.colormaps["viridis"](channel / max(1, channels - 1))
        amplitude.plot(place, 20 * np.log10(np.maximum(np.abs(response), 1e-3)), color=shade, label=str(channel))
        phase.plot(place, np.degrees(np.angle(response)), color=shade)
    amplitude.set(ylabel="amplitude relative to the description (dB)")
    phase.set(
        ylabel="phase relative to the description (deg)", xlabel="fast-time frequency (bandwidths from the carrier)"
    )
    amplitude.legend(title="channel", fontsize="x-small", ncols=8)
    for axes in (amplitude, phase):
        axes.grid(alpha=0.3)
    width = beam_width(calibration)
    figure.suptitle(f"{sensor}: receivers, from {calibration.dwells} dwells; beam width over that described: {width}")
    figure.savefig(path, dpi=110)


def beam_width(calibration: Calibration) -> str:
    """Width of the beams relative to the description, with its standard error, as text."""
    if not np.isfinite(calibration.width_sigma):
        return "not determined"
    return f"{calibration.width_factor:.4f} +- {calibration.width_sigma:.4f}"


def draw_image(image: C64, grid: Grid, title: str, path: Path) -> None:
    """Write a PNG of the power of a focused image, down to 60 dB below its peak, in coordinates of the image plane."""
    power = np.abs(image) ** 2
    level = decibels(power / np.nanmax(power))
    figure = Figure(figsize=(8.5, 7.5), layout="constrained")
    axis = figure.subplots()
    high, wide = grid.rows * grid.row_spacing / 2, grid.cols * grid.col_spacing / 2
    shown = axis.imshow(level, extent=(-wide, wide, high, -high), vmin=-60, vmax=0, cmap="gray")
    axis.set(title=title, xlabel="along-track (m)", ylabel="range (m)")
    figure.colorbar(shown, label="power (dB below the peak)")
    figure.savefig(path, dpi=110)


def height_limits(terrain: F64, worst: float) -> tuple[float, float]:
    """Lowest and highest height of the colour scale, m: those of the terrain, and at least its middle +- `worst`.

    On flat ground the colours thus show errors of the heights, instead of one colour.
    """
    low, high = np.nanpercentile(terrain, [0.5, 99.5])
    middle = (low + high) / 2
    return float(min(low, middle - worst)), float(max(high, middle + worst))


def _show(axis: Axes, result: Mosaic, values: F64, limits: tuple[float, float], colours: str) -> AxesImage:
    """Draw one layer of a mosaic in ground coordinates."""
    unit, factor = ("km", 1e-3) if np.ptp(result.east) > 3000 else ("m", 1.0)
    axis.set(xlabel=f"east, along-track ({unit})", ylabel=f"north ({unit})", facecolor="0.85")
    (west, east), (south, north) = _edges(result.east * factor), _edges(result.north * factor)
    return axis.imshow(
        values,
        extent=(west, east, south, north),
        origin="lower",
        vmin=limits[0],
        vmax=limits[1],
        cmap=colours,
        interpolation="nearest",
    )


def _edges(centres: F64) -> tuple[float, float]:
    """Outer edges of a row of evenly spaced cells."""
    half = (centres[-1] - centres[0]) / max(1, len(centres) - 1) / 2
    return float(centres[0] - half), float(centres[-1] + half)


def _s68(error: F64) -> float:
    """Half the width from 16 to 84 %; 1 if there is no error at all, so that a colour scale exists."""
    return float(np.diff(np.nanpercentile(error, [16, 84]))[0] / 2) if np.any(np.isfinite(error)) else 1.0


def _draw_geometry(axis: Axes, preset: Preset) -> None:
    """Draw the vertical section across the flight: platform, line of sight and fan of beams."""
    flight, sensor = preset.flight, preset.sensor
    side = {"right": -1, "left": 1}[sensor.look_side]
    across, up = np.sin(flight.look_angle_rad), np.cos(flight.look_angle_rad)
    axis.plot([0, side * across], [up, 0], "k-", lw=1)
    for edge in (-0.06, 0.06):
        angle = flight.look_angle_rad + edge
        reach = up / np.cos(angle)
        axis.plot([0, side * reach * np.sin(angle)], [up, 0], "k--", lw=0.7)
    axis.plot([-1.1, 1.1], [0, 0], color="saddlebrown", lw=3)
    axis.plot([0, 0], [0, up], color="0.6", lw=0.7)
    axis.plot(0, up, "o", color="tab:red", ms=9)
    axis.annotate("platform, flying east", (0, up), (0.0, up + 0.07), ha="center")
    span = sensor.detectors * sensor.pitch_beamwidths * sensor.wavelength_m / sensor.aperture_m
    axis.annotate(
        f"slant range {flight.slant_range_m / 1e3:g} km\n"
        f"look angle {np.degrees(flight.look_angle_rad):.0f}° from nadir\n"
        f"{sensor.detectors} beams span {span * 1e3:.3g} mrad\n"
        f"= {span * flight.slant_range_m:.4g} m across the line of sight",
        (side * across / 2, up / 2),
        (0.08 if side < 0 else -0.08, up * 0.45),
        ha="left" if side < 0 else "right",
    )
    axis.set(title="look geometry (beams not to scale)", aspect="equal", ylim=(-0.1, 0.95))
    axis.text(side * 1.0, -0.09, "south" if side < 0 else "north", ha="center")
    axis.axis("off")
