"""Pairwise amplitude-comparison monopulse (SAL paper, sections 2 and 3).

Of each two neighbouring detectors, Sigma is the sum and Delta the upper minus the lower; the discriminant is
mu = Delta / Sigma. The pair with the most power in Sigma is taken in each pixel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sal_height.array_ml import OBJECTIVES, best_elevation
from sal_height.beams import Beams
from sal_height.errors import UserError
from sal_height.estimate import ElevationEstimate, Validity, explained_power, validity_of
from sal_height.looks import Covariance, Looks

Array = npt.NDArray[np.float64]
Discriminant = Callable[[Array, Array, Array], Array]

OUTSIDE_MARGIN = 3.0
"""Noise powers by which a direction outside the array must explain a pixel better to be believed."""

TABLE_NODES = 401
"""Nodes of the table that inverts the discriminant."""


def ratio(sum_power: Array, _difference_power: Array, cross_power: Array) -> Array:
    """Power-weighted mean of Re(Delta / Sigma): Re sum Delta Sigma* / sum |Sigma|^2.

    Biased towards the middle of the pair by the factor CNR / (CNR + 1) for a fluctuating target, however many looks.
    """
    return cross_power / sum_power


def total_least_squares(sum_power: Array, difference_power: Array, cross_power: Array) -> Array:
    """Exact two-channel maximum likelihood: noise in Sigma is accounted for, so the bias of `ratio` is gone.

    mu = tan(1/2 atan2(2 Re R_DS, R_SS - R_DD)); needs equal noise in Sigma and Delta, not its value.
    """
    return np.tan(np.arctan2(2 * cross_power, sum_power - difference_power) / 2)


DISCRIMINANTS: dict[str, Discriminant] = {"tls": total_least_squares, "ratio": ratio}
"""Estimates of the discriminant by name."""


def pair_discriminant(offset: npt.ArrayLike, squint: npt.ArrayLike, pitch: float, beams: Beams) -> Array:
    """Noise-free discriminant of a pair for a target `offset` above its middle (all rad); broadcasts."""
    lower, upper = _pair_response(offset, squint, pitch, beams)
    return (upper - lower) / (upper + lower)


def monopulse_elevation(
    looks: Looks, beams: Beams, squint: Array, noise_power: float, discriminant: Discriminant, min_cnr: float
) -> ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel from its strongest pair.

    Args:
        looks: covariance of M channels in each pixel.
        beams: of the M detectors, equally spaced.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in one channel (`estimate.common_noise`).
        discriminant: one of DISCRIMINANTS.
        min_cnr: pixels below this power ratio are LOW_CNR.

    Raises:
        UserError: fewer than two detectors, or unequal pitch.
    """
    pitch = _pitch(beams)
    diagonal = np.diagonal(looks.covariance, axis1=-2, axis2=-1).astype(np.float64)
    beside = np.diagonal(looks.covariance, offset=1, axis1=-2, axis2=-1).astype(np.float64)
    pair_power = diagonal[..., :-1] + diagonal[..., 1:]
    pair = np.argmax(pair_power + 2 * beside, axis=-1)[..., None]

    def chosen(values: Array) -> Array:
        return np.take_along_axis(values, pair, axis=-1)[..., 0]

    sum_power = chosen(pair_power + 2 * beside)
    difference_power = chosen(pair_power - 2 * beside)
    with np.errstate(invalid="ignore"):
        mu = discriminant(sum_power, difference_power, chosen(diagonal[..., 1:] - diagonal[..., :-1]))
    offset, slope = _invert(mu, squint, pitch, beams)

    sum_noise = 2 * noise_power
    energy = sum_power / sum_noise - looks.count
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = (1 + mu**2) / (2 * energy) * (1 + looks.count / (energy * (1 + mu**2))) / slope**2
        lower, upper = _pair_response(offset, squint, pitch, beams)
        cnr = energy * 2 / (lower + upper) ** 2 / looks.count
    middles = (beams.boresights[:-1] + beams.boresights[1:]) / 2
    elevation = middles[pair[..., 0]] + offset
    validity = validity_of(looks, beams, squint, noise_power, elevation, cnr, min_cnr)
    outside = _better_outside(looks.covariance, beams, squint, noise_power, elevation)
    validity = np.where((validity == Validity.OK) & outside, Validity.OUTSIDE_ARRAY, validity)
    return ElevationEstimate(
        elevation=elevation,
        sigma=np.sqrt(np.where(energy > 0, variance, np.inf)),
        cnr=cnr,
        validity=np.where(np.isnan(offset) & looks.finite, Validity.OUTSIDE_PAIR, validity).astype(np.uint8),
    )


