"""Number of scatterers in a pixel: none, one, two, three, or one extended surface; by tests and by probability.

Every further scatterer, and the spread of one, is accepted by a likelihood-ratio test in its own direction, at a stated
rate of false alarms; and an accepted model must leave only noise. The probability of each model follows from
Bayes' rule, by Laplace's approximation (MacKay, Neural Computation 4, 1992): with the maximum l of the log-likelihood
over the parameters x, their Fisher information F and prior density p(x),

    ln P(model | looks) = ln P(model) + l + ln p(x) + n/2 ln 2 pi - 1/2 ln det F + const

The last three terms are the Occam factor: the fraction of the prior that the looks have left.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import gammaincc, gammainccinv

from sal_height.beams import Beams
from sal_height.elevation.array._kernels import GRID_STEP
from sal_height.elevation.array.bounds import information
from sal_height.elevation.array.estimate import ORDERS
from sal_height.elevation.layover._order_kernels import learn_from_neighbours, weigh_priors
from sal_height.elevation.layover.extended import GREATEST_SPREAD, LEAST_SPREAD, free_looks, log_prior
from sal_height.elevation.layover.several import CNR_RANGE, SeveralScatterers, fit_powers, power_of
from sal_height.elevation.looks.looks import DwellColumns
from sal_height.numeric import F64, Index, blocks, in_threads, rows_at_once

NONE, ONE, TWO, THREE, SPREAD = range(5)
"""The models: none, one, two, three scatterers, or one that is spread; as in `ElevationEstimate.order_probability`."""

PRIOR = np.array([0.05, 0.7, 0.1, 0.05, 0.1])
"""Prior probability of each model."""

NEIGHBOURS = 7  # pixels in range and in azimuth over which the ground is assumed to be alike
EM_STEPS = 5  # the fractions of the models are then within 0.01 of their limit

SPREADS = np.geomspace(LEAST_SPREAD, GREATEST_SPREAD, 10)
"""Standard deviations of elevation of extended surfaces at which the prior is summed up, beamwidths."""


def log_evidence_of_one(explained: F64, looks: F64, turning: F64, domain: float) -> F64:
    """Log-evidence of one scatterer against none, or of one more, from the power that it explains; any shape.

    Args:
        explained: power that it explains, sum over looks, noise powers.
        looks: K.
        turning: squared rate at which the direction of its response turns, D / |a|^2, 1/rad^2.
        domain: range of its elevation, rad.
    """
    power = power_of(explained, looks)
    likelihood = explained * power / (1 + power) - looks * np.log1p(power)
    of_elevation = _log_volume(2 * looks * power**2 / (1 + power) * turning, domain)
    return likelihood + of_elevation + _log_volume(looks * (power / (1 + power)) ** 2, CNR_RANGE)


def log_evidence_of_several(several: SeveralScatterers, domain: float) -> F64:
    """Log-evidence of S scatterers against none, (pixels,).

    Args:
        several: fit of the scatterers.
        domain: range of their elevations, rad.
    """
    fit = fit_powers(several.gram, several.seen, several.looks, several.power * several.array_power)
    ranges, volumes = np.array([domain, CNR_RANGE]), np.empty(len(fit.power))
    weigh_priors(several.turning, several.inverse, fit.power, fit.information, several.looks, ranges, volumes)
    return fit.log_likelihood + volumes + math.lgamma(several.elevation.shape[1] + 1)


def log_evidence_of_spread(
    along_slope: F64, explained: F64, looks: F64, turning: F64, level: F64, beamwidth: float
) -> F64:
    """Log-evidence of an extended surface against a single point, without a fit of the former; any shape.

    Args:
        along_slope: power along the slope of the response, sum over looks, noise powers.
        explained: power that the point explains.
        looks: K.
        turning: D / |a|^2, 1/rad^2.
        level: mean power of one look of level ground along the slope, noise included, noise powers.
        beamwidth: beamwidth of the antenna, rad.
    """
    unit = power_of(explained, looks) * turning * beamwidth**2
    gains = _gain_of_spread(along_slope, looks, level + np.multiply.outer(SPREADS**2, unit))
    gains += log_prior(SPREADS).reshape(-1, *(1 for _ in unit.shape))
    return _log_sum(gains, axis=0)[0] - math.log(len(SPREADS))


def log_evidence_of_level(along_slope: F64, looks: F64, level: F64) -> F64:
    """Log-evidence of level ground, whose ranges differ within a pixel, against a single point; any shape.

    Args:
        along_slope: power along the slope of the response, sum over looks, noise powers.
        looks: K.
        level: mean power of one look of level ground along the slope, noise included, noise powers.
    """
    return _gain_of_spread(along_slope, looks, level)


def _gain_of_spread(along_slope: F64, looks: F64, level: F64) -> F64:
    """Gain in log-likelihood from a mean power of a look along the slope that is `level` times that of the noise."""
    return along_slope * (1 - 1 / level) - free_looks(looks) * np.log(level)


def log_probabilities(log_evidence: F64, here: tuple[Index, Index], columns: DwellColumns) -> F64:
    """Logarithm of the posterior probability of each model from log-evidences against noise, (rows, cols, ORDERS).

    The frequencies of TWO, THREE and SPREAD among the pixels that are not single depend on the scene: kerbs have pairs,
    forests do not. For each of the pixels `here` they are estimated from the others in a square of NEIGHBOURS pixels
    (EM algorithm; Dempster, Laird and Rubin, J. Royal Statistical Society B 39, 1977), and one more as in PRIOR.

    Args:
        log_evidence: log-evidence against noise, shape (rows, cols, ORDERS).
        here: rows and columns of some pixels, row by row.
        columns: columns of the dwells, which are independent of each other.
    """
    found = np.empty_like(log_evidence)

    def weigh(rows: slice) -> None:
        # With the models first, numbers of neighbouring pixels are next to each other.
        logarithms = np.moveaxis(log_evidence[rows], -1, 0) + np.log(PRIOR)[:, None, None]
        logarithms = np.ascontiguousarray(logarithms)
        found[rows] = np.moveaxis(logarithms - _log_sum(logarithms, axis=0), 0, -1)

    in_threads(weigh, blocks(len(found), rows_at_once(found[0].size)))
    some, fractions = found[here], np.zeros((*log_evidence.shape[:2], ORDERS - TWO))
    learn_from_neighbours(log_evidence[here], here, columns.cols, PRIOR, NEIGHBOURS // 2, EM_STEPS, some, fractions)
    found[here] = some
    return found


def _log_sum(logarithm: F64, axis: int) -> F64:
    """Logarithm of the sum, over an axis that is kept, of numbers with these logarithms; one of them is finite."""
    highest = np.max(logarithm, axis=axis, keepdims=True)
    return np.asarray(highest + np.log(np.sum(np.exp(logarithm - highest), axis=axis, keepdims=True)))


def _log_volume(information: F64, prior_range: float) -> F64:
    """Logarithm of the fraction of a uniform prior that looks with this information leave; about 0 at most."""
    return 0.5 * np.log(2 * np.pi / (information * prior_range**2 + 2 * np.pi))


@lru_cache(maxsize=64)
def path_length(beams: Beams, squint: float) -> float:
    """Length of the path of u = a / |a| over the boresights, at one squint (rad)."""
    nodes = np.linspace(*beams.span, math.ceil(np.ptp(beams.span) / (GRID_STEP * beams.beamwidth)) + 1)
    turning = np.sqrt(information(beams, nodes, squint) / beams.power(nodes, squint))
    return float(np.trapezoid(turning, nodes))


@lru_cache(maxsize=4096)
def detection_threshold(length: float, looks: float, false_alarm: float) -> float:
    """Gain in explained power, in noise powers, that one more scatterer seems to bring with the rate `false_alarm`.

    If there is none, the gain in a known direction is noise with a gamma distribution of order K. Its greatest value
    over direction exceeds a level x no more often than it starts above x or crosses x upwards (Rice; Davies,
    Biometrika 64, 1977):

        P(max > x) <= Q(x) + L sqrt(x / pi) p(x)

    Q and p are the distribution's upper tail and density. Newton's method finds where the logarithm of this bound is
    that of the rate, between the level of a known direction and one that is never exceeded.

    Args:
        length: L, `path_length`; 0 for a known direction.
        looks: K.
        false_alarm: probability of exceeding the threshold.
    """
    low, high = float(gammainccinv(looks, false_alarm)), 10 * looks + 1000
    level = low
    for _ in range(50):  # a few steps suffice
        density = math.exp((looks - 1) * math.log(level) - level - math.lgamma(looks))
        crossings = length * math.sqrt(level / math.pi) * density
        bound = float(gammaincc(looks, level)) + crossings
        slope = crossings * ((looks - 0.5) / level - 1) - density
        low, high = (level, high) if bound > false_alarm else (low, level)
        moved = level - bound * math.log(bound / false_alarm) / slope if bound > 0 else low
        moved = moved if low < moved < high else (low + high) / 2
        settled = abs(moved - level) < 1e-9 * level
        level = moved
        if settled:
            break
    return level
