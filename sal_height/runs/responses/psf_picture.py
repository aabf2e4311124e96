"""The picture of `sal-height psf`: the panels of the PSF paper, and the reasons for missing ones."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sal_height.graph.picture import page
from sal_height.numeric import F64, frequencies
from sal_height.response import (
    FINENESS,
    AxisSpectrum,
    AxisTransfer,
    Pointing,
    PointSpread,
    PointTarget,
    PsfReport,
    estimate_transfer_function,
)

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


def draw_psf(report: PsfReport, title: str, reasons: Sequence[str], path: Path) -> None:
    """Write a PNG: chips, responses of targets and of speckle, point-spread function, pointing, and text.

    A quantity that is not determined has no panel, but its reason in the text.

    Args:
        report: report of the measurement.
        title: title of the picture.
        reasons: remark for each quantity that is not determined.
        path: path of the picture.
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
    chips_shown = 4  # number of targets whose chips are drawn, as in the paper
    shown = report.targets[:chips_shown]
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
    axes.set(title=f"|{letter}| of targets", ylim=(0, None))
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
    phase_known = 3.0  # standard errors that the modulus of a response must exceed for its phase to be drawn
    known = np.abs(axis.response) > phase_known * axis.sigma
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
    axes.set(title=f"|{letter}| of speckle, and of targets" if transfer else f"|{letter}| of speckle", ylim=(0, None))
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
    text_width = 135  # characters in a line of the text below the panels
    return "\n".join(textwrap.fill(line, text_width, subsequent_indent="    ") for line in lines)


def _decibels(amplitude: F64) -> F64:
    return 20 * np.log10(np.maximum(amplitude, 1e-10))
