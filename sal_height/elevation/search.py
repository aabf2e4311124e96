"""The elevation at which a quadratic form w^H R w is greatest, w the weights for that elevation, R a pixel's matrix.

The form is evaluated on a coarse grid, as one matrix product for all pixels, and climbed from there by Newton steps
between the nodes of a table of w. The beams may be of any pattern: complex, turned, or averaged over the flight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from sal_height.beams import Beams
from sal_height.elevation._kernels import (
    GRID_STEP,
    TABLE_STEPS,
    TILE,
    add_weighted,
    climb_highest,
    climb_uphill,
    evaluate_on_grid,
    fit_scatterer,
)
from sal_height.elevation._several_kernels import gain_beside_one
from sal_height.elevation.bounds import Numbers
from sal_height.elevation.looks import Covariance, Looks
from sal_height.errors import UserError
from sal_height.numeric import F32, F64, Index, in_parallel

Objective = Callable[[F64, F64], tuple[F64, F64]]
"""Gives the weights and their slope from response and slope of the beams, all real and of shape (..., detectors)."""

PIXELS_OF_THREAD = 2048  # number of pixels from which on another thread is worthwhile
PIXELS_AT_ONCE = 2048  # pixels whose covariance and objective are held at a time: they fit into a processor's cache
SEARCHES_HELD = 64  # squints whose search is held: several blocks of pixels have the same one
SPARE_SQUINTS = 14  # squints beyond pi per beamwidth from which all others are interpolated, with an error of 1e-9


class Peaks(NamedTuple):
    """The highest peak of the objective in each pixel; arrays of shape (pixels,).

    Attributes:
        elevation: of the peak, rad; the end of the domain where the objective still rises there.
        height: value of the objective there.
        second: value of the objective at the second highest peak; `NO_PEAK` where there is none.
    """

    elevation: F64
    height: F64
    second: F64


@dataclass(frozen=True, eq=False)
class PeakSearch:
    """The search at one squint.

    Attributes:
        first: lowest elevation searched, rad.
        step: of the table, rad; the grid takes every TABLE_STEPS-th node.
        entries: positions of the upper triangle in a flattened matrix, padded by zeros to a multiple of TILE.
        grid: products w_m w_n at each node of the grid, those of m < n doubled, shape (entries, grid nodes); 0 where
            `entries` is padded.
        pieces: cubic polynomials for w between the nodes of the table (Hermite: w and w' are exact at the nodes),
            coefficients of rising powers, shape (table nodes - 1, 4, detectors). For the aperture's beams, whose
            shortest period is 2 beamwidths, the error is 5e-8 in w and 5e-6 per beamwidth in w'.
        power: such polynomials for |a|^2, shape (table nodes - 1, 4).
        complex_beams: whether w stands for complex numbers: their real parts, then their imaginary parts.
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
        padding = (0, -len(m) % TILE)
        return cls(
            first=float(nodes[0]),
            step=step,
            entries=np.pad(m * coarse.shape[1] + n, padding),
            grid=np.ascontiguousarray(np.pad(products.T, (padding, (0, 0))), dtype=np.float32),
            pieces=np.ascontiguousarray(_hermite(weight, weight_slope * step), dtype=np.float32),
            power=np.ascontiguousarray(_hermite(power, power_slope * step), dtype=np.float32),
            complex_beams=complex_beams,
        )

    def peaks(self, covariance: Covariance, margin: float = 0.0) -> Peaks:
        """Find the highest peak of the objective in the search domain, and the height of the second highest.

        Runs in the calling thread alone.

        Args:
            covariance: matrices of the quadratic forms, shape (pixels, channels, channels); complex if the beams are.
                They need not be positive.
            margin: the second peak is looked for among those that lie lower by the objective of a scatterer of this
                power at most, in the unit of the covariance.

        Raises:
            UserError: the beams are complex and the covariance is not.
        """
        blocks = [covariance[i : i + PIXELS_AT_ONCE] for i in range(0, len(covariance), PIXELS_AT_ONCE)]
        parts = [self.peaks_of(block, self.on_grid(block), margin) for block in blocks]
        return Peaks(*np.concatenate([np.empty((3, 0)), *parts], axis=1))

    def peaks_of(self, covariance: Covariance, values: F32, margin: float) -> Peaks:
        """The same as `peaks` from the objective `on_grid`."""
        position, height, second = np.empty((3, len(covariance)))
        margin *= float(np.max(np.sum(self.pieces[:, 0].astype(np.float64) ** 2, axis=-1)))
        climb_highest(self._real(covariance), values, np.float32(margin), self.pieces, (position, height, second))
        return Peaks(self.first + self.step * position, height, second)

    def gain_beside(self, covariance: Covariance, values: F32, elevation: F64) -> F64:
        """What one more scatterer beside a single one would explain, in the unit of the covariance, (2, pixels).

        First at the node of the grid where that is most, second along the slope of the single one's response.

        Args:
            covariance: shape (pixels, channels, channels).
            values: of the normalised objective `on_grid`.
            elevation: of the single one, within the domain, rad, shape (pixels,).
        """
        position = np.clip((elevation - self.first) / self.step, 0.0, len(self.pieces))
        found, matrices = np.empty((2, len(covariance))), covariance if self.complex_beams else self._real(covariance)
        gain_beside_one(matrices, values, position, self.unit_pieces, self.units_across, found)
        return found

    def fit(self, covariance: Covariance, elevation: F64) -> F64:
        """Fit one scatterer at a known elevation to each pixel.

        Args:
            covariance: shape (pixels, channels, channels); complex if the beams are.
            elevation: rad, shape (pixels,); those beyond the domain count as its ends.

        Returns:
            The power that the scatterer explains, w^H R w / |w|^2; |a|^2; and how fast the direction of w turns,
            D / |a|^2 in 1/rad^2 (`bounds.information`). Shape (3, pixels); NaN where the elevation is.
        """
        position = np.clip((elevation - self.first) / self.step, 0.0, len(self.pieces))
        found = np.empty((3, len(position)))
        known = np.isfinite(position)
        place = np.where(known, position, 0.0)
        fit_scatterer(self._real(covariance), place, self.pieces, self.power, self.complex_beams, found)
        found[2] /= self.step**2
        found[:, ~known] = np.nan
        return found

    @property
    def last(self) -> float:
        """Highest elevation searched, rad."""
        return self.first + self.step * len(self.pieces)

    @cached_property
    def grid_nodes(self) -> F64:
        """Elevations of the grid, rad."""
        return self.first + self.step * TABLE_STEPS * np.arange(self.grid.shape[1], dtype=np.float64)

    @cached_property
    def unit_pieces(self) -> Numbers:
        """`pieces`, complex if the beams are, shape (table nodes - 1, 4, channels)."""
        if not self.complex_beams:
            return self.pieces
        channels = self.pieces.shape[2] // 2
        return np.ascontiguousarray(self.pieces[..., :channels] + np.complex64(1j) * self.pieces[..., channels:])

    @cached_property
    def unit_nodes(self) -> Numbers:
        """Weights at the nodes of the grid, complex if the beams are, shape (grid nodes, channels)."""
        last = self.unit_pieces[-1:].sum(axis=1)
        return np.ascontiguousarray(np.concatenate([self.unit_pieces[:, 0], last])[::TABLE_STEPS])

    @cached_property
    def units_across(self) -> Numbers:
        """`unit_nodes` with the channels first."""
        return np.ascontiguousarray(self.unit_nodes.T)

    def responses_at(self, elevation: F64) -> tuple[Numbers, Numbers, F64]:
        """Weights at elevations (rad, shape (...)) within the domain, their slopes (1/rad), and |a|^2, from the table.

        Shapes (..., channels), (..., channels) and (...); complex if the beams are.
        """
        position = np.clip((elevation - self.first) / self.step, 0.0, len(self.pieces))
        node = np.minimum(position.astype(np.intp), len(self.pieces) - 1)
        powers = (position - node)[..., None] ** np.arange(4)
        rise = np.arange(1, 4) * powers[..., :3] / self.step
        pieces = self.unit_pieces[node]
        weight = (powers[..., None, :] @ pieces)[..., 0, :]
        slope = (rise[..., None, :] @ pieces[..., 1:, :])[..., 0, :]
        return weight, slope, np.sum(powers * self.power[node], axis=-1)

    def on_grid(self, covariance: Covariance) -> F32:
        """Evaluate the objective of some pixels at all nodes of the grid, (pixels, grid nodes); errors as `peaks`."""
        return evaluate_on_grid(self._real(covariance), self.entries, self.grid)

    def peaks_uphill(self, covariance: Covariance, nodes: Index) -> F64:
        """Find the elevation (rad) of the peak uphill of a node of the grid in each pixel; errors as `peaks`.

        Args:
            covariance: shape (pixels, channels, channels).
            nodes: of the grid, one for each pixel, shape (pixels,).
        """
        position, matrices = np.empty(len(covariance)), self._real(covariance)
        values = evaluate_on_grid(matrices, self.entries, self.grid)
        climb_uphill(matrices, values, self.pieces, nodes, position)
        return self.first + self.step * position

    def _real(self, covariance: Covariance) -> F32:
        """Real matrices whose quadratic form with the real weights is that of the covariance."""
        if not self.complex_beams:
            return np.ascontiguousarray(covariance.real, dtype=np.float32)
        if not np.iscomplexobj(covariance):
            raise UserError(REAL_COVARIANCE)
        real, imaginary = covariance.real, covariance.imag
        return np.ascontiguousarray(np.block([[real, -imaginary], [imaginary, real]]), dtype=np.float32)


REAL_COVARIANCE = "The covariance of complex beams is real; it must be complex (looks with hermitian=True)."

Find = Callable[[PeakSearch, Covariance, slice, Index], F64]
"""Gives numbers (count, pixels) from the search at the pixels' squint, their covariance (pixels, channels, channels),
and the rows and columns of the image they come from."""


@dataclass(frozen=True, eq=False)
class PeakSearches:
    """Searches over the same elevations at several squints.

    Attributes:
        nodes: elevations of the table, rad.
        at: gives the search at one of the squints (rad).
    """

    nodes: F64
    at: Callable[[float], PeakSearch]

    @classmethod
    def over(cls, beams: Beams, squint: F64, objective: Objective, guard: float) -> Self:
        """Searches over `beams.domain(guard)` for targets at the `squint` of any column (angles in rad).

        The columns of a spotlight image all have squints of their own. Over squint the beams are as smooth as over
        elevation, so that a polynomial through a few of them (Chebyshev nodes) stands for any between them.

        Raises:
            UserError: the beams have no elevation in common.
        """
        squints, (first, last) = np.unique(squint), beams.domain(guard)
        grid_steps = max(1, int(np.ceil((last - first) / (GRID_STEP * beams.beamwidth))))
        nodes = np.linspace(first, last, TABLE_STEPS * grid_steps + 1)

        @lru_cache(SEARCHES_HELD)
        def exact(squint: float) -> PeakSearch:
            return PeakSearch.of(nodes, beams.response(nodes, squint), beams.slope(nodes, squint), objective)

        count = SPARE_SQUINTS + int(np.ceil(np.pi * np.ptp(squints) / beams.track_beamwidth))
        if len(squints) <= count:
            return cls(nodes, exact)
        chebyshev = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        few = squints.min() + np.ptp(squints) * (1 + chebyshev) / 2
        searches = [exact(squint) for squint in few.tolist()]
        own = [(search.grid, search.pieces, search.power) for search in searches]
        stack = tuple(np.stack(values) for values in zip(*own, strict=True))

        @lru_cache(SEARCHES_HELD)
        def interpolated(squint: float) -> PeakSearch:
            weights = _lagrange(few, squint).astype(np.float32)
            grid, pieces, power = (_weighted_sum(weights, values) for values in stack)
            return replace(searches[0], grid=grid, pieces=pieces, power=power)

        return cls(nodes, interpolated)

    def of_pixels(self, looks: Looks, count: int, find: Find) -> F64:
        """Find `count` numbers for every pixel, shape (count, rows, cols), block by block on all processors.

        `find` gives them for the pixels of a block, which all have the same squint.
        """
        result = np.empty((count, *looks.count.shape))

        def work(search: PeakSearch, rows: slice, cols: Index) -> None:
            pixels = looks.covariance[rows, cols]
            found = find(search, pixels.reshape(-1, *pixels.shape[2:]), rows, cols)
            result[:, rows, cols] = found.reshape(count, *pixels.shape[:2])

        self.each(looks.squint, len(looks.count), work)
        return result

    def each(self, squint: F64, rows: int, work: Callable[[PeakSearch, slice, Index], object]) -> None:
        """Call `work` with the search, the rows and the columns of each block of the image, on all processors.

        A block has up to PIXELS_AT_ONCE pixels, or a row of them, and one of the squints (rad, shape (cols,)).
        """
        angles, angle_of = np.unique(squint, return_inverse=True)
        blocks: list[tuple[float, slice, Index]] = []
        for index, angle in enumerate(angles.tolist()):
            alike = np.flatnonzero(angle_of == index)
            for cols in np.split(alike, range(PIXELS_AT_ONCE, len(alike), PIXELS_AT_ONCE)):
                high = max(1, PIXELS_AT_ONCE // len(cols))
                blocks += [(angle, slice(row, min(row + high, rows)), cols) for row in range(0, rows, high)]

        def work_on(part: slice) -> None:
            for angle, some_rows, cols in blocks[part]:
                work(self.at(angle), some_rows, cols)

        in_parallel(work_on, len(blocks), -(-PIXELS_OF_THREAD * len(blocks) // max(1, rows * len(squint))))


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
    """Cubics from node to node with these values and slopes (per step) at both; shape (nodes - 1, 4, ...)."""
    rise, start, end = np.diff(value, axis=0), slope[:-1], slope[1:]
    return np.stack([value[:-1], start, 3 * rise - 2 * start - end, start + end - 2 * rise], axis=1)


def _weighted_sum(weights: F32, values: F32) -> F32:
    """Sum of `values` over their first axis; BLAS would wait for its threads."""
    total = np.zeros(values.shape[1:], np.float32)
    add_weighted(weights, values.reshape(len(values), -1), total.reshape(-1))
    return total
