"""The picture of `sal-height psf`: the panels of the PSF paper, and the reasons for what is not determined."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sal_height.numeric import C128, F64, frequencies
from sal_height.response import (
    FINENESS,
    AxisSpectrum,
    Pointing,
    PointSpread,
    PointTarget,
    PsfReport,
    estimate_transfer_function,
)

mpl.use("Agg")


CHIPS_SHOWN = 4
"""Number of targets whose chips are drawn, as in the paper."""

PHASE_KNOWN = 3.0
"""The phase of a response is drawn where its modulus exceeds so many standard errors."""

FAINTEST_DB = -50
"""Lowest level of chips and point-spread functions in the picture, dB of the peak."""

TEXT_WIDTH = 190
"""Characters in a line of the text below the panels."""


def draw_psf(report: PsfReport, title: str, reasons: Sequence[str], path: Path) -> None:
    """Write a PNG: chips, responses of targets and of speckle, point-spread function, pointing, and text.

    Args:
        report: what was measured.
        title: title of the picture.
        reasons: a sentence for each quantity that is not determined.
        path: path of the picture.
    """
    figure = Figure(figsize=(17, 16), layout="constrained")
    grid = figure.add_gridspec(4, CHIPS_SHOWN, height_ratios=(1, 1, 1, 0.45))
    panels = [[figure.add_subplot(grid[row, col]) for col in range(CHIPS_SHOWN)] for row in range(3)]
    for index, axes in enumerate(panels[0]):
        _draw_chip(axes, report.targets[index] if index < len(report.targets) else None, index)
    _draw_responses(panels[1], report)
    range_speckle, azimuth_speckle, spread_axes, pointing_axes = panels[2]
    _draw_speckle(range_speckle, "R", report)
    _draw_speckle(azimuth_speckle, "A", report)
    _draw_spread(spread_axes, report.spread)
    _draw_pointing(pointing_axes, report.pointing)
    _write_text(figure.add_subplot(grid[3, :]), report, reasons)
    figure.suptitle(title)
    figure.savefig(path, dpi=80)


def _draw_chip(axes: Axes, target: PointTarget | None, index: int) -> None:
    """Draw the power around a target (figure 3)."""
    axes.set_title(f"target {index + 1}")
    if target is None:
        _leave_blank(axes, "no target" if index == 0 else "no more targets")
        return
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
        title=f"target {index + 1}: {10 * np.log10(target.over_clutter):.1f} dB over clutter (dB of the peak)",
        xlabel="azimuth from the peak (pixels)",
        ylabel="range from the peak (pixels)",
    )
    axes.title.set_fontsize("medium")


def _draw_responses(panels: Sequence[Axes], report: PsfReport) -> None:
    """Draw modulus and phase of R (figures 6 to 10) and of A (figures 11 to 15), of each target and of all together."""
    transfer = report.transfer
    names = ("|R| of targets", "arg R of targets", "|A| of targets", "arg A of targets")
    for axes, name in zip(panels, names, strict=True):
        axes.set_title(name)
        if transfer is None:
            _leave_blank(axes, "not determined")
    if transfer is None:
        return
    own = [estimate_transfer_function([target]) for target in report.targets[:CHIPS_SHOWN]]
    for one in own if len(report.targets) > 1 else []:
        _draw_response(panels[:2], one.range.response, one.range.sigma, None)
        _draw_response(panels[2:], one.azimuth.response, one.azimuth.sigma, None)
    _draw_response(panels[:2], transfer.range.response, transfer.range.sigma, "range")
    _draw_response(panels[2:], transfer.azimuth.response, transfer.azimuth.sigma, "azimuth")


def _draw_response(panels: Sequence[Axes], response: C128, sigma: F64, axis: str | None) -> None:
    """Draw a response: with its errors, or as a thin line if it is that of a single target (`axis` is None)."""
    modulus, phase = panels
    frequency, amplitude = frequencies(len(response)), np.abs(response)
    angle = np.where(amplitude > PHASE_KNOWN * sigma, np.angle(response), np.nan)
    if axis is None:
        modulus.plot(frequency, amplitude, lw=0.6, color="0.6")
        phase.plot(frequency, angle, ".", ms=2, color="0.6")
        return
    error = sigma / np.sqrt(2)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = error / amplitude
    modulus.plot(frequency, amplitude, color="tab:blue")
    modulus.fill_between(frequency, np.maximum(0, amplitude - error), amplitude + error, alpha=0.3, color="tab:blue")
    phase.errorbar(frequency, angle, turn, fmt=".", ms=4, lw=0.8, color="tab:blue")
    modulus.set(xlabel=f"{axis} frequency (cycles per pixel)", ylim=(0, None))
    phase.set(xlabel=f"{axis} frequency (cycles per pixel)", ylabel="rad", ylim=(-np.pi, np.pi))
    for axes in panels:
        axes.grid(alpha=0.3)
        axes.set_xlim(-0.5, 0.5)


def _draw_speckle(axes: Axes, name: str, report: PsfReport) -> None:
    """Draw the modulus from speckle (figure 24) with its errors, and that from targets, both with an rms of 1."""
    axes.set_title(f"|{name}| of speckle, and of targets")
    if report.spectra is None:
        _leave_blank(axes, "not determined")
        return
    along_range = name == "R"
    spectrum: AxisSpectrum = report.spectra.range if along_range else report.spectra.azimuth
    count = report.chip[0 if along_range else 1]
    power, sigma = spectrum.unfolded(count)
    low, middle, high = (np.sqrt(np.maximum(0, power + step * sigma)) for step in (-1, 0, 1))
    axes.plot(frequencies(count), middle, color="tab:orange", label="speckle")
    axes.fill_between(frequencies(count), low, high, alpha=0.3, color="tab:orange")
    if report.transfer:
        response = report.transfer.range.response if along_range else report.transfer.azimuth.response
        scale = np.sqrt(np.mean(np.abs(response) ** 2))
        axes.plot(frequencies(count), np.abs(response) / scale, color="tab:blue", lw=0.8, label="targets")
    axes.set(xlabel=f"{'range' if along_range else 'azimuth'} frequency (cycles per pixel)", ylim=(0, None))
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def _draw_spread(axes: Axes, spread: PointSpread | None) -> None:
    """Draw the point-spread function (figure 26) and mark its anomalous sidelobes."""
    axes.set_title("point-spread function (dB of the peak)")
    if spread is None:
        _leave_blank(axes, "not determined")
        return
    rows, cols = (size / FINENESS for size in spread.pixels.shape)
    half = 0.5 / FINENESS
    shown = axes.imshow(
        _decibels(np.abs(spread.pixels)),
        extent=(-cols / 2 - half, cols / 2 - half, rows / 2 - half, -rows / 2 - half),
        vmin=FAINTEST_DB,
        vmax=0,
        cmap="magma",
        aspect="auto",
    )
    for one in spread.range.sidelobes:
        axes.plot(0, one.position, "o", mfc="none", mec="cyan", ms=12)
    for one in spread.azimuth.sidelobes:
        axes.plot(one.position, 0, "o", mfc="none", mec="cyan", ms=12)
    axes.set(xlabel="azimuth (pixels)", ylabel="range (pixels)")
    axes.figure.colorbar(shown, ax=axes)


def _draw_pointing(axes: Axes, pointing: Sequence[Pointing]) -> None:
    axes.set_title("pointing of the antenna")
    if not any(len(one.cols) for one in pointing):
        _leave_blank(axes, "not determined")
        return
    for one in pointing:
        axes.errorbar(one.cols, one.displacement, one.sigma, fmt=".", ms=4, lw=0.8)
    axes.set(xlabel="azimuth (pixels)", ylabel="Doppler centroid (cycles per pixel)")
    axes.grid(alpha=0.3)


def _write_text(axes: Axes, report: PsfReport, reasons: Sequence[str]) -> None:
    """Write the result of the test of superposition, and the reasons for what is not determined."""
    axes.axis("off")
    lines = [f"Not determined: {reason}" for reason in reasons]
    if report.linearity:
        found = report.linearity
        lines.insert(
            0,
            f"Superposition of targets and speckle: p = {found.p_value:.3g}, chi-square {found.chi_square:.1f} of "
            f"{found.freedom}, in chips of {report.linearity_rows} rows.",
        )
    text = "\n".join(textwrap.fill(line, TEXT_WIDTH, subsequent_indent="    ") for line in lines)
    axes.text(0.01, 0.98, text, va="top", ha="left", transform=axes.transAxes, fontsize=10)


def _leave_blank(axes: Axes, why: str) -> None:
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes, color="0.4")
    axes.set(xticks=[], yticks=[])


def _decibels(amplitude: F64) -> F64:
    return 20 * np.log10(np.maximum(amplitude, 1e-10))
