"""The greatest value of w^H R w over elevation, where R is a pixel's covariance and w the weights for that elevation.

It is searched on a grid, as one matrix product for all pixels, and climbed from there between the nodes of a table of
w. Both take the beams as they are: of any pattern, complex or not, turned, or averaged over the flight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from sal_height.beams import Beams
from sal_height.elevation.looks import Covariance, Covariances
from sal_height.errors import UserError
from sal_height.numeric import F32, F64, Index, compiled, in_parallel, inlined

Objective = Callable[[F64, F64], tuple[F64, F64]]
"""Weights and their slope from response and slope of the beams, all real and of the shape (..., detectors)."""

Columns = slice | Index

PIXELS_OF_THREAD = 2048
"""Pixels that are worth a thread."""

GRID_STEP = 0.2
"""Spacing of the coarse search in beamwidths: a fifth of the shortest period of the objective's numerator."""

TABLE_STEPS = 6
"""Of the table of weights in each step of the grid."""

NEAR_HIGHEST = float(np.cos(1.5 * np.pi * GRID_STEP / 2) ** 2)
"""Share of the grid's greatest value from which on a peak is climbed.

A function between 0 and 1 with periods of P or more is cos^2(pi x / P) or more at x from where it is 1 (M. Riesz), and
the nearest node is half a step from the highest peak at most. P is 1 beamwidth; 1.5 leaves room for the denominator,
which varies beyond the array. Of 48 000 pixels at 0 to 20 dB none missed its highest peak, where the highest node
alone would have missed 0.8 %.
"""

BETWEEN_NODES = 1 / (2 * NEAR_HIGHEST - 1)
"""Greatest range of an objective over its range on the grid: a function between 0 and 1 reaches NEAR_HIGHEST and
1 - NEAR_HIGHEST at nodes. Where an objective is negative on the grid, this bounds it from below between the nodes."""

ROUNDING = 1e-5
"""Share of the greatest value below 0 that a positive objective may have on the grid: the error of its float32 sums."""

NO_PEAK = -1e300
"""Height of a peak that is not there: less than any objective, and finite as compiled loops take all numbers to be."""

SETTLED = 0.1
"""Newton step, in steps of the table, that is the last: the next would move the peak by 1e-5 beamwidths at most."""

MOST_STEPS = 40
"""Of a climb; if all halve the bracket, that is the end of float64."""

TILE = 4
"""Pixels, and entries of their matrices, that are multiplied at a time."""

SQUINTS_MORE = 14
"""Of the squints that stand for many, beyond pi for each beamwidth: leaves an error of 1e-9."""

PIXELS_AT_ONCE = 2048
"""Pixels whose covariance and objective are held at a time: what fits into a processor's cache."""


class Peaks(NamedTuple):
    """The highest peak of the objective in each pixel; arrays of the shape (pixels,).

    Attributes:
        elevation: of the peak, rad; the end of the domain where the objective still rises there.
        height: value of the objective there.
        second: value of the objective at the second highest peak; NO_PEAK where there is none.
    """

    elevation: F64
    height: F64
    second: F64


