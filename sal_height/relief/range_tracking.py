"""Tracking of the relief in range: heights from noisy measurements of neighbouring cells on the ground.

The relief paper estimates the angle of each range cell and leaves the tracking of the relief from cell to cell to
Bayesian filtering of a virtual target. Here the relief is a stationary Gauss-Markov (Ornstein-Uhlenbeck) process,

    h_(i+1) - m = phi (h_i - m) + w_i,    phi = exp(-d / l),    var w = s^2 (1 - phi^2),

with the mean m, the standard deviation s and the correlation length l of a `ReliefPrior`, and the ground spacing d
between cells. Each cell is measured with a standard deviation of its own, or not at all. The Kalman filter then gives
the posterior of each height given all cells up to it, the smoother of Rauch, Tung and Striebel (AIAA Journal 3, 1965)
the posterior given all cells of the swath. Every column is a track of its own.

A measurement farther from its prediction than `gate` standard deviations of their difference (the validation gate of
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001) is an outlier and not
used. The variance of the prediction then keeps growing, up to s^2, and the gate with it: beyond a cliff the track is
found again after a fraction of l, unless the ground stays more than `gate` s away from the mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from sal_height.errors import UserError
from sal_height.numeric import F64, Bool, compiled, in_parallel

Heights = npt.NDArray[np.floating[Any]]

GATE = 4.0
"""Default gate, standard deviations: 1 in 16 000 Gaussian errors lies beyond."""

LEAST_SIGMA = 1e-100
"""Least sigma of a measured height, m: the precision 1 / sigma^2 of anything greater is finite."""

WIDEST_GATE = 1e15
"""Gate that stands for an infinite one, standard deviations: compiled loops take numbers to be finite."""

OUTLIER_SHARE = 0.05
"""Assumed share of outliers among the measurements from which a prior is estimated; its value matters little."""

COLUMNS_OF_PRIOR = 64
"""Number of columns from which a prior is estimated; more would hardly improve the estimate."""

LEAST_STEPS = 30
"""Least number of pairs of consecutive measured cells of a column from which a prior can be estimated."""

FLATTEST = 2.0
"""Least standard deviation of an estimated relief over that of the mean of all measurements.

A smaller one cannot be told from level ground, and would state heights with less error than the mean itself has.
"""

TOLERANCE = 0.02
"""Tolerance of the search for a prior: of the logarithms of length and sigma, and of the log-likelihood."""

COLUMNS_AT_ONCE = 64
"""Number of columns that are tracked at a time: 1000 rows of them fit into a processor's cache."""


