"""The impulse response of an image along range and azimuth: how scatterers contribute to the pixels around them.

A window w over the band gives a scatterer at a distance of x cells the response h(x), the Fourier transform of w. Noise
and speckle of neighbouring pixels are correlated by the Fourier transform of w^2; the sidelobes of h let bright ground
appear in shadow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sal_height.numeric import F64, window

NODES = 1024
"""Samples of the band at which windows are evaluated; the response within REACH hardly depends on their number."""

REACH = 64
"""Pixels to each side up to which sidelobes are counted; 0.2 % of the energy is beyond with the rectangular window."""


@dataclass(frozen=True)
class AxisResponse:
    """The response along one axis of an image.

    Attributes:
        window: window over the band, a name in `numeric.WINDOWS`.
        spacing: spacing of the pixels, cells of the unweighted resolution.
    """

    window: str
    spacing: float

    def likeness(self, count: int) -> F64:
        """|rho|^2 of the noise, and of the speckle, of pixels at distances of 0, 1, ... count - 1 pixels."""
        squares = window(self.window, NODES) ** 2
        return _transform(squares / squares.sum(), self.spacing * np.arange(count, dtype=np.float64)) ** 2

    def fractions(self) -> tuple[F64, F64]:
        """Fraction of a scatterer's energy in each pixel from -REACH to REACH, and the part of it in the main lobe.

        The scatterer is anywhere in pixel 0. The fractions of all pixels have the sum 1.
        """
        return _fractions(self.window, self.spacing)

    def position_error(self, count: int) -> F64:
        """Covariance (pixels squared) of the unknown position of speckle, at distances of 0, 1, ... count - 1 pixels.

        A pixel is the sum g = sum_j c_j h(x_j) of scatterers with random phases; let d = sum_j c_j h(x_j) x_j. Over the
        looks k of a pixel the position of the speckle about the power-weighted mean of the looks' positions is

            Re(sum_k d_k g_k*) / sum_k |g_k|^2

        The covariance of Re(d_k g_k*) in two looks is (D G - C^2) / 2 with the correlations D of d, G of g and C of d
        with g, which is odd. They follow from the main lobe of h; G is 1 in one look.
        """
        return _position_error(self.window, self.spacing, count)


@dataclass(frozen=True)
class CellResponse:
    """The response of an image: the product of those along its two axes.

    Attributes:
        down: response along range.
        across: response along azimuth.
        pedestal: fraction of a scatterer's energy in each pixel along azimuth, caused by random phase errors of pulses.
    """

    down: AxisResponse
    across: AxisResponse
    pedestal: float = 0.0


@lru_cache(maxsize=64)
def _fractions(name: str, spacing: float) -> tuple[F64, F64]:
    per_pixel = 8  # samples of the response, over which a scatterer's position in its pixel is averaged
    steps = np.arange(-REACH * per_pixel, (REACH + 1) * per_pixel) + 0.5
    offset = np.abs(steps / per_pixel - 0.5) * spacing
    amplitude = _transform(window(name, NODES) / NODES, offset)
    energy = amplitude**2
    # The main lobe ends where the response is 0 for the first time.
    first_null = offset[(amplitude <= 0)].min(initial=offset.max())
    parts = np.stack([energy, np.where(offset < first_null, energy, 0.0)])
    whole, main_lobe = parts.reshape(2, -1, per_pixel).sum(axis=-1) / energy.sum()
    return whole, main_lobe


@lru_cache(maxsize=64)
def _position_error(name: str, spacing: float, count: int) -> F64:
    cells = np.arange(-4.0, 4.0, 1 / 128)
    amplitude = _transform(window(name, NODES) / NODES, cells)
    response = np.where(np.abs(cells) < np.abs(cells[amplitude <= 0]).min(), amplitude, 0.0)
    moment = response * cells / spacing
    shifts = spacing * np.arange(count, dtype=np.float64)
    moved, moved_moment = (
        np.stack([np.interp(cells + shift, cells, values, 0.0, 0.0) for shift in shifts])
        for values in (response, moment)
    )
    energy = response @ response
    error = (moved @ response) * (moved_moment @ moment) + (moved_moment @ response) * (moved @ moment)
    return np.asarray(error / energy**2 / 2, dtype=np.float64)


def _transform(weights: F64, cells: F64) -> F64:
    """Fourier transform of symmetric weights over the band at distances in cells."""
    position = (np.arange(len(weights)) - (len(weights) - 1) / 2) / len(weights)
    return np.cos(2 * np.pi * np.multiply.outer(cells, position)) @ weights
