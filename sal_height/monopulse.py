"""Pairwise amplitude-comparison monopulse (SAL paper, sections 2 and 3).

Of each two neighbouring detectors, Sigma is the sum and Delta the upper minus the lower, both of channels with the same
noise (`estimate.whitening`): then that of Sigma and Delta is equal and independent, too. The pair with the most power
in Sigma is taken in each pixel; its discriminant mu = Re(Delta / Sigma) is estimated and inverted (`discriminant`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.array_ml import OBJECTIVES, best_elevation
from sal_height.beams import Beams
from sal_height.discriminant import Inversion, Reason, invert
from sal_height.errors import UserError
from sal_height.estimate import ElevationEstimate, Validity, by_rows, explained_power, validity_of
from sal_height.looks import Covariance, Looks

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Estimator = Callable[[Array, Array, ComplexArray, float | Array], Array]

OUTSIDE_MARGIN = 3.0
"""Noise powers by which a direction outside the array must explain a pixel better to be believed."""


def ratio(sum_power: Array, _difference_power: Array, cross_power: ComplexArray, _noise_energy: float | Array) -> Array:
    """Power-weighted mean of Re(Delta / Sigma): Re sum Delta Sigma* / sum |Sigma|^2 (SAL paper, section 3).

    Biased towards the middle of the pair by the factor CNR / (CNR + 1) for a fluctuating target, however many looks
    (Kanter 1977).
    """
    return np.real(cross_power) / sum_power


def noise_subtraction(
    sum_power: Array, _difference_power: Array, cross_power: ComplexArray, noise_energy: float | Array
) -> Array:
    """`ratio` without the noise in its denominator: Re sum Delta Sigma* / (sum |Sigma|^2 - noise energy).

    Free of the bias as the looks grow in number. NaN where there is no more power in Sigma than noise.
    """
    signal = sum_power - noise_energy
    return np.where(signal > 0, np.real(cross_power) / np.where(signal > 0, signal, 1.0), np.nan)


def total_least_squares(
    sum_power: Array, difference_power: Array, cross_power: ComplexArray, _noise_energy: float | Array
) -> Array:
    """Exact two-channel maximum likelihood: noise in Sigma is accounted for, so the bias of `ratio` is gone.

    The ratio of the principal eigenvector of the covariance of Sigma and Delta: its modulus is
    tan(1/2 atan2(2 |R_DS|, R_SS - R_DD)), its phase that of R_DS. Needs equal noise in Sigma and Delta, not its value.
    """
    modulus = np.tan(np.arctan2(2 * np.abs(cross_power), sum_power - difference_power) / 2)
    return np.asarray(modulus * np.cos(np.angle(cross_power)))


DISCRIMINANTS: dict[str, Estimator] = {
    "tls": total_least_squares,
    "ratio": ratio,
    "noise_subtraction": noise_subtraction,
}
"""Estimates of the discriminant by name, each from sums over looks: |Sigma|^2, |Delta|^2, Delta Sigma*, and the mean
energy K sigma^2 of the noise in Sigma. Real beams make the mean of Delta Sigma* real: then only its real part is given,
as noise alone is left in the other."""


def monopulse_elevation(
    looks: Looks, beams: Beams, squint: Array, noise_power: float, discriminant: Estimator, min_cnr: float
) -> ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel from its strongest pair.

    Sigma is the bound for the pair by itself, (1 + |Delta / Sigma|^2) / (2 E) (1 + K / (E (1 + |Delta / Sigma|^2)))
    over the square of the slope of the discriminant, with E the energy of the looks' signal over the noise power in
    Sigma. Pixels are OUTSIDE_PAIR where their discriminant is outside the domain of their pair.

    Args:
        looks: covariance of M channels in each pixel.
        beams: of the M detectors.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in every channel (`estimate.whitening`).
        discriminant: one of DISCRIMINANTS.
        min_cnr: pixels below this power ratio are LOW_CNR.

    Raises:
        UserError: fewer than two detectors.
    """
    if beams.count < 2:
        raise UserError(f"The sensor has {beams.count} detector; monopulse needs 2 or more.")
    best = best_elevation(looks.covariance, beams, squint, OBJECTIVES["normalised"])

    def estimate(some: Looks, rows: slice) -> ElevationEstimate:
        return _of_strongest_pairs(some, beams, squint, noise_power, discriminant, min_cnr, best[rows])

    return by_rows(looks, estimate)