def _better_outside(
    covariance: Covariance, beams: Beams, squint: Array, noise_power: float, elevation: Array
) -> npt.NDArray[np.bool_]:
    """Whether a target outside the array explains the channels better than one at `elevation`, by OUTSIDE_MARGIN.

    A pair cannot see that its target is in a sidelobe; the other detectors can.
    """
    best = best_elevation(covariance, beams, squint, OBJECTIVES["normalised"])
    first, last = beams.span
    gain = explained_power(covariance, beams.response(best, squint))
    gain -= explained_power(covariance, beams.response(np.nan_to_num(elevation, nan=first), squint))
    return ((best < first) | (best > last)) & (gain > OUTSIDE_MARGIN * noise_power)


def _pitch(beams: Beams) -> float:
    """Spacing of the boresights in rad.

    Raises:
        UserError: fewer than two detectors, or unequal spacing.
    """
    if len(beams.boresights) < 2:
        raise UserError(f"The sensor has {len(beams.boresights)} detector; monopulse needs 2 or more.")
    pitches = np.diff(beams.boresights)
    if np.ptp(pitches) > 1e-6 * pitches[0]:
        raise UserError(
            f"The boresights are spaced {pitches.min():.6g} to {pitches.max():.6g} rad; monopulse needs equal spacing."
        )
    return float(np.mean(pitches))


def _pair_response(offset: npt.ArrayLike, squint: npt.ArrayLike, pitch: float, beams: Beams) -> tuple[Array, Array]:
    """Amplitudes of the lower and the upper detector of a pair."""
    azimuth = np.asarray(squint) / beams.beamwidth
    lower = beams.patterns[0].amplitude((np.asarray(offset) + pitch / 2) / beams.beamwidth, azimuth)
    upper = beams.patterns[0].amplitude((np.asarray(offset) - pitch / 2) / beams.beamwidth, azimuth)
    return lower, upper


def _invert(mu: Array, squint: Array, pitch: float, beams: Beams) -> tuple[Array, Array]:
    """Offset from the pair's middle (rad) with discriminant `mu`, and the slope d mu / d offset there (1/rad).

    Searched within one pitch of the middle. Interpolated in a table, then two Newton steps with the exact slope.
    NaN where |mu| exceeds what the table holds.
    """
    nodes = np.linspace(-pitch, pitch, TABLE_NODES)
    offset = np.empty_like(mu)
    for col, angle in enumerate(squint):
        table = pair_discriminant(nodes, angle, pitch, beams)
        rising = _rising_middle(table)
        offset[:, col] = np.interp(mu[:, col], table[rising], nodes[rising], left=np.nan, right=np.nan)
    for _ in range(2):
        slope = _discriminant_slope(offset, squint, pitch, beams)
        offset = offset - (pair_discriminant(offset, squint, pitch, beams) - mu) / slope
    return offset, _discriminant_slope(offset, squint, pitch, beams)


def _rising_middle(table: Array) -> slice:
    """The part of an odd table around its middle where it rises and stays within [-1, 1]."""
    middle = len(table) // 2
    usable = np.concatenate([[True], np.diff(table[middle:]) > 0]) & (np.abs(table[middle:]) <= 1)
    reach = len(usable) if np.all(usable) else int(np.argmin(usable))
    return slice(middle - reach + 1, middle + reach)


def _discriminant_slope(offset: Array, squint: Array, pitch: float, beams: Beams) -> Array:
    """Slope d mu / d offset: 2 (u' l - u l') / (u + l)^2, 1/rad."""
    lower, upper = _pair_response(offset, squint, pitch, beams)
    azimuth = np.asarray(squint) / beams.beamwidth
    lower_slope = beams.patterns[0].slope((offset + pitch / 2) / beams.beamwidth, azimuth) / beams.beamwidth
    upper_slope = beams.patterns[0].slope((offset - pitch / 2) / beams.beamwidth, azimuth) / beams.beamwidth
    return 2 * (upper_slope * lower - upper * lower_slope) / (upper + lower) ** 2
