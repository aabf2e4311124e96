"""The monopulse discriminant of a pair of detectors and its inversion (SAL paper, sections 2 to 4).

Of two beams with amplitudes l (lower) and u (upper) of a target, Sigma = u + l is the sum and Delta = u - l the
difference; the discriminant is mu = Re(Delta / Sigma). It depends on the elevation and, if the detector axis is
turned or the pattern does not separate, on the squint.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from scipy.optimize import elementwise

from sal_height.beams import Beams
from sal_height.numeric import F64, I64, U8, Bool

LEAST_SLOPE = 1e-5
"""Slope of the discriminant per beamwidth at which its domain ends.

Float64 holds mu to 4e-16, hence the elevation to 4e-11 beamwidths there. For Gaussian beams half a beamwidth apart
that is |mu| = 1 - 7.6e-6, 9.5 beamwidths from the middle.
"""

LEAST_COHERENCE = 0.5
"""Least |Sigma| / (|u| + |l|) of the domain. Real beams have 1 wherever |mu| <= 1."""

LEAST_CLEARANCE = 1e-3
"""Beamwidths by which the domain stays off a null of Sigma, as |Sigma| over its slope tells."""

LEAST_AMPLITUDE = 1e-250
"""Least |u| + |l| of the domain: below it the ratio of Gaussian beams loses digits to underflow."""

FARTHEST = 30.0
"""Beamwidths of elevation from the crossing to which the domain is searched."""

SEARCH_STEP = 0.1
"""Beamwidths between the elevations at which the search looks; no pattern is finer than about half a beamwidth."""

ROUNDING = 1e-9
"""Beamwidths by which a target may lie beyond the domain and still count as at its end."""

TABLE_NODES = 41
"""Elevations of the table from which the inversion starts."""

SETTLED = 1e-6
"""Newton step, in distances between two nodes, that is the last: what it leaves is of the order of its square."""

MOST_STEPS = 60
"""Of Newton's method or, where it leaves its bracket, of halving."""


class Reason(IntEnum):
    """Why a discriminant has no elevation."""

    INSIDE = 0
    BELOW = 1
    ABOVE = 2
    NOT_FINITE = 3
    NO_DOMAIN = 4


@dataclass(frozen=True, eq=False)
class Inversion:
    """Elevations of discriminants; all arrays have their shape.

    Attributes:
        elevation: rad from nadir in body axes; NaN where the reason is not INSIDE.
        slope: of the discriminant there, 1/rad; NaN where the reason is not INSIDE.
        reason: `Reason` of each: INSIDE the domain; BELOW or ABOVE the values that mu takes in it; NOT_FINITE; or
            NO_DOMAIN where the pair has none at that squint. uint8.
    """

    elevation: F64
    slope: F64
    reason: U8


@dataclass(frozen=True, eq=False)
class _Table:
    """Nodes of the discriminant over its domain, shape (squints, TABLE_NODES); NaN where there is no domain."""

    elevation: F64
    mu: F64
    slope: F64


