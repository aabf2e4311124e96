"""What every elevation estimator returns, and the reasons a pixel has no height."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError
from sal_height.looks import Looks
from sal_height.sensor import Beams

Array = npt.NDArray[np.float64]


class Validity(IntEnum):
    """Why a pixel has no height; the same values as the constants of sal_height_msgs/HeightImage."""

    OK = 0
    LOW_CNR = 1
    OUTSIDE_ARRAY = 2
    OUTSIDE_PAIR = 3
    NOT_ONE_SCATTERER = 4
    MISSING_DATA = 5


@dataclass(frozen=True)
class ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel; all arrays have the shape (rows, cols) of the looks.

    Attributes:
        elevation: rad from nadir in body axes.
        sigma: standard deviation of elevation, rad; infinite where there is no signal.
        cnr: carrier-to-noise power ratio of one look in a hypothetical detector looking straight at the scatterer.
        validity: `Validity` of each pixel, uint8.
    """

    elevation: Array
    sigma: Array
    cnr: Array
    validity: npt.NDArray[np.uint8]


MISFIT_SHARE = 0.03
"""Share of a pixel's power that may remain unexplained before it counts as more than one scatterer."""


def validity_of(
    looks: Looks, beams: Beams, squint: Array, noise_power: float, elevation: Array, cnr: Array, min_cnr: float
) -> npt.NDArray[np.uint8]:
    """Reason for which each pixel's estimate cannot be used, the first that applies, or OK.

    What one scatterer at `elevation` leaves of the power is noise: (M - 1) K sigma^2 with the spread of a chi-square
    of 2 (M - 1) K degrees of freedom. If more is left, the pixel holds another scatterer, or none where it was put.

    Args:
        looks: covariance of M channels in each pixel.
        beams: of the M detectors.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in one channel.
        elevation: estimates, rad, shape (rows, cols).
        cnr: estimates, power ratio, shape (rows, cols).
        min_cnr: least usable power ratio.
    """
    response = beams.response(elevation, squint)
    degrees = (len(beams.boresights) - 1) * looks.count
    explained = output_power(looks.covariance, response) / np.sum(response**2, axis=-1) / noise_power
    left = np.trace(looks.covariance, axis1=-2, axis2=-1) / noise_power - explained
    misfit = (left > degrees + 5 * np.sqrt(degrees)) & (left - degrees > MISFIT_SHARE * explained)
    first, last = beams.span
    return np.select(
        [~looks.finite, ~(cnr >= min_cnr), ~((elevation >= first) & (elevation <= last)), misfit],
        [Validity.MISSING_DATA, Validity.LOW_CNR, Validity.OUTSIDE_ARRAY, Validity.NOT_ONE_SCATTERER],
        Validity.OK,
    ).astype(np.uint8)


def output_power(covariance: Array, response: Array) -> Array:
    """Power of the channels combined with weights `response`, a^T R a: shapes (..., M, M) and (..., M) give (...)."""
    return np.asarray(np.einsum("...m,...mn,...n->...", response, covariance, response, optimize=True))


def require_noise(noise_power: float) -> None:
    """Refuse an unknown noise power.

    Raises:
        UserError: it is not positive.
    """
    if not noise_power > 0:
        raise UserError("The noise power of the image is not known; SensorInfo.noise_power must be greater than 0.")
