"""The complex point-spread function, from the range and the azimuth response (PSF paper, figures 25 and 26)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from sal_height.numeric import C128, F64, Index
from sal_height.response.impulse import OVERSAMPLING, CutResponse, band_frequencies, cut_response
from sal_height.response.transfer_function import TransferFunction

FINENESS = 4
"""Samples per pixel of the function as it is drawn, those of the paper."""

NEIGHBOURS = 3
"""Sidelobes nearer to the peak whose median a sidelobe is compared with."""

SIGNIFICANT = 3.5
"""Standard errors by which an anomalous sidelobe stands above that."""


@dataclass(frozen=True)
class Sidelobe:
    """A sidelobe greater than those nearer to the peak, which a smooth response does not have.

    A ripple of n periods in all frequencies makes a pair of them n pixels to both sides (paired echoes).

    Attributes:
        position: pixels from the peak, signed.
        level_db: its power over that of the peak.
        significance: its amplitude less that of the sidelobes nearer to the peak, in standard errors.
    """

    position: float
    level_db: float
    significance: float


@dataclass(frozen=True)
class PointSpread:
    """The response to a point.

    Attributes:
        pixels: complex128, FINENESS samples per pixel, 1 in the middle, at row rows * FINENESS / 2 and the column
            alike; shape (rows * FINENESS, cols * FINENESS).
        range_cut: widths and sidelobes along range.
        azimuth_cut: along azimuth.
        range_sidelobes: the anomalous ones along range, from the greatest on.
        azimuth_sidelobes: along azimuth.
    """

    pixels: C128
    range_cut: CutResponse
    azimuth_cut: CutResponse
    range_sidelobes: tuple[Sidelobe, ...]
    azimuth_sidelobes: tuple[Sidelobe, ...]


def estimate_point_spread(transfer: TransferFunction) -> PointSpread:
    """The point-spread function of a system with that transfer function, and its figures."""
    down = cut_through(transfer.range_response, FINENESS)
    across = cut_through(transfer.azimuth_response, FINENESS)
    return PointSpread(
        pixels=np.asarray(np.outer(down, across)),
        range_cut=_measured(transfer.range_response),
        azimuth_cut=_measured(transfer.azimuth_response),
        range_sidelobes=anomalous_sidelobes(transfer.range_response, transfer.range_sigma),
        azimuth_sidelobes=anomalous_sidelobes(transfer.azimuth_response, transfer.azimuth_sigma),
    )


def cut_through(response: C128, fineness: int) -> C128:
    """The point-spread function along an axis: the response's transform, with zeros beside its band.

    Args:
        response: from -1/2 cycle per pixel on, shape (count,).
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

    Those of a smooth response fall, or stay alike, from the peak outwards; what makes one rise above both its
    neighbours, and above the median of the NEIGHBOURS before it by SIGNIFICANT standard errors, is a ripple of the
    response. Both sides are searched together, in the root of their mean power. An echo adds to the sidelobes that are
    there without it, so that its level and its place are those of the sum.

    Args:
        response: as in `cut_through`.
        sigma: standard errors of its bins, shape (count,).
    """
    fine = np.abs(cut_through(response, OVERSAMPLING))
    middle = len(fine) // 2
    sides = np.stack([fine[middle:], fine[middle:0:-1]])
    both = np.sqrt(np.mean(sides**2, axis=0))
    error = float(np.sqrt(np.sum(sigma**2) / 2) / len(sigma))
    tops = np.concatenate([[0], _tops(both)])
    levels = both[tops]
    found = []
    for i in _tops(np.append(levels, 0.0)):
        usual = float(np.quantile(levels[max(0, i - NEIGHBOURS) : i], 0.5, method="lower"))
        excess = float(levels[i] - usual)
        if excess > SIGNIFICANT * error:
            significance = excess / error if error else float("inf")
            found += [
                Sidelobe(sign * position / OVERSAMPLING, 20 * float(np.log10(side[position])), significance)
                for sign, side in zip((1, -1), sides, strict=True)
                for position in [_top_near(side, tops[i])]
                if side[position] > usual
            ]
    return tuple(sorted(found, key=lambda one: -one.level_db))


def _tops(amplitude: F64) -> Index:
    """Indices of the local maxima inside."""
    return np.flatnonzero((amplitude[1:-1] > amplitude[:-2]) & (amplitude[1:-1] >= amplitude[2:])) + 1


def _top_near(amplitude: F64, index: int) -> int:
    """Index of the greatest value up to half a pixel from an index."""
    first = max(0, index - OVERSAMPLING // 2)
    return int(first + np.argmax(amplitude[first : index + OVERSAMPLING // 2 + 1]))


def _measured(response: C128) -> CutResponse:
    power = np.abs(cut_through(response, OVERSAMPLING)) ** 2
    return cut_response(power, len(power) // 2)
