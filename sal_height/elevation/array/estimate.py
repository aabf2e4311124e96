"""The result of every elevation estimator, and the reasons for invalid pixels."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Self

import numpy as np
from scipy.special import gammainccinv

from sal_height.elevation.array.beam_error import PowerLaw
from sal_height.elevation.array.bounds import beam_power
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.numeric import F64, U8, Bool, ShortRepr


class Validity(IntEnum):
    """Reason for which a pixel has no height, or the kind of its heights; the values are those of HeightImage.msg."""

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
    THREE_SCATTERERS = 10
    EXTENDED = 11
    NO_SIGNAL = 12
    IMPRECISE = 13
    NO_GROUND = 14


SCATTERERS = {Validity.OK: 1, Validity.EXTENDED: 1, Validity.TWO_SCATTERERS: 2, Validity.THREE_SCATTERERS: 3}
"""Number of scatterers of a pixel whose measurement can be used, by its validity."""

MEASURED = tuple(SCATTERERS)
"""Validities of the pixels whose measurement can be used."""

USABLE = (*MEASURED, Validity.INTERPOLATED)
"""Validities of the pixels that have a height."""

_COUNTS = np.zeros(256, np.uint8)
_COUNTS[list(SCATTERERS)] = list(SCATTERERS.values())

ORDERS = 5
"""Number of models of a pixel: 0, 1, 2 or 3 scatterers, or one extended surface."""


def scatterer_count(validity: U8) -> U8:
    """Number of scatterers with a height in each pixel, by its `Validity`; same shape."""
    return _COUNTS[validity]


@dataclass(frozen=True)
class Scatterer:
    """One scatterer of every pixel; arrays of the shape (rows, cols) of the looks, NaN without a scatterer.

    Attributes:
        elevation: angle from nadir in body axes, or that of the middle of an extended surface, rad.
        sigma: standard deviation of elevation, rad; infinite where there is no signal.
        cnr: carrier-to-noise power ratio of one look in a hypothetical detector looking straight at the scatterer.
        spread: standard deviation of elevation within an extended surface, rad; 0: a single point.
    """

    elevation: F64
    sigma: F64
    cnr: F64
    spread: F64

    def where(self, there: Bool, other: Scatterer | None = None) -> Scatterer:
        """This scatterer `there`, and the other one, or NaN, elsewhere."""
        values = ((getattr(self, f.name), getattr(other, f.name) if other else np.nan) for f in fields(self))
        return Scatterer(*(np.where(there, mine, theirs) for mine, theirs in values))


@dataclass(frozen=True, eq=False)
class Residue(ShortRepr):
    """A single scatterer fitted to each pixel, whatever is there, and one more; arrays (rows, cols), finite.

    Powers are sums over the looks, in units of the receivers' noise power.

    Attributes:
        elevation: elevation of the single scatterer, rad.
        explained: power that it explains.
        beside: greatest power that one more scatterer, or a spread of the single one, would explain.
    """

    elevation: F64
    explained: F64
    beside: F64


@dataclass(frozen=True)
class ElevationEstimate(ShortRepr):
    """Elevations of the scatterers in every pixel.

    Attributes:
        scatterers: strongest scatterer of every pixel, and the weaker ones that were searched for; the first is finite
            in all pixels with a signal, valid or not.
        validity: `Validity` of each pixel, uint8, shape (rows, cols).
        order_probability: probability of 0, 1, 2 and 3 scatterers and of one extended surface, with the sum 1, shape
            (rows, cols, ORDERS); NaN where it was not estimated. None: not estimated.
        residue: fit of a single scatterer, for tests of the data; None: there are none of this estimator.
    """

    scatterers: tuple[Scatterer, ...]
    validity: U8
    order_probability: F64 | None = None
    residue: Residue | None = None

    @classmethod
    def of_one(cls, elevation: F64, sigma: F64, cnr: F64, validity: U8) -> Self:
        """The estimate of a single scatterer in each pixel, without extent."""
        return cls((Scatterer(elevation, sigma, cnr, np.zeros_like(elevation)),), validity)

    @property
    def first(self) -> Scatterer:
        """The strongest scatterer."""
        return self.scatterers[0]

    @property
    def elevation(self) -> F64:
        """Elevation of the strongest scatterer, rad."""
        return self.first.elevation

    @property
    def sigma(self) -> F64:
        """Standard deviation of the elevation of the strongest scatterer, rad."""
        return self.first.sigma

    @property
    def cnr(self) -> F64:
        """CNR of the strongest scatterer, power ratio."""
        return self.first.cnr

    def with_sigma(self, sigma: F64) -> Self:
        """The estimate with another standard deviation of the strongest scatterer, rad."""
        return replace(self, scatterers=(replace(self.first, sigma=sigma), *self.scatterers[1:]))


@dataclass(frozen=True, eq=False)
class Fit(ShortRepr):
    """Fit of a model to each pixel; arrays (rows, cols), powers in units of the receivers' noise power.

    Attributes:
        explained: power that its scatterers explain, sum over looks, including their part of the noise.
        left: power that they do not explain.
        degrees: order of the gamma distribution of `left` if only noise is left: half the number of real dimensions of
            noise in K looks of M channels, less the parameters of the model.
        directions: number of independent directions among which the strongest was chosen.
        leaked: expected power of the sidelobes of scatterers in other pixels, sum over looks.
        coherent: part of the degrees that errors of the beams affect as well (`beam_error.PowerLaw`).
        beam_error: power of these errors in a channel.
    """

    explained: F64
    left: F64
    degrees: F64
    directions: int
    leaked: F64 | float = 0.0
    coherent: F64 | float = 0.0
    beam_error: F64 | float = 0.0


def array_fit(looks: Looks, explained: F64, gain: F64, uncertainty: float) -> Fit:
    """Fit of a scatterer with the response of real beams to M channels of equal noise.

    K complex amplitudes and one elevation leave M K - K - 1/2 complex dimensions of noise, M - 3/2 of them in the
    direction of the amplitudes.

    Args:
        looks: covariance of M channels in each pixel.
        explained: a^H R a / |a|^2 over the receivers' noise power, shape (rows, cols).
        gain: |a|^2.
        uncertainty: relative uncertainty of the beams.
    """
    channels = looks.covariance.shape[-1]
    return Fit(
        explained,
        left=looks.power / looks.receiver_noise - explained,
        degrees=(channels - 1) * looks.count - 0.5,
        directions=channels,
        leaked=looks.leaked,
        coherent=channels - 1.5,
        beam_error=uncertainty**2 * np.maximum(explained - looks.count, 0.0) / gain,
    )


def noise_limit(degrees: F64, rate: float) -> F64:
    """Power, in units of the noise power, that noise exceeds with the probability `rate`; 0 where it has no power.

    The sum of `degrees` squared moduli of circular Gaussian noise of mean power 1 has a gamma distribution.
    """
    orders = np.unique(degrees)
    limits = np.where(orders > 0, gammainccinv(np.maximum(orders, 0.5), rate), 0.0)
    return np.asarray(limits[np.searchsorted(orders, degrees)])


def sidelobe_limit(leaked: F64 | float, rate: float) -> F64:
    """Power of other pixels' sidelobes that is exceeded with the probability `rate`; `leaked` is its expectation.

    All looks of a pixel receive nearly the same wave, as the sidelobes of one scatterer change little over a few
    pixels: their power is that of one look of speckle, which is exponentially distributed.
    """
    return -np.log(rate) * np.asarray(leaked)


def detection_limit(looks: Looks, directions: int, settings: HeightSettings) -> F64:
    """Least power of a detected signal, above noise and other pixels' sidelobes, in the receivers' noise powers.

    Args:
        looks: covariance of the pixels; the power is a sum over looks.
        directions: number of independent directions among which the strongest was chosen.
        settings: rates of false alarms.
    """
    noise = noise_limit(looks.count, settings.false_alarm_rate / directions)
    return noise + sidelobe_limit(looks.leaked, settings.sidelobe_rate)


def is_detected(looks: Looks, fit: Fit, settings: HeightSettings) -> Bool:
    """True where a signal stands out from noise and other pixels' sidelobes, shape (rows, cols).

    Where another pixel of the square around passes the limit of one pixel, there is something to see. In a square of
    noise this is rare, and a single pixel passes for a scatterer only above the limit for all pixels of the square.

    Args:
        looks: covariance of the pixels.
        fit: fit of one scatterer to every pixel.
        settings: rates of false alarms.
    """
    square = 7  # pixels in range and in azimuth
    strong, detected = (
        fit.explained >= detection_limit(looks, fit.directions * pixels, settings) for pixels in (square**2, 1)
    )
    return strong | (detected & looks.columns.has_another(detected, square))


def is_explained(fit: Fit, settings: HeightSettings) -> Bool:
    """True where a model leaves only noise and errors of the beams, or a small fraction of what it explains.

    Args:
        fit: fit of one scatterer to every pixel, or of several.
        settings: rates of false alarms, and the fraction of the explained power that may be left beyond the mean noise.
    """
    explained = np.array(fit.left - fit.degrees <= settings.misfit_fraction * fit.explained)
    unsure = ~explained
    if unsure.any():
        values = fit.left, fit.degrees, fit.leaked, fit.coherent, fit.beam_error
        left, degrees, leaked, coherent, error = (np.broadcast_to(v, explained.shape)[unsure] for v in values)
        law = PowerLaw.of(degrees, coherent, error)
        noise = law.exceeded(left - sidelobe_limit(leaked, settings.sidelobe_rate)) >= settings.false_alarm_rate
        explained[unsure] = noise
    return explained


def decide_validity(
    looks: Looks, fit: Fit, strong: Bool, inside: Bool, outside: Validity, settings: HeightSettings
) -> U8:
    """First reason for which the estimate of each pixel cannot be used, or OK; for every estimator.

    Args:
        looks: covariance of the channels in each pixel.
        fit: fit of one scatterer to every pixel.
        strong: True where its CNR is sufficient.
        inside: True where its elevation is one that the estimator can determine.
        outside: reason elsewhere.
        settings: limits for detection and for a single scatterer.
    """
    detected = is_detected(looks, fit, settings)
    validity = np.where(is_explained(fit, settings), np.uint8(Validity.OK), np.uint8(Validity.NOT_ONE_SCATTERER))
    # The first reason that applies is written last.
    validity[~inside] = outside
    validity[~strong] = Validity.LOW_CNR
    validity[~detected] = Validity.NO_SIGNAL
    validity[~looks.finite] = Validity.MISSING_DATA
    return validity


def explained_power(covariance: Covariance, response: F64) -> F64:
    """Power that a scatterer with the response a explains: a^H R a / |a|^2, shape (...), in double precision.

    Args:
        covariance: R, shape (..., M, M); complex if the response is.
        response: a, shape (..., M).
    """
    outputs = np.einsum("...mn,...n->...m", covariance, response)
    return np.sum(response.conj() * outputs, axis=-1).real / beam_power(response)


def with_foreign_power(estimate: ElevationEstimate, variance: F64) -> ElevationEstimate:
    """The estimate with the variance (rad^2, shape (rows, cols)) that sidelobes of other pixels add.

    It is that of a scatterer with all the energy of a pixel; one of several has the fraction given by its CNR.
    """
    total = sum(np.where(np.isfinite(one.cnr), one.cnr, 0.0) for one in estimate.scatterers)

    def widened(one: Scatterer) -> Scatterer:
        parts = np.divide(total, one.cnr, where=one.cnr > 0, out=np.ones_like(one.cnr))
        return replace(one, sigma=np.sqrt(one.sigma**2 + parts * variance))

    return replace(estimate, scatterers=tuple(map(widened, estimate.scatterers)))


def without_imprecise(estimate: ElevationEstimate, limit: float) -> ElevationEstimate:
    """The estimate with IMPRECISE where the sigma of a scatterer of the pixel is above the limit (rad)."""
    count = scatterer_count(estimate.validity)
    imprecise = np.zeros(count.shape, np.bool_)
    for number, one in enumerate(estimate.scatterers):
        imprecise |= (count > number) & ~(one.sigma <= limit)
    return replace(estimate, validity=np.where(imprecise, Validity.IMPRECISE, estimate.validity).astype(np.uint8))


def without_saturated(estimate: ElevationEstimate) -> ElevationEstimate:
    """The estimate of a dwell with clipped samples: SATURATED, with one scatterer, where it would be measured."""
    validity = np.where(np.isin(estimate.validity, MEASURED), Validity.SATURATED, estimate.validity).astype(np.uint8)
    return replace(estimate, scatterers=estimate.scatterers[:1], validity=validity)
