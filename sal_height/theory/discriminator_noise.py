"""Noise of the monopulse discriminant in closed form (SAL paper, section 3; Kanter 1977).

In each look a pair receives Sigma = S + n and Delta = kappa S + n'. Equal independent noise in both detectors makes n
and n' independent circular Gaussian noise of the same variance. The estimate is the power-weighted ratio
mu = Re sum_k Delta_k Sigma_k* / sum_k |Sigma_k|^2.

The carrier-to-noise ratio (CNR) is a power ratio and has two definitions, which differ by a factor of about two:

    cnr_sum       of the sum channel, |S|^2 / E|n|^2 (section 3, figures 5 and 6)
    cnr_detector  of one hypothetical detector that looks straight at the target (section 5, figures 10 and 11)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import hyp1f1, i0e, ive
from scipy.stats import ncx2, t

from sal_height.beams import Beams
from sal_height.errors import UserError
from sal_height.numeric import F64

NORMAL_SHARES = (0.15865525393145707, 0.8413447460685429)
"""Probabilities of a normal variable below minus and plus one standard deviation: the "16 and 84 %" of s68."""


def straight_power(beams: Beams) -> float:
    """Return the power |h(0, 0)|^2 of a target straight ahead, the mean over the detectors' patterns.

    It is 1 for point detectors and less for finite ones, which average over the focal spot.

    Raises:
        UserError: the patterns are 0 straight ahead.
    """
    power = float(np.mean([np.abs(pattern.amplitude(0.0, 0.0)) ** 2 for pattern in beams.patterns]))
    if not power > 0:
        raise UserError(
            f"The beam patterns have a mean power of {power:.6g} straight ahead; a CNR needs more than 0 there."
        )
    return power


def cnr_detector_of(cnr_sum: npt.ArrayLike, pair: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """Return the CNR of one detector that looks straight at the target, from that of the sum channel.

    It is 2 |h(0, 0)|^2 / |l + u|^2 times as much: l and u are the two responses, and Sigma has the noise of both.
    Infinite where the sum channel receives nothing.

    Args:
        cnr_sum: power ratio; broadcasts with the angles.
        pair: beams of two detectors.
        elevation: elevation of the target, rad.
        squint: squint of the target, rad.

    Raises:
        UserError: the detectors receive nothing straight ahead.
    """
    sum_gain = np.abs(pair.response(elevation, squint).sum(axis=-1)) ** 2 / 2 / straight_power(pair)
    with np.errstate(divide="ignore"):
        return np.asarray(cnr_sum) / sum_gain


def steady_mean(kappa: npt.ArrayLike, cnr_sum: npt.ArrayLike) -> F64:
    """Return the mean of mu for one look at a target of constant brightness: kappa (1 - exp(-x)) (Kanter 1977)."""
    return -np.asarray(kappa) * np.expm1(-np.asarray(cnr_sum))


def steady_looks_mean(kappa: npt.ArrayLike, cnr_sum: npt.ArrayLike, looks: npt.ArrayLike) -> F64:
    """Return the mean of mu for K looks at a target of constant brightness: kappa K C E[1 / (K + J)].

    J has Poisson's law with the mean K C, because sum_k |Sigma_k|^2 is a mixture of Gamma laws of order K + J. The
    series sums to kappa C M(1, K + 1, -K C), M being Kummer's function. For one look that is `steady_mean`; for very
    many kappa C / (C + 1), so that more looks increase the bias. Broadcasts.
    """
    kappa, cnr_sum, looks = np.asarray(kappa), np.asarray(cnr_sum), np.asarray(looks)
    return kappa * cnr_sum * hyp1f1(1, looks + 1, -looks * cnr_sum)


def gaussian_mean(kappa: npt.ArrayLike, cnr_sum: npt.ArrayLike) -> F64:
    """Return the mean of mu for a fluctuating (complex Gaussian) target: kappa C / (C + 1), for any number of looks."""
    kappa, cnr_sum = np.asarray(kappa), np.asarray(cnr_sum)
    return kappa * cnr_sum / (cnr_sum + 1)


def gaussian_law(kappa: float, cnr_sum: float, looks: int) -> Any:
    """Return the law of mu for a fluctuating (complex Gaussian) target, a frozen distribution of `scipy.stats`.

    It is exact for any number of looks K. Delta given Sigma is a linear regression with the coefficient
    kappa C / (C + 1) and the residual variance 1 + kappa^2 C / (C + 1); its coefficient estimated from K complex
    samples has Student's law with 2 K degrees of freedom:

        mu = kappa C / (C + 1) + sqrt(C + 1 + kappa^2 C) / (C + 1) T_2K / sqrt(2 K)
    """
    scale = np.sqrt((cnr_sum + 1 + kappa**2 * cnr_sum) / (2 * looks)) / (cnr_sum + 1)
    return t(2 * looks, gaussian_mean(kappa, cnr_sum), scale)


@dataclass(frozen=True)
class SteadyLaw:
    """Law of mu for one look at a target of constant brightness. It has a mean, but no variance.

    Attributes:
        kappa: discriminant without noise.
        cnr_sum: CNR of the sum channel, power ratio.
    """

    kappa: float
    cnr_sum: float

    def cdf(self, mu: npt.ArrayLike) -> F64:
        """Probability of less than `mu`; broadcasts.

        mu is exceeded where Re (Delta - mu Sigma) Sigma* > 0: a Hermitian form with one positive and one negative
        eigenvalue, that is |U| > |V| of two independent Gaussian variables with means (Stein 1964):

            P(|U| < |V|) = Q(a, b) - var U / (var U + var V) exp(-(a^2 + b^2) / 2) I0(a b),

        Q being Marcum's function, here the tail of a non-central chi-square of two degrees of freedom.
        """
        mu = np.asarray(mu, dtype=np.float64)
        radius, off = np.hypot(mu, 1), mu - self.kappa
        a, b = (np.sqrt(self.cnr_sum / 2) * np.abs(radius + sign * off) / radius for sign in (1, -1))
        below = np.where(b > 0, ncx2.sf(b**2, 2, a**2), 1.0)
        return below - (radius - mu) / (2 * radius) * np.exp(-((a - b) ** 2) / 2) * i0e(a * b)

    def ppf(self, probability: float) -> float:
        """Return the value below which mu lies with this probability, to 1e-12."""
        reach = abs(self.kappa) + 1
        while not self.cdf(-reach) < probability < self.cdf(reach):
            reach *= 2
        return float(brentq(lambda mu: float(self.cdf(mu)) - probability, -reach, reach, xtol=1e-12))


class SteadyMlLaw(SteadyLaw):
    """Law of the exact maximum likelihood estimate of gamma (`kappa`) from one look at a target of constant brightness.

    tan of half the phase between Sigma + j Delta and Sigma - j Delta: these have equal independent noise and, without
    it, equal powers and the phases plus and minus atan(gamma). It has neither mean nor variance.
    """

    def cdf(self, mu: npt.ArrayLike) -> F64:
        """Probability of less than `mu`; broadcasts.

        The phase of each, less that without noise, has the coefficients c_n = E cos(n phase) = sqrt(pi y / 2) / 2
        exp(-y / 2) (I_(n-1)/2 (y / 2) + I_(n+1)/2 (y / 2)) with y = x (1 + gamma^2) / 2 (Middleton 1960); that of their
        difference has c_n^2. Its Fourier series is integrated term by term from -pi / 2, where tan begins.
        """
        power = self.cnr_sum * (1 + self.kappa**2) / 2
        order = np.arange(1, 40 + int(10 * np.sqrt(power)))
        bessel = ive((order - 1) / 2, power / 2) + ive((order + 1) / 2, power / 2)
        coefficient = np.pi * power / 4 * bessel**2
        truth, angle = np.arctan(self.kappa), np.arctan(np.asarray(mu, dtype=np.float64))[..., None]
        turned = np.sin(2 * order * (angle - truth)) - np.sin(2 * order * (-np.pi / 2 - truth))
        return 0.5 + angle[..., 0] / np.pi + np.sum(coefficient / order * turned, axis=-1) / np.pi


def s68_of(law: Any) -> float:
    """Return half the width of a law from 16 to 84 %: the standard deviation of a normal distribution as wide.

    Args:
        law: anything whose `ppf` gives quantiles: `SteadyLaw`, `SteadyMlLaw`, or a distribution of `scipy.stats`.
    """
    low, high = (law.ppf(probability) for probability in NORMAL_SHARES)
    return float(high - low) / 2
