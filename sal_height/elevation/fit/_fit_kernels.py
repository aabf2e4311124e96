"""Compiled loops over pixels of the tests of a dwell's data.

Each has a twin in plain NumPy in the tests. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

import numpy as np

from sal_height.elevation.array._beside_kernels import Numbers, inner
from sal_height.numeric import F64, Bool, Index, compiled, inlined, squared

LOWEST, HIGHEST, BINS = -1.0, 3.0, 256
"""Ratios that are distinguished, and number of bins for them: the first and the last have all beyond."""

MAGNIFIED = 8.0
"""Factor by which a deviation of the beams from what is expected is greater in its ratio, so that bins resolve it."""

ALIKE, NEIGHBOURS = 0, 1
"""Rows of the scores: of a wave alike in all channels, and of noise that neighbouring channels have in common."""


@compiled
def sort_pixels(
    power: F64,
    explained: F64,
    beside: F64,
    count: F64,
    elevation: F64,
    finite: Bool,
    channels: int,
    noise: float,
    error: float,
    usual: tuple[float, float],
    span: tuple[float, float],
    levels: F64,
    chosen: Index,
) -> tuple[int, int]:
    """Noise level of each pixel, and the pixels whose scatterer is within the array.

    A pixel's level is what its scatterer leaves, over the median of noise of power 1; it is negative where there seem
    to be more scatterers than one. All shapes are (rows, cols).

    Args:
        power: power of the pixels, sum over looks and M channels.
        explained: power that a scatterer explains, noise powers.
        beside: power that one more would explain.
        count: K.
        elevation: elevation of the scatterer, rad.
        finite: False for pixels that do not count.
        channels: M.
        noise: noise power of a look.
        error: greatest fraction of the explained power that errors of the beams leave.
        usual: greatest `beside` of a pixel with one scatterer in noise of power 1: line over K, value at 0 and slope.
        span: elevations of the ends of the array, rad.
        levels: levels to fill in; 0 where the pixel does not count.
        chosen: numbers of the pixels within the array to fill in, (pixels,).

    Returns:
        The numbers of pixels that count, and of those within the array.
    """
    rows, cols = power.shape
    counted, inside = 0, 0
    for i in range(rows):
        for j in range(cols):
            levels[i, j] = 0.0
            if not finite[i, j]:
                continue
            counted += 1
            order = (channels - 1) * count[i, j] - 0.5
            left = power[i, j] / noise - (1 + error) * explained[i, j]
            level = left / (order - 1 / 3)  # the median of a gamma distribution, to 1e-3
            is_single = 0 < beside[i, j] <= left / order * (usual[0] + usual[1] * count[i, j])
            levels[i, j] = level if is_single else -abs(level)
            if span[0] <= elevation[i, j] <= span[1]:
                chosen[inside] = i * cols + j
                inside += 1
    return counted, inside


@compiled
def gather_ratios(
    matrices: Numbers,
    pixels: Index,
    numbers: Index,
    squints: Index,
    elevation: F64,
    axis: tuple[float, float],
    boresights: F64,
    pieces: Numbers,
    power: Numbers,
    count: F64,
    levels: F64,
    beside: F64,
    noise: float,
    least: tuple[float, float, float],
    most_beside: float,
    ratios: F64,
    sums: F64,
    scores: F64,
) -> None:
    """Ratios of what some pixels have to what they should have, as sums of weights in bins, and scores of the noise.

    Args:
        matrices: R, (n, M, M).
        pixels: numbers of some pixels of the image, (p,).
        numbers: numbers of the same pixels among the matrices, (p,).
        squints: number of the squint of each column, (cols,).
        elevation: elevation of the scatterer of each pixel, (rows, cols), rad; as `count`, `levels` and `beside`.
        axis: first elevation of the table of unit responses, and its step, rad.
        boresights: boresights of the channels, (M,), rad.
        pieces: cubics of the table, (squints, table nodes - 1, 4, M).
        power: cubics of |a|^2, (squints, table nodes - 1, 4).
        count: K.
        levels: noise level of each pixel; positive where it has one scatterer (`sort_pixels`).
        beside: power that one more scatterer would explain, noise powers.
        noise: noise power of a look.
        least: least part |u_m|^2, and least S / K, for a channel of a pixel to count (`_add_channels`); and least S / K
            for the stretch of the beams.
        most_beside: fraction of the scatterer's power that one more may explain where the stretch of the beams is
            measured, and there does not seem to be a single one.
        ratios: sum of the weights in every bin, to add to, (2 M + 1, BINS): gains of channels, amplitudes of their
            noise, stretch of the beams.
        sums: sum of the squares of the weights, and number of pixels, to add to, (2, 2 M + 1).
        scores: sums of scores and of their variances, to add to, of pixels with several scatterers and of those with
            one, (2, 2, 2): ALIKE and NEIGHBOURS.
    """
    size, last, cols = matrices.shape[1], pieces.shape[1] - 1, elevation.shape[1]
    unit, slope, output, turn, total = np.empty((5, size), pieces.dtype)
    for i in range(len(pixels)):
        row, col = pixels[i] // cols, pixels[i] % cols
        matrix = matrices[numbers[i]]
        position = (elevation[row, col] - axis[0]) / axis[1]
        node = min(int(position), last)
        piece, strength, t = pieces[squints[col], node], power[squints[col], node], np.float32(position - node)
        for m in range(size):
            unit[m] = piece[0, m] + t * (piece[1, m] + t * (piece[2, m] + t * piece[3, m]))
            slope[m] = piece[1, m] + t * (2 * piece[2, m] + 3 * t * piece[3, m])
        # R is Hermitian: sums over its rows are side by side in memory.
        output[:] = 0
        total[:] = 0
        for n in range(size):
            line, factor = matrix[n], unit[n]
            for m in range(size):
                output[m] += np.conj(line[m]) * factor
                total[m] += line[m]
        own, whole = inner(unit, output).real, np.sum(total)
        level, looks = levels[row, col], noise * count[row, col]
        if level != 0:
            _add_scores(matrix, whole.real, unit, output, own, count[row, col], scores[int(level > 0)])
        _add_channels(matrix, unit, output, own, looks, least, ratios, sums)
        if own - looks < least[2] * looks or (level <= 0 and beside[row, col] * noise > most_beside * own):
            continue
        # The slope of a over |a| is that of u and the part along u by which |a| grows.
        grows = (strength[1] + t * (2 * strength[2] + 3 * t * strength[3])) / (
            2 * (strength[0] + t * (strength[1] + t * (strength[2] + t * strength[3])))
        )
        for m in range(size):
            offset = (elevation[row, col] - boresights[m]) / axis[1]
            turn[m] = np.float32(offset) * (slope[m] + grows * unit[m])
        _add_stretch(unit, slope, output, turn, own - looks, ratios[2 * size], sums[:, 2 * size])


@inlined
def _add_channels(
    matrix: Numbers,
    unit: Numbers,
    output: Numbers,
    own: float,
    looks: float,
    least: tuple[float, float, float],
    ratios: F64,
    sums: F64,
) -> None:
    """Add the gain of each channel that the scatterer of a pixel is in, and the noise of each that it is not in.

    With the unit response u and w = u - u_m e_m, which is without channel m, the other channels estimate the amplitudes
    of the looks as w^H g / |w|^2, and their power, without the noise in it, as S = w^H R w / |w|^2 - K. Of it channel m
    should have the part |u_m|^2 S in common with them; it has u_m^* e_m^H R w. The weight of the ratio of both is the
    square root of that part, which is the part over the deviation of the noise in it.

    A channel with a smaller part |u_m|^2, and less of the scatterer than noise, has noise: of the power that is left of
    it, (P R P)_mm with P the projection across u, K (1 - |u_m|^2) is expected. The amplitude of the noise is the square
    root of the ratio of both; its weight is 1.

    Args:
        matrix: R.
        unit: u.
        output: R u.
        own: u^H R u.
        looks: K times the noise power of a look.
        least: as in `gather_ratios`, like the others.
        ratios: sums of weights.
        sums: sums of squares, and numbers.
    """
    for m in range(unit.size):
        part = (np.conj(unit[m]) * unit[m]).real
        shared = (np.conj(unit[m]) * output[m]).real
        if part < least[0]:
            if part * own < looks:
                left = matrix[m, m].real - 2 * shared + part * own
                ratios[unit.size + m, _bin(np.sqrt(max(left, 0.0) / (looks * (1 - part))))] += 1
                sums[0, unit.size + m] += 1
                sums[1, unit.size + m] += 1
            continue
        if 1 - part < least[0]:
            continue
        alone = part * matrix[m, m].real
        signal = (own - 2 * shared + alone) / (1 - part) - looks
        if signal < least[1] * looks:
            continue
        ratio = (shared - alone) / (part * signal)
        ratios[m, _bin(ratio)] += np.sqrt(part * signal)
        sums[0, m] += part * signal
        sums[1, m] += 1


@inlined
def _add_stretch(
    unit: Numbers, slope: Numbers, output: Numbers, turn: Numbers, signal: float, ratios: F64, sums: F64
) -> None:
    """Add the stretch of the beams that a pixel shows: their width over the distance between them, less 1.

    Beams that are wider by a fraction e than assumed, or closer to each other, have the response a - e d, with
    d = (x - x_m) a'_m of channel m for a scatterer at x. Of d only the part across u and its slope shows; the rest is
    another amplitude and another elevation.

    Args:
        unit: u.
        slope: slope of u, perpendicular to it.
        output: R u.
        turn: d / |a|, changed.
        signal: power of the scatterer without noise.
        ratios: sums of weights.
        sums: sum of squares, and number.
    """
    along, across, norm = unit.dtype.type(0), unit.dtype.type(0), np.float32(0)
    for m in range(unit.size):
        along += np.conj(unit[m]) * turn[m]
        across += np.conj(slope[m]) * turn[m]
        norm += (np.conj(slope[m]) * slope[m]).real
    if norm > 0:
        across /= norm
    seen, expected = 0.0, 0.0
    for m in range(unit.size):
        rest = turn[m] - along * unit[m] - across * slope[m]
        seen -= (np.conj(rest) * output[m]).real
        expected += (np.conj(rest) * rest).real
    expected *= signal
    ratios[_bin(1 + MAGNIFIED * seen / expected)] += np.sqrt(expected)
    sums[0] += expected
    sums[1] += 1


@inlined
def _add_scores(
    matrix: Numbers,
    whole: float,
    unit: Numbers,
    output: Numbers,
    own: float,
    count: float,
    scores: F64,
) -> None:
    """Add the scores of a pixel with one scatterer: what its rest has of a pattern T of the noise, over its own level.

    Noise of the covariance 1 + r T leaves P R P of a pixel, P the projection across u. Its score tr(P R P T) has the
    expectation K tr(P T) + r K tr(P T P T), and the variance K tr(P T P T) if r is 0 (Rao's score test).

    Args:
        matrix: R.
        whole: sum of the elements of R.
        unit: u.
        output: R u.
        own: u^H R u.
        count: K.
        scores: sums of the scores less their expectation without T, and of the variances.
    """
    size, left, sum_of_unit, sum_of_output = unit.size, -own, unit.dtype.type(0), unit.dtype.type(0)
    for m in range(size):
        left += matrix[m, m].real
        sum_of_unit += unit[m]
        sum_of_output += output[m]
    level = max(left, 1e-6 * own) / ((size - 1) * count - 0.5)
    inside = (np.conj(sum_of_unit) * sum_of_unit).real / size
    common = 2 * (np.conj(sum_of_unit) * sum_of_output).real
    seen = (whole - common + inside * size * own) / size
    scores[ALIKE, 0] += seen / level - count * (1 - inside)
    scores[ALIKE, 1] += count * squared(1 - inside)
    seen, inside, spread = 0.0, 0.0, 0.0
    for m in range(size):
        beside = unit.dtype.type(0)
        if m > 0:
            beside += unit[m - 1]
        if m < size - 1:
            beside += unit[m + 1]
            pair = np.conj(unit[m]) * unit[m + 1]
            ours = (unit[m + 1] * np.conj(output[m])).real + (unit[m] * np.conj(output[m + 1])).real
            seen += 2 * (matrix[m, m + 1].real - ours + own * pair.real)
            inside += 2 * pair.real
        spread += (np.conj(beside) * beside).real
    scores[NEIGHBOURS, 0] += seen / level + count * inside
    scores[NEIGHBOURS, 1] += count * (2 * (size - 1) - 2 * spread + squared(inside))


@inlined
def _bin(ratio: float) -> int:
    return int(min(max((ratio - LOWEST) * (BINS / (HIGHEST - LOWEST)), 0.0), BINS - 1.0))


@compiled
def median_ratios(weights: F64, sums: F64, found: F64) -> None:
    """Median of the ratios of each row, its standard deviation, and the number of pixels, into `found`, (3, rows).

    The standard deviation is that of the median of normal deviates whose quartiles are as far from each other. Ratios
    are spread evenly within their bin. Arguments as in `gather_ratios`.
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


@compiled
def median_levels(levels: F64, ends: Index, found: F64) -> None:
    """Median noise level of the pixels with one scatterer, and their number, in blocks of rows and in all of them.

    Args:
        levels: noise levels, positive where there is one scatterer, (rows, cols).
        ends: first row of each block, and the end of the last one, (blocks + 1,).
        found: medians and numbers to fill in, (2, blocks + 1), those of all rows last.
    """
    flat, cols, blocks = levels.ravel(), levels.shape[1], len(ends) - 1
    some = np.empty(levels.size)
    for block in range(blocks + 1):
        first, end = (ends[0], ends[blocks]) if block == blocks else (ends[block], ends[block + 1])
        number = 0
        for i in range(first * cols, end * cols):
            some[number] = flat[i]
            number += flat[i] > 0
        found[1, block] = number
        found[0, block] = np.median(some[:number]) if number > 0 else 0.0