@dataclass(frozen=True)
class PeakSearch:
    """All that a search for the greatest w^H R w needs to know of the beams, at one squint.

    Complex beams of M detectors are real ones of 2 M, of the real and the imaginary parts.

    Attributes:
        first: lowest elevation searched, rad.
        step: of the table, rad; the grid takes every TABLE_STEPS-th node.
        entries: places of the upper triangle in a flattened matrix, and first places again up to a multiple of TILE.
        grid: products w_m w_n at each node of the grid, those of m < n doubled, shape (entries, grid nodes); 0 where
            `entries` repeats itself.
        pieces: cubic polynomials for w from node to node of the table (Hermite: w and w' are exact at the nodes),
            coefficients of rising powers, shape (table nodes - 1, 4, detectors). For the aperture's beams, whose
            shortest period is 2 beamwidths, the error is 5e-8 in w and 5e-6 per beamwidth in w'.
        power: such polynomials for |a|^2, shape (table nodes - 1, 4).
        complex_beams: whether w stands for complex numbers.
    """

    first: float
    step: float
    entries: Index
    grid: F32
    pieces: F32
    power: F32
    complex_beams: bool

    @classmethod
    def of(cls, nodes: F64, response: F64, slope: F64, objective: Objective) -> Self:
        """The search on a table whose `nodes` (rad) hold the beams' response and slope, shape (nodes, detectors)."""
        step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
        response, slope, complex_beams = _as_real(response), _as_real(slope), np.iscomplexobj(response)
        weight, weight_slope = objective(response, slope)
        power, power_slope = np.sum(response**2, axis=-1), 2 * np.sum(response * slope, axis=-1)
        coarse = weight[::TABLE_STEPS]
        m, n = np.triu_indices(coarse.shape[1])
        products = coarse[:, m] * coarse[:, n] * np.where(m == n, 1, 2)
        beyond = (0, -len(m) % TILE)
        return cls(
            first=float(nodes[0]),
            step=step,
            entries=np.pad(m * coarse.shape[1] + n, beyond),
            grid=np.ascontiguousarray(np.pad(products.T, (beyond, (0, 0))), dtype=np.float32),
            pieces=np.ascontiguousarray(_hermite(weight, weight_slope * step), dtype=np.float32),
            power=np.ascontiguousarray(_hermite(power, power_slope * step), dtype=np.float32),
            complex_beams=complex_beams,
        )

    def peaks(self, covariance: Covariance, margin: float = 0.0) -> Peaks:
        """Find the highest peak of the objective in the search domain, and how high the second one is.

        Runs in the calling thread alone.

        Args:
            covariance: matrices of the quadratic forms, shape (pixels, channels, channels); complex if the beams are.
                They need not be positive.
            margin: the second peak is looked for among those that lie lower by the objective of a scatterer of this
                power at most, in the unit of the covariance.

        Raises:
            UserError: the beams are complex and the covariance is not.
        """
        position, height, second = np.empty((3, len(covariance)))
        margin *= float(np.max(np.sum(self.pieces[:, 0].astype(np.float64) ** 2, axis=-1)))
        for begin in range(0, len(covariance), PIXELS_AT_ONCE):
            block = slice(begin, begin + PIXELS_AT_ONCE)
            matrices = self._real(covariance[block])
            values = _on_grid(matrices, self.entries, self.grid)
            found = position[block], height[block], second[block]
            _climb_highest(matrices, values, np.float32(margin), self.pieces, found)
        return Peaks(self.first + self.step * position, height, second)

    def fit(self, covariance: Covariance, elevation: F64) -> F64:
        """What one scatterer at `elevation` (rad, (pixels,)) makes of some pixels, shape (3, pixels); NaN of NaN.

        What it explains of the power, w^H R w / |w|^2; |a|^2; and D / |a|^2 (`bounds.information`), in 1/rad^2 how fast
        the direction of w turns. Elevations beyond the domain count as its ends.
        """
        position = np.clip((elevation - self.first) / self.step, 0.0, len(self.pieces))
        found = np.empty((3, len(position)))
        known = np.isfinite(position)
        place = np.where(known, position, 0.0)
        _fit(self._real(covariance), place, self.pieces, self.power, self.complex_beams, found)
        found[2] /= self.step**2
        found[:, ~known] = np.nan
        return found

    def on_grid(self, covariance: Covariance) -> F32:
        """Objective of some pixels at every node of the grid, (pixels, grid nodes); errors and threads as `peaks`."""
        return _on_grid(self._real(covariance), self.entries, self.grid)

    def peaks_uphill(self, covariance: Covariance, nodes: Index) -> F64:
        """Elevation (rad) of the peak that lies uphill of a node of the grid, for each of some pixels.

        From the node of the highest peak on the grid it is what `peaks` finds there. Errors and threads as `peaks`.

        Args:
            covariance: shape (pixels, channels, channels).
            nodes: of the grid, one for each pixel, shape (pixels,).
        """
        position, matrices = np.empty(len(covariance)), self._real(covariance)
        _climb_uphill(matrices, _on_grid(matrices, self.entries, self.grid), self.pieces, nodes, position)
        return self.first + self.step * position

    def _real(self, covariance: Covariance) -> F32:
        """Real matrices whose quadratic form with the real weights is that of the covariance."""
        if not self.complex_beams:
            return np.ascontiguousarray(covariance.real, dtype=np.float32)
        if not np.iscomplexobj(covariance):
            raise UserError("The covariance of complex beams is real; it must be complex (multilook with hermitian).")
        real, imaginary = covariance.real, covariance.imag
        return np.ascontiguousarray(np.block([[real, -imaginary], [imaginary, real]]), dtype=np.float32)


Find = Callable[[PeakSearch, Covariance, slice, Columns], F64]


