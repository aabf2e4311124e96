"""Elevations from discriminants by tables, which are made once for an array of beams.

The discriminants of all pairs of neighbouring detectors, and their domains, are tabulated at squints of a fixed
lattice. Over elevation each table is a row of cubics with the exact slopes at its nodes (Hermite), which are inverted;
over squint, elevations are those of the polynomial through the four nearest squints, at the same share of the values in
the domain. Where the beams do not allow that, as at the end of a main lobe, `invert` is called. What is found for a
pixel by the tables depends on its own discriminant and squint alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.looks.dwell_columns import DwellColumns
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
"""Steps of squint that are tabulated together: those of an image of one beamwidth."""

NEAREST = np.arange(-1, 3)
"""Numbers of the four squints around a step, counted from the one at its lower end."""

NODE_STEP = 0.05
"""Beamwidths between the nodes in the middle of a domain; they are denser towards its ends."""

ALLOWED_ERROR = 1e-5
"""Error of elevation times slope of the discriminant up to which tables are used; noise of one look at 60 dB has 7e-4.

In the middle of a pair, where mu rises by about 1 per beamwidth, it is as many beamwidths.
"""

TABLES_HELD = 8
"""Tables that are held: of a few arrays, each at the squints of its images."""


@dataclass(frozen=True, eq=False)
class InverseTable:
    """Inverse discriminants of all pairs in CELLS steps of squint; p numbers pairs and k squints.

    Attributes:
        mu: increasing discriminants, shape (p, k, nodes).
        values: of each node elevation (rad) and the slope of mu (1/rad); real part of Sigma and its slope; imaginary
            part and its slope; that of Delta / Sigma and its slope; shape (p, k, nodes, 8).
        ends: least and greatest mu of the domain, with what rounding allows, shape (p, k, 2).
        kind: of each step of squint: INSIDE, NO_DOMAIN anywhere in it, or UNKNOWN: to be inverted by the beams; uint8,
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
            pair: number of the lower detector of each one's pair, same shape.
            cell: number of the step in which each column's squint lies, shape (cols,).
            weights: of the squints around it, shape (cols, 4).
        """
        found, reason = np.full((4, *mu.shape), np.nan), np.empty(mu.shape, np.uint8)
        look_up(mu, pair, (cell, weights), (self.mu, self.values, self.ends), self.kind, found, reason)
        return found, reason


def invert_pairs(beams: Beams, mu: F64, pair: Index, squint: F64, columns: DwellColumns) -> PairElevation:
    """Invert the discriminant of each pixel for its pair of neighbouring detectors, within ALLOWED_ERROR.

    Args:
        beams: of single detectors.
        mu: discriminants, shape (rows, cols); NaN is NOT_FINITE.
        pair: number of the lower detector of each one's pair, same shape.
        squint: of the columns, rad, shape (cols,).
        columns: of the dwells. By the beams, each is inverted alone: all discriminants of a pair share a table then.

    Raises:
        UserError: the patterns of two neighbouring detectors have no angle in common.
    """
    place = squint / squint_step(beams)
    finite = np.isfinite(place)
    below = np.floor(np.where(finite, place, 0.0))
    weights = _lagrange(np.where(finite, place, 0.0) - below)
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
    """Invert by the beams what the tables do not know in the columns of a dwell: changes `inverse` in place."""
    mu, pair, unknown = mu[:, columns], pair[:, columns], inverse.reason[:, columns] == UNKNOWN
    for lower in np.unique(pair[unknown]).tolist():
        here, two = unknown & (pair == lower), beams.pair(lower)
        angle = np.broadcast_to(squint[columns], mu.shape)[here]
        exact = PairElevation.of(two, invert(two, mu[here], angle), angle)
        for one in fields(inverse):
            getattr(inverse, one.name)[:, columns][here] = getattr(exact, one.name)


def squint_step(beams: Beams) -> float:
    """SQUINT_STEP in rad: of the beamwidth along the detector axis or beside it, whichever is passed sooner."""
    passed = abs(np.sin(beams.rotation)) / beams.beamwidth, abs(np.cos(beams.rotation)) / beams.beamwidth_beside
    return float(SQUINT_STEP / max(passed))


def _alike(page: I64, finite: np.ndarray) -> Iterator[tuple[int, slice | Index]]:
    """Columns of each page that has any with a finite squint."""
    first = int(page[0]) if page.size else 0
    if page.size and finite.all() and (page == first).all():
        yield first, slice(None)
        return
    for number in np.unique(page[finite]).tolist():
        yield number, np.flatnonzero((page == number) & finite)


def _lagrange(place: F64) -> F64:
    """Weights by which polynomials through values at NEAREST give those at `place` (0 to 1), shape (places, 4)."""
    before, after, last = place + 1, place - 1, place - 2
    weights = np.empty((len(place), len(NEAREST)))
    weights[:, 0] = -place * after * last / 6
    weights[:, 1] = before * after * last / 2
    weights[:, 2] = -before * place * last / 2
    weights[:, 3] = before * place * after / 6
    return weights


@lru_cache(TABLES_HELD)
def inverse_table(beams: Beams, page: int) -> InverseTable:
    """The table of CELLS steps of squint, the middle one of which begins at `page` times CELLS steps.

    Beams are told apart by their identity.
    """
    step = squint_step(beams)
    first = page * CELLS - CELLS // 2
    squint = step * np.arange(first + NEAREST[0], first + CELLS + NEAREST[-1])
    pairs = [beams.pair(lower) for lower in range(beams.count - 1)]
    domains = np.array([discriminant_domain(pair, squint) for pair in pairs])  # (p, 2, k)
    widest = np.nanmax(np.append(domains[:, 1] - domains[:, 0], 0.0)) / beams.beamwidth
    count = 2 + int(np.ceil(np.pi / 2 * min(widest, 2 * FARTHEST) / NODE_STEP))
    share = (1 - np.cos(np.linspace(0, np.pi, count))) / 2
    nodes = domains[:, 0, :, None] * (1 - share) + domains[:, 1, :, None] * share
    tables = [_tabulated(pair, elevation, squint[:, None]) for pair, elevation in zip(pairs, nodes, strict=True)]
    mu, values, ends = (np.stack(parts) for parts in zip(*tables, strict=True))
    table = InverseTable(mu, values, ends, np.full((len(pairs), CELLS), INSIDE, np.uint8))
    for number, pair in enumerate(pairs):
        table.kind[number] = _kinds(table, number, pair, squint[-NEAREST[0] : -NEAREST[-1]] + step / 2)
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


def _kinds(table: InverseTable, number: int, pair: Beams, squint: F64) -> U8:
    """Kind of each cell of a pair, by the beams in its middle and between nodes: where interpolation errs most."""
    cell, weights = np.arange(CELLS), np.tile(_lagrange(np.array([0.5])), (CELLS, 1))
    around = cell[:, None] + np.arange(len(NEAREST))
    known = np.isfinite(table.ends[number, :, 0])
    least, most = (np.sum(weights * table.mu[number, around, end], axis=1) for end in (0, -1))
    # Half way between the nodes of the squint below.
    nodes = table.mu[number, cell - NEAREST[0]].T
    share = ((nodes[1:] + nodes[:-1]) / 2 - nodes[0]) / (nodes[-1] - nodes[0])
    wanted = np.nan_to_num(least + (most - least) * share)
    found, reason = table.look_up(wanted, np.full(wanted.shape, number), cell, weights)
    exact_low, exact_high = discriminant_domain(pair, squint)
    back = discriminant(pair, np.vstack([found[0], exact_low, exact_high]), squint)
    error = np.abs(back - np.vstack([wanted, least, most]))
    allowed = np.all(error <= ALLOWED_ERROR, axis=0) & np.all(reason == INSIDE, axis=0)
    empty = ~known[around].any(axis=1) & np.isnan(exact_low)
    return np.select([allowed, empty], [INSIDE, NO_DOMAIN], UNKNOWN).astype(np.uint8)
