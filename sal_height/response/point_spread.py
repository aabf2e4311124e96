"""The complex point-spread function, from the range and the azimuth response (PSF paper, figures 25 and 26)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from sal_height.numeric import C128, F64, Index, ShortRepr
from sal_height.response.impulse import OVERSAMPLING, CutResponse, band_frequencies, cut_response
from sal_height.response.transfer_function import AxisTransfer, TransferFunction

FINENESS = 4  # samples per pixel of the function as it is drawn, those of the paper


@dataclass(frozen=True)
class Sidelobe:
    """A sidelobe greater than those nearer to the peak, which a smooth response does not have.

    A ripple of n periods in all frequencies makes a pair of them n pixels to both sides (paired echoes).

    Attributes:
        position: signed distance from the peak, pixels.
        level_db: power over that of the peak, dB.
        significance: amplitude less that of the sidelobes nearer to the peak, in standard errors.
    """

    position: float
    level_db: float
    significance: float


@dataclass(frozen=True)
class AxisSpread:
    """The point-spread function along one axis: widths and sidelobes, and the anomalous sidelobes, greatest first."""

    cut: CutResponse
    sidelobes: tuple[Sidelobe, ...]


@dataclass(frozen=True, eq=False)
class PointSpread(ShortRepr):
    """The response to a point, and its figures along range and azimuth.

    Attributes:
        pixels: response, complex128, FINENESS samples per pixel, 1 in the middle, at row rows * FINENESS / 2 and column
            cols * FINENESS / 2; shape (rows * FINENESS, cols * FINENESS).
        range: figures along range.
        azimuth: figures along azimuth.
    """

    pixels: C128
    range: AxisSpread
    azimuth: AxisSpread


def estimate_point_spread(transfer: TransferFunction) -> PointSpread:
    """The point-spread function of a system with that transfer function, and its figures."""
    axes = transfer.range, transfer.azimuth
    down, across = (cut_through(axis.response, FINENESS) for axis in axes)
    return PointSpread(np.asarray(np.outer(down, across)), *map(_axis_spread, axes))


def cut_through(response: C128, fineness: int) -> C128:
    """The point-spread function along an axis: the response's transform, with zeros outside its band.

    Args:
        response: response from -1/2 cycle per pixel on, shape (count,).
        fineness: samples per pixel.

    Returns:
        complex128, shape (count * fineness,); the peak is in the middle.
    """
    count = len(response)
    spectrum = scipy.fft.ifftshift(response)
    padded = np.zeros(count * fineness, dtype=np.complex128)
    padded[band_frequencies(np.abs(spectrum) ** 2) % len(padded)] = spectrum
    return scipy.fft.fftshift(scipy.fft.ifft(padded)) * fineness


def anomalous_sidelobes(response: C128, sigma: F64) -> tuple[Sidelobe, ...]:
    """Sidelobes that stand above the ones nearer to the peak, from the greatest on.

    Those of a smooth response fall, or stay equal, from the peak outwards; the cause of one that rises above both its
    neighbours, and above the median of the three before it by 3.5 standard errors, is a ripple of the response. Both
    sides are searched together, in the root of their mean power. An echo adds to the sidelobes that are there without
    it, so that its level and position are those of the sum.

    Args:
        response: response as in `cut_through`.
        sigma: standard errors of its bins, shape (count,).
    """
    fine = np.abs(cut_through(response, OVERSAMPLING))
    middle = len(fine) // 2
    sides = {1: fine[middle:], -1: fine[middle:0:-1]}
    both = np.sqrt(np.mean(np.square(list(sides.values())), axis=0))
    error = float(np.sqrt(np.sum(sigma**2) / 2) / len(sigma))
    tops = np.concatenate([[0], _tops(both)])
    levels, half = both[tops], OVERSAMPLING // 2
    found = []
    for i in _tops(np.append(levels, 0.0)):
        usual = float(np.quantile(levels[max(0, i - 3) : i], 0.5, method="lower"))
        excess = float(levels[i] - usual)
        if excess <= 3.5 * error:
            continue
        for sign, side in sides.items():
            near = slice(max(0, tops[i] - half), tops[i] + half + 1)  # up to half a pixel from the mean of both
            place = near.start + int(np.argmax(side[near]))
            if side[place] > usual:
                level = 20 * float(np.log10(side[place]))
                found.append(Sidelobe(sign * place / OVERSAMPLING, level, excess / error if error else float("inf")))
    return tuple(sorted(found, key=lambda one: -one.level_db))


def _tops(amplitude: F64) -> Index:
    """Indices of the local maxima inside."""
    return np.flatnonzero((amplitude[1:-1] > amplitude[:-2]) & (amplitude[1:-1] >= amplitude[2:])) + 1


def _axis_spread(axis: AxisTransfer) -> AxisSpread:
    power = np.abs(cut_through(axis.response, OVERSAMPLING)) ** 2
    return AxisSpread(cut_response(power, len(power) // 2), anomalous_sidelobes(axis.response, axis.sigma))
