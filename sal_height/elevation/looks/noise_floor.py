"""The noise floor of pixels that receive power from other pixels: through sidelobes, and at the edge of a shadow.

The power from other pixels follows from the impulse response and the image itself. The sidelobes of all scatterers are
weak in windowed images, but a shadow has no other signal. Main lobes reach into the next pixel only: on illuminated
ground that is the resolution of the image, but the first pixel of a shadow has no other power.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import fdtri

from sal_height.elevation.looks._look_kernels import find_edges
from sal_height.elevation.looks.look_windows import AxisLooks, Bands
from sal_height.numeric import F64, Bool

SPECKLE_RATE = 0.003
"""Fraction of pairs of pixels of level ground whose speckle differs as much as a shadow and its surroundings.

A pixel has 12 ordered pairs of neighbours; of the pixels between such a pair only the weak ones are affected.
"""


def foreign_power(power: F64, mean_power: F64, noise: float, down: AxisLooks, across: AxisLooks, deviation: F64) -> F64:
    """Expected power of scatterers elsewhere in each pixel, mean of its looks, shape of `mean_power`.

    Args:
        power: power of each sample over all channels, shape (rows, cols) of samples.
        mean_power: power of each pixel, mean of its looks, shape (rows, cols) of pixels.
        noise: expected power of the noise in it.
        down: looks along range.
        across: looks along azimuth.
        deviation: standard deviation of each pixel's noise power, mean of its looks and sum over channels.
    """
    if not (down.leakage and across.leakage):
        return np.zeros_like(deviation)
    sums = np.multiply.outer(down.looks.sums, across.looks.sums)

    def mean(samples: F64, along_range: Bands, along_azimuth: Bands) -> F64:
        return along_range.down(along_azimuth.across(samples)) / sums

    signal = np.maximum(power - noise, 0.0)
    near = mean(signal, down.leakage.near, across.leakage.near)
    of_neighbours = near - mean(signal, down.leakage.own, across.leakage.own)
    sidelobes = mean(signal, down.leakage.whole, across.leakage.whole) - near
    edge = is_edge_of_shadow(mean_power - noise, down, across, deviation)
    return np.maximum(sidelobes, 0.0) + np.where(edge, np.maximum(of_neighbours, 0.0), 0.0)


def is_edge_of_shadow(power: F64, down: AxisLooks, across: AxisLooks, deviation: F64) -> Bool:
    """Pixels with a dark and a bright neighbour whose powers differ more than by speckle and noise; shape of `power`.

    Noise counts with one standard deviation on either side.

    Args:
        power: power of the pixels less that of noise, shape (rows, cols).
        down: looks along range.
        across: looks along azimuth.
        deviation: standard deviation of the noise power, same shape as `power`.
    """
    edge = np.empty(power.shape, np.bool_)
    find_edges(power, _speckle_contrast(down, across), deviation, (down.apart, across.apart), edge)
    return edge


@lru_cache(maxsize=4)
def _speckle_contrast(down: AxisLooks, across: AxisLooks) -> F64:
    """Ratio of the powers of two pixels that speckle exceeds at SPECKLE_RATE, shape (rows, cols).

    The ratio of the powers of two pixels of K looks of speckle has the F distribution of 2 K and 2 K degrees.
    """
    (rows, row_of), (cols, col_of) = (np.unique(axis.count, return_inverse=True) for axis in (down, across))
    degrees = 2 * np.multiply.outer(rows, cols)
    return np.asarray(fdtri(degrees, degrees, 1 - SPECKLE_RATE)[row_of[:, None], col_of])
