"""The noise floor of pixels that hold power of others: sidelobes everywhere, and the edge of a shadow.

What a pixel holds of scatterers elsewhere follows from the impulse response and the image itself. Sidelobes of all
scatterers together are weak in windowed images, but in a shadow they are all there is. Main lobes reach into the next
pixel only: on lit ground that is what an image's resolution means, but the first pixel of a shadow has no other power.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import fdtri

from sal_height.elevation.looks._look_kernels import find_edges
from sal_height.elevation.looks.look_windows import AxisLooks, Bands
from sal_height.numeric import F64, Bool

SPECKLE_RATE = 0.003
"""Share of pairs of pixels of level ground whose speckle differs as much as shadow and what is beside it.

A pixel has 12 ordered pairs of neighbours; of those that lie between such a pair only the weak ones lose by it.
"""


def foreign_power(power: F64, mean_power: F64, noise: float, down: AxisLooks, across: AxisLooks, deviation: F64) -> F64:
    """Expected power of scatterers elsewhere in each pixel, mean of its looks, shape of `mean_power`.

    Args:
        power: of each sample over all channels, shape (rows, cols) of samples.
        mean_power: of each pixel, mean of its looks, shape (rows, cols) of pixels.
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
    """Pixels that have a dark and a bright neighbour, farther apart than speckle and noise; shape of `power`.

    Of noise one standard deviation counts on either side.

    Args:
        power: of pixels without that of noise, shape (rows, cols).
        down: looks along range.
        across: looks along azimuth.
        deviation: of the noise's power, same shape as `power`.
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
