"""Estimates of gamma = Delta / Sigma from sums over looks or pulses of the products of Sigma and Delta.

Sigma is the sum of two beams and Delta the upper minus the lower one; the SAL paper calls their ratio the discriminant
mu.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.monopulse.inversion import PairElevation
from sal_height.errors import UserError
from sal_height.numeric import C128, F64

NoisePowers = tuple[float, float]
"""E|n|^2 of one sample of Sigma and of Delta; the two noises are independent."""


@dataclass(frozen=True, eq=False)
class Products:
    """Sums over looks or pulses, from which DISCRIMINANTS estimate gamma; arrays of one shape.

    Attributes:
        sum_power: sum of |Sigma|^2.
        difference_power: sum of |Delta|^2.
        cross_power: sum of Delta Sigma*; only its real part where gamma is real, because the other is noise alone.
        count: number of looks or pulses K, one for all or one for each pixel.
    """

    sum_power: F64
    difference_power: F64
    cross_power: npt.NDArray[np.inexact[Any]]
    count: int | F64


def products(total: C128, difference: C128) -> Products:
    """Sum the products of Sigma and Delta, shape (..., K), over the last axis, for a real gamma.

    Phases common to both channels drop out, so that pulses may be summed with or without phase compensation. For the
    same reason this is no coherent accumulation: noise adds to the powers with each pulse (`products_variance`). Use
    it for looks, and `synthesise` for pulses.
    """
    return Products(
        np.sum(np.abs(total) ** 2, axis=-1, dtype=np.float64),
        np.sum(np.abs(difference) ** 2, axis=-1, dtype=np.float64),
        np.sum((difference * total.conj()).real, axis=-1, dtype=np.float64),
        total.shape[-1],
    )


def products_of_looks(looks: Looks) -> Products:
    """Return the products of multi-looked images with the channels (Sigma, Delta), shape (rows, cols)."""
    covariance = looks.covariance[:, :]
    return Products(
        covariance[..., 0, 0].real.astype(np.float64),
        covariance[..., 1, 1].real.astype(np.float64),
        covariance[..., 1, 0].astype(np.complex128 if np.iscomplexobj(covariance) else np.float64),
        looks.count,
    )


def sum_and_difference(lower: F64, upper: F64, product: npt.NDArray[np.inexact[Any]], count: int | F64) -> Products:
    """Return the products of Sigma and Delta from those of the two detectors.

    Args:
        lower: sum over looks of |l|^2, l being the amplitude of the lower detector.
        upper: sum of |u|^2, of the upper detector.
        product: sum of l u*; real where only its real part is known.
        count: number of looks.
    """
    both, coherent = lower + upper, 2 * product
    return Products(both + coherent.real, both - coherent.real, upper - lower - 1j * coherent.imag, count)


def ratio(sums: Products, _noise_power: float) -> F64:
    """Estimate gamma by the power-weighted mean of Re(Delta / Sigma): Re sum Delta Sigma* / sum |Sigma|^2.

    SAL paper, section 3; the real part of the relief paper's eq. 17.

    Biased towards the middle of the pair by the factor CNR / (CNR + 1) for a fluctuating target, however many looks
    (Kanter 1977).
    """
    return np.real(sums.cross_power) / sums.sum_power


def noise_subtraction(sums: Products, noise_power: float) -> F64:
    """Estimate gamma without the noise in the denominator: Re sum Delta Sigma* / (sum |Sigma|^2 - K noise power).

    The bias of `ratio` vanishes as the number of looks grows. NaN where Sigma has no more power than noise.
    """
    signal = sums.sum_power - sums.count * noise_power
    return np.where(signal > 0, np.real(sums.cross_power) / np.where(signal > 0, signal, 1.0), np.nan)


def total_least_squares(sums: Products, _noise_power: float) -> F64:
    """Estimate gamma by exact two-channel maximum likelihood, which accounts for the noise in Sigma.

    It is the ratio of the components of the principal eigenvector of the covariance of Sigma and Delta: its modulus is
    tan(1/2 atan2(2 |R_DS|, R_SS - R_DD)), its phase that of R_DS. The noise of Sigma and Delta must be equal; its value
    is not needed.
    """
    modulus = np.tan(np.arctan2(2 * np.abs(sums.cross_power), sums.sum_power - sums.difference_power) / 2)
    return modulus * np.cos(np.angle(sums.cross_power))


Estimator = Callable[[Products, float], F64]
"""Function of the products of Sigma and Delta and of the noise power of Sigma that estimates gamma."""


DISCRIMINANTS: dict[str, Estimator] = {
    "tls": total_least_squares,
    "ratio": ratio,
    "noise_subtraction": noise_subtraction,
}
"""Estimators of gamma by name."""


def discriminate(sums: Products, estimator: Estimator, noise_powers: NoisePowers) -> F64:
    """Estimate gamma from products, in their shape.

    Delta is scaled until its noise equals that of Sigma, and gamma is scaled back. `total_least_squares` is then the
    exact maximum likelihood for unequal noise, too; the other estimators do not change.

    Args:
        sums: products of Sigma and Delta.
        estimator: one of DISCRIMINANTS.
        noise_powers: noise powers of Sigma and Delta.

    Raises:
        UserError: a noise power is not known (0), negative or not finite.
    """
    even, scale = whitened_products(sums, noise_powers)
    with np.errstate(divide="ignore", invalid="ignore"):
        return estimator(even, noise_powers[0]) / scale


def whitened_products(sums: Products, noise_powers: NoisePowers) -> tuple[Products, float]:
    """Return products with the noise power of Sigma in both channels, and the factor by which Delta was scaled."""
    if not all(np.isfinite(power) and power > 0 for power in noise_powers):
        raise UserError(
            f"The noise powers of Sigma and Delta are {tuple(float(power) for power in noise_powers)}; both must be "
            "known, finite and greater than 0."
        )
    scale = float(np.sqrt(noise_powers[0] / noise_powers[1]))
    scaled = Products(sums.sum_power, sums.difference_power * scale**2, sums.cross_power * scale, sums.count)
    return scaled, scale


def accuracy(sums: Products, found: PairElevation, noise_powers: NoisePowers, uncertainty: float) -> tuple[F64, F64]:
    """Return the standard deviation of elevation (rad) and the CNR of one look, from the energy of these looks.

    The deviation is that of gamma (`products_variance`) over the discriminant's slope. Errors of the beams, of variance
    u^2 in each, add noise of power 2 u^2 |A|^2 to Sigma and Delta that looks do not average: to the variance of gamma
    (1 + gamma^2) u^2 / |upper + lower|^2 (`discriminator_variance`; see `array.beam_error`). The CNR is that of a
    detector which looks straight at the scatterer and has the noise 1 / (1/N_Sigma + 1/N_Delta): that of each of two
    detectors whose sum and difference have equal noise.

    Args:
        sums: products of Sigma and Delta.
        found: elevation of the scatterer, with the slope of gamma and the beams there.
        noise_powers: noise powers of Sigma and Delta.
        uncertainty: u (`Beams.uncertainty`).
    """
    energy = sums.sum_power - sums.count * noise_powers[0]
    detector_noise = 1 / (1 / noise_powers[0] + 1 / noise_powers[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = products_variance(found.modulus, energy, sums.count, noise_powers)
        variance = (variance + (1 + found.modulus**2) * uncertainty**2 / found.sum_gain) / found.slope**2
        cnr = energy / found.sum_gain / sums.count / detector_noise
    return np.sqrt(np.where(energy > 0, variance, np.inf)), np.asarray(cnr)


def discriminator_variance(gamma: npt.ArrayLike, energy: npt.ArrayLike, noise_powers: tuple[float, float]) -> F64:
    """Return the variance of gamma to first order in the noise: (N_Delta + gamma^2 N_Sigma) / (2 E); broadcasts.

    For equal noise and the signal-to-noise ratio x in Sigma that is (1 + gamma^2) / (2 x). It holds for `ratio` and for
    the exact maximum likelihood. For one look at a steady target, the second order adds the fraction (1 + 2 gamma^2) /
    (x + x gamma^2) for `ratio`, and twice as much for the maximum likelihood; in the strict sense neither has a
    variance, because of its tails.

    Args:
        gamma: modulus of Delta / Sigma without noise.
        energy: energy of the signal in Sigma, over all looks.
        noise_powers: noise powers of Sigma and Delta.
    """
    gamma, energy = np.asarray(gamma), np.asarray(energy)
    return (noise_powers[1] + gamma**2 * noise_powers[0]) / (2 * energy)


def products_variance(
    gamma: npt.ArrayLike, energy: npt.ArrayLike, count: npt.ArrayLike, noise_powers: tuple[float, float]
) -> F64:
    """Return the variance of the maximum-likelihood gamma from products summed over many looks or pulses; broadcasts.

    It is `discriminator_variance` times 1 + K / (E/N_Sigma + gamma^2 E/N_Delta). The second term is the cost of not
    knowing the amplitudes of the K looks, or the phases of the K pulses: 1 / (x + x gamma^2) for equal noise and the
    signal-to-noise ratio x of each. The result is the Cramer-Rao bound for Gaussian amplitudes
    (`bounds.stochastic_crb`).

    Args:
        gamma: modulus of Delta / Sigma without noise.
        energy: E of the signal in Sigma, over all looks.
        count: number of looks or pulses, K.
        noise_powers: noise powers of Sigma and Delta.
    """
    over_noise = np.asarray(energy) * (1 / noise_powers[0] + np.asarray(gamma) ** 2 / noise_powers[1])
    return discriminator_variance(gamma, energy, noise_powers) * (1 + np.asarray(count) / over_noise)