def discriminant(pair: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """Noise-free discriminant Re(Delta / Sigma) of two beams for targets at `elevation` and `squint` (rad); broadcasts.

    Not finite where Sigma is 0.
    """
    return _ratio(pair.response(elevation, squint))


def discriminant_slope(pair: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """Derivative of `discriminant` with respect to elevation, 1/rad: Re 2 (u' l - u l') / Sigma^2; broadcasts."""
    return _ratio_slope(pair.response(elevation, squint), pair.slope(elevation, squint))


def discriminant_domain(pair: Beams, squint: npt.ArrayLike) -> tuple[F64, F64]:
    """Least and greatest elevation (rad) between which the discriminant can be inverted, in the shape of `squint`.

    The interval around the crossing of the two beams in which mu rises by LEAST_SLOPE per beamwidth or more, |mu| <= 1,
    and Sigma stays clear of 0 (LEAST_COHERENCE, LEAST_CLEARANCE). For real beams |mu| = 1 where the target is in the
    first null of the farther detector; beyond it, sidelobes repeat the values of mu. NaN where the crossing itself is
    not such an elevation: all of it lies in a sidelobe.

    With the detector axis turned by psi, the crossing of two equal beams lies at elevation -squint tan psi from their
    middle: there the target is as far from one boresight as from the other.

    Args:
        pair: two beams, or a stack of pairs (`Beams.pair`).
        squint: of the targets, rad.

    Raises:
        UserError: the patterns of the two detectors have no angle in common.
    """
    squint, lower = np.broadcast_arrays(np.asarray(squint, dtype=np.float64), pair.boresights[..., 0])
    stack = _stack(pair, np.broadcast_to(pair.boresights, (*lower.shape, 2)).reshape(-1, 2))
    low, high = _domain(stack, squint.ravel())
    return low.reshape(squint.shape), high.reshape(squint.shape)


def invert(pair: Beams, mu: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
    """Elevation at which a pair of beams has the discriminant `mu`, within its domain; broadcasts.

    Exact to 1e-9 beamwidths: from a table of each squint, Newton's method with the exact slope, which never leaves the
    two nodes around the solution. The table takes as long as some 80 pixels for each different squint and pair.

    Args:
        pair: two beams, or a stack of pairs (`Beams.pair`) that broadcasts with `squint`.
        mu: discriminants; NaN is NOT_FINITE.
        squint: of the targets, rad.

    Raises:
        UserError: the patterns of the two detectors have no angle in common.
    """
    different, stack, which = _different(pair, np.asarray(squint, dtype=np.float64))
    mu, which = np.broadcast_arrays(np.asarray(mu, dtype=np.float64), which)
    table = _table(stack, different)
    slack = ROUNDING * pair.beamwidth * table.slope
    reason = np.select(
        [
            ~(np.isfinite(mu) & np.isfinite(different)[which]),
            np.isnan(table.mu[:, 0])[which],
            mu < (table.mu - slack)[which, 0],
            mu > (table.mu + slack)[which, -1],
        ],
        [Reason.NOT_FINITE, Reason.NO_DOMAIN, Reason.BELOW, Reason.ABOVE],
        Reason.INSIDE,
    ).astype(np.uint8)
    inside = reason == Reason.INSIDE
    elevation, slope = np.full(mu.shape, np.nan), np.full(mu.shape, np.nan)
    elevation[inside], slope[inside] = _solve(stack, mu[inside], different, which[inside], table)
    return Inversion(elevation, slope, reason)


def moving_squint(squint: npt.ArrayLike, radial_velocity: npt.ArrayLike, speed: npt.ArrayLike) -> F64:
    """Squint (rad) at which a moving target really is that an image shows at `squint`; broadcasts.

    A target at squint phi recedes from the platform at v_r - v sin phi: its own velocity, less what the platform gains
    on it. An image takes all of it for the platform's, and shows the target at the squint phi' with
    -v sin phi' = v_r - v sin phi, so that phi = phi' + v_r / v for small angles (SAL paper, section 4): one that
    recedes appears behind its place, at smaller squint.

    The beams are to be inverted where the target is. That holds in spotlight mode, and in stripmap, where the aspects
    under which a target was seen while its image was synthesised lie around phi instead of phi'.

    Args:
        squint: of the pixel, rad.
        radial_velocity: v_r of the target, m/s, positive if it recedes.
        speed: v of the platform, m/s.
    """
    return np.asarray(squint) + np.asarray(radial_velocity) / np.asarray(speed)


def _ratio(amplitude: F64) -> F64:
    lower, upper = amplitude[..., 0], amplitude[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.real((upper - lower) / (upper + lower))


def _ratio_slope(amplitude: F64, derivative: F64) -> F64:
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.sum(amplitude, axis=-1, keepdims=True)
        (lower, upper), (lower_slope, upper_slope) = (np.moveaxis(f / total, -1, 0) for f in (amplitude, derivative))
        return 2 * np.real(upper_slope * lower - upper * lower_slope)


def _margin(pair: Beams, elevation: F64, squint: F64, phase: F64) -> F64:
    """What is left of the domain's tightest condition, negative outside; -1 where the discriminant is not finite.

    `phase` is that of Sigma at a place nearby: where Sigma has passed through 0, it differs by half a turn.
    """
    amplitude = pair.response(elevation, squint)
    derivative = pair.slope(elevation, squint) * pair.beamwidth
    total, strength = np.sum(amplitude, axis=-1), np.sum(np.abs(amplitude), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.real(total * np.exp(-1j * phase)) / strength
        clearance = np.abs(total) / np.abs(np.sum(derivative, axis=-1))
    margin = np.minimum.reduce(
        [
            _ratio_slope(amplitude, derivative) - LEAST_SLOPE,
            1 - np.abs(_ratio(amplitude)),
            coherence - LEAST_COHERENCE,
            clearance - LEAST_CLEARANCE,
        ]
    )
    return np.where((strength >= LEAST_AMPLITUDE) & np.isfinite(margin), margin, -1.0)


def _stack(pair: Beams, boresights: F64) -> Beams:
    """Pairs like `pair` with other boresights, shape (pairs, 2)."""
    return replace(pair, boresights=boresights, middle=pair.axis_middle)


def _part(stack: Beams, index: I64) -> Beams:
    """Some pairs of a stack."""
    return replace(stack, boresights=stack.boresights[index])


def _different(pair: Beams, squint: F64) -> tuple[F64, Beams, I64]:
    """The different combinations of squint and pair, and which of them each is; that in the shape they broadcast to."""
    squints, squint_of = np.unique(squint, return_inverse=True)
    lowers, pair_of = np.unique(pair.boresights[..., 0], return_inverse=True)
    combined = squint_of.reshape(squint.shape) * len(lowers) + pair_of.reshape(pair.boresights.shape[:-1])
    _, first, which = np.unique(combined, return_index=True, return_inverse=True)
    boresights = np.broadcast_to(pair.boresights, (*combined.shape, 2)).reshape(-1, 2)[first]
    return squints[combined.ravel()[first] // len(lowers)], _stack(pair, boresights), which.reshape(combined.shape)


def _domain(stack: Beams, squint: F64) -> tuple[F64, F64]:
    """`discriminant_domain` of a stack of pairs at one squint each."""
    middle = np.mean(stack.boresights, axis=-1)
    crossing = _on_axis(stack, middle, squint + np.average(stack.aspects, weights=stack.weights))
    both = np.tile(np.arange(len(squint)), 2)
    low, high = np.split(
        _ends(_part(stack, both), squint[both], crossing[both], np.repeat([-1.0, 1.0], len(squint))), 2
    )
    return low, high


def _on_axis(pair: Beams, place: F64, squint: F64) -> F64:
    """Elevation (rad) of the direction at `squint` that has its `place` (rad from nadir) along the detector axis."""
    middle = pair.axis_middle
    return middle + (place - middle - squint * math.sin(pair.rotation)) / math.cos(pair.rotation)


def _known(pair: Beams, squint: F64) -> tuple[F64, F64]:
    """Elevations (rad) at which the patterns are known under all aspects."""
    first, last = pair.known
    within = 0.1 * ROUNDING * pair.beamwidth
    seen = squint + pair.aspects[:, None]
    return _on_axis(pair, first + within, seen).max(axis=0), _on_axis(pair, last - within, seen).min(axis=0)


def _ends(stack: Beams, squint: F64, crossing: F64, direction: F64) -> F64:
    """End of the domain below (`direction` -1) or above (1) the crossing of each pair; NaN if that is outside."""
    lowest, highest = _known(stack, squint)
    going = np.flatnonzero((crossing >= lowest) & (crossing <= highest))
    phase = np.zeros_like(squint)
    phase[going] = _sum_phase(_part(stack, going), crossing[going], squint[going])
    going = going[_margin(_part(stack, going), crossing[going], squint[going], phase[going]) >= 0]
    inside = np.full_like(squint, np.nan)
    inside[going] = crossing[going]
    outside = inside.copy()
    for step in np.arange(SEARCH_STEP, FARTHEST, SEARCH_STEP) * stack.beamwidth:
        there = np.clip(crossing[going] + step * direction[going], lowest[going], highest[going])
        outside[going] = there
        going = going[_margin(_part(stack, going), there, squint[going], phase[going]) >= 0]
        inside[going] = outside[going]
        phase[going] = _sum_phase(_part(stack, going), inside[going], squint[going])
        going = going[(inside[going] > lowest[going]) & (inside[going] < highest[going])]
        if not going.size:
            break
    between = np.flatnonzero(np.abs(outside - inside) > 0)
    if between.size:
        inside[between] = elementwise.find_root(
            lambda elevation, squint, phase, *pair: _margin(
                _stack(stack, np.stack(pair, -1)), elevation, squint, phase
            ),
            (inside[between], outside[between]),
            args=(squint[between], phase[between], *stack.boresights[between].T),
            tolerances={"xatol": 0.01 * ROUNDING * stack.beamwidth},
        ).x
    return inside


def _sum_phase(pair: Beams, elevation: F64, squint: F64) -> F64:
    return np.angle(np.sum(pair.response(elevation, squint), axis=-1))


def _table(stack: Beams, squint: F64) -> _Table:
    """Table of each pair at its squint, denser towards the ends of the domain."""
    low, high = _domain(stack, squint)
    share = (1 - np.cos(np.linspace(0, np.pi, TABLE_NODES))) / 2
    elevation = low[:, None] * (1 - share) + high[:, None] * share
    mu, slope = np.full_like(elevation, np.nan), np.full_like(elevation, np.nan)
    exists = np.flatnonzero(np.isfinite(low))
    nodes = _part(stack, np.repeat(exists, TABLE_NODES))
    found = _evaluate(nodes, elevation[exists].ravel(), np.repeat(squint[exists], TABLE_NODES))
    mu[exists], slope[exists] = (values.reshape(-1, TABLE_NODES) for values in found)
    return _Table(elevation, mu, slope)


def _evaluate(pair: Beams, elevation: F64, squint: F64) -> tuple[F64, F64]:
    """Discriminant and its slope (1/rad)."""
    amplitude = pair.response(elevation, squint)
    return _ratio(amplitude), _ratio_slope(amplitude, pair.slope(elevation, squint))


def _solve(stack: Beams, mu: F64, squints: F64, which: I64, table: _Table) -> tuple[F64, F64]:
    """Elevation and slope for each `mu` of shape (pixels,), whose pair and squint are number `which`."""
    # Discriminants of number k lie within 3 k - 1 and 3 k + 1, so that one search finds the nodes around all pixels.
    nodes = (3 * np.arange(len(squints))[:, None] + np.nan_to_num(table.mu)).ravel()
    first = which * TABLE_NODES
    below = np.clip(np.searchsorted(nodes, 3 * which + mu, side="right") - 1, first, first + TABLE_NODES - 2)
    (low, high), (mu_low, mu_high), (slope_low, slope_high) = (
        (values.ravel()[below], values.ravel()[below + 1]) for values in (table.elevation, table.mu, table.slope)
    )
    mu = np.clip(mu, mu_low, mu_high)
    # The cubic of elevation over mu that has the values and the slopes of both nodes.
    rise, width = mu_high - mu_low, high - low
    share = (mu - mu_low) / rise
    bend = (1 - share) * (rise / slope_low - width) - share * (rise / slope_high - width)
    start = np.clip(low + share * width + share * (1 - share) * bend, low, high)
    return _newton(_part(stack, which), mu, squints[which], start, low, high)


def _newton(stack: Beams, mu: F64, squint: F64, start: F64, low: F64, high: F64) -> tuple[F64, F64]:
    """Solution between `low` and `high`, and the slope there: Newton's step, or half the bracket if that leaves it."""
    settled = SETTLED * (high - low) + 4 * np.finfo(np.float64).eps
    elevation, slope = start, np.empty_like(start)
    going = np.arange(len(start))
    for _ in range(MOST_STEPS):
        here = elevation[going]
        value, slope[going] = _evaluate(_part(stack, going), here, squint[going])
        excess = value - mu[going]
        low[going], high[going] = np.where(excess < 0, here, low[going]), np.where(excess > 0, here, high[going])
        there = here - excess / slope[going]
        within = np.clip(there, low[going], high[going])
        kept = np.abs(within - there) <= settled[going]
        elevation[going] = np.where(kept, within, (low[going] + high[going]) / 2)
        going = going[~(np.abs(there - here) <= settled[going])]
        if not going.size:
            break
    return elevation, slope


Inverse = Callable[[Beams, F64, F64], Inversion]
"""Elevations from the pair of beams, gamma, and the squint of each (rad, broadcasts): see `discriminant.invert`."""


def invert_linear(pair: Beams, gamma: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
    """Elevation by the tangent in the equisignal direction, theta_0 + gamma / g (relief paper, eq. 6, 7); broadcasts.

    Of unlike beams, whose gamma is not 0 half way between them, the tangent there. Exact to first order only; see
    `discriminant.invert` for the beams as they are. |gamma| up to 1 is INSIDE, as there.

    Args:
        pair: the two beams.
        gamma: NaN is NOT_FINITE.
        squint: of the targets, rad.
    """
    gamma, squint = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(squint, dtype=np.float64))
    middle = equisignal_elevation(pair, squint)
    slope = discriminant_slope(pair, middle, squint)
    with np.errstate(divide="ignore", invalid="ignore"):
        elevation = middle + (gamma - discriminant(pair, middle, squint)) / slope
    rising = slope * pair.beamwidth > LEAST_SLOPE
    return inversion_between(elevation, slope, gamma, (-1.0, 1.0), rising)


def equisignal_elevation(pair: Beams, squint: F64) -> F64:
    """Elevation (rad) at `squint` of the direction as far along the detector axis from one beam as from the other."""
    seen = squint + np.average(pair.aspects, weights=pair.weights)
    return np.mean(pair.boresights) - seen * np.tan(pair.rotation)


def inversion_between(elevation: F64, slope: F64, gamma: F64, ends: tuple[float, float], exists: Bool) -> Inversion:
    """The inversion of gamma that is good between `ends`, where there `exists` a characteristic at all."""
    reason = np.select(
        [~np.isfinite(gamma), ~exists, gamma < ends[0], gamma > ends[1]],
        [Reason.NOT_FINITE, Reason.NO_DOMAIN, Reason.BELOW, Reason.ABOVE],
        Reason.INSIDE,
    ).astype(np.uint8)
    inside = reason == Reason.INSIDE
    return Inversion(np.where(inside, elevation, np.nan), np.where(inside, slope, np.nan), reason)


INVERSES: dict[str, Inverse] = {"exact": invert, "linear": invert_linear}
"""Inversions by the beams themselves, by name."""
