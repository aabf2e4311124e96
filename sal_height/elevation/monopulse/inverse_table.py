"""Elevations from discriminants by tables, which are made once for an array of beams.

The discriminants of all pairs of neighbouring detectors, and their domains, are tabulated at squints of a fixed
lattice. Over elevation each table is a row of cubics with the exact slopes at its nodes (Hermite), which are inverted;
over squint, elevations are those of the polynomial through the four nearest squints, at the same fraction of the values
in the domain. In steps of squint in which these err by more than ALLOWED_ERROR, as at the end of a main lobe, `invert`
gives the exact elevation. By the tables, the result of a pixel depends on its own discriminant and squint alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.looks.looks import DwellColumns
from sal_height.elevation.monopulse._kernels import INSIDE, NO_DOMAIN, NOT_FINITE, UNKNOWN, look_up
from sal_height.elevation.monopulse.discriminant import (
    FARTHEST,
    ROUNDING,
    discriminant,
    discriminant_domain,
)
from sal_height.elevation.monopulse.inversion import PairElevation, invert
from sal_height.numeric import F64, I64, U8, Index

SQUINT_STEP = 1 / 24
"""Beamwidths between the squints of a table."""

CELLS = 24
"""Number of steps of squint in a table: those of an image of one beamwidth."""

NEAREST = np.arange(-1, 3)
"""Numbers of the four squints around a step, counted from the one at its lower end."""

ALLOWED_ERROR = 1e-5
"""Error of elevation times slope of the discriminant up to which tables are used; noise of one look at 60 dB has 7e-4.

