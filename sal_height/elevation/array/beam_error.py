"""Effect of uncertain beams on elevations and on the test of fit.

A scatterer has the amplitude A_k (a_m + e_m) in channel m and look k, with errors e_m of the beams that are circular,
independent between channels and of variance u^2 (`Beams.uncertainty`, relative to the beams' maximum). They act as
noise proportional to the signal: with the energy S = sum_k |A_k|^2 over the noise power, it has the power u^2 S in the
direction of the amplitudes over looks, and none in the K - 1 other directions. Looks do not average it, and more energy
does not reduce it. To first order the likelihood's peak moves by (D as in `bounds`)

    d theta = Re(a'_perp^H e) / D,    variance = u^2 / (2 D)

for one scatterer. It is common to all pixels of one elevation and squint, in all dwells: averages over pixels or dwells
do not reduce it.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincc

from sal_height.beams import Beams
from sal_height.elevation.array.bounds import information
from sal_height.numeric import F64


def beam_deviation(determined: npt.ArrayLike, uncertainty: float) -> F64:
    """Standard deviation of elevation (rad) from uncertain beams: u / sqrt(2 D); infinite where D is not positive.

    Args:
        determined: D, 1/rad^2 (`bounds.information`).
        uncertainty: u.
    """
    determined = np.asarray(determined, dtype=np.float64)
    if uncertainty == 0:
        return np.zeros_like(determined)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(determined > 0, uncertainty / np.sqrt(2 * determined), np.inf)


def common_deviation(beams: Beams, elevation: npt.ArrayLike, squint: npt.ArrayLike) -> F64:
    """`beam_deviation` of scatterers at `elevation` and `squint` (rad, which broadcast); NaN where one is."""
    deviation = beam_deviation(information(beams, elevation, squint), beams.uncertainty)
    return np.where(np.isfinite(np.broadcast_arrays(elevation, squint)).all(axis=0), deviation, np.nan)


class PowerLaw(NamedTuple):
    """Distribution of a power: shift + scale g, where g has the gamma distribution of that order.

    Attributes:
        order: order of the gamma distribution.
        scale, shift: parameters in units of the noise power.
    """

    order: F64
    scale: F64
    shift: F64

    @classmethod
    def of(cls, order: F64, coherent: F64 | float, error: F64 | float) -> Self:
        """Distribution of the power that noise and errors of the beams leave in a pixel, by its first three moments.

        Of the complex dimensions that a scatterer leaves, `coherent` lie in the direction of the amplitudes of the
        looks, and have the power 1 + `error`; the rest have 1. A sum of gamma distributions is near to one of them with
        the same mean, variance and skewness (Imhof, Biometrika 48, 1961, eq. 4.1, after Pearson): of 10^-3 it keeps 1.0
        to 1.5 10^-3. Without an error it is exact, and for one look.

        Args:
            order: number of complex dimensions of the noise.
            coherent: number of those in the direction of the amplitudes.
            error: u^2 S.
        """
        rest = order - coherent
        mean, variance, third = (coherent * (1 + error) ** n + rest for n in (1, 2, 3))
        some = variance > 0
        scale = np.divide(third, variance, out=np.ones_like(variance), where=some)
        fitted = np.divide(variance, scale**2, out=np.zeros_like(variance), where=some)
        return cls(fitted, scale, mean - fitted * scale)

    def exceeded(self, power: F64) -> F64:
        """Probability of more than `power` (in noise powers); 0 without any dimension."""
        some = self.order > 0
        beyond = np.maximum((power - self.shift) / self.scale, 0.0)
        return np.where(some, gammaincc(np.where(some, self.order, 1.0), beyond), power <= 0)
