"""Compiled loops of the searches: over elevation, and along lines of pixels.

Each has a twin in plain NumPy in the tests. Positions are in steps of the table of weights, sums over detectors or
nodes are vectorised. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F32, F64, Index, compiled, inlined

GRID_STEP = 0.2  # spacing of the coarse search, beamwidths: a fifth of the shortest period of the objective
TABLE_STEPS = 6  # steps of the table of weights in each step of the grid
TILE, PIXEL_TILE = 4, 6  # entries of the matrices, and pixels, that are multiplied at a time
NO_PEAK = -1e300  # height of a peak that does not exist: less than any objective, and finite

NEAR_HIGHEST = float(np.cos(1.5 * np.pi * GRID_STEP / 2) ** 2)
"""Least fraction of the greatest value on the grid that a node needs for a climb to start from it.

A function between 0 and 1 with periods of P or more is cos^2(pi x / P) or more at the distance x from where it is 1
(M. Riesz), and the nearest node is half a step from the highest peak at most. P is 1 beamwidth; 1.5 leaves room for
the denominator, which varies beyond the array. Of 48 000 pixels at 0 to 20 dB none missed its highest peak, where the
highest node alone would have missed 0.8 %.
"""

BETWEEN_NODES = 1 / (2 * NEAR_HIGHEST - 1)
"""Greatest range of an objective over its range on the grid: a function between 0 and 1 has values of NEAR_HIGHEST or
more and of 1 - NEAR_HIGHEST or less at nodes. This bounds an objective that is negative somewhere from below."""


@compiled
def evaluate_on_grid(matrices: F32, squints: Index, entries: Index, grid: F32) -> F32:
    """Objective of every pixel at every node of the grid, (pixels, grid nodes).

    A matrix product, in tiles of four entries and six successive pixels of one squint, which stay in registers. BLAS
    takes two thirds of the time by itself, but many times as long among the threads that work here already.

    Args:
        matrices: matrices of the quadratic forms, shape (pixels, detectors, detectors).
        squints: number of the squint of each pixel, shape (pixels,).
        entries: as in `SearchTables`.
        grid: as in `SearchTables`.
    """
    pixels, size = len(matrices), matrices.shape[1] ** 2
    flat, values = matrices.reshape(pixels, size), np.zeros((pixels + PIXEL_TILE - 1, grid.shape[2]), np.float32)
    i, spare = 0, values[pixels:]
    while i < pixels:
        alike = 1
        while alike < PIXEL_TILE and i + alike < pixels and squints[i + alike] == squints[i]:
            alike += 1
        lines, last = grid[squints[i]], i + alike - 1
        r0, r1, r2 = flat[i], flat[min(i + 1, last)], flat[min(i + 2, last)]
        r3, r4, r5 = flat[min(i + 3, last)], flat[min(i + 4, last)], flat[last]
        v0 = values[i]
        v1 = values[i + 1] if alike > 1 else spare[0]
        v2 = values[i + 2] if alike > 2 else spare[1]
        v3 = values[i + 3] if alike > 3 else spare[2]
        v4 = values[i + 4] if alike > 4 else spare[3]
        v5 = values[i + 5] if alike > 5 else spare[4]
        i += alike
        for p in range(0, entries.size, TILE):
            a, b, c, d = entries[p], entries[p + 1], entries[p + 2], entries[p + 3]
            a0, b0, c0, d0 = r0[a], r0[b], r0[c], r0[d]
            a1, b1, c1, d1 = r1[a], r1[b], r1[c], r1[d]
            a2, b2, c2, d2 = r2[a], r2[b], r2[c], r2[d]
            a3, b3, c3, d3 = r3[a], r3[b], r3[c], r3[d]
            a4, b4, c4, d4 = r4[a], r4[b], r4[c], r4[d]
            a5, b5, c5, d5 = r5[a], r5[b], r5[c], r5[d]
            ga, gb, gc, gd = lines[p], lines[p + 1], lines[p + 2], lines[p + 3]
            for g in range(ga.size):
                e, f, h, k = ga[g], gb[g], gc[g], gd[g]
                v0[g] += a0 * e + b0 * f + c0 * h + d0 * k
                v1[g] += a1 * e + b1 * f + c1 * h + d1 * k
                v2[g] += a2 * e + b2 * f + c2 * h + d2 * k
                v3[g] += a3 * e + b3 * f + c3 * h + d3 * k
                v4[g] += a4 * e + b4 * f + c4 * h + d4 * k
                v5[g] += a5 * e + b5 * f + c5 * h + d5 * k
    return values[:pixels]


@compiled
def climb_highest(
    matrices: F32, squints: Index, values: F32, margins: F32, pieces: F32, found: tuple[F64, F64, F64]
) -> None:
    """Climb from the high nodes of the grid; return the highest peak and the height of the second.

    Args:
        matrices: matrices of the quadratic forms, shape (pixels, detectors, detectors).
        squints: number of the squint of each pixel, shape (pixels,).
        values: objective on the grid, shape (pixels, grid nodes).
        margins: greatest height of the first peak above the second, (pixels,).
        pieces: as in `SearchTables`.
        found: arrays to fill with position (steps of the table) and height of the peak, and height of the second,
            (pixels,).
    """
    work, last = np.empty((3, pieces.shape[3]), np.float32), values.shape[1] - 1
    position, height, second = found
    for i in range(len(values)):
        table, margin = pieces[squints[i]], margins[i]
        line, top, bottom = values[i], values[i, 0], values[i, 0]
        for g in range(line.size):
            top = max(top, line[g])
            bottom = min(bottom, line[g])
        # The sums in float32 make a positive objective negative by 1e-5 of its greatest value at most.
        positive = bottom >= -np.float32(1e-5) * top
        floor = np.float32(0) if positive else top - np.float32(BETWEEN_NODES) * (top - bottom)
        enough = floor + np.float32(NEAR_HIGHEST) * (top - margin - floor)
        position[i], height[i], second[i] = 0.0, NO_PEAK, NO_PEAK
        for g in range(line.size):
            if line[g] < enough:
                continue
            rises, falls = g == 0 or line[g] >= line[g - 1], g == last or line[g] > line[g + 1]
            if not (rises and falls) and not is_behind_a_dip(line, g):
                continue
            there, value = _climb(matrices[i], table, max(g - 1, 0), start_of_climb(line, g), min(g + 1, last), work)
            if value > height[i]:
                position[i], height[i], second[i] = there, value, height[i]
            else:
                second[i] = max(second[i], value)


@compiled
def is_behind_a_dip(line: F32, g: int) -> bool:
    """True if a higher neighbour of a node bends upwards: between peaks so near that the grid shows one only."""
    if g > 1 and line[g - 1] > line[g] and line[g - 2] + line[g] > 2 * line[g - 1]:
        return True
    return g < line.size - 2 and line[g + 1] >= line[g] and line[g + 2] + line[g] > 2 * line[g + 1]


@compiled
def start_of_climb(line: F32, g: int) -> float:
    """Vertex of the parabola through a node of the grid and its neighbours, if it is a peak; else the node itself."""
    if g == 0 or g == line.size - 1 or line[g] < line[g - 1] or line[g] < line[g + 1]:
        return float(g)
    return g + 0.5 * float(line[g + 1] - line[g - 1]) / float(2 * line[g] - line[g - 1] - line[g + 1])


@inlined
def _climb(matrix: F32, pieces: F32, low: float, start: float, high: float, work: F32) -> tuple[float, float]:
    """Position and height of the peak between two nodes of the grid, by Newton steps within a shrinking bracket."""
    low, position, high, height = float(low * TABLE_STEPS), start * TABLE_STEPS, float(high * TABLE_STEPS), 0.0
    for _ in range(40):  # as many bisections exhaust float64
        value, slope, curvature = _objective_at(position, matrix, pieces, work)
        if slope > 0:
            low = position
        else:
            high = position
        moved = 0.5 * (low + high)
        if curvature < 0 and low <= position - slope / curvature <= high:
            moved = position - slope / curvature
        height = value + 0.5 * slope * (moved - position)
        settled = abs(moved - position) < 0.1  # steps of the table: the next would be 1e-5 beamwidths at most
        position = moved
        if settled:
            break
    return position, height


@inlined
def _objective_at(position: float, matrix: F32, pieces: F32, work: F32) -> tuple[float, float, float]:
    """w^T R w, and its first and second derivative per step of the table."""
    node = min(int(position), len(pieces) - 1)
    t, two, three = np.float32(position - node), np.float32(2), np.float32(3)
    weight, slope, bend = work[0], work[1], work[2]
    for m in range(weight.size):
        weight[m] = pieces[node, 0, m] + t * (pieces[node, 1, m] + t * (pieces[node, 2, m] + t * pieces[node, 3, m]))
    for m in range(weight.size):
        slope[m] = pieces[node, 1, m] + t * (two * pieces[node, 2, m] + three * t * pieces[node, 3, m])
    for m in range(weight.size):
        bend[m] = two * (pieces[node, 2, m] + three * t * pieces[node, 3, m])
    value, first, second = np.float32(0), np.float32(0), np.float32(0)
    for m in range(weight.size):
        output, output_slope = np.float32(0), np.float32(0)
        for n in range(weight.size):
            output += matrix[m, n] * weight[n]
            output_slope += matrix[m, n] * slope[n]
        value += weight[m] * output
        first += slope[m] * output
        second += bend[m] * output + slope[m] * output_slope
    return float(value), float(2 * first), float(2 * second)


@compiled
def fit_scatterer(
    matrices: F32, squints: Index, position: F64, pieces: F32, power: F32, complex_beams: bool, found: F64
) -> None:
    """See `PeakSearch.fit`; `found` of shape (3, pixels), the last per step of the table."""
    size = pieces.shape[3]
    half = size // 2
    weight, slope = np.empty(size, np.float32), np.empty(size, np.float32)
    for i in range(len(position)):
        node = min(int(position[i]), pieces.shape[1] - 1)
        piece, square_piece = pieces[squints[i], node], power[squints[i], node]
        t, two, three = np.float32(position[i] - node), np.float32(2), np.float32(3)
        for m in range(size):
            weight[m] = piece[0, m] + t * (piece[1, m] + t * (piece[2, m] + t * piece[3, m]))
            slope[m] = piece[1, m] + t * (two * piece[2, m] + three * t * piece[3, m])
        value, square, norm, along, across = 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(size):
            output = np.float32(0)
            for n in range(size):
                output += matrices[i, m, n] * weight[n]
            value += weight[m] * output
            norm += weight[m] * weight[m]
            square += slope[m] * slope[m]
            along += weight[m] * slope[m]
        if complex_beams:
            for m in range(half):
                across += weight[m] * slope[half + m] - weight[half + m] * slope[m]
        found[0, i] = value / norm if norm > 0 else 0.0
        found[1, i] = square_piece[0] + t * (square_piece[1] + t * (square_piece[2] + t * square_piece[3]))
        found[2, i] = (square - (along * along + across * across) / norm) / norm if norm > 0 else 0.0
