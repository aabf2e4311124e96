"""Measuring focused images: where the brightest target is, how wide its response, how far above the background."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.geometry import Grid

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complexfloating]

CHIP = 64
"""Side of the chip around the target, pixels."""

OVERSAMPLING = 32


@dataclass(frozen=True)
class ImpulseResponse:
    """The response of the brightest target.

    Attributes:
        position: in map, m, shape (3,).
        row_width: width at -3 dB along the rows' direction (range), m.
        col_width: width at -3 dB along the columns' direction (azimuth), m.
        peak_over_median_db: power of the peak pixel over the median of the image, dB.
    """

    position: Array
    row_width: float
    col_width: float
    peak_over_median_db: float


def measure_brightest(image: ComplexArray, grid: Grid) -> ImpulseResponse:
    """Measure the response of the brightest pixel's target, interpolated OVERSAMPLING times by Fourier zero-padding."""
    power = np.abs(image) ** 2
    peak = np.unravel_index(np.nanargmax(power), image.shape)
    starts = [int(np.clip(p - CHIP // 2, 0, max(0, n - CHIP))) for p, n in zip(peak, image.shape, strict=True)]
    row, col = (int(p) for p in peak)
    down = np.nan_to_num(image[starts[0] : starts[0] + CHIP, col])
    across = np.nan_to_num(image[row, starts[1] : starts[1] + CHIP])
    fine_row, row_width = _peak_and_width(down, row - starts[0])
    fine_col, col_width = _peak_and_width(across, col - starts[1])
    return ImpulseResponse(
        position=grid.points(starts[0] + fine_row, starts[1] + fine_col),
        row_width=row_width * grid.row_spacing,
        col_width=col_width * grid.col_spacing,
        peak_over_median_db=float(10 * np.log10(power[row, col] / np.nanmedian(power))),
    )


def _peak_and_width(cut: ComplexArray, near: int) -> tuple[float, float]:
    """Position of the peak within two pixels of `near` and its width at half power, in pixels."""
    power = np.abs(_oversample(cut)) ** 2
    first = max(0, (near - 2) * OVERSAMPLING)
    peak = first + int(np.argmax(power[first : (near + 2) * OVERSAMPLING + 1]))
    half = power[peak] / 2
    left, right = peak, peak
    while left > 0 and power[left - 1] > half:
        left -= 1
    while right < len(power) - 1 and power[right + 1] > half:
        right += 1
    before = (power[left] - half) / (power[left] - power[left - 1]) if left > 0 else 0.0
    after = (power[right] - half) / (power[right] - power[right + 1]) if right < len(power) - 1 else 0.0
    return peak / OVERSAMPLING, float(right - left + before + after) / OVERSAMPLING


def _oversample(cut: ComplexArray) -> ComplexArray:
    """Interpolate a cut; its spectrum, which may lie anywhere in the band, is first moved to the middle."""
    count = len(cut)
    spectrum = np.fft.fft(cut)
    turn = np.exp(2j * np.pi * np.arange(count) / count)
    centre = round(float(np.angle(np.sum(np.abs(spectrum) ** 2 * turn))) / (2 * np.pi) * count)
    middle = np.fft.fftshift(np.roll(spectrum, -centre))
    padding = count * (OVERSAMPLING - 1)
    padded = np.pad(middle, (padding // 2, padding - padding // 2))
    return np.asarray(np.fft.ifft(np.fft.ifftshift(padded))) * OVERSAMPLING
