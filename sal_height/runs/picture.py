"""Pictures of a calibration and of focused images."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from sal_height.calibration import Calibration
from sal_height.geometry import Grid
from sal_height.numeric import C64
from sal_height.runs.irf_picture import decibels

mpl.use("Agg")


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
