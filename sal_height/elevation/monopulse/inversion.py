"""Elevations from discriminants: the inversion of mu for a pair of beams, exact or linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Self

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.elevation.monopulse.discriminant import (
    LEAST_SLOPE,
    ROUNDING,
    discriminant,
    discriminant_domain,
    discriminant_slope,
    discriminant_with_slope,
)
from sal_height.numeric import F64, U8, Bool

MOST_STEPS = 10  # maximum number of Newton steps


class Reason(IntEnum):
    """Reason for which a discriminant has no elevation."""

    INSIDE = 0
    BELOW = 1
    ABOVE = 2
    NOT_FINITE = 3
    NO_DOMAIN = 4


UNPAIRED = np.zeros(len(Reason), np.bool_)
UNPAIRED[[Reason.BELOW, Reason.ABOVE, Reason.NO_DOMAIN]] = True
"""True for each `Reason` of a discriminant outside the domain of its pair."""


@dataclass(frozen=True, eq=False)
class Inversion:
    """Elevations of discriminants; all arrays have their shape.

    Attributes:
        elevation: angle from nadir in body axes, NaN where the reason is not INSIDE, rad.
        slope: slope of the discriminant there, NaN where the reason is not INSIDE, 1/rad.
        reason: `Reason` of each: INSIDE the domain; BELOW or ABOVE the values of mu in it; NOT_FINITE; or NO_DOMAIN
            where the pair has none at that squint. uint8.
    """

    elevation: F64
    slope: F64
    reason: U8


@dataclass(frozen=True, eq=False)
class PairElevation(Inversion):
    """Elevations of discriminants, and the beams of their pairs there; all arrays have their shape.

    Attributes:
        sum_gain: |Sigma|^2 of a scatterer of amplitude 1; NaN where the reason is not INSIDE, as `modulus`.
        modulus: |Delta / Sigma|.
    """

    sum_gain: F64
    modulus: F64

    @classmethod
    def of(cls, pair: Beams, found: Inversion, squint: npt.ArrayLike) -> Self:
        """The inversion for one pair of beams at squints (rad), which broadcast."""
        lower, upper = np.moveaxis(pair.response(found.elevation, squint), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            modulus = np.abs(upper - lower) / np.abs(upper + lower)
        return cls(found.elevation, found.slope, found.reason, np.abs(upper + lower) ** 2, modulus)

    @classmethod
    def side_by_side(cls, several: Sequence[Self]) -> Self:
        """The inversions of parts of an image, which are some columns each, as one."""
        return cls(*(np.concatenate([getattr(one, f.name) for one in several], axis=-1) for f in fields(cls)))


def invert(pair: Beams, mu: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
    """Find the elevation at which a pair of beams has the discriminant `mu`, within its domain; broadcasts.

    A table of mu over elevation at each squint gives the start of Newton's method with the exact slope, which leads
    within 1e-9 beamwidths.

    Args:
        pair: beams of the two detectors.
        mu: discriminants; NaN is NOT_FINITE.
        squint: squint of the targets, rad.

    Raises:
        UserError: the patterns of the two detectors have no angle in common.
    """
    squints, which = np.unique(squint, return_inverse=True)
    mu, squint, which = np.broadcast_arrays(np.asarray(mu, dtype=np.float64), squint, which.reshape(np.shape(squint)))
    domain = discriminant_domain(pair, squints)
    # 2^14 nodes for all squints, but at least 129 for each: linear interpolation then errs by up to 8e-3 beamwidths
    # (Gaussian beams), and Newton's method takes two or three steps. A cubic table (PCHIP) that errs by 2e-10
    # beamwidths by itself needs 2000 nodes (jinc) to 16000 (Gaussian beams) at each squint: for the 256 squints of a
    # spotlight image that takes 0.6 to 4 times as long as the whole inversion.
    count = max(129, 2**14 // squints.size)
    # Nodes are denser towards the ends of the domain, where the discriminant of Gaussian beams levels off.
    fraction = (1 - np.cos(np.linspace(0, np.pi, count))) / 2
    nodes = domain[0][:, None] * (1 - fraction) + domain[1][:, None] * fraction
    values = discriminant(pair, nodes, squints[:, None])
    slack = ROUNDING * pair.beamwidth * discriminant_slope(pair, nodes[:, [0, -1]], squints[:, None])
    least, most = values[:, 0] - slack[:, 0], values[:, -1] + slack[:, 1]
    known = np.where(np.isfinite(squint), mu, np.nan)
    reason = _reasons(known, least[which], most[which], np.isfinite(domain[0])[which])
    inside = reason == Reason.INSIDE
    group, wanted, angle = which[inside], mu[inside], squint[inside]
    low, high = (end[group] for end in domain)
    # The tables are joined to one, shifted by 4, because mu lies between -1 and 1.
    shift = 4.0 * np.arange(squints.size)
    found = np.interp(wanted + shift[group], (np.nan_to_num(values) + shift[:, None]).ravel(), nodes.ravel())
    last_slope = np.empty_like(found)
    for _ in range(MOST_STEPS):
        value, last_slope = discriminant_with_slope(pair, found, angle)
        before, found = found, np.clip(found - (value - wanted) / last_slope, low, high)
        # The next step would leave 1e-11 beamwidths, even at the least slope.
        if np.all(np.abs(found - before) < 1e-8 * pair.beamwidth):
            break
    elevation, slope = (np.full(mu.shape, np.nan) for _ in range(2))
    elevation[inside], slope[inside] = found, last_slope
    return Inversion(elevation, slope, reason)


def invert_linear(pair: Beams, gamma: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
    """Find elevations by the tangent in the equisignal direction, theta_0 + gamma / g (relief paper, eq. 6 and 7).

    If the beams are unlike, so that gamma is not 0 half way between them, the tangent there is used. Exact to first
    order only; `invert` follows the beams as they are. |gamma| up to 1 is INSIDE, as there. Broadcasts.

    Args:
        pair: beams of the two detectors.
        gamma: estimates of Delta / Sigma; NaN is NOT_FINITE.
        squint: squint of the targets, rad.
    """
    gamma, squint = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(squint, dtype=np.float64))
    middle = equisignal_elevation(pair, squint)
    slope = discriminant_slope(pair, middle, squint)
    with np.errstate(divide="ignore", invalid="ignore"):
        elevation = middle + (gamma - discriminant(pair, middle, squint)) / slope
    rising = slope * pair.beamwidth > LEAST_SLOPE
    return inversion_between(elevation, slope, gamma, (-1.0, 1.0), rising)


def equisignal_elevation(pair: Beams, squint: F64) -> F64:
    """Return the elevation (rad) at `squint` half way between two beams along the detector axis."""
    return np.mean(pair.boresights) - (squint + pair.mean_aspect) * np.tan(pair.rotation)


def inversion_between(elevation: F64, slope: F64, gamma: F64, ends: tuple[float, float], exists: Bool) -> Inversion:
    """Return the inversion that is valid for gamma between `ends`, and where a characteristic `exists`."""
    reason = _reasons(gamma, *ends, exists)
    inside = reason == Reason.INSIDE
    return Inversion(np.where(inside, elevation, np.nan), np.where(inside, slope, np.nan), reason)


def _reasons(gamma: F64, least: F64 | float, most: F64 | float, exists: Bool) -> U8:
    """Return the `Reason` of each gamma."""
    return np.select(
        [~np.isfinite(gamma), ~exists, gamma < least, gamma > most],
        [Reason.NOT_FINITE, Reason.NO_DOMAIN, Reason.BELOW, Reason.ABOVE],
        Reason.INSIDE,
    ).astype(np.uint8)
