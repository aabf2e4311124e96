"""What every elevation estimator returns, and the reasons a pixel has no height."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from scipy.special import gammainccinv

from sal_height.beams import Beams
from sal_height.elevation.bounds import beam_power
from sal_height.elevation.looks import Covariance, Looks
from sal_height.numeric import F64, U8, compiled, in_parallel


class Validity(IntEnum):
    """Why a pixel has no height, two or that of its neighbours; as the constants of sal_height_msgs/HeightImage."""

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


MISFIT_SHARE = 0.03
"""Share of a pixel's power that may remain unexplained before it counts as more than one scatterer."""

PIXELS_OF_THREAD = 2**14
"""Pixels that are worth a thread."""

FALSE_ALARMS = 1e-4
"""Share of pixels of noise alone in which the strongest of M independent directions passes for a signal."""


def validity_of(
    looks: Looks, beams: Beams, noise_power: float, elevation: F64, explained: F64, cnr: F64, min_cnr: float
) -> U8:
    """Reason for which each pixel's estimate cannot be used, the first that applies, or OK.

    What one scatterer at `elevation` leaves of the power is noise: (M - 1) K sigma^2 with the spread of a chi-square
    of 2 (M - 1) K degrees of freedom. If more is left, the pixel holds another scatterer, or none where it was put.
    Two scatterers closer than about half a beamwidth cannot be told from one. Looks in range on sloping ground differ
    in elevation; from about 0.3 beamwidths on they count as several scatterers.

    Args:
        looks: covariance of M channels in each pixel.
        beams: of the M detectors.
        noise_power: E|n|^2 of one SLC pixel in every channel.
        elevation: estimates, rad, shape (rows, cols).
        explained: power that one scatterer there explains (`explained_power`) over the noise power, shape (rows, cols).
        cnr: estimates, power ratio, shape (rows, cols).
        min_cnr: least usable power ratio.
    """
    degrees = (beams.count - 1) * looks.count
    counts, which = np.unique(looks.count, return_inverse=True)
    detected = explained >= gammainccinv(counts, FALSE_ALARMS / beams.count)[which]
    left = looks.power / noise_power - explained
    misfit = (left > degrees + 5 * np.sqrt(degrees)) & (left - degrees > MISFIT_SHARE * explained)
    first, last = beams.span
    return np.select(
        [~looks.finite, ~(detected & (cnr >= min_cnr)), ~((elevation >= first) & (elevation <= last)), misfit],
        [Validity.MISSING_DATA, Validity.LOW_CNR, Validity.OUTSIDE_ARRAY, Validity.NOT_ONE_SCATTERER],
        Validity.OK,
    ).astype(np.uint8)


def explained_power(covariance: Covariance, response: F64) -> F64:
    """Power that a single scatterer seen with amplitudes `response` explains: a^H R a / a^H a, shape (...)."""
    return output_power(covariance, response) / beam_power(response)


def output_power(covariance: Covariance, response: F64) -> F64:
    """Power of the channels combined with weights `response`, a^H R a, in double precision.

    Args:
        covariance: shape (..., M, M); complex if the response is.
        response: shape (..., M).
    """
    size = response.shape[-1]
    power = np.empty(response.shape[:-1])
    matrices, weights = covariance.reshape(-1, size, size), np.ascontiguousarray(response).reshape(-1, size)
    flat = power.reshape(-1)
    in_parallel(lambda part: _quadratic_forms(matrices[part], weights[part], flat[part]), flat.size, PIXELS_OF_THREAD)
    return power


@compiled
def _quadratic_forms(matrices: Covariance, weights: F64, result: F64) -> None:
    for i in range(result.size):
        total = 0.0
        for m in range(weights.shape[1]):
            row, weight = matrices[i, m], np.conj(weights[i, m])
            for n in range(weights.shape[1]):
                total += (weight * row[n] * weights[i, n]).real
        result[i] = total


def without_saturated(estimate: ElevationEstimate) -> ElevationEstimate:
    """The estimate of a dwell whose samples are clipped: what would be usable is SATURATED, and without a second."""
    usable = np.isin(estimate.validity, (Validity.OK, Validity.TWO_SCATTERERS))
    nowhere = np.full(estimate.elevation.shape, np.nan)
    return replace(
        estimate,
        validity=np.where(usable, Validity.SATURATED, estimate.validity).astype(np.uint8),
        second=SecondScatterer(nowhere, nowhere, nowhere) if estimate.second else None,
    )
