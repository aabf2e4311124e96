"""One surface that is spread over elevation within a pixel: a slope towards the sensor, rubble, foliage.

Its scatterers are many and independent, so that a look holds A a(t) + B a'(t) + ..., where the second amplitude has the
power of the first times the variance s^2 of elevation. The likelihood of a single scatterer peaks near the middle t of
the spread, with the variance of a point plus s^2 / 2K: the centre of the looks' power is not that of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.elevation.beam_error import beam_deviation
from sal_height.elevation.bounds import Numbers
from sal_height.elevation.search import PeakSearch
from sal_height.elevation.several import LEAST_POWER, GaussianFit, adjoint, fit_powers
from sal_height.numeric import F64

MOST_NODES = 5  # of the quadrature over a uniform spread (Gauss and Legendre)
LEAST_SPREAD, GREATEST_SPREAD = 0.05, 0.3  # standard deviation of a uniform surface's elevation, beamwidths


@dataclass(frozen=True, eq=False)
class ExtendedSurface:
    """An extended surface fitted to each of some pixels; arrays of shape (pixels,).

    Attributes:
        elevation: of its middle, rad.
        spread: standard deviation s of the elevation of its scatterers, rad.
        modelled: the same within the bounds of the model, rad.
        sigma: standard deviation of `elevation`, rad.
        along_slope: power along the slope of the response there, sum over looks, noise powers.
        turning: D / |a|^2 there, 1/rad^2.
        explained: power in the `directions` of the fit, sum over looks, noise powers.
        fit: likelihood of its power.
        looks: K.
    """

    elevation: F64
    spread: F64
    modelled: F64
    sigma: F64
    along_slope: F64
    turning: F64
    explained: F64
    fit: GaussianFit
    looks: F64

    @classmethod
    def at(
        cls, search: PeakSearch, covariance: Numbers, looks: F64, single: F64, along_slope: F64, beamwidth: float
    ) -> Self:
        """Fit a surface whose middle is at the peak of the likelihood of one scatterer.

        Args:
            search: of the normalised objective, at the squint of the pixels.
            covariance: R in noise powers, (pixels, M, M).
            looks: K, (pixels,).
            single: elevation of that peak, rad, (pixels,).
            along_slope: power along u' there, sum over looks, noise powers, (pixels,).
            beamwidth: rad.
        """
        explained, _, turning = search.fit(covariance, single)
        power = np.maximum(explained / looks - 1, LEAST_POWER)
        spread = spread_of(along_slope, looks, power, turning)
        bounded = np.clip(spread, LEAST_SPREAD * beamwidth, GREATEST_SPREAD * beamwidth)
        nodes, weights = np.polynomial.legendre.leggauss(directions(covariance.shape[-1]))
        units, _, array_power = search.responses_at(single[:, None] + bounded[:, None] * np.sqrt(3) * nodes)
        shares = np.sqrt(weights / 2 * array_power / array_power.mean(axis=1, keepdims=True))
        basis = np.linalg.qr(np.swapaxes(units, 1, 2))[0]
        units = np.swapaxes(units * shares[..., None], 1, 2)
        gram, seen = adjoint(units) @ units, adjoint(units) @ covariance @ units
        fit = fit_powers(gram, seen, looks, power[:, None], np.ones((1, len(nodes))))
        sigma = np.sqrt(np.maximum(point_variance(explained, looks, turning) + spread**2 / (2 * looks), 0))
        seen_by_basis = np.einsum("pmi,pmn,pni->p", basis.conj(), covariance, basis).real
        return cls(single, spread, bounded, sigma, along_slope, turning, seen_by_basis, fit, looks)

    def with_uncertain_beams(self, uncertainty: float, array_power: F64) -> Self:
        """The surface with the sigma that `beam_deviation` adds, for |a|^2 at the middle."""
        beams = beam_deviation(self.turning * array_power, uncertainty)
        return replace(self, sigma=np.hypot(self.sigma, beams))


def directions(channels: int) -> int:
    """Number of dimensions in which the looks of an extended surface may lie, of those of all channels."""
    return min(MOST_NODES, channels - 1)


def free_looks(looks: F64) -> F64:
    """Number of complex dimensions of the power along the slope: K, less the real one that the peak has taken."""
    return looks - 0.5


def spread_of(along_slope: F64, looks: F64, power: F64, turning: F64) -> F64:
    """Standard deviation of elevation, rad; 0 where there is no more power along the slope than noise has.

    Args:
        along_slope: power along the slope of the response, sum over looks, noise powers.
        looks: K.
        power: p of one look.
        turning: D / |a|^2, 1/rad^2.
    """
    excess = np.maximum(along_slope / free_looks(looks) - 1, 0.0)
    return np.sqrt(excess / np.maximum(power * turning, 1e-300))


def point_variance(explained: F64, looks: F64, turning: F64) -> F64:
    """Variance (rad^2) of the elevation of one point-like scatterer from the power that it explains."""
    energy = np.maximum(explained - looks, LEAST_POWER * looks)
    return (1 + looks / energy) / (2 * energy * turning)
