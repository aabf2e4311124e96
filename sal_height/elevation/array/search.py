"""The elevation at which a quadratic form w^H R w is greatest, w the weights for that elevation, R a pixel's matrix.

The form is evaluated on a coarse grid, as one matrix product for all pixels, and climbed from there by Newton steps
between the nodes of a table of w. The beams may be of any pattern: complex, turned, or averaged over the flight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array._beside_kernels import gain_beside_one
from sal_height.elevation.array._kernels import (
    GRID_STEP,
    NEAR_HIGHEST,
    TABLE_STEPS,
    TILE,
    climb_highest,
    evaluate_on_grid,
    fit_scatterer,
)
from sal_height.elevation.array.bounds import Numbers
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.errors import UserError
from sal_height.numeric import F32, F64, I64, Index, ShortRepr, in_parallel

Objective = Callable[[F64, F64], tuple[F64, F64]]
"""Function of response and slope of the beams that returns weights and their slope; all real, (..., detectors)."""

PIXELS_OF_THREAD = 2048  # number of pixels from which another thread pays
PIXELS_AT_ONCE = 2048  # pixels whose covariance and objective are computed at a time: they fit into a processor's cache
SQUINTS_AT_ONCE = 16  # squints whose tables are made together, of 0.2 MB each with 16 detectors
SEARCHES_KEPT = 256  # squints whose tables are cached, those of a wide image: it has one a column, and dwells the same

SQUINT_STEP = 1 / 16
"""Beamwidths between the squints at which responses are computed from the beams' patterns.

