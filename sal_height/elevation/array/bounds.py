"""Least standard deviation of an elevation estimate from the detectors of an array.

A target at elevation theta gives detector m the amplitude A_k a_m(theta) in look k, plus noise of variance sigma^2.
A change of the amplitude moves the samples along a. Only the part of a' = da/dtheta that is perpendicular to a contains
information on theta:

    D = a'^H (I - a a^H / |a|^2) a'

All bounds are Cramer-Rao bounds; they differ in their assumptions on the amplitudes (Stoica and Nehorai, IEEE Trans.
Acoustics, Speech and Signal Processing 38, 1990). CNR is |A|^2 / sigma^2: that of a detector with h = 1 at the target.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.numeric import F64

Numbers = npt.NDArray[Any]
"""Real or complex."""


def information(beams: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """Compute D (1/rad^2) for targets at `elevation` and `squint` (rad), which broadcast."""
    return information_of(beams.response(elevation, squint), beams.slope(elevation, squint))


def information_of(response: F64, slope: F64) -> F64:
    """Compute D from responses a and slopes a' of shape (..., detectors); 1/rad^2 if the slopes are per rad."""
    overlap = np.abs(np.sum(response.conj() * slope, axis=-1)) ** 2
    return np.sum(np.abs(slope) ** 2, axis=-1) - overlap / beam_power(response)


def unit_vectors(response: Numbers) -> Numbers:
    """Divide responses a, shape (..., detectors), by |a|; the result is 0 where |a| is."""
    norm = np.linalg.norm(response, axis=-1, keepdims=True)
    return response * np.divide(1.0, norm, where=norm > 0, out=np.zeros_like(norm))


def beam_power(response: F64) -> F64:
    """Compute |a|^2 of responses a, shape (..., detectors), real or complex."""
    return np.sum(np.abs(response) ** 2, axis=-1)


def conditional_crb(
    beams: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike, cnr: npt.ArrayLike, looks: int
) -> F64:
    """Least standard deviation (rad) for looks whose energies have the known sum K C: 1 / sqrt(2 K C D).

    Args:
        beams: beams of the array.
        elevation: elevation of the target, rad; broadcasts with `squint` and `cnr`.
        squint: squint of the target, rad.
        cnr: C of one look, power ratio; the bound is infinite where it is not positive.
        looks: K.
    """
    return _deviation(looks * np.asarray(cnr), information(beams, elevation, squint))


def stochastic_crb(
    beams: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike, cnr: npt.ArrayLike, looks: int
) -> F64:
    """Least standard deviation (rad) for Gaussian amplitudes of unknown power: sqrt((1 + 1 / (C |a|^2)) / (2 K C D)).

    With many looks, estimates approach it at high CNR; with a few, `speckle_crb` is nearer. Arguments as in
    `conditional_crb`.
    """
    response = beams.response(elevation, squint)
    determined = information_of(response, beams.slope(elevation, squint))
    return stochastic_deviation(looks * np.asarray(cnr), looks, beam_power(response), determined)


def stochastic_deviation(energy: F64, looks: npt.ArrayLike, power: F64, determined: F64) -> F64:
    """Compute `stochastic_crb` from the energy E = K C, K, |a|^2 and D; infinite where E is not positive."""
    positive = np.maximum(energy, 0.0)
    return _deviation(positive**2 / (positive + np.asarray(looks) / power), determined)


def speckle_crb(beams: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike, cnr: npt.ArrayLike, looks: int) -> F64:
    """Least standard deviation (rad) for Gaussian amplitudes: the root of the mean of the conditional variance.

    The mean of the inverse of their energy is 1 / ((K - 1) C), which is infinite for one look. Arguments as in
    `conditional_crb`.
    """
    return conditional_crb(beams, elevation, squint, cnr, looks - 1)


def _deviation(energy: npt.ArrayLike, information: F64) -> F64:
    """Compute 1 / sqrt(2 E D); infinite where E or D is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = 1 / (2 * np.asarray(energy) * information)
    return np.sqrt(np.where((np.asarray(energy) > 0) & (information > 0), variance, np.inf))
