"""Several scatterers in one pixel: layover, at the same range and Doppler frequency but at different elevations.

Look k is sum_s A_sk u(t_s) plus noise of variance 1, u = a / |a| the unit response. With R = sum_k g_k g_k^H,
profiling out the complex amplitudes leaves the conditional likelihood of S elevations (Ziskind and Wax, IEEE Trans.
Acoustics, Speech and Signal Processing 36, 1988)

    f(t_1 ... t_S) = tr(P R),    P = U (U^H U)^-1 U^H,    U = [u(t_1) ... u(t_S)]

The power that the best S explain beyond the best S - 1 is the likelihood ratio of S against S - 1. If the amplitudes
are Gaussian and independent of each other, with the mean powers p_s, the likelihood is that of the covariance
U diag(p) U^H + I.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from sal_height.elevation.array.bounds import Numbers
from sal_height.elevation.array.search import PeakSearch
from sal_height.elevation.layover._order_kernels import invert_diagonals
from sal_height.elevation.layover._several_kernels import LEAST_POWER, maximise_powers, search_beside, weigh_together
from sal_height.numeric import F32, F64

CNR_RANGE = math.log(10 ** (40 / 10) / 10 ** (0 / 10))
"""Range of the logarithm of each scatterer's CNR, within which it is uniform: 0 to 40 dB."""


@dataclass(frozen=True, eq=False)
class SeveralScatterers:
    """The S scatterers that explain most power of each of some pixels; arrays of shape (pixels, ...).

    Attributes:
        elevation: angles from nadir, (pixels, S), rad.
        explained: power f, sum over looks, in noise powers, (pixels,).
        array_power: |a|^2 at the elevations, (pixels, S).
        along_slopes: power along the part of each slope that is perpendicular to all responses, (pixels, S).
        gram: U^H U, (pixels, S, S).
        inverse: (U^H U)^-1, (pixels, S, S).
        seen: U^H R U, (pixels, S, S).
        fitted: (U^H U)^-1 U^H R U (U^H U)^-1, sums over looks of products of the fitted amplitudes, (pixels, S, S).
        turning: D^H (I - P) D with D = dU/dt, (pixels, S, S), 1/rad^2.
        looks: K, (pixels,).
    """

    elevation: F64
    explained: F64
    array_power: F64
    along_slopes: F64
    gram: Numbers
    inverse: Numbers
    seen: Numbers
    fitted: Numbers
    turning: Numbers
    looks: F64

    @classmethod
    def at(cls, search: PeakSearch, covariance: Numbers, looks: F64, elevation: F64) -> Self:
        """Fit scatterers at known elevations (rad, (pixels, S)); the other arguments are those of `search_several`."""
        pixels, count = elevation.shape
        tables = search.tables
        explained, (power, along) = np.empty(pixels), np.empty((2, pixels, count))
        gram, inverse, seen, fitted, turning = products = np.empty((5, pixels, count, count), covariance.dtype)
        pieces, squints = (tables.unit_pieces, tables.power), search.every(pixels)
        weigh_together(covariance, squints, search.position(elevation), pieces, (explained, power, along, *products))
        return cls(elevation, explained, power, along, gram, inverse, seen, fitted, turning / tables.step**2, looks)

    @cached_property
    def power(self) -> F64:
        """Carrier-to-noise power ratio of one look in a detector that looks straight at each, (pixels, S)."""
        signal = self.fitted / self.looks[:, None, None] - self.inverse
        return np.diagonal(signal, axis1=1, axis2=2).real / self.array_power

    @property
    def sigma(self) -> F64:
        """Cramer-Rao bound of each elevation, rad, (pixels, S); infinite where the looks do not determine them.

        With D = dU/dt and the covariance Z of the amplitudes (Stoica and Nehorai, IEEE Trans. Acoustics, Speech and
        Signal Processing 38, 1990), * element by element:

            F = 2 K Re{(D^H (I - P) D) * known^T},    known = Z (Z + (U^H U)^-1)^-1 Z

        `known` is Z - (U^H U)^-1 to first order in the noise.
        """
        return deviations(self.information())

    def deviation_by_beams(self, uncertainty: float) -> F64:
        """Standard deviation of each elevation from uncertain beams, rad, (pixels, S).

        As `beam_error.beam_deviation`, with the sum of the errors of all scatterers against the power of each.
        """
        own = np.maximum(self.power, 1e-300)
        slopes = np.diagonal(self.turning, axis1=1, axis2=2).real * self.array_power
        return uncertainty * np.sqrt(np.maximum(own.sum(axis=1, keepdims=True) / own, 1.0) / (2 * slopes))

    def along_surfaces(self, level_spread: F64, greatest: F64) -> tuple[F64, F64]:
        """Power along the slopes beyond that of level ground, and of surfaces whose spread is 1 rad, (pixels,).

        Both are sums over the scatterers and looks, in noise powers.

        Args:
            level_spread: standard deviation of elevation within a pixel on level ground, (pixels,), rad.
            greatest: power along the slope of one scatterer that is counted at most, over that of level ground.
        """
        free = self.looks[:, None] - 0.5
        turning = np.diagonal(self.turning, axis1=1, axis2=2).real
        unit = np.maximum(self.power * self.array_power, 0.0) * turning
        level = 1 + unit * level_spread[:, None] ** 2
        along = np.minimum(self.along_slopes, greatest[:, None] * level)
        return np.sum(along - free * level, axis=1), np.sum(free * unit, axis=1)

    def deviation_by_spread(self, level_spread: F64) -> F64:
        """Standard deviation of each elevation from the spread of its surface, rad, (pixels, S).

        The range of a pixel is that of the power of all its scatterers. Where one of them is spread, its elevation at
        that range may be any of its own; or it is two, of which only the mean was found. The ends of an even surface
        are sqrt(3) of its spreads from its middle: with half the spread they are within 3.5 standard deviations. The
        spread is that beyond what noise, with one standard deviation, and level ground leave along the slope.

        Args:
            level_spread: standard deviation of elevation within a pixel on level ground, (pixels,), rad.
        """
        free = self.looks[:, None] - 0.5
        turning = np.diagonal(self.turning, axis1=1, axis2=2).real
        unit = np.maximum(self.power * self.array_power, 1e-300) * turning
        level = 1 + unit * level_spread[:, None] ** 2
        excess = np.maximum(self.along_slopes - (free + np.sqrt(free)) * level, 0.0)
        return 0.5 * np.sqrt(excess / (free * unit))

    def information(self) -> F64:
        """Fisher information F of the elevations, 1/rad^2, (pixels, S, S)."""
        known = self.fitted - 2 * self.looks[:, None, None] * self.inverse
        return 2 * (self.turning * np.swapaxes(known, 1, 2)).real