Over squint they are as smooth as over elevation: a polynomial through six of them errs between them by 3e-7 for a
period of 2 beamwidths, the shortest of an aperture's beams, and by 2e-5 for half of that.
"""

NEAREST = np.arange(-2, 4)  # numbers of these six squints, counted from the one below


class Peaks(NamedTuple):
    """The highest peak of the objective in each pixel; arrays of shape (pixels,).

    Attributes:
        elevation: elevation of the peak, or the end of the domain where the objective still rises there, rad.
        height: value of the objective there.
        second: value of the objective at the second highest peak; `NO_PEAK` if it does not exist.
    """

    elevation: F64
    height: F64
    second: F64


@dataclass(frozen=True, eq=False)
class SearchTables:
    """The weights w at some squints.

    Attributes:
        first: lowest elevation searched, rad.
        step: step of the table, of whose nodes the grid has every TABLE_STEPS-th, rad.
        entries: positions of the upper triangle in a flattened matrix, padded by zeros to a multiple of TILE.
        grid: products w_m w_n at each node of the grid, those of m < n doubled, shape (squints, entries, grid nodes); 0
            where `entries` is padded.
        pieces: cubic polynomials for w between the nodes of the table (Hermite: w and w' are exact at the nodes),
            coefficients of rising powers, shape (squints, table nodes - 1, 4, detectors). For the aperture's beams,
            whose shortest period is 2 beamwidths, the error is 5e-8 in w and 5e-6 per beamwidth in w'.
        power: cubic polynomials for |a|^2, shape (squints, table nodes - 1, 4).
        complex_beams: True if w has the real parts, then the imaginary parts, of complex numbers.
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
        """Tables from response and slope of the beams at `nodes` (rad), shape (squints, nodes, detectors)."""
        step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
        response, slope, complex_beams = _as_real(response), _as_real(slope), np.iscomplexobj(response)
        weight, weight_slope = objective(response, slope)
        power, power_slope = np.sum(response**2, axis=-1), 2 * np.sum(response * slope, axis=-1)
        coarse = weight[:, ::TABLE_STEPS]
        m, n = np.triu_indices(coarse.shape[2])
        products = coarse[..., m] * coarse[..., n] * np.where(m == n, 1, 2)
        padding = (0, -len(m) % TILE)
        grid = np.pad(np.swapaxes(products, 1, 2), ((0, 0), padding, (0, 0)))
        return cls(
            first=float(nodes[0]),
            step=step,
            entries=np.pad(m * coarse.shape[2] + n, padding),
            grid=np.ascontiguousarray(grid, dtype=np.float32),
            pieces=np.ascontiguousarray(_hermite(weight, weight_slope * step), dtype=np.float32),
            power=np.ascontiguousarray(_hermite(power, power_slope * step), dtype=np.float32),
            complex_beams=complex_beams,
        )

    @property
    def steps(self) -> int:
        """Number of steps of the table."""
        return self.pieces.shape[1]

    @property
    def last(self) -> float:
        """Highest elevation searched, rad."""
        return self.first + self.step * self.steps

    @cached_property
    def grid_nodes(self) -> F64:
        """Elevations of the grid, rad."""
        return self.first + self.step * TABLE_STEPS * np.arange(self.grid.shape[2], dtype=np.float64)

    @cached_property
    def greatest(self) -> F32:
        """Greatest |w|^2 at the nodes of the table, shape (squints,)."""
        return np.asarray(np.max(np.sum(self.pieces[:, :, 0] ** 2, axis=-1), axis=-1))

    @cached_property
    def unit_pieces(self) -> Numbers:
        """`pieces`, complex if the beams are, shape (squints, table nodes - 1, 4, channels)."""
        if not self.complex_beams:
            return self.pieces
        channels = self.pieces.shape[3] // 2
        return np.ascontiguousarray(self.pieces[..., :channels] + np.complex64(1j) * self.pieces[..., channels:])

    @cached_property
    def units_across(self) -> Numbers:
        """Weights at the nodes of the grid, complex if the beams are, shape (squints, channels, grid nodes)."""
        last = self.unit_pieces[:, -1:].sum(axis=2)
        nodes = np.concatenate([self.unit_pieces[:, :, 0], last], axis=1)[:, ::TABLE_STEPS]
        return np.ascontiguousarray(np.swapaxes(nodes, 1, 2))

    @cached_property
    def precise_units_across(self) -> Numbers:
        """`units_across` in double precision."""
        return self.units_across.astype(np.result_type(self.units_across, np.float64))


@dataclass(frozen=True, eq=False)
class PeakSearch(ShortRepr):
    """The search of some pixels, each at its own squint.

    Attributes:
        tables: tables at the squints.
        squints: number of the squint of each pixel in the tables, shape (pixels,); or one for all, shape (1,). Pixels
            of the same squint are fastest next to each other.
    """

    tables: SearchTables
    squints: Index

    def of(self, some: Index | slice) -> Self:
        """The search of some of the pixels."""
        return replace(self, squints=self.squints[some])

    def every(self, pixels: int) -> Index:
        """Number of the squint of each of N pixels."""
        return self.squints if len(self.squints) == pixels else np.repeat(self.squints, pixels)

    def position(self, elevation: F64) -> F64:
        """Elevations (rad, any shape) in steps of the table; those beyond the domain count as its ends."""
        return np.clip((elevation - self.tables.first) / self.tables.step, 0.0, self.tables.steps)

    def elevation(self, position: F64) -> F64:
        """Elevations (rad) of positions in steps of the table, of any shape."""
        return self.tables.first + self.tables.step * position

    def peaks(self, covariance: Covariance, margin: float = 0.0) -> Peaks:
        """Find the highest peak of the objective in the search domain, and the height of the second highest.

        Runs in the calling thread alone.

        Args:
            covariance: matrices of the quadratic forms, shape (pixels, channels, channels); complex if the beams are.
                They need not be positive.
            margin: power of a scatterer, in the unit of the covariance; the second peak is searched for among those
                that are lower than the first by its objective at most.

        Raises:
            UserError: the beams are complex and the covariance is not.
        """
        squints, parts = self.every(len(covariance)), [np.empty((3, 0))]
        for first in range(0, len(covariance), PIXELS_AT_ONCE):
            block = covariance[first : first + PIXELS_AT_ONCE]
            search = replace(self, squints=squints[first : first + PIXELS_AT_ONCE])
            parts.append(np.array(search.peaks_of(block, search.on_grid(block), margin)))
        return Peaks(*np.concatenate(parts, axis=1))

    def peaks_of(self, covariance: Covariance, values: F32, margin: F64 | float) -> Peaks:
        """The same as `peaks`, from the objective `on_grid`; `margin` may be that of every pixel, (pixels,)."""
        squints, tables = self.every(len(covariance)), self.tables
        position, height, second = np.empty((3, len(covariance)))
        margins = np.asarray(margin, np.float32) * tables.greatest[squints]
        climb_highest(self._real(covariance), squints, values, margins, tables.pieces, (position, height, second))
        return Peaks(self.elevation(position), height, second)

    def may_peak_beyond(self, covariance: Covariance, domain: tuple[float, float], least: F64) -> Index:
        """Numbers of the pixels whose highest peak may be beyond the domain (rad) and `least` high or more, (pixels,).

        The node nearest to the highest peak has NEAR_HIGHEST of its height, and is half a step from it at most. The
        objective must not be negative; errors as in `peaks`.
        """
        grid = _grid_beyond(self.tables, *domain)
        squints = self.every(len(covariance))
        values = evaluate_on_grid(self._real(covariance), squints, self.tables.entries, grid)
        return np.flatnonzero(values.max(axis=1, initial=-np.inf) >= NEAR_HIGHEST * least)

    def gain_beside(self, covariance: Covariance, values: F32, elevation: F64) -> F64:
        """Power that a scatterer in addition to the single one explains, in the unit of the covariance, (2, pixels).

        First at the best node of the grid, second along the slope of the response of the single scatterer.

        Args:
            covariance: shape (pixels, channels, channels).
            values: normalised objective `on_grid`.
            elevation: elevation of the single scatterer, within the domain, shape (pixels,), rad.
        """
        found, tables, squints = np.empty((2, len(covariance))), self.tables, self.every(len(covariance))
        matrices = covariance if tables.complex_beams else self._real(covariance)
        position = self.position(elevation)
        gain_beside_one(matrices, squints, values, position, tables.unit_pieces, tables.units_across, found)
        return found

    def fit(self, covariance: Covariance, elevation: F64) -> F64:
        """Fit one scatterer at a known elevation to each pixel.

        Args:
            covariance: shape (pixels, channels, channels); complex if the beams are.
            elevation: elevation of the scatterer, shape (pixels,), rad; those beyond the domain count as its ends.

        Returns:
            The power that the scatterer explains, w^H R w / |w|^2; |a|^2; and the squared rate at which the direction
            of w turns, D / |a|^2 in 1/rad^2 (`bounds.information`). Shape (3, pixels); NaN where the elevation is.
        """
        position, tables, squints = self.position(elevation), self.tables, self.every(len(elevation))
        found = np.empty((3, len(position)))
        known = np.isfinite(position)
        at, kind = np.where(known, position, 0.0), tables.complex_beams
        fit_scatterer(self._real(covariance), squints, at, tables.pieces, tables.power, kind, found)
        found[2] /= tables.step**2
        found[:, ~known] = np.nan
        return found

    def responses_at(self, elevation: F64) -> tuple[Numbers, Numbers, F64]:
        """Weights at elevations (rad, (pixels, ...)) within the domain, their slopes (1/rad), and |a|^2, by the table.

        Shapes (pixels, ..., channels), (pixels, ..., channels) and (pixels, ...); complex if the beams are.
        """
        position, tables = self.position(elevation), self.tables
        number = self.every(len(elevation)).reshape(-1, *(1 for _ in elevation.shape[1:]))
        node = np.minimum(position.astype(np.intp), tables.steps - 1)
        powers = (position - node)[..., None] ** np.arange(4)
        rise = np.arange(1, 4) * powers[..., :3] / tables.step
        pieces = tables.unit_pieces[number, node]
        weight = (powers[..., None, :] @ pieces)[..., 0, :]
        slope = (rise[..., None, :] @ pieces[..., 1:, :])[..., 0, :]
        return weight, slope, np.sum(powers * tables.power[number, node], axis=-1)

    def on_grid(self, covariance: Covariance) -> F32:
        """Objective of some pixels at all nodes of the grid, (pixels, grid nodes); errors as in `peaks`."""
        squints = self.every(len(covariance))
        return evaluate_on_grid(self._real(covariance), squints, self.tables.entries, self.tables.grid)

    def _real(self, covariance: Covariance) -> F32:
        """Real matrices whose quadratic form with the real weights is that of the covariance."""
        if not self.tables.complex_beams:
            return np.ascontiguousarray(covariance.real, dtype=np.float32)
        if not np.iscomplexobj(covariance):
            raise UserError(REAL_COVARIANCE)
        real, imaginary = covariance.real, covariance.imag
        return np.ascontiguousarray(np.block([[real, -imaginary], [imaginary, real]]), dtype=np.float32)


REAL_COVARIANCE = "The covariance of complex beams is real; it must be complex (looks with hermitian=True)."

Pixels = tuple[Index, Index]
"""Rows and columns of some pixels of an image, each of shape (pixels,)."""

Find = Callable[[PeakSearch, Covariance, Pixels], F64]
"""Function of the search of some pixels and their covariance (pixels, channels, channels) that returns numbers (count,
pixels)."""


class Block(NamedTuple):
    """Columns or pixels that are searched at a time.

    Attributes:
        parts: squints that have tables, in the unit of `PeakSearches.part`.
        squints: number of the squint of each item among them.
        items: numbers of the columns or pixels, shape (items,).
    """

    parts: tuple[int, ...]
    squints: Index
    items: Index


@dataclass(frozen=True, eq=False)
class PeakSearches(ShortRepr):
    """Searches over the same elevations at any squints.

    Attributes:
        grid_nodes: elevations of the grid, rad.
        part: least difference of squints that have tables of their own, rad.
        of_parts: function that returns the tables at multiples of `part`.
    """

    grid_nodes: F64
    part: float
    of_parts: Callable[[tuple[int, ...]], SearchTables]

    @classmethod
    def over(cls, beams: Beams, objective: Objective, guard: float) -> PeakSearches:
        """Searches over `beams.domain(guard)`, at any squint; angles in rad.

        They are made when they are needed, from tables at multiples of SQUINT_STEP, and cached for the next image of
        the same beams. The result of a search depends on its squint alone, not on the other columns.

        Raises:
            UserError: the beams have no elevation in common.
        """
        return _searches(beams, objective, guard)

    def at(self, squint: F64 | float) -> PeakSearch:
        """The search of pixels at these squints (rad, shape (pixels,)), or of any pixels at a single one."""
        parts, squints = np.unique(self._parts(np.atleast_1d(squint)), return_inverse=True)
        return PeakSearch(self.of_parts(tuple(parts.tolist())), squints)

    def of(self, block: Block) -> PeakSearch:
        """The search of the items of a block."""
        return PeakSearch(self.of_parts(block.parts), block.squints)

    def blocks(self, squint: F64, cols: Index, most: int) -> list[Block]:
        """Items in the order of their squints, `most` or fewer of SQUINTS_AT_ONCE squints at a time.

        Args:
            squint: squints of all columns of an image, shape (cols,), rad. Tables are made for all of them, for the
                next image, in which other columns have items.
            cols: column of each item, shape (items,).
            most: greatest number of items at a time.
        """
        parts, number = np.unique(self._parts(squint), return_inverse=True)
        tables = [tuple(parts[i : i + SQUINTS_AT_ONCE].tolist()) for i in range(0, len(parts), SQUINTS_AT_ONCE)]
        squint_of = number[cols]
        order = np.argsort(squint_of, kind="stable")
        ends = np.searchsorted(squint_of[order], SQUINTS_AT_ONCE * np.arange(len(tables) + 1)).tolist()
        return [
            Block(tables[group], squint_of[some] - SQUINTS_AT_ONCE * group, some)
            for group, (first, end) in enumerate(pairwise(ends))
            for some in (order[i : min(i + most, end)] for i in range(first, end, most))
        ]

    def of_pixels(self, looks: Looks, count: int, find: Find) -> F64:
        """Find `count` numbers for every pixel, shape (count, rows, cols), block by block on all processors."""
        result = np.empty((count, *looks.count.shape))

        def work(search: PeakSearch, pixels: Pixels) -> None:
            result[:, *pixels] = find(search, looks.covariance[pixels], pixels)

        self.each(looks.squint, len(looks.count), work)
        return result

    def each(self, squint: F64, rows: int, work: Callable[[PeakSearch, Pixels], object]) -> None:
        """Call `work` with the search and the pixels of each block of the image, on all processors.

        A block has up to PIXELS_AT_ONCE pixels, column by column, of neighbouring columns: samples of their looks lie
        next to each other. Squints (rad, shape (cols,)) are of the columns.
        """
        high = min(max(rows, 1), max(1, PIXELS_AT_ONCE // min(max(len(squint), 1), SQUINTS_AT_ONCE)))
        columns = self.blocks(squint, np.arange(len(squint)), PIXELS_AT_ONCE // high)
        blocks = [(block, np.arange(top, min(top + high, rows))) for block in columns for top in range(0, rows, high)]

        def work_on(some: slice) -> None:
            for block, down in blocks[some]:
                each = np.repeat(np.arange(len(block.items)), len(down))
                work(self.of(block).of(each), (np.tile(down, len(block.items)), block.items[each]))

        in_parallel(work_on, len(blocks), -(-PIXELS_OF_THREAD * len(blocks) // max(1, rows * len(squint))))

    def _parts(self, squint: F64) -> I64:
        """Squints (rad) in the unit `part`."""
        return np.rint(squint / self.part).astype(np.int64)


def _as_real(values: F64) -> F64:
    """Complex numbers as their real parts, then their imaginary parts, along the last axis."""
    return np.concatenate([values.real, values.imag], axis=-1) if np.iscomplexobj(values) else values


@lru_cache(4)  # arrays of beams, as a calibration always makes new ones
def _searches(beams: Beams, objective: Objective, guard: float) -> PeakSearches:
    """See `PeakSearches.over`; beams are distinguished by their identity."""
    first, last = beams.domain(guard)
    grid_steps = max(1, int(np.ceil((last - first) / (GRID_STEP * beams.beamwidth))))
    nodes = np.linspace(first, last, TABLE_STEPS * grid_steps + 1)
    squint_step = SQUINT_STEP * beams.track_beamwidth
    # Squints are rounded to these parts of a step, 1e-6 beamwidths at most, so that columns that differ by rounding
    # errors have one search. Squints move elevations by a fraction of their own error.
    parts_of_step = 2**15

    @lru_cache(SEARCHES_KEPT)
    def exact(number: int) -> tuple[F64, F64]:
        squint = number * squint_step
        return beams.response(nodes, squint), beams.slope(nodes, squint)

    def at_squint(part: int) -> tuple[F64, F64]:
        number, rest = divmod(part, parts_of_step)
        weights = _lagrange(rest / parts_of_step)
        used = [(weight, *exact(number + k)) for weight, k in zip(weights, NEAREST.tolist(), strict=True) if weight]
        response, slope = (sum(weight * values[n] for weight, *values in used) for n in (0, 1))
        return np.asarray(response), np.asarray(slope)

    @lru_cache(SEARCHES_KEPT // SQUINTS_AT_ONCE)
    def of_parts(parts: tuple[int, ...]) -> SearchTables:
        responses, slopes = zip(*map(at_squint, parts), strict=True)
        return SearchTables.of(nodes, np.stack(responses), np.stack(slopes), objective)

    return PeakSearches(nodes[::TABLE_STEPS], squint_step / parts_of_step, of_parts)


@lru_cache(SEARCHES_KEPT // SQUINTS_AT_ONCE)
def _grid_beyond(tables: SearchTables, first: float, last: float) -> F32:
    """The part of `tables.grid` at the nodes that are nearest to elevations below `first` or above `last` (rad).

    Zeros make their number a multiple of 8, as processors multiply eight at a time.
    """
    half = 0.5 * TABLE_STEPS * tables.step
    near = (tables.grid_nodes < first + half) | (tables.grid_nodes > last - half)
    return np.pad(tables.grid[:, :, near], ((0, 0), (0, 0), (0, -int(near.sum()) % 8)))


def _lagrange(position: float) -> list[float]:
    """Weights of the values at NEAREST in the polynomial through them, at `position`."""
    others = ((number, NEAREST[number != NEAREST]) for number in NEAREST)
    return [float(np.prod((position - other) / (number - other))) for number, other in others]


def _hermite(value: F64, slope: F64) -> F64:
    """Cubics from node to node with these values and slopes (per step) at both; shape (squints, nodes - 1, 4, ...)."""
    rise, start, end = np.diff(value, axis=1), slope[:, :-1], slope[:, 1:]
    return np.stack([value[:, :-1], start, 3 * rise - 2 * start - end, start + end - 2 * rise], axis=2)
