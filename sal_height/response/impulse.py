"""Measuring focused images and windows: width, sidelobes and position of a point's response, and image contrast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.special import entr

from sal_height.errors import UserError
from sal_height.numeric import C128, F64, I64, WINDOWS, Bool, Complex, ShortRepr, broadening, noise_gain, window

CHIP = 256  # side of the chip around the target, pixels
OVERSAMPLING = 32  # samples per pixel of an interpolated cut
REACH = 10  # sidelobes are counted up to this many widths (at -3 dB) from the peak
NEAR = 8  # pixels around a given place where the target is searched


@dataclass(frozen=True)
class CutResponse:
    """A point's response along one axis, in the cut through its peak, at OVERSAMPLING samples per pixel.

    The main lobe lies between the first minima of power to both sides of the peak; sidelobes are the rest up to REACH
    widths from the peak. For an unweighted band pslr_db is -13.26 and islr_db -10.2; it would be -9.7 over an endless
    cut. A number is NaN if the cut is too short for it.

    Attributes:
        width: distance between the points at half the peak's power, pixels; NaN unless both are in the cut.
        pslr_db: greatest power of the sidelobes over that of the peak, dB; NaN unless the first sidelobe is whole on
            both sides.
        islr_db: energy of the sidelobes over that of the main lobe, dB; NaN unless the cut reaches REACH widths to
            both sides.
    """

    width: float
    pslr_db: float
    islr_db: float


@dataclass(frozen=True)
class ImpulseResponse:
    """The response of a target, and the contrast of the image it is in.

    With a `geometry.Grid` the position in m is grid.points(row, col), a width in m the width times the spacing.

    Attributes:
        row: row of the interpolated peak, pixels from the centre of the first row.
        col: column of the interpolated peak, pixels from the centre of the first column.
        row_cut: response along the rows' index (axis 0) through the peak.
        col_cut: response along the columns' index (axis 1) through the peak.
        peak_over_median_db: power of the target's brightest pixel over the median of the image, dB; NaN if that is 0.
        entropy: entropy of the image, - sum p ln p, with p the fraction of each finite pixel in their energy.
    """

    row: float
    col: float
    row_cut: CutResponse
    col_cut: CutResponse
    peak_over_median_db: float
    entropy: float


@dataclass(frozen=True, eq=False)
class Chip(ShortRepr):
    """Pixels around a target as a sum of waves, which has values between them too (Fourier interpolation).

    Attributes:
        start: row and column of its first pixel in the image.
        spectrum: discrete Fourier transform of its pixels, scaled to a greatest amplitude of 1, those not finite taken
            for 0; complex128, shape (rows, cols).
        frequencies: cycles per pixel of each bin along rows and along columns, in the band of the spectrum.
        finite: first and last of the pixels around the target, without a gap, that are finite; in the image's rows,
            and in its columns.
    """

    start: tuple[int, int]
    spectrum: C128
    frequencies: tuple[F64, F64]
    finite: tuple[tuple[int, int], tuple[int, int]]

    def values(self, rows: npt.ArrayLike, cols: npt.ArrayLike) -> C128:
        """Amplitude at each of `rows` and each of `cols`, fractional pixels of the image; shape (rows, cols)."""
        return np.linalg.multi_dot([self.waves(0, rows), self.spectrum, self.waves(1, cols).T])

    def power(self, rows: npt.ArrayLike, cols: npt.ArrayLike) -> F64:
        """Square of the modulus of `values`."""
        return np.abs(self.values(rows, cols)) ** 2

    def peak(self, row: int, col: int) -> tuple[float, float]:
        """Row and column of the interpolated peak, within a pixel of the brightest one and among finite pixels."""
        pixel, peak = (row, col), [float(row), float(col)]
        for axis in (0, 1, 0, 1):  # the second time after the step along the other axis
            spectrum = (self.spectrum, self.spectrum.T)[axis]
            across = self.waves(1 - axis, peak[1 - axis])[0]
            # einsum: threads of a BLAS cost more than so small a product
            line = self.waves(axis, peak[axis])[0] * np.einsum("ij,j", spectrum, across)
            first, last = self.finite[axis]
            limits = max(first, pixel[axis] - 1), min(last, pixel[axis] + 1)
            peak[axis] = float(np.clip(peak[axis] + peak_offset(line, self.frequencies[axis]), *limits))
        return peak[0], peak[1]

    def waves(self, axis: int, positions: npt.ArrayLike) -> C128:
        """Each bin's wave at positions along an axis, shape (positions, bins)."""
        pixels = np.atleast_1d(np.asarray(positions, dtype=np.float64)) - self.start[axis]
        phase = 2 * np.pi * np.outer(pixels, self.frequencies[axis])
        waves = np.empty(phase.shape, dtype=np.complex128)
        waves.real, waves.imag = np.cos(phase), np.sin(phase)  # half the time of a complex exp
        return waves / self.spectrum.shape[axis]


