"""Compiled loops over pixels of the tests of a dwell's data.

Each has a twin in plain NumPy in the tests. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

import numpy as np

from sal_height.elevation.array._beside_kernels import Numbers
from sal_height.numeric import F64, Bool, Index, compiled

LOWEST, HIGHEST, BINS = -1.0, 3.0, 256
"""Gains that are distinguished, and number of bins for them: the first and the last have all beyond."""


@compiled
def levels_of_noise(
    power: F64,
    explained: F64,
    beside: F64,
    count: F64,
    finite: Bool,
    channels: int,
    error: float,
    usual: tuple[float, float],
    levels: F64,
) -> int:
    """Noise levels of the pixels with one scatterer: what it leaves, over the median of noise of power 1.

    Args:
        power: power of the pixels, sum over looks and M channels, noise powers, (pixels,).
        explained: power that a scatterer explains.
        beside: power that one more would explain.
        count: K.
        finite: False for pixels that do not count.
        channels: M.
        error: greatest fraction of the explained power that errors of the beams leave.
        usual: greatest `beside` of a pixel with one scatterer in noise of power 1: line over K, value at 0 and slope.
        levels: levels to fill in, in the order of the pixels, (pixels,).

    Returns:
        The number of levels.
    """
    found = 0
    for i in range(len(power)):
        order = (channels - 1) * count[i] - 0.5
        left = power[i] - (1 + error) * explained[i]
        if finite[i] and 0 < beside[i] <= left / order * (usual[0] + usual[1] * count[i]):
            levels[found] = left / (order - 1 / 3)  # the median of a gamma distribution, to 1e-3
            found += 1
    return found


@compiled
def gather_gains(
    matrices: Numbers,
    pixels: Index,
    squints: Index,
    position: F64,
    pieces: Numbers,
    explained: F64,
    looks: F64,
    least: tuple[float, float],
    weights: F64,
    sums: F64,
) -> None:
    """Gains of every channel in some pixels, as the sum of their weights in bins.

    With the unit response u and w = u - u_m e_m, which is without channel m, the other channels estimate the amplitudes
    of the looks as w^H g / |w|^2, and their power, without the noise in it, as S = w^H R w / |w|^2 - K. Of it channel m
    should have the part |u_m|^2 S in common with them; it has u_m^* e_m^H R w. The weight of the ratio of both is the
    square root of that part, which is the part over the deviation of the noise in it.

    Args:
        matrices: R, (pixels, M, M).
        pixels: numbers of some of these pixels, (n,).
        squints: number of the squint of each, (n,).
        position: position of the scatterer in steps of the table, (n,).
        pieces: cubics of the table of unit responses, (squints, table nodes - 1, 4, M).
        explained: u^H R u, (n,).
        looks: K times the noise power of a look, (n,).
        least: least part |u_m|^2, and least S / K, for a channel of a pixel to count.
        weights: sum of the weights in every bin, to add to, (M, BINS).
        sums: sum of the squares of the weights, and number of pixels, to add to, (2, M).
    """
    size, last = matrices.shape[1], pieces.shape[1] - 1
    unit, per_bin = np.empty(size, pieces.dtype), BINS / (HIGHEST - LOWEST)
    for i in range(len(pixels)):
        matrix, node = matrices[pixels[i]], min(int(position[i]), last)
        piece, t = pieces[squints[i], node], np.float32(position[i] - node)
        for m in range(size):
            unit[m] = piece[0, m] + t * (piece[1, m] + t * (piece[2, m] + t * piece[3, m]))
        for m in range(size):
            part = (np.conj(unit[m]) * unit[m]).real
            if part < least[0] or 1 - part < least[0]:
                continue
            row, output = matrix[m], unit.dtype.type(0)
            for n in range(size):
                output += row[n] * unit[n]
            shared, own = (np.conj(unit[m]) * output).real, part * row[m].real
            signal = (explained[i] - 2 * shared + own) / (1 - part) - looks[i]
            if signal < least[1] * looks[i]:
                continue
            place = ((shared - own) / (part * signal) - LOWEST) * per_bin
            weights[m, int(min(max(place, 0.0), BINS - 1.0))] += np.sqrt(part * signal)
            sums[0, m] += part * signal
            sums[1, m] += 1


@compiled
def median_gains(weights: F64, sums: F64, found: F64) -> None:
    """Median of the gains of each channel, its standard deviation, and the number of pixels, into `found`, (3, M).

    The standard deviation is that of the median of normal deviates whose quartiles are as far from each other. Gains
    are spread evenly within their bin. Arguments as in `gather_gains`.
    """
    of_quartiles, bin_width = 1.349, (HIGHEST - LOWEST) / BINS  # distance of quartiles for a standard deviation of 1
    for m in range(len(weights)):
        total, reached, below = np.sum(weights[m]), 0, 0.0
        quartiles = np.zeros(3)
        for b in range(BINS):
            above = below + weights[m, b]
            while reached < 3 and weights[m, b] > 0 and above >= 0.25 * (reached + 1) * total * (1 - 1e-12):
                quartiles[reached] = LOWEST + bin_width * (b + (0.25 * (reached + 1) * total - below) / weights[m, b])
                reached += 1
            below = above
        width = (quartiles[2] - quartiles[0]) / of_quartiles
        found[0, m] = quartiles[1]
        found[1, m] = np.sqrt(np.pi / 2 * sums[0, m]) * width / max(total, 1e-300)
        found[2, m] = sums[1, m]