@dataclass(frozen=True)
class PeakSearches:
    """Searches over the same elevations at several squints.

    The columns of a spotlight image all have their own. Over squint the beams are as smooth as over elevation, so that
    a polynomial through a few squints (Chebyshev nodes) stands for any between them.

    Attributes:
        nodes: elevations of the table, rad.
        beams: of the channels.
        objective: what w is of the beams.
        squints: of which the searches in `stack` are, rad; empty: each is made of the beams.
        stack: grid, pieces and power of those searches, with a first axis for them.
        like: one of those searches; None: there is none.
        made: of the beams so far, by squint.
    """

    nodes: F64
    beams: Beams
    objective: Objective
    squints: F64
    stack: tuple[F32, ...]
    like: PeakSearch | None = None
    made: dict[float, PeakSearch] = field(default_factory=dict)

    @classmethod
    def over(cls, beams: Beams, squints: F64, objective: Objective, guard: float) -> Self:
        """Searches over `beams.domain(guard)` for targets at any of `squints` (distinct; angles in rad).

        Raises:
            UserError: the beams have no elevation in common.
        """
        first, last = beams.domain(guard)
        grid_steps = max(1, int(np.ceil((last - first) / (GRID_STEP * beams.beamwidth))))
        nodes = np.linspace(first, last, TABLE_STEPS * grid_steps + 1)
        each = cls(nodes, beams, objective, np.empty(0), ())
        count = SQUINTS_MORE + int(np.ceil(np.pi * np.ptp(squints) / beams.beamwidth))
        if len(squints) <= count:
            return each
        chebyshev = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        few = squints.min() + np.ptp(squints) * (1 + chebyshev) / 2
        searches = [each.at(squint) for squint in few.tolist()]
        own = [(search.grid, search.pieces, search.power) for search in searches]
        stack = tuple(np.stack(values) for values in zip(*own, strict=True))
        return replace(each, squints=few, stack=stack, like=searches[0])

    def at(self, squint: float) -> PeakSearch:
        """The search at one of the squints (rad)."""
        if self.like:
            weights = _lagrange(self.squints, squint).astype(np.float32)
            grid, pieces, power = (_weighted_sum(weights, values) for values in self.stack)
            return replace(self.like, grid=grid, pieces=pieces, power=power)
        if squint not in self.made:
            response, slope = self.beams.response(self.nodes, squint), self.beams.slope(self.nodes, squint)
            self.made[squint] = PeakSearch.of(self.nodes, response, slope, self.objective)
        return self.made[squint]

    def of_pixels(self, covariance: Covariances, squint: F64, count: int, find: Find) -> F64:
        """`count` numbers of every pixel, (count, rows, cols), which `find` gives for blocks of one squint each.

        Args:
            covariance: shape (rows, cols, channels, channels); blocks of it are asked for on all processors.
            squint: of each column, rad, shape (cols,).
            count: of numbers.
            find: gives (count, pixels) from the search, the covariance (pixels, channels, channels), and the rows and
                columns of a block.
        """
        result = np.empty((count, *covariance.shape[:2]))

        def work(search: PeakSearch, rows: slice, cols: Columns) -> None:
            pixels = covariance[rows, cols]
            found = find(search, pixels.reshape(-1, *pixels.shape[2:]), rows, cols)
            result[:, rows, cols] = found.reshape(count, *pixels.shape[:2])

        self.each(squint, covariance.shape[0], work)
        return result

    def each(self, squint: F64, rows: int, work: Callable[[PeakSearch, slice, Columns], object]) -> None:
        """Do `work` on the search, the rows and the columns of all pixels, on all processors.

        In blocks of PIXELS_AT_ONCE pixels or, where one column is more, of a column; all pixels of a block have the
        same of the squints (rad, (cols,)).
        """
        angles, angle_of = np.unique(squint, return_inverse=True)
        if len(angles) == 1:
            search, wide = self.at(float(angles[0])), min(len(squint), PIXELS_AT_ONCE)
            high = max(1, PIXELS_AT_ONCE // wide)
            blocks = list(product(range(0, rows, high), range(0, len(squint), wide)))

            def work_on(part: slice) -> None:
                for row, col in blocks[part]:
                    work(search, slice(row, min(row + high, rows)), slice(col, min(col + wide, len(squint))))

            in_parallel(work_on, len(blocks), -(-PIXELS_OF_THREAD // (high * wide)))
            return

        def work_at(part: slice) -> None:
            for index in range(part.start, part.stop):
                search, cols = self.at(float(angles[index])), np.flatnonzero(angle_of == index)
                high = max(1, PIXELS_AT_ONCE // len(cols))
                for row in range(0, rows, high):
                    work(search, slice(row, min(row + high, rows)), cols)

        in_parallel(work_at, len(angles))


def _as_real(values: F64) -> F64:
    """Complex numbers as their real parts, then their imaginary parts, along the last axis."""
    return np.concatenate([values.real, values.imag], axis=-1) if np.iscomplexobj(values) else values


def _lagrange(nodes: F64, place: float) -> F64:
    """Weights by which a polynomial through values at Chebyshev `nodes` gives its value at `place`."""
    middle, half = (nodes.max() + nodes.min()) / 2, (nodes.max() - nodes.min()) / 2
    highest = len(nodes) - 1
    at_nodes, there = (chebvander((x - middle) / half, highest) for x in (nodes, np.array([place])))
    return np.linalg.solve(at_nodes.T, there[0])


def _hermite(value: F64, slope: F64) -> F64:
    """Cubics from node to node with these values and slopes (per step) at both; (nodes - 1, 4, ...)."""
    rise, start, end = np.diff(value, axis=0), slope[:-1], slope[1:]
    return np.stack([value[:-1], start, 3 * rise - 2 * start - end, start + end - 2 * rise], axis=1)


def _weighted_sum(weights: F32, values: F32) -> F32:
    """Sum of `values` over their first axis; that of BLAS waits for threads."""
    total = np.zeros(values.shape[1:], np.float32)
    _add_weighted(weights, values.reshape(len(values), -1), total.reshape(-1))
    return total


# The loops below are compiled. Positions are in steps of the table; sums over detectors are vectorised.


@compiled
def _add_weighted(weights: F32, values: F32, total: F32) -> None:
    for k in range(len(weights)):
        weight, line = weights[k], values[k]
        for i in range(total.size):
            total[i] += weight * line[i]


@compiled
def _on_grid(matrices: F32, entries: Index, grid: F32) -> F32:
    """Objective of every pixel at every node of the grid, (pixels, grid nodes).

    A matrix product, in tiles of four pixels and four entries that stay in registers. That of BLAS takes half the
    time alone, but many times as long beside the threads that are at work here already.
    """
    pixels, size = len(matrices), matrices.shape[1] ** 2
    flat, values = matrices.reshape(pixels, size), np.zeros((pixels + TILE - 1, grid.shape[1]), np.float32)
    for i in range(0, pixels, TILE):
        r0, r1 = flat[i], flat[min(i + 1, pixels - 1)]
        r2, r3 = flat[min(i + 2, pixels - 1)], flat[min(i + 3, pixels - 1)]
        v0, v1, v2, v3 = values[i], values[i + 1], values[i + 2], values[i + 3]
        for p in range(0, entries.size, TILE):
            a, b, c, d = entries[p], entries[p + 1], entries[p + 2], entries[p + 3]
            a0, b0, c0, d0 = r0[a], r0[b], r0[c], r0[d]
            a1, b1, c1, d1 = r1[a], r1[b], r1[c], r1[d]
            a2, b2, c2, d2 = r2[a], r2[b], r2[c], r2[d]
            a3, b3, c3, d3 = r3[a], r3[b], r3[c], r3[d]
            ga, gb, gc, gd = grid[p], grid[p + 1], grid[p + 2], grid[p + 3]
            for g in range(ga.size):
                v0[g] += a0 * ga[g] + b0 * gb[g] + c0 * gc[g] + d0 * gd[g]
                v1[g] += a1 * ga[g] + b1 * gb[g] + c1 * gc[g] + d1 * gd[g]
                v2[g] += a2 * ga[g] + b2 * gb[g] + c2 * gc[g] + d2 * gd[g]
                v3[g] += a3 * ga[g] + b3 * gb[g] + c3 * gc[g] + d3 * gd[g]
    return values[:pixels]


@compiled
def _climb_highest(matrices: F32, values: F32, margin: np.float32, pieces: F32, found: tuple[F64, F64, F64]) -> None:
    """Climb from the high nodes of the grid; keep the highest peak and the height of the second.

    Args:
        matrices: of the quadratic forms, shape (pixels, detectors, detectors).
        values: of the objective on the grid, shape (pixels, grid nodes).
        margin: by which second peaks may be lower.
        pieces: of `PeakSearch`.
        found: to fill with the place of the peak in steps of the table, its height, and that of the second, (pixels,).
    """
    work, last = np.empty((3, pieces.shape[2]), np.float32), values.shape[1] - 1
    position, height, second = found
    for i in range(len(values)):
        line, top, bottom = values[i], values[i, 0], values[i, 0]
        for g in range(line.size):
            top = max(top, line[g])
            bottom = min(bottom, line[g])
        positive = bottom >= -np.float32(ROUNDING) * top
        floor = np.float32(0) if positive else top - np.float32(BETWEEN_NODES) * (top - bottom)
        enough = floor + np.float32(NEAR_HIGHEST) * (top - margin - floor)
        position[i], height[i], second[i] = 0.0, NO_PEAK, NO_PEAK
        for g in range(line.size):
            if line[g] < enough:
                continue
            rises, falls = g == 0 or line[g] >= line[g - 1], g == last or line[g] > line[g + 1]
            if not (rises and falls) and not _behind_a_dip(line, g):
                continue
            place, value = _climb(matrices[i], pieces, max(g - 1, 0), _start(line, g), min(g + 1, last), work)
            if value > height[i]:
                position[i], height[i], second[i] = place, value, height[i]
            else:
                second[i] = max(second[i], value)


@compiled
def _climb_uphill(matrices: F32, values: F32, pieces: F32, nodes: Index, position: F64) -> None:
    """Climb from one node of each pixel's grid; arguments as of `_climb_highest`."""
    work, last = np.empty((3, pieces.shape[2]), np.float32), values.shape[1] - 1
    for i in range(len(values)):
        line, g = values[i], nodes[i]
        while g < last and line[g + 1] >= line[g]:
            g += 1
        while g > 0 and line[g - 1] > line[g]:
            g -= 1
        position[i], _ = _climb(matrices[i], pieces, max(g - 1, 0), _start(line, g), min(g + 1, last), work)


@compiled
def _behind_a_dip(line: F32, g: int) -> bool:
    """Whether a higher neighbour of a node bends upwards: between peaks so near that the grid shows one only."""
    if g > 1 and line[g - 1] > line[g] and line[g - 2] + line[g] > 2 * line[g - 1]:
        return True
    return g < line.size - 2 and line[g + 1] >= line[g] and line[g + 2] + line[g] > 2 * line[g + 1]


@compiled
def _start(line: F32, g: int) -> float:
    """Vertex of the parabola through a node of the grid and its neighbours, if it is a peak; else the node itself."""
    if g == 0 or g == line.size - 1 or line[g] < line[g - 1] or line[g] < line[g + 1]:
        return float(g)
    return g + 0.5 * float(line[g + 1] - line[g - 1]) / float(2 * line[g] - line[g - 1] - line[g + 1])


@inlined
def _climb(matrix: F32, pieces: F32, low: float, start: float, high: float, work: F32) -> tuple[float, float]:
    """Place and height of the peak between two nodes of the grid, by Newton steps kept within a shrinking bracket."""
    low, place, high, height = float(low * TABLE_STEPS), start * TABLE_STEPS, float(high * TABLE_STEPS), 0.0
    for _ in range(MOST_STEPS):
        value, slope, curvature = _objective_at(place, matrix, pieces, work)
        if slope > 0:
            low = place
        else:
            high = place
        moved = 0.5 * (low + high)
        if curvature < 0 and low <= place - slope / curvature <= high:
            moved = place - slope / curvature
        height = value + 0.5 * slope * (moved - place)
        settled = abs(moved - place) < SETTLED
        place = moved
        if settled:
            break
    return place, height


@inlined
def _objective_at(place: float, matrix: F32, pieces: F32, work: F32) -> tuple[float, float, float]:
    """w^T R w, and its first and second derivative per step of the table."""
    node = min(int(place), len(pieces) - 1)
    t, two, three = np.float32(place - node), np.float32(2), np.float32(3)
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
def _fit(matrices: F32, position: F64, pieces: F32, power: F32, complex_beams: bool, found: F64) -> None:
    """See `PeakSearch.fit`; `found` of shape (3, pixels), the last per step of the table."""
    size = pieces.shape[2]
    half = size // 2
    weight, slope = np.empty(size, np.float32), np.empty(size, np.float32)
    for i in range(len(position)):
        node = min(int(position[i]), len(pieces) - 1)
        piece, t, two, three = pieces[node], np.float32(position[i] - node), np.float32(2), np.float32(3)
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
        found[1, i] = power[node, 0] + t * (power[node, 1] + t * (power[node, 2] + t * power[node, 3]))
        found[2, i] = (square - (along * along + across * across) / norm) / norm if norm > 0 else 0.0