def measure_brightest(image: Complex, near: tuple[int, int] | None = None) -> ImpulseResponse:
    """Measure the response of the target at the brightest pixel.

    The image must be sampled more finely than its band requires: interpolation cannot undo aliasing.

    Args:
        image: complex pixels, shape (rows, cols); those that are not finite do not count.
        near: row and column of a pixel; the brightest is searched up to NEAR pixels from it, None: everywhere.

    Raises:
        UserError: no pixel there is finite and not 0.
    """
    amplitude = np.abs(image).astype(np.float64)
    amplitude[~np.isfinite(amplitude)] = np.nan
    row, col = _brightest(amplitude, near)
    power = (amplitude / amplitude[row, col]) ** 2
    median = float(np.nanmedian(power))
    chip = chip_around(image, row, col)
    fine_row, fine_col = chip.peak(row, col)
    return ImpulseResponse(
        row=fine_row,
        col=fine_col,
        row_cut=_response_along(0, chip, fine_row, fine_col),
        col_cut=_response_along(1, chip, fine_row, fine_col),
        peak_over_median_db=-10 * float(np.log10(median)) if median > 0 else float("nan"),
        entropy=float(np.nansum(entr(power / np.nansum(power)))),
    )


def chip_around(image: Complex, row: int, col: int, size: tuple[int, int] = (CHIP, CHIP)) -> Chip:
    """The chip of `size` rows and columns, or as many as there are, around a pixel that is finite and not 0."""
    first_row, first_col = (
        int(np.clip(p - count // 2, 0, max(0, n - count)))
        for p, n, count in zip((row, col), image.shape, size, strict=True)
    )
    pixels = image[first_row : first_row + size[0], first_col : first_col + size[1]].astype(np.complex128)
    finite = np.isfinite(pixels)
    pixels[~finite] = 0
    pixels /= np.abs(pixels).max()
    spectrum = np.fft.fft2(pixels)
    energy = np.abs(spectrum) ** 2
    return Chip(
        start=(first_row, first_col),
        spectrum=np.asarray(spectrum),
        frequencies=(
            band_frequencies(energy.sum(axis=1)) / energy.shape[0],
            band_frequencies(energy.sum(axis=0)) / energy.shape[1],
        ),
        finite=(
            _run(finite[:, col - first_col], row - first_row, first_row),
            _run(finite[row - first_row], col - first_col, first_col),
        ),
    )


def cut_response(power: F64, peak: int) -> CutResponse:
    """The response in a cut of power with OVERSAMPLING samples per pixel, whose peak is at index `peak`."""
    power = power / power[peak]
    width = _steps_to_half(power[peak:]) + _steps_to_half(power[peak::-1])
    falls = np.diff(power) < 0
    minima = np.flatnonzero(falls[:-1] & ~falls[1:]) + 1
    before, after = minima[minima < peak], minima[minima > peak]
    pslr_db = islr_db = float("nan")
    if np.isfinite(width) and len(before) > 1 and len(after) > 1:
        left, right = before[-1], after[0]
        first, last = peak - int(REACH * width), peak + int(REACH * width)
        sidelobes = np.concatenate([power[max(0, first) : left], power[right + 1 : last + 1]])
        pslr_db = 10 * float(np.log10(sidelobes.max()))
        if first >= 0 and last < len(power):
            islr_db = 10 * float(np.log10(sidelobes.sum() / power[left : right + 1].sum()))
    return CutResponse(width / OVERSAMPLING, pslr_db, islr_db)


@dataclass(frozen=True)
class WindowFigures:
    """Broadening, sidelobes and noise gain of a window.

    Attributes:
        response: response to a point, in resolution bins (of 1 / bandwidth) instead of pixels.
        broadening: width over that of the unweighted band.
        noise_gain: factor on the power of noise, which is the equivalent noise bandwidth, bins.
    """

    response: CutResponse
    broadening: float
    noise_gain: float


def measure_windows() -> dict[str, WindowFigures]:
    """Measure the response of each of `windows.WINDOWS` over a band of 1024 samples."""
    figures, count = {}, 1024
    for name in WINDOWS:
        weights = window(name, count)
        response = np.fft.fftshift(np.fft.fft(weights, OVERSAMPLING * count))
        cut = cut_response(np.abs(response) ** 2, OVERSAMPLING * count // 2)
        figures[name] = WindowFigures(cut, broadening(weights), noise_gain(weights))
    return figures


def _brightest(amplitude: F64, near: tuple[int, int] | None) -> tuple[int, int]:
    """Row and column of the greatest amplitude, not NaN, in all of the image or near a pixel."""
    first_row, first_col = (max(0, p - NEAR) for p in near) if near else (0, 0)
    part = amplitude[first_row : near[0] + NEAR + 1, first_col : near[1] + NEAR + 1] if near else amplitude
    if not np.any(part > 0):
        place = f"within {NEAR} pixels of row {near[0]}, column {near[1]} " if near else ""
        raise UserError(
            f"The image of {amplitude.shape[0]} x {amplitude.shape[1]} pixels has none {place}that is finite and not "
            "0; a target is one that is."
        )
    row, col = np.unravel_index(np.nanargmax(part), part.shape)
    return first_row + int(row), first_col + int(col)


def _run(finite: Bool, at: int, start: int) -> tuple[int, int]:
    """First and last index of the run of True around `at`, counted from `start`."""
    gaps = np.flatnonzero(~finite)
    before, after = gaps[gaps < at], gaps[gaps > at]
    return start + (int(before[-1]) + 1 if len(before) else 0), start + int(after[0] if len(after) else len(finite)) - 1


def band_frequencies(energy: F64) -> I64:
    """Frequencies (cycles per chip) of the bins of a spectrum: of all those a bin stands for, the one in its band.

    The band may lie anywhere on the circle of frequencies, and clutter may weigh one side of it more than the other:
    the circle is cut where the spectrum is emptiest. A spectrum without a gap is cut at half a cycle per pixel.

    Args:
        energy: energy of each bin, in the order of `numpy.fft.fft`, shape (bins,).
    """
    count = len(energy)
    # Averaged so widely that the fringes of two targets or the speckle of clutter leave no gap of their own.
    around = max(3, round(count / 32))
    smooth = uniform_filter1d(
        uniform_filter1d(np.asarray(energy, dtype=np.float64), around, mode="wrap"), around, mode="wrap"
    )
    emptiest = int(np.argmin(smooth))
    # Speckle in a chip of CHIP columns varies by 2 % there; a gap of 2 % of the sampling rate leaves 0.6.
    highest = emptiest if smooth[emptiest] < 0.8 * np.mean(energy) else (count + 1) // 2
    return (np.arange(count) - highest) % count + highest - count


def peak_offset(spectrum: C128, frequencies: F64) -> float:
    """Position of the peak of a sum of waves near pixel 0, pixels.

    Args:
        spectrum: amplitude of each wave, shape (count,).
        frequencies: frequency of each, within one cycle, cycles per pixel; shape (count,).
    """
    waves = 2j * np.pi * (frequencies - np.mean(frequencies))
    place = 0.0
    for _ in range(5):  # Newton's steps, each of which doubles the digits
        moved = spectrum * np.exp(waves * place)
        value, slope, curvature = moved.sum(), moved @ waves, moved @ waves**2
        rise = np.real(np.conj(value) * slope)
        bend = np.real(np.conj(value) * curvature) + np.abs(slope) ** 2
        place += float(np.clip(-rise / bend, -0.25, 0.25) if bend < 0 else np.copysign(0.25, rise))
    return place


def _response_along(axis: int, chip: Chip, row: float, col: float) -> CutResponse:
    """The response along an axis through the peak at `row` and `col`, as far as the adjacent pixels are finite."""
    (first, last), position = chip.finite[axis], (row, col)[axis]
    before, after = int((position - first) * OVERSAMPLING), int((last - position) * OVERSAMPLING)
    positions = position + np.arange(-before, after + 1) / OVERSAMPLING
    power = chip.power(positions, col) if axis == 0 else chip.power(row, positions)
    return cut_response(power.ravel(), before)


def _steps_to_half(power: F64) -> float:
    """Samples from the first, which is 1, to where a cut has fallen to a half; NaN if it does not."""
    below = np.flatnonzero(power <= 0.5)
    if not len(below):
        return float("nan")
    k = int(below[0])
    return k - 1 + float((power[k - 1] - 0.5) / (power[k - 1] - power[k]))
