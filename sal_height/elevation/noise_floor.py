"""The noise floor of pixels that hold power of others: sidelobes everywhere, and the edge of a shadow.

What a pixel holds of scatterers elsewhere follows from the impulse response and the image itself. Sidelobes of all
scatterers together are weak in windowed images, but in a shadow they are all there is. Main lobes reach into the next
pixel only: on lit ground that is what an image's resolution means, but the first pixel of a shadow has no other power.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.special import fdtri

from sal_height.elevation.cell_response import REACH, AxisResponse, CellResponse
from sal_height.numeric import F64, Bool

SPECKLE_RATE = 0.003
"""Share of pairs of pixels of level ground whose speckle differs as much as shadow and what is beside it.

A pixel has 12 ordered pairs of neighbours; of those that lie between such a pair only the weak ones lose by it.
"""


@dataclass(frozen=True, eq=False)
class LookWeights:
    """The weights of samples in pixels along one axis.

    Attributes:
        matrix: weight of each sample in each pixel, shape (pixels, samples).
        apart: number of pixels from one to the next that shares no sample with it.
        response: along the axis.
    """

    matrix: csr_array
    apart: int
    response: AxisResponse

    def own_shares(self) -> csr_array:
        """The weight by which the main lobe of a scatterer at a sample counts in pixels that have this sample."""
        samples, (_, near) = self.matrix.shape[1], self.response.shares()
        reach = min(REACH, samples - 1)
        shares = near[REACH - reach : REACH + reach + 1]
        spread = diags_array(shares, offsets=range(-reach, reach + 1), shape=(samples, samples))
        return csr_array((self.matrix @ spread).multiply(self.matrix > 0))


def foreign_power(power: F64, down: LookWeights, across: LookWeights, count: F64, noise: F64) -> F64:
    """Expected power of scatterers elsewhere in each pixel, mean of its looks, shape (rows, cols) of pixels.

    Args:
        power: of each sample over all channels, less that of noise, shape (rows, cols) of samples.
        down: weights along range.
        across: weights along azimuth.
        count: effective number of looks, shape (rows, cols) of pixels.
        noise: standard deviation of each pixel's noise power, mean of its looks and sum over channels.
    """

    def mean(samples: F64, by_row: csr_array, by_col: csr_array) -> F64:
        return np.asarray(by_row @ (by_col @ samples.T).T) / sums

    sums = np.multiply.outer(down.matrix.sum(axis=1), across.matrix.sum(axis=1))
    signal = np.maximum(power, 0.0)
    near, sidelobes = CellResponse(down.response, across.response).spread(signal)
    of_neighbours = mean(near, down.matrix, across.matrix) - mean(signal, down.own_shares(), across.own_shares())
    edge = is_edge_of_shadow(mean(power, down.matrix, across.matrix), count, noise, (down.apart, across.apart))
    return mean(sidelobes, down.matrix, across.matrix) + np.where(edge, np.maximum(of_neighbours, 0.0), 0.0)


def is_edge_of_shadow(power: F64, count: F64, noise: F64, apart: tuple[int, int]) -> Bool:
    """Pixels that have a dark and a bright neighbour, farther apart than speckle and noise; shape of `power`.

    The ratio of the powers of two pixels of K looks of speckle has the F distribution of 2 K and 2 K degrees. Of noise
    one standard deviation counts on either side.

    Args:
        power: of pixels, shape (rows, cols).
        count: effective number of looks, same shape.
        noise: standard deviation of the noise's power, same shape.
        apart: rows and columns from a pixel to its neighbours.
    """
    (rows, cols), (high, wide) = power.shape, apart
    around = np.pad(power, [(high, high), (wide, wide)], mode="edge")
    corners = ((0, wide), (2 * high, wide), (high, 0), (high, 2 * wide))
    beside = np.stack([around[row : row + rows, col : col + cols] for row, col in corners])
    contrast = fdtri(2 * count, 2 * count, 1 - SPECKLE_RATE)
    return np.asarray(beside.max(axis=0) - noise > contrast * (beside.min(axis=0) + noise))