def search_several(
    search: PeakSearch, covariance: Numbers, values: F32, start: F64, least: F64
) -> tuple[F64, F64, F64]:
    """Find one scatterer more than `start` in some pixels.

    Args:
        search: search of these pixels with the normalised objective.
        covariance: R in noise powers, double precision, (pixels, M, M).
        values: objective `on_grid`.
        start: elevations of the best S - 1 scatterers, (pixels, S - 1), rad.
        least: power that one more must explain at a node of the grid, (pixels,). Where it does not, the result has that
            node, and an explained power of 0.

    Returns:
        Elevations, rad, (pixels, S); the power that they explain; and that of the best additional node, (pixels,).
    """
    found, (explained, gain) = np.empty((len(start), start.shape[1] + 1)), np.empty((2, len(start)))
    tables, squints = search.tables, search.every(len(start))
    responses = tables.precise_units_across, tables.unit_pieces
    search_beside(covariance, squints, values, search.position(start), least, responses, (found, explained, gain))
    return search.elevation(np.sort(found, axis=1)), explained, gain


def deviations(information: F64) -> F64:
    """Standard deviations (pixels, S) from the information (pixels, S, S); infinite where it is not positive."""
    variance = np.empty(information.shape[:2])
    invert_diagonals(information.copy(), variance)
    return np.where(variance >= 0, np.sqrt(np.maximum(variance, 0)), np.inf)


@dataclass(frozen=True, eq=False)
class GaussianFit:
    """Likelihood of Gaussian amplitudes at its maximum over their powers; arrays of shape (pixels, ...).

    Attributes:
        log_likelihood: logarithm of the likelihood over that of noise alone, (pixels,).
        information: Fisher information of the logarithms of the powers, (pixels, S, S).
        power: power of each scatterer in the whole array, (pixels, S), noise powers.
    """

    log_likelihood: F64
    information: F64
    power: F64


def fit_powers(gram: Numbers, seen: Numbers, looks: F64, start: F64) -> GaussianFit:
    """Maximise over the powers p the likelihood of pixels with the covariance U diag(p) U^H + I, by Fisher's scoring.

        l = tr(N B U^H R U B) - K ln det(I + X),    B = diag(p)^(1/2),    X = B U^H U B,    N = (I + X)^-1

    The gradient over ln p_s is (N B U^H R U B N - K X N)_ss, the Fisher information K |(X N)_st|^2.

    Args:
        gram: U^H U, (pixels, S, S).
        seen: U^H R U, (pixels, S, S).
        looks: K, (pixels,).
        start: initial powers, (pixels, S), noise powers.
    """
    power, likelihood, information = start.copy(), np.empty(len(start)), np.empty(gram.shape)
    maximise_powers(gram, seen, looks, power, (likelihood, information))
    return GaussianFit(likelihood, information, power)


def power_of(explained: F64, looks: F64) -> F64:
    """Power of one look of a scatterer in the whole array from that explained in K looks, noise powers; any shape."""
    return np.maximum(explained / looks - 1, LEAST_POWER)


def adjoint(matrix: Numbers) -> Numbers:
    """The conjugate transpose of the last two axes."""
    return np.swapaxes(matrix.conj(), -1, -2)