def _of_strongest_pairs(
    looks: Looks,
    beams: Beams,
    squint: Array,
    noise_power: float,
    discriminant: Estimator,
    min_cnr: float,
    best: Array,
) -> ElevationEstimate:
    """`monopulse_elevation` where `best` (rad, (rows, cols)) is what all detectors say (`array_ml.best_elevation`)."""
    covariance = np.asarray(looks.covariance)
    strongest, sum_power, difference_power, cross_power = _strongest_pair(covariance)
    sum_noise = 2 * noise_power
    with np.errstate(divide="ignore", invalid="ignore"):
        mu = discriminant(sum_power, difference_power, cross_power, looks.count * sum_noise)
    found, sum_gain, gain = _invert_pairs(beams, strongest, mu, np.broadcast_to(squint, mu.shape))

    energy = sum_power / sum_noise - looks.count
    with np.errstate(divide="ignore", invalid="ignore"):
        total = 2 * gain / sum_gain  # 1 + |Delta / Sigma|^2
        variance = total / (2 * energy) * (1 + looks.count / (energy * total)) / found.slope**2
        cnr = energy * 2 / sum_gain / looks.count
    explained = explained_power(covariance, beams.response(found.elevation, squint)) / noise_power
    validity = validity_of(looks, beams, noise_power, found.elevation, explained, cnr, min_cnr)
    outside = _better_outside(covariance, beams, squint, noise_power, found.elevation, best)
    validity = np.where((validity == Validity.OK) & outside, Validity.OUTSIDE_ARRAY, validity)
    unpaired = np.isin(found.reason, [Reason.BELOW, Reason.ABOVE, Reason.NO_DOMAIN]) & looks.finite
    return ElevationEstimate(
        elevation=found.elevation,
        sigma=np.sqrt(np.where(energy > 0, variance, np.inf)),
        cnr=cnr,
        validity=np.where(unpaired, Validity.OUTSIDE_PAIR, validity).astype(np.uint8),
    )


def _strongest_pair(
    covariance: npt.NDArray[np.inexact[Any]],
) -> tuple[npt.NDArray[np.intp], Array, Array, ComplexArray]:
    """The pair with the most power in Sigma, and its sums over looks of |Sigma|^2, |Delta|^2 and Delta Sigma*.

    The imaginary part of the covariance may have been left out where the beams are real.
    """
    diagonal = np.diagonal(covariance, axis1=-2, axis2=-1).real.astype(np.float64)
    beside = np.diagonal(covariance, offset=1, axis1=-2, axis2=-1).astype(np.complex128)
    strongest = np.asarray(np.argmax(diagonal[..., :-1] + diagonal[..., 1:] + 2 * beside.real, axis=-1))
    row, col = np.ogrid[: strongest.shape[0], : strongest.shape[1]]
    lower, upper = diagonal[row, col, strongest], diagonal[row, col, strongest + 1]
    return strongest, *sum_and_difference(lower, upper, beside[row, col, strongest])


def sum_and_difference(lower: Array, upper: Array, product: ComplexArray) -> tuple[Array, Array, ComplexArray]:
    """Sums over looks of |Sigma|^2, |Delta|^2 and Delta Sigma*, as the estimates of the discriminant take them.

    Args:
        lower: sum of |l|^2 over looks, l the amplitude of the lower detector.
        upper: of |u|^2.
        product: of l u*; real where only its real part is known.
    """
    both, coherent = lower + upper, 2 * product
    return both + coherent.real, both - coherent.real, upper - lower - 1j * coherent.imag


def _invert_pairs(beams: Beams, pair: npt.NDArray[np.intp], mu: Array, squint: Array) -> tuple[Inversion, Array, Array]:
    """What `mu` of each pixel's `pair` means, with |u + l|^2 and |u|^2 + |l|^2 of the pair's beams there."""
    elevation, slope, sum_gain, gain = np.full((4, *mu.shape), np.nan)
    reason = np.full(mu.shape, Reason.NOT_FINITE, np.uint8)
    for here in _inverted_together(beams, pair):
        beams_here = beams.pair(pair[here] if len(beams.patterns) == 1 else pair[here][0])
        found = invert(beams_here, mu[here], squint[here])
        elevation[here], slope[here], reason[here] = found.elevation, found.slope, found.reason
        amplitude = beams_here.response(found.elevation, squint[here])
        sum_gain[here] = np.abs(np.sum(amplitude, axis=-1)) ** 2
        gain[here] = np.sum(np.abs(amplitude) ** 2, axis=-1)
    return Inversion(elevation, slope, reason), sum_gain, gain


def _inverted_together(beams: Beams, pair: npt.NDArray[np.intp]) -> list[npt.NDArray[np.bool_]]:
    """Pixels whose pairs make a stack: all where the detectors have one pattern, otherwise those of each pair."""
    if len(beams.patterns) == 1:
        return [np.ones(pair.shape, dtype=np.bool_)]
    return [pair == lower for lower in np.unique(pair)]


def _better_outside(
    covariance: Covariance, beams: Beams, squint: Array, noise_power: float, elevation: Array, best: Array
) -> npt.NDArray[np.bool_]:
    """Whether a target at `best`, outside the array, explains the channels better than one at `elevation`.

    By OUTSIDE_MARGIN.

    A pair cannot see that its target is in a sidelobe; the other detectors can.
    """
    first, last = beams.span
    gain = explained_power(covariance, beams.response(best, squint))
    gain -= explained_power(covariance, beams.response(np.nan_to_num(elevation, nan=first), squint))
    return ((best < first) | (best > last)) & (gain > OUTSIDE_MARGIN * noise_power)