@dataclass(frozen=True)
class ReliefPrior:
    """Prior distribution of the relief.

    Attributes:
        length: correlation length on the ground, m: the correlation of heights falls to 1 / e.
        sigma: standard deviation of heights, m.
        mean: of heights, m.

    Raises:
        UserError: length or sigma is not greater than 0, or a value is not finite.
    """

    length: float
    sigma: float
    mean: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values that no relief has."""
        if not (np.all(np.isfinite([self.length, self.sigma, self.mean])) and self.length > 0 and self.sigma > 0):
            raise UserError(
                f"The prior of the relief has length {self.length:g} m, sigma {self.sigma:g} m and mean "
                f"{self.mean:g} m; all must be finite, the first two greater than 0."
            )

    def correlation(self, distance: npt.ArrayLike) -> F64:
        """Correlation of two heights `distance` (m) apart; broadcasts."""
        return np.exp(-np.abs(distance) / self.length)

    def noise(self, spacing: float) -> float:
        """Variance (m^2) of the process noise of a step of `spacing` (m): s^2 (1 - phi^2)."""
        return float(-(self.sigma**2) * np.expm1(-2 * spacing / self.length))


@dataclass(frozen=True)
class TrackedRelief:
    """Tracked heights of all cells; arrays of shape (rows, cols).

    Attributes:
        height: posterior mean, m.
        sigma: posterior standard deviation, m.
        outlier: True where a measurement was rejected by the gate.
    """

    height: Heights
    sigma: Heights
    outlier: Bool


def filtered(height: Heights, sigma: Heights, spacing: float, prior: ReliefPrior, gate: float = GATE) -> TrackedRelief:
    """Estimate each height from the cells up to it, in the order of rows, by the Kalman filter.

    Args:
        height: measured, m, float32 or float64, shape (rows, cols), rows in the order of range.
        sigma: its standard deviation, m, same shape. A cell is not measured where either is not finite or sigma is
            not greater than 0.
        spacing: ground spacing between rows, m.
        prior: of the relief.
        gate: measurements farther from their prediction are outliers, standard deviations; infinite: none is.

    Returns:
        Heights and standard deviations of all cells, in the precision of `height`; computed in double precision.

    Raises:
        UserError: the shapes differ or are not (rows, cols), or spacing or gate is not greater than 0.
    """
    return _tracked(height, sigma, spacing, prior, gate, both_ways=False)


def smoothed(height: Heights, sigma: Heights, spacing: float, prior: ReliefPrior, gate: float = GATE) -> TrackedRelief:
    """Estimate each height from all cells of its column, by the filter and the smoother of Rauch, Tung and Striebel.

    Arguments, result and errors are those of `filtered`, which also decides what is an outlier.
    """
    return _tracked(height, sigma, spacing, prior, gate, both_ways=True)


def estimated_prior(
    height: Heights, sigma: Heights, spacing: float, length: float | None = None, relief_sigma: float | None = None
) -> ReliefPrior:
    """Estimate the prior under which the measured heights are most likely; length and sigma unless they are given.

    The likelihood of a Gauss-Markov process is the product of the likelihoods of the filter's innovations (Schweppe,
    IEEE Trans. Information Theory 11, 1965). Outliers would make the relief look rough. Therefore a measurement is
    taken to be an outlier with the probability OUTLIER_SHARE, and then to have any height between the least and the
    greatest; the filter weighs it by the probability that it is none (probabilistic data association, Bar-Shalom and
    Tse, Automatica 11, 1975).

    Up to COLUMNS_OF_PRIOR columns are used, each as a track of its own. Lengths are searched from a third of `spacing`
    to ten swaths, standard deviations from `flattest` on, which is the result for level ground.

    Args:
        height: measured, m, shape (rows, cols), as in `filtered`.
        sigma: its standard deviation, m.
        spacing: ground spacing between rows, m.
        length: correlation length, m; None: estimated.
        relief_sigma: standard deviation of the relief, m; None: estimated.

    Raises:
        UserError: fewer than LEAST_STEPS pairs of consecutive measured cells of a column, or what `filtered` and
            `ReliefPrior` refuse.
    """
    check_measurements(height, sigma, spacing)
    deviation, precision = measurements(*_columns_of_prior(height, sigma), 0.0)
    measured = precision > 0
    steps = int(np.sum(np.maximum(np.count_nonzero(measured, axis=0) - 1, 0)))
    if steps < LEAST_STEPS:
        raise UserError(
            f"The heights have {steps} pairs of consecutive measured cells of a column; a prior of the relief can be "
            f"estimated from {LEAST_STEPS} or more."
        )
    known = deviation[measured]
    error = float(np.median(1 / np.sqrt(precision[measured])))
    low, middle, high = np.percentile(known, [16, 50, 84])
    extent = float(np.ptp(known)) + error

    def misfit(values: F64) -> float:
        """Negative log-likelihood of log(length), log(sigma), and mean less median in units of the median error."""
        prior = ReliefPrior(*np.exp(values[:2]).tolist())
        centred = deviation - (middle + values[2] * error)
        phi, q = float(prior.correlation(spacing)), prior.noise(spacing)
        return -float(_log_likelihood(centred, precision, phi, q, prior.sigma**2, OUTLIER_SHARE, 1 / extent))

    swath = spacing * len(height)
    lengths = [length] if length is not None else np.geomspace(spacing, swath, 6).tolist()
    spread = max(float(high - low) / 2, error)
    sigmas = [relief_sigma] if relief_sigma is not None else [0.1 * spread, 0.4 * spread, spread]
    starts = [np.array([*np.log([some, other]), 0.0]) for some in lengths for other in sigmas]
    lowest = np.array([*np.log([spacing / 3, flattest(precision)]), -np.inf])
    highest = np.array([*np.log([10 * swath, 10 * extent]), np.inf])
    free = np.array([length is None, relief_sigma is None, True])
    found = minimised(misfit, min(starts, key=misfit), free, lowest, highest)
    return ReliefPrior(float(np.exp(found[0])), float(np.exp(found[1])), float(middle + found[2] * error))


def flattest(precision: F64) -> float:
    """Least standard deviation (m) of a relief that can be told from level ground: FLATTEST times that of the mean.

    Args:
        precision: of one or more measurements (`measurements`).
    """
    known = precision[precision > 0]
    return FLATTEST * float(np.median(1 / np.sqrt(known)) / np.sqrt(len(known)))


def minimised(misfit: Callable[[F64], float], start: F64, free: Bool, lowest: F64, highest: F64) -> F64:
    """Minimise a misfit over the `free` ones of some values from `start`, by the simplex of Nelder and Mead."""
    found = start.copy()

    def misfit_of_free(values: F64) -> float:
        found[free] = values
        return misfit(found)

    bounds = np.stack([lowest, highest], axis=-1)[free]
    best = minimize(
        misfit_of_free,
        np.clip(start[free], *bounds.T),
        method="Nelder-Mead",
        bounds=bounds,
        options={"xatol": TOLERANCE, "fatol": TOLERANCE},
    )
    found[free] = best.x
    return found


def _columns_of_prior(height: Heights, sigma: Heights) -> tuple[Heights, Heights]:
    """Up to COLUMNS_OF_PRIOR of the columns that hold a height, evenly spaced."""
    seen = np.flatnonzero(np.any(np.isfinite(height), axis=0))
    count = min(len(seen), COLUMNS_OF_PRIOR)
    chosen = seen[np.linspace(0, len(seen) - 1, count).astype(np.intp)]
    return height[:, chosen], sigma[:, chosen]


def steady_sigmas(prior: ReliefPrior, spacing: float, measured_sigma: float) -> tuple[float, float]:
    """Standard deviations (m) of `filtered` and `smoothed` heights far from the edges of the swath.

    All cells are measured with `measured_sigma` (m) and none is an outlier. The filter's predicted variance is
    the positive root of P^2 + P (R (1 - phi^2) - q) - q R = 0, what follows the measurement P R / (P + R); the
    smoother's is the fixed point of its recursion.
    """
    phi, q, r = float(prior.correlation(spacing)), prior.noise(spacing), measured_sigma**2
    off = q - r * q / prior.sigma**2
    predicted = (off + np.sqrt(off**2 + 4 * q * r)) / 2
    updated = predicted * r / (predicted + r)
    back = phi * updated / predicted
    return float(np.sqrt(updated)), float(np.sqrt((updated - back**2 * predicted) / (1 - back**2)))


def measurements(height: Heights, sigma: Heights, mean: float) -> tuple[F64, F64]:
    """Deviations of measured heights from `mean` (m) and their precisions 1 / sigma^2 (1 / m^2); 0 where not measured.

    Arguments are those of `filtered`.
    """
    deviation, precision = np.empty(height.shape), np.empty(height.shape)
    _measure(height, sigma, mean, deviation, precision)
    return deviation, precision


def _measure(height: Heights, sigma: Heights, mean: float, deviation: F64, precision: F64) -> None:
    """Fill `deviation` and `precision` as `measurements` returns them."""
    missing = ~((sigma > LEAST_SIGMA) & np.isfinite(height))
    deviation[:], precision[:] = height, sigma
    deviation -= mean
    deviation[missing], precision[missing] = 0.0, np.inf
    np.square(precision, out=precision)
    np.reciprocal(precision, out=precision)


def check_measurements(height: Heights, sigma: Heights, spacing: float, gate: float = GATE) -> None:
    """Check the arguments of `filtered`.

    Raises:
        UserError: the heights cannot be tracked with them.
    """
    if height.ndim != 2 or height.shape != sigma.shape:
        raise UserError(
            f"Heights have the shape {height.shape}, their sigmas {sigma.shape}; both must have the same (rows, cols)."
        )
    if not (spacing > 0 and np.isfinite(spacing)):
        raise UserError(f"The rows of the heights are {spacing:g} m apart; it must be finite and greater than 0.")
    if not gate > 0:
        raise UserError(f"The gate is {gate:g} standard deviations; it must be greater than 0.")


def _tracked(
    height: Heights, sigma: Heights, spacing: float, prior: ReliefPrior, gate: float, both_ways: bool
) -> TrackedRelief:
    check_measurements(height, sigma, spacing, gate)
    phi, q, square = float(prior.correlation(spacing)), prior.noise(spacing), min(gate, WIDEST_GATE) ** 2
    result = TrackedRelief(np.empty_like(height), np.empty_like(height), np.empty(height.shape, np.bool_))

    def work(part: slice) -> None:
        scratch = np.empty((2, len(height), COLUMNS_AT_ONCE))
        for first in range(part.start, part.stop, COLUMNS_AT_ONCE):
            block = np.s_[:, first : min(first + COLUMNS_AT_ONCE, part.stop)]
            state, variance = scratch[..., : result.height[block].shape[1]]
            _measure(height[block], sigma[block], prior.mean, state, variance)
            _filter(phi, q, float(prior.sigma**2), square, state, variance, result.outlier[block])
            if both_ways:
                _smooth(phi, q, state, variance)
            _write(state, variance, float(prior.mean), result.height[block], result.sigma[block])

    in_parallel(work, height.shape[1], COLUMNS_AT_ONCE)
    return result


# The loops below are compiled; all columns of a row are worked on at a time.


@compiled
def _filter(
    phi: float, q: float, prior_variance: float, square_gate: float, state: F64, variance: F64, outlier: Bool
) -> None:
    """Turn measured deviations and their precisions (0: not measured) into filtered states and variances."""
    rows, cols = state.shape
    predicted, spread = np.zeros(cols), np.full(cols, prior_variance)
    for i in range(rows):
        for c in range(cols):
            innovation, weight = state[i, c] - predicted[c], variance[i, c]
            outlier[i, c] = innovation**2 * weight > square_gate * (1 + spread[c] * weight)
            weight = 0.0 if outlier[i, c] else weight
            variance[i, c] = spread[c] / (1 + spread[c] * weight)
            state[i, c] = predicted[c] + variance[i, c] * weight * innovation
            predicted[c] = phi * state[i, c]
            spread[c] = phi**2 * variance[i, c] + q


@compiled
def _smooth(phi: float, q: float, state: F64, variance: F64) -> None:
    """Turn filtered states and variances into smoothed ones, from the last row to the first."""
    rows, cols = state.shape
    for i in range(rows - 2, -1, -1):
        for c in range(cols):
            predicted = phi**2 * variance[i, c] + q
            back = phi * variance[i, c] / predicted
            state[i, c] += back * (state[i + 1, c] - phi * state[i, c])
            variance[i, c] += back**2 * (variance[i + 1, c] - predicted)


@compiled
def _write(state: F64, variance: F64, mean: float, height: Heights, sigma: Heights) -> None:
    """Fill height and sigma."""
    for i in range(state.shape[0]):
        for c in range(state.shape[1]):
            height[i, c] = state[i, c] + mean
            sigma[i, c] = np.sqrt(variance[i, c])


@compiled
def _log_likelihood(
    deviation: F64, precision: F64, phi: float, q: float, prior_variance: float, share: float, density: float
) -> float:
    """Log-likelihood of measurements of which a `share` are outliers of uniform `density` (1/m)."""
    total = 0.0
    for c in range(deviation.shape[1]):
        state, spread = 0.0, prior_variance
        for i in range(deviation.shape[0]):
            if precision[i, c] > 0:
                innovation, variance = deviation[i, c] - state, spread + 1 / precision[i, c]
                near = (1 - share) * np.exp(-(innovation**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
                likelihood = near + share * density
                inlier, gain = near / likelihood, spread / variance
                total += np.log(likelihood)
                state += inlier * gain * innovation
                spread += inlier * gain * ((1 - inlier) * gain * innovation**2 - spread)
            state *= phi
            spread = phi**2 * spread + q
    return total
