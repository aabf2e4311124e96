"""The monopulse discriminant of a pair of detectors, and its invertible domain (SAL paper, sections 2 to 4).

Two beams have the amplitudes l (lower) and u (upper) for a target; Sigma = u + l is their sum and Delta = u - l their
difference. The discriminant is mu = Re(Delta / Sigma). It depends on the elevation and, if the detector axis is turned
or the pattern is not a product of functions of elevation and squint, on the squint.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.optimize import elementwise

from sal_height.beams import Beams
from sal_height.numeric import F64

LEAST_SLOPE = 1e-5
"""Slope of the discriminant, per beamwidth, below which it is not inverted.

Float64 resolves mu to 4e-16, hence the elevation to 4e-11 beamwidths there. For Gaussian beams half a beamwidth apart
that is |mu| = 1 - 7.6e-6, 9.5 beamwidths from the middle.
"""

LEAST_CLEARANCE = 1e-3  # beamwidths from the domain to a null of Sigma, estimated as |Sigma| over its slope
FARTHEST = 30.0  # beamwidths from the crossing of the two beams up to which an end of the domain is searched
ROUNDING = 1e-9  # beamwidths beyond an end of the domain at which a target still counts as at the end


def discriminant(pair: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """Evaluate the noise-free discriminant Re(Delta / Sigma) at `elevation` and `squint` (rad); broadcasts.

    Not finite where Sigma is 0.
    """
    return _ratio(pair.response(elevation, squint))


def discriminant_slope(pair: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """Evaluate d mu / d elevation = Re 2 (u' l - u l') / Sigma^2 in 1/rad; broadcasts."""
    return _ratio_slope(pair.response(elevation, squint), pair.slope(elevation, squint))


def discriminant_with_slope(pair: Beams, elevation: F64, squint: F64) -> tuple[F64, F64]:
    """Evaluate `discriminant` and `discriminant_slope` (1/rad) together."""
    amplitude = pair.response(elevation, squint)
    return _ratio(amplitude), _ratio_slope(amplitude, pair.slope(elevation, squint))


def discriminant_domain(pair: Beams, squint: npt.ArrayLike) -> tuple[F64, F64]:
    """Find the elevations (rad) between which the discriminant can be inverted, in the shape of `squint`.

    The domain is the interval around the crossing of the two beams in which mu rises by LEAST_SLOPE per beamwidth or
    more, |mu| <= 1, and Sigma stays clear of 0 (`_margin`). For real beams |mu| = 1 where the
    target is in the first null of the farther detector; beyond it, sidelobes repeat the values of mu. The ends are NaN
    where the crossing itself does not meet these conditions, because all of it lies in a sidelobe.

    With the detector axis turned by psi, the crossing of two equal beams lies at elevation -squint tan psi from their
    middle: there the target is as far from one boresight as from the other.

    Args:
        pair: beams of the two detectors.
        squint: squint of the targets, rad.

    Raises:
        UserError: the patterns of the two detectors have no angle in common.
    """
    shape, squints = np.shape(squint), np.ravel(np.asarray(squint, dtype=np.float64))
    crossing = _on_axis(pair, float(np.mean(pair.boresights)), squints + pair.mean_aspect)
    both_ways = np.repeat([-1.0, 1.0], squints.size)
    low, high = np.split(_ends(pair, np.tile(squints, 2), np.tile(crossing, 2), both_ways), 2)
    return low.reshape(shape), high.reshape(shape)


def moving_squint(squint: npt.ArrayLike, radial_velocity: npt.ArrayLike, speed: npt.ArrayLike) -> F64:
    """Return the squint (rad) of a moving target that an image shows at `squint`; broadcasts.

    The range of a target at squint phi grows at the rate v_r - v sin phi: its own radial velocity v_r, less what the
    platform gains on it. An image attributes all of it to the platform and shows the target at the squint phi' with
    -v sin phi' = v_r - v sin phi, so that phi = phi' + v_r / v for small angles (SAL paper, section 4): a receding
    target appears behind its position, at smaller squint.

    The beams are to be inverted at the squint of the target. That holds in spotlight mode, and in stripmap, where the
    aspects under which a target was observed while its image was synthesised lie around phi instead of phi'.

    Args:
        squint: squint of the pixel, rad.
        radial_velocity: v_r of the target, positive if it recedes, m/s.
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
    """Return the margin of the domain's tightest condition, negative outside; -1 where mu is not finite.

    `phase` is that of Sigma at a nearby elevation: beyond a null of Sigma the phase differs from it by pi.
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
            coherence - 0.5,  # real beams have 1 wherever |mu| <= 1
            clearance - LEAST_CLEARANCE,
        ]
    )
    # With less amplitude the ratio of Gaussian beams loses digits to underflow.
    return np.where((strength >= 1e-250) & np.isfinite(margin), margin, -1.0)


def _on_axis(pair: Beams, angle: float, squint: F64) -> F64:
    """Return the elevation (rad) of the direction at `squint` and at `angle` (rad) along the detector axis."""
    middle = pair.axis_middle
    return middle + (angle - middle - squint * math.sin(pair.rotation)) / math.cos(pair.rotation)


def _known(pair: Beams, squint: F64) -> tuple[F64, F64]:
    """Return the elevations (rad) between which the patterns are known under all aspects."""
    first, last = pair.known
    within = 0.1 * ROUNDING * pair.beamwidth
    seen = squint + pair.aspects[:, None]
    return _on_axis(pair, first + within, seen).max(axis=0), _on_axis(pair, last - within, seen).min(axis=0)


def _ends(pair: Beams, squint: F64, crossing: F64, direction: F64) -> F64:
    """Find the end of the domain below (`direction` -1) or above (1) each crossing; NaN if that lies outside."""
    lowest, highest = _known(pair, squint)
    limit = np.where(direction < 0, lowest, highest)
    inside, outside, phase = (np.full_like(squint, np.nan) for _ in range(3))
    going = np.flatnonzero((crossing >= lowest) & (crossing <= highest))
    phase[going] = _sum_phase(pair, crossing[going], squint[going])
    # Step away from the crossing until the first elevation outside, which may be the crossing itself. Patterns have no
    # details finer than about half a beamwidth.
    for step in np.arange(0.0, FARTHEST, 0.1) * pair.beamwidth:
        there = np.clip(crossing[going] + step * direction[going], lowest[going], highest[going])
        outside[going] = there
        going = going[_margin(pair, there, squint[going], phase[going]) >= 0]
        inside[going] = outside[going]
        phase[going] = _sum_phase(pair, inside[going], squint[going])
        going = going[inside[going] != limit[going]]
        if not going.size:
            break
    # The end lies between the last elevation inside and the first outside.
    between = np.flatnonzero(np.abs(outside - inside) > 0)
    if between.size:
        inside[between] = elementwise.find_root(
            lambda elevation, squint, phase: _margin(pair, elevation, squint, phase),
            (inside[between], outside[between]),
            args=(squint[between], phase[between]),
            tolerances={"xatol": 0.01 * ROUNDING * pair.beamwidth},
        ).x
    return inside


def _sum_phase(pair: Beams, elevation: F64, squint: F64) -> F64:
    return np.angle(np.sum(pair.response(elevation, squint), axis=-1))
