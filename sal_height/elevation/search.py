"""The elevation at which a quadratic form w^H R w is greatest, w the weights for that elevation, R a pixel's matrix.

The form is evaluated on a coarse grid, as one matrix product for all pixels, and climbed from there by Newton steps
between the nodes of a table of w. The beams may be of any pattern: complex, turned, or averaged over the flight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple, Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation._kernels import (
    GRID_STEP,
    TABLE_STEPS,
    TILE,
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
ARRAYS_HELD = 4  # arrays of beams whose searches are held: a calibration makes ever new ones

SQUINT_STEP = 1 / 16
"""Beamwidths between the squints at which responses are computed from the beams' patterns.

Over squint they are as smooth as over elevation: a polynomial through six of them errs between them by 3e-7 for a
period of 2 beamwidths, the shortest of an aperture's beams, and by 2e-5 for half of that.
"""

NEAREST = np.arange(-2, 4)  # numbers of these six squints, counted from the one below

SQUINT_PARTS = 2**15
"""Parts of such a step to which squints are rounded, 1e-6 beamwidths at most: columns that differ by rounding errors
share a search. Squints move elevations by a fraction of their own error."""


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

    def power_at(self, position: F64) -> F64:
        """|a|^2 at positions in steps of the table, of any shape."""
        node = np.minimum(position.astype(np.intp), len(self.pieces) - 1)
        piece, t = self.power[node], position - node
        return np.asarray(piece[..., 0] + t * (piece[..., 1] + t * (piece[..., 2] + t * piece[..., 3])))

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
        part: least difference of squints that have searches of their own, rad.
        of_part: gives the search at a multiple of `part`.
    """

    nodes: F64
    part: float
    of_part: Callable[[int], PeakSearch]

    @classmethod
    def over(cls, beams: Beams, objective: Objective, guard: float) -> PeakSearches:
        """Searches over `beams.domain(guard)`, at any squint; angles in rad.

        They are made when they are needed, from tables at multiples of SQUINT_STEP, and held for the next image of the
        same beams. What a search finds depends on its squint alone, not on the other columns.

        Raises:
            UserError: the beams have no elevation in common.
        """
        return _searches(beams, objective, guard)

    def at(self, squint: float) -> PeakSearch:
        """The search at a squint (rad)."""
        return self.of_part(round(squint / self.part))

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
        parts, part_of = np.unique(np.rint(squint / self.part), return_inverse=True)
        blocks: list[tuple[int, slice, Index]] = []
        for index, part in enumerate(parts.tolist()):
            alike = np.flatnonzero(part_of == index)
            for first in range(0, len(alike), PIXELS_AT_ONCE):
                cols = alike[first : first + PIXELS_AT_ONCE]
                high = max(1, PIXELS_AT_ONCE // len(cols))
                blocks += [(int(part), slice(row, min(row + high, rows)), cols) for row in range(0, rows, high)]

        def work_on(share: slice) -> None:
            for part, some_rows, cols in blocks[share]:
                work(self.of_part(part), some_rows, cols)

        in_parallel(work_on, len(blocks), -(-PIXELS_OF_THREAD * len(blocks) // max(1, rows * len(squint))))


def _as_real(values: F64) -> F64:
    """Complex numbers as their real parts, then their imaginary parts, along the last axis."""
    return np.concatenate([values.real, values.imag], axis=-1) if np.iscomplexobj(values) else values


@lru_cache(ARRAYS_HELD)
def _searches(beams: Beams, objective: Objective, guard: float) -> PeakSearches:
    """See `PeakSearches.over`; beams are told apart by their identity."""
    first, last = beams.domain(guard)
    grid_steps = max(1, int(np.ceil((last - first) / (GRID_STEP * beams.beamwidth))))
    nodes = np.linspace(first, last, TABLE_STEPS * grid_steps + 1)
    squint_step = SQUINT_STEP * beams.track_beamwidth

    @lru_cache(SEARCHES_HELD)
    def exact(number: int) -> tuple[F64, F64]:
        squint = number * squint_step
        return beams.response(nodes, squint), beams.slope(nodes, squint)

    @lru_cache(SEARCHES_HELD)
    def of_part(part: int) -> PeakSearch:
        number, rest = divmod(part, SQUINT_PARTS)
        weights = _lagrange(rest / SQUINT_PARTS)
        used = [(weight, *exact(number + k)) for weight, k in zip(weights, NEAREST.tolist(), strict=True) if weight]
        response, slope = (sum(weight * values[n] for weight, *values in used) for n in (0, 1))
        return PeakSearch.of(nodes, np.asarray(response), np.asarray(slope), objective)

    return PeakSearches(nodes, squint_step / SQUINT_PARTS, of_part)


def _lagrange(place: float) -> list[float]:
    """Weights by which a polynomial through values at NEAREST gives its value at `place`."""
    others = ((number, NEAREST[number != NEAREST]) for number in NEAREST)
    return [float(np.prod((place - other) / (number - other))) for number, other in others]


def _hermite(value: F64, slope: F64) -> F64:
    """Cubics from node to node with these values and slopes (per step) at both; shape (nodes - 1, 4, ...)."""
    rise, start, end = np.diff(value, axis=0), slope[:-1], slope[1:]
    return np.stack([value[:-1], start, 3 * rise - 2 * start - end, start + end - 2 * rise], axis=1)
