"""What every elevation estimator returns, and the reasons a pixel has no height."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from scipy.special import gammainccinv

from sal_height.elevation.bounds import beam_power
from sal_height.elevation.looks import Covariance, Looks
from sal_height.elevation.settings import HeightSettings
from sal_height.numeric import F64, U8, Bool


class Validity(IntEnum):
    """Why a pixel has no height, or two, or one from its neighbours; the values are those of HeightImage.msg."""

    OK = 0
    LOW_CNR = 1
    OUTSIDE_ARRAY = 2
    OUTSIDE_PAIR = 3
    NOT_ONE_SCATTERER = 4
    MISSING_DATA = 5
    TWO_SCATTERERS = 6
    AMBIGUOUS = 7
    SATURATED = 8
    INTERPOLATED = 9


@dataclass(frozen=True)
class SecondScatterer:
    """The weaker scatterer of pixels that hold two; arrays (rows, cols), NaN elsewhere.

    Attributes:
        elevation: rad from nadir in body axes.
        sigma: standard deviation of elevation, rad.
        cnr: carrier-to-noise power ratio of one look in a detector looking straight at it.
    """

    elevation: F64
    sigma: F64
    cnr: F64


@dataclass(frozen=True)
class ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel; all arrays have the shape (rows, cols) of the looks.

    Attributes:
        elevation: rad from nadir in body axes.
        sigma: standard deviation of elevation, rad; infinite where there is no signal.
        cnr: carrier-to-noise power ratio of one look in a hypothetical detector looking straight at the scatterer.
        validity: `Validity` of each pixel, uint8; where it is TWO_SCATTERERS, the rest is of the stronger one.
        second: the weaker one there; None: not looked for.
    """

    elevation: F64
    sigma: F64
    cnr: F64
    validity: U8
    second: SecondScatterer | None = None


@dataclass(frozen=True, eq=False)
class Fit:
    """How well one scatterer explains each pixel; arrays (rows, cols), powers in units of the receivers' noise power.

    Attributes:
        explained: power that the scatterer explains, sum over looks, its share of the noise included.
        left: power that it does not explain.
        degrees: order of the gamma distribution of `left` if nothing but noise is left: half the number of real
            dimensions of noise in K looks of M channels, less those that the scatterer's parameters have taken.
        directions: number of independent directions among which the strongest was chosen.
        leaked: expected power of the sidelobes of scatterers in other pixels, sum over looks.
    """

    explained: F64
    left: F64
    degrees: F64
    directions: int
    leaked: F64 | float = 0.0


def array_fit(looks: Looks, explained: F64) -> Fit:
    """Fit of a scatterer with the response of real beams to M channels of equal noise.

    K complex amplitudes and one elevation leave M K - K - 1/2 complex dimensions of noise.

    Args:
        looks: covariance of M channels in each pixel.
        explained: a^H R a / |a|^2 over the receivers' noise power, shape (rows, cols).
    """
    channels = looks.covariance.shape[-1]
    left, degrees = looks.power / looks.receiver_noise - explained, (channels - 1) * looks.count - 0.5
    return Fit(explained, left, degrees, channels, looks.leaked)


def noise_limit(degrees: F64, rate: float) -> F64:
    """Power, in units of the noise power, that noise exceeds with the probability `rate`; 0 where it has no power.

    The sum of `degrees` squared moduli of circular Gaussian noise of mean power 1 has a gamma distribution.
    """
    orders, which = np.unique(degrees, return_inverse=True)
    return np.where(orders > 0, gammainccinv(np.maximum(orders, 0.5), rate), 0.0)[which]


def sidelobe_limit(leaked: F64 | float, rate: float) -> F64:
    """Power of other pixels' sidelobes that is exceeded with the probability `rate`; `leaked` is its expectation.

    All looks of a pixel see nearly the same wave, as the sidelobes of one scatterer change little over a few pixels:
    their power is that of one look of speckle, which is exponentially distributed.
    """
    return -np.log(rate) * np.asarray(leaked)


def detection_limit(looks: Looks, directions: int, settings: HeightSettings) -> F64:
    """Least power, in units of the receivers' noise power, of what is neither noise nor other pixels' sidelobes.

    Args:
        looks: whose power is looked at, sum over looks.
        directions: number of independent directions among which the strongest was chosen.
        settings: rates of false alarms.
    """
    noise = noise_limit(looks.count, settings.false_alarm_rate / directions)
    return noise + sidelobe_limit(looks.leaked, settings.sidelobe_rate)


def is_one_scatterer(fit: Fit, settings: HeightSettings) -> Bool:
    """Whether what a scatterer leaves of a pixel is noise, or a small share of what it explains.

    Two scatterers closer than about half a beamwidth cannot be told from one. Looks in range on sloping ground differ
    in elevation; from about 0.3 beamwidths on they count as several scatterers.

    Args:
        fit: of one scatterer to every pixel.
        settings: rates of false alarms, and share of the explained power that may be left beyond the mean of the noise.
    """
    limit = noise_limit(fit.degrees, settings.false_alarm_rate) + sidelobe_limit(fit.leaked, settings.sidelobe_rate)
    noise = fit.left <= limit
    return noise | (fit.left - fit.degrees <= settings.misfit_share * fit.explained)


def decide_validity(
    looks: Looks, fit: Fit, strong: Bool, inside: Bool, outside: Validity, settings: HeightSettings
) -> U8:
    """Reason for which each pixel's estimate cannot be used, the first that applies, or OK; for every estimator.

    Args:
        looks: covariance of the channels in each pixel.
        fit: of one scatterer to every pixel.
        strong: where its CNR is sufficient.
        inside: where its elevation is one that the estimator can tell.
        outside: reason to give elsewhere.
        settings: when a scatterer is detected, and is the only one.
    """
    detected = fit.explained >= detection_limit(looks, fit.directions, settings)
    return np.select(
        [~looks.finite, ~(detected & strong), ~inside, ~is_one_scatterer(fit, settings)],
        [Validity.MISSING_DATA, Validity.LOW_CNR, outside, Validity.NOT_ONE_SCATTERER],
        Validity.OK,
    ).astype(np.uint8)


def explained_power(covariance: Covariance, response: F64) -> F64:
    """Power that a scatterer with the response a explains: a^H R a / |a|^2, shape (...), in double precision.

    Args:
        covariance: R, shape (..., M, M); complex if the response is.
        response: a, shape (..., M).
    """
    outputs = np.einsum("...mn,...n->...m", covariance, response)
    return np.sum(response.conj() * outputs, axis=-1).real / beam_power(response)


def without_saturated(estimate: ElevationEstimate) -> ElevationEstimate:
    """The estimate of a dwell whose samples are clipped: what would be usable is SATURATED, and without a second."""
    usable = np.isin(estimate.validity, (Validity.OK, Validity.TWO_SCATTERERS))
    nowhere = np.full(estimate.elevation.shape, np.nan)
    return replace(
        estimate,
        validity=np.where(usable, Validity.SATURATED, estimate.validity).astype(np.uint8),
        second=SecondScatterer(nowhere, nowhere, nowhere) if estimate.second else None,
    )