In the middle of a pair, where mu rises by about 1 per beamwidth, it is in beamwidths.
"""


@dataclass(frozen=True, eq=False)
class InverseTable:
    """Inverse discriminants of all pairs in CELLS steps of squint; p numbers pairs and k squints.

    Attributes:
        mu: increasing discriminants, shape (p, k, nodes).
        values: elevation (rad) of each node and the slope of mu (1/rad); real part of Sigma and its slope; imaginary
            part and its slope; that of Delta / Sigma and its slope; shape (p, k, nodes, 8).
        ends: least and greatest mu of the domain, with a margin for rounding, shape (p, k, 2).
        kind: kind of each step of squint: INSIDE, NO_DOMAIN anywhere in it, or UNKNOWN, which `invert` inverts; uint8,
            shape (p, CELLS).
    """

    mu: F64
    values: F64
    ends: F64
    kind: U8

    def look_up(self, mu: F64, pair: Index, cell: I64, weights: F64) -> tuple[F64, U8]:
        """Elevation, slope, |Sigma|^2 and Im(Delta / Sigma), shape (4, rows, cols), and the reasons, or UNKNOWN.

        Args:
            mu: discriminants, shape (rows, cols).
            pair: number of the lower detector of the pair of each, same shape.
            cell: number of the step of each column's squint, shape (cols,).
            weights: weights of the squints around it, shape (cols, 4).
        """
        found, reason = np.full((4, *mu.shape), np.nan), np.empty(mu.shape, np.uint8)
        look_up(mu, pair, (cell, weights), (self.mu, self.values, self.ends), self.kind, found, reason)
        return found, reason


def invert_pairs(beams: Beams, mu: F64, pair: Index, squint: F64, columns: DwellColumns) -> PairElevation:
    """Invert the discriminant of each pixel for its pair of neighbouring detectors, within ALLOWED_ERROR.

    Args:
        beams: beams of single detectors.
        mu: discriminants, shape (rows, cols); NaN is NOT_FINITE.
        pair: number of the lower detector of the pair of each, same shape.
        squint: squint of the columns, shape (cols,), rad.
        columns: columns of the dwells. `invert` is called for each dwell alone, as it makes a table for all
            discriminants of a call.

    Raises:
        UserError: the patterns of two neighbouring detectors have no angle in common.
    """
    position = squint / squint_step(beams)
    finite = np.isfinite(position)
    below = np.floor(np.where(finite, position, 0.0))
    weights = _lagrange(np.where(finite, position, 0.0) - below)
    page = np.floor_divide(below + CELLS // 2, CELLS).astype(np.int64)
    cell = (below - page * CELLS).astype(np.int64) + CELLS // 2
    found, reason = np.full((4, *mu.shape), np.nan), np.full(mu.shape, NOT_FINITE, np.uint8)
    for number, cols in _alike(page, finite):
        found[:, :, cols], reason[:, cols] = inverse_table(beams, number).look_up(
            mu[:, cols], pair[:, cols], cell[cols], weights[cols]
        )
    elevation, slope, sum_gain, imaginary = found
    inverse = PairElevation(elevation, slope, reason, sum_gain, np.hypot(mu, imaginary))
    for of_dwell in columns.slices if np.any(reason == UNKNOWN) else []:
        _invert_unknown(inverse, beams, mu, pair, squint, of_dwell)
    return inverse


def _invert_unknown(inverse: PairElevation, beams: Beams, mu: F64, pair: Index, squint: F64, columns: slice) -> None:
    """Invert exactly where the tables err too much, in the columns of a dwell: changes `inverse` in place."""
    mu, pair, unknown = mu[:, columns], pair[:, columns], inverse.reason[:, columns] == UNKNOWN
    for lower in np.unique(pair[unknown]).tolist():
        here, two = unknown & (pair == lower), beams.pair(lower)
        angle = np.broadcast_to(squint[columns], mu.shape)[here]
        exact = PairElevation.of(two, invert(two, mu[here], angle), angle)
        for one in fields(inverse):
            getattr(inverse, one.name)[:, columns][here] = getattr(exact, one.name)


def squint_step(beams: Beams) -> float:
    """SQUINT_STEP in rad: of the beamwidth along the detector axis or across it, whichever is passed sooner."""
    passed = abs(np.sin(beams.rotation)) / beams.beamwidth, abs(np.cos(beams.rotation)) / beams.beamwidth_beside
    return float(SQUINT_STEP / max(passed))


def _alike(page: I64, finite: np.ndarray) -> Iterator[tuple[int, slice | Index]]:
    """Pages, and the columns of each, that have a finite squint."""
    first = int(page[0]) if page.size else 0
    if page.size and finite.all() and (page == first).all():
        yield first, slice(None)
        return
    for number in np.unique(page[finite]).tolist():
        yield number, np.flatnonzero((page == number) & finite)


def _lagrange(position: F64) -> F64:
    """Weights of the values at NEAREST in the polynomials through them, at `position` (0 to 1), (positions, 4)."""
    before, after, last = position + 1, position - 1, position - 2
    weights = np.empty((len(position), len(NEAREST)))
    weights[:, 0] = -position * after * last / 6
    weights[:, 1] = before * after * last / 2
    weights[:, 2] = -before * position * last / 2
    weights[:, 3] = before * position * after / 6
    return weights


@lru_cache(8)  # a few arrays, each at the squints of its images
def inverse_table(beams: Beams, page: int) -> InverseTable:
    """The table of CELLS steps of squint, the middle one of which starts at `page` times CELLS steps.

    Beams are distinguished by their identity.
    """
    step = squint_step(beams)
    first = page * CELLS - CELLS // 2
    squint = step * np.arange(first + NEAREST[0], first + CELLS + NEAREST[-1])
    pairs = [beams.pair(lower) for lower in range(beams.count - 1)]
    middle = squint[-NEAREST[0] : -NEAREST[-1]] + step / 2
    both = np.array([discriminant_domain(pair, np.append(squint, middle)) for pair in pairs])
    domains, exact = both[:, :, : len(squint)], both[:, :, len(squint) :]  # (p, 2, k)
    widest = np.nanmax(np.append(domains[:, 1] - domains[:, 0], 0.0)) / beams.beamwidth
    # Nodes are 0.05 beamwidths apart in the middle of a domain, and denser towards its ends.
    count = 2 + int(np.ceil(np.pi / 2 * min(widest, 2 * FARTHEST) / 0.05))
    fraction = (1 - np.cos(np.linspace(0, np.pi, count))) / 2
    nodes = domains[:, 0, :, None] * (1 - fraction) + domains[:, 1, :, None] * fraction
    tables = [_tabulated(pair, elevation, squint[:, None]) for pair, elevation in zip(pairs, nodes, strict=True)]
    mu, values, ends = (np.stack(parts) for parts in zip(*tables, strict=True))
    table = InverseTable(mu, values, ends, np.full((len(pairs), CELLS), INSIDE, np.uint8))
    for number, pair in enumerate(pairs):
        table.kind[number] = _kinds(table, number, pair, middle, exact[number])
    return table


def _tabulated(pair: Beams, elevation: F64, squint: F64) -> tuple[F64, F64, F64]:
    """`mu`, `values` and `ends` of one pair, at elevations of shape (squints, nodes)."""
    amplitude, turn = pair.response(elevation, squint), pair.slope(elevation, squint)
    with np.errstate(divide="ignore", invalid="ignore"):
        total, total_slope = amplitude.sum(axis=-1), turn.sum(axis=-1)
        ratio = (amplitude[..., 1] - amplitude[..., 0]) / total
        ratio_slope = 2 * (turn[..., 1] * amplitude[..., 0] - amplitude[..., 1] * turn[..., 0]) / total**2
        mu, slope = np.real(ratio), np.real(ratio_slope)
    parts = elevation, slope, total.real, total_slope.real, total.imag, total_slope.imag, ratio.imag, ratio_slope.imag
    slack = ROUNDING * pair.beamwidth * slope
    ends = np.stack([mu[:, 0] - slack[:, 0], mu[:, -1] + slack[:, -1]], axis=-1)
    return mu, np.stack(parts, axis=-1), ends


def _kinds(table: InverseTable, number: int, pair: Beams, squint: F64, domain: F64) -> U8:
    """Kind of each cell of a pair, by the beams in its middle and between nodes: where interpolation errs most.

    `squint` is that of the middle of each cell, and `domain` its `discriminant_domain`, shape (2, cells).
    """
    cell, weights = np.arange(CELLS), np.tile(_lagrange(np.array([0.5])), (CELLS, 1))
    around = cell[:, None] + np.arange(len(NEAREST))
    known = np.isfinite(table.ends[number, :, 0])
    least, most = (np.sum(weights * table.mu[number, around, end], axis=1) for end in (0, -1))
    # Half way between the nodes of the squint below.
    nodes = table.mu[number, cell - NEAREST[0]].T
    fraction = ((nodes[1:] + nodes[:-1]) / 2 - nodes[0]) / (nodes[-1] - nodes[0])
    wanted = np.nan_to_num(least + (most - least) * fraction)
    found, reason = table.look_up(wanted, np.full(wanted.shape, number), cell, weights)
    back = discriminant(pair, np.vstack([found[0], domain]), squint)
    error = np.abs(back - np.vstack([wanted, least, most]))
    allowed = np.all(error <= ALLOWED_ERROR, axis=0) & np.all(reason == INSIDE, axis=0)
    empty = ~known[around].any(axis=1) & np.isnan(domain[0])
    return np.select([allowed, empty], [INSIDE, NO_DOMAIN], UNKNOWN).astype(np.uint8)
