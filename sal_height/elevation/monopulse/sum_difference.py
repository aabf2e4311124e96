"""The discriminator of a relief radar that receives Sigma and Delta of two beams (relief paper: Volosyuk et al.).

The two beams G are offset by delta / 2 above and below the equisignal direction theta_0. From a surface element at
theta_0 + theta_h with the complex amplitude beta, the channels receive

    Sigma = upper + lower = 2 G(delta/2) beta,   Delta = upper - lower = gamma Sigma,   gamma = g theta_h to first order

(relief paper, eq. 3 to 9), each with noise of its own. gamma is estimated from sums of products (`Products`) by one of
`estimators.DISCRIMINANTS`. `ratio` is the real part of the relief paper's eq. 17, which is the maximum likelihood for a
complex gamma; `total_least_squares` is that for a real one, tan(1/2 atan2(2 Re Sigma* Delta, |Sigma|^2 - |Delta|^2)).
`inversion.invert`, `invert_linear` or a `SlopeTable` then give the elevation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.estimate import (
    DEFAULT_RULES,
    ElevationEstimate,
    Fit,
    Validity,
    ValidityRules,
    decide_validity,
)
from sal_height.elevation.looks import Looks
from sal_height.elevation.monopulse.estimators import (
    Estimator,
    NoisePowers,
    Products,
    accuracy,
    discriminate,
    products_of_looks,
    total_least_squares,
    whitened_products,
)
from sal_height.elevation.monopulse.inversion import (
    Inverse,
    Inversion,
    Reason,
    invert,
)
from sal_height.errors import UserError
from sal_height.numeric import F64, U8, Bool


@dataclass(frozen=True)
class Discriminator:
    """How elevations are estimated from Sigma and Delta.

    Attributes:
        estimator: estimator of gamma, one of `estimators.DISCRIMINANTS`.
        inverse: elevation from gamma, one of INVERSES or the `invert` of a `SlopeTable`.
    """

    estimator: Estimator = total_least_squares
    inverse: Inverse = invert


def sum_difference_elevation(
    looks: Looks,
    pair: Beams,
    squint: F64,
    noise_powers: NoisePowers,
    discriminator: Discriminator,
    min_cnr: float,
    rules: ValidityRules = DEFAULT_RULES,
) -> ElevationEstimate:
    """Estimate the elevation of the scatterer in every pixel of images whose channels are Sigma and Delta.

    The standard deviation and the CNR are those of `estimators.accuracy`.

    LOW_CNR: the part that both channels have in common is not detected above noise, or is below `min_cnr`.
    OUTSIDE_PAIR: gamma has no elevation, for example because there is a signal in Delta and none in Sigma.
    NOT_ONE_SCATTERER: one scatterer in two whitened channels leaves K - 1 noise powers on average, and more is left
    (`estimate.is_one_scatterer`).

    Args:
        looks: covariance of Sigma = upper + lower and Delta = upper - lower in each pixel (`sum_difference_channels`).
        pair: the two beams, lower and upper.
        squint: of each column, rad, shape (cols,).
        noise_powers: of one SLC pixel of Sigma and of Delta.
        discriminator: estimator of gamma, and its inversion.
        min_cnr: pixels below this power ratio are LOW_CNR.
        rules: of validity.

    Raises:
        UserError: there are not two channels and two beams, or `discriminate` refuses the noise powers.
    """
    if not looks.covariance.shape[-1] == pair.count == 2:
        raise UserError(
            f"There are {looks.covariance.shape[-1]} channels and {pair.count} beams; sum and difference need 2 of "
            "each."
        )
    sums = products_of_looks(looks)
    gamma = discriminate(sums, discriminator.estimator, noise_powers)
    found = discriminator.inverse(pair, gamma, np.broadcast_to(squint, gamma.shape))
    sigma, cnr = accuracy(sums, pair.response(found.elevation, squint), found.slope, noise_powers)
    return ElevationEstimate(
        found.elevation, sigma, cnr, _validity(looks, sums, noise_powers, found, cnr >= min_cnr, rules)
    )


def _validity(
    looks: Looks, sums: Products, noise_powers: NoisePowers, found: Inversion, strong: Bool, rules: ValidityRules
) -> U8:
    """Reason for which each pixel's estimate cannot be used, the first that applies, or OK."""
    explained, left = _eigenvalues(whitened_products(sums, noise_powers)[0]) / noise_powers[0]
    fit = Fit(explained, left, looks.count - 1, directions=2)  # K amplitudes and one complex gamma are estimated
    outside = np.isin(found.reason, [Reason.BELOW, Reason.ABOVE, Reason.NO_DOMAIN])
    return decide_validity(looks, fit, strong | outside, ~outside, Validity.OUTSIDE_PAIR, rules)


def _eigenvalues(sums: Products) -> F64:
    """Return the greater and the lesser eigenvalue of the covariance of Sigma and Delta, shape (2, ...)."""
    mean = (sums.sum_power + sums.difference_power) / 2
    apart = np.hypot((sums.sum_power - sums.difference_power) / 2, np.abs(sums.cross_power))
    return np.stack([mean + apart, mean - apart])
