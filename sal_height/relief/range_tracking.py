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
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, minimize

from sal_height.errors import UserError
from sal_height.numeric import F64, Bool, Index, blocks, in_parallel
from sal_height.relief import _kernels as kernels
from sal_height.relief._kernels import LEAST_SIGMA, Heights
from sal_height.relief.settings import DEFAULT_TRACKING, TrackingSettings

LEAST_STEPS = 20
"""Least number of pairs of consecutive measured cells of a column from which a prior can be estimated, to a third."""

FLATTEST = 2.0
"""Least standard deviation of an estimated relief over that of the mean of all measurements.

A smaller one cannot be told from level ground, and would state heights with less error than the mean itself has.
"""

TOLERANCE = 0.02
"""Tolerance of the search for a prior: of the logarithms of length and sigma, and of the log-likelihood."""

COLUMNS_AT_ONCE = 64
"""Number of columns that are tracked at a time: 1000 rows of them fit into a processor's cache."""


@dataclass(frozen=True, eq=False)
class MeasuredHeights:
    """Measured heights of the cells of an image, rows in the order of range.

    Attributes:
        height: m, float32 or float64, shape (rows, cols).
        sigma: standard deviation of height, m, same shape. A cell is not measured where either is not finite or sigma
            is not greater than 0.
        spacings: ground spacing between rows and between columns, m.

    Raises:
        UserError: the shapes differ or are not (rows, cols), or a spacing is not finite and greater than 0.
    """

    height: Heights
    sigma: Heights
    spacings: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse heights that cannot be tracked."""
        if self.height.ndim != 2 or self.height.shape != self.sigma.shape:
            raise UserError(
                f"Heights have the shape {self.height.shape}, their sigmas {self.sigma.shape}; both must have the same "
                "(rows, cols)."
            )
        if not all(np.isfinite(spacing) and spacing > 0 for spacing in self.spacings):
            raise UserError(
                f"The rows of the heights are {self.spacings[0]:g} m apart and the columns {self.spacings[1]:g} m; "
                "both must be finite and greater than 0."
            )

    def deviations(self, mean: float) -> tuple[F64, F64]:
        """Deviations of the heights from `mean` (m) and their precisions 1 / sigma^2 (1/m^2); 0 if not measured."""
        measured = np.isfinite(self.height) & np.isfinite(self.sigma) & (self.sigma > LEAST_SIGMA)
        height, sigma = self.height.astype(np.float64), self.sigma.astype(np.float64)
        return np.where(measured, height - mean, 0.0), 1 / np.where(measured, sigma, np.inf) ** 2


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

    def step(self, spacing: float) -> tuple[float, float]:
        """Correlation phi of cells `spacing` (m) apart, and variance s^2 (1 - phi^2) of the process noise, m^2."""
        return float(self.correlation(spacing)), float(-(self.sigma**2) * np.expm1(-2 * spacing / self.length))


@dataclass(frozen=True, eq=False)
class TrackedRelief:
    """Tracked heights of all cells; arrays of shape (rows, cols).

    Attributes:
        height: posterior mean, m, in the precision of the measured heights.
        sigma: posterior standard deviation, m.
        outlier: True where a measurement was rejected by the gate.
    """

    height: Heights
    sigma: Heights
    outlier: Bool


def filtered(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate each height from the cells up to it, in the order of rows, by the Kalman filter."""
    return _tracked(measured, prior, settings.gate, both_ways=False)


def smoothed(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate each height from all cells of its column, by the filter and the smoother of Rauch, Tung and Striebel.

    The filter decides what is an outlier.
    """
    return _tracked(measured, prior, settings.gate, both_ways=True)


def _tracked(measured: MeasuredHeights, prior: ReliefPrior, gate: float, both_ways: bool) -> TrackedRelief:
    """Filter the columns, a block of them at a time, and smooth them if they are tracked `both_ways`."""
    height, sigma, step = measured.height, measured.sigma, prior.step(measured.spacings[0])
    moments = float(prior.mean), float(prior.sigma**2)
    result = TrackedRelief(np.empty_like(height), np.empty_like(height), np.empty(height.shape, np.bool_))
    columns = blocks(height.shape[1], COLUMNS_AT_ONCE)

    def work(part: slice) -> None:
        scratch = np.empty((2, len(height), COLUMNS_AT_ONCE))
        for block in columns[part]:
            here = np.s_[:, block]
            state, variance = scratch[..., : block.stop - block.start]
            kernels.filter_columns(
                height[here], sigma[here], moments, step, float(gate), state, variance, result.outlier[here]
            )
            if both_ways:
                kernels.smooth_columns(step, state, variance)
            np.add(state, prior.mean, out=result.height[here], casting="same_kind")
            np.sqrt(variance, out=result.sigma[here], casting="same_kind")

    in_parallel(work, len(columns))
    return result


def estimated_prior(measured: MeasuredHeights, settings: TrackingSettings = DEFAULT_TRACKING) -> ReliefPrior:
    """Estimate the prior under which the measured heights are most likely; length and sigma unless they are given.

    The likelihood of a Gauss-Markov process is the product of the likelihoods of the filter's innovations (Schweppe,
    IEEE Trans. Information Theory 11, 1965). Outliers would make the relief look rough. Therefore a measurement is
    taken to be an outlier with the probability `outlier_share`, and then to have any height between the least and the
    greatest; the filter weighs it by the probability that it is none (probabilistic data association, Bar-Shalom and
    Tse, Automatica 11, 1975).

    Up to `prior_columns` columns are used, each as a track of its own. Lengths are searched from a third of the spacing
    of rows to ten swaths, standard deviations from `flattest` on, which is the result for level ground.

    Raises:
        UserError: fewer than LEAST_STEPS pairs of consecutive measured cells of a column.
    """
    deviation, precision = measured.deviations(0.0)
    chosen = evenly(np.flatnonzero(np.any(precision > 0, axis=0)), settings.prior_columns)
    deviation, precision = deviation[:, chosen], precision[:, chosen]
    seen = precision > 0
    steps = int(np.sum(np.maximum(np.count_nonzero(seen, axis=0) - 1, 0)))
    if steps < LEAST_STEPS:
        raise UserError(
            f"The heights have {steps} pairs of consecutive measured cells of a column; a prior of the relief can be "
            f"estimated from {LEAST_STEPS} or more."
        )
    error = float(np.median(1 / np.sqrt(precision[seen])))
    low, middle, high = np.percentile(deviation[seen], [16, 50, 84])
    extent = float(np.ptp(deviation[seen])) + error
    spacing, swath = measured.spacings[0], measured.spacings[0] * len(deviation)

    def misfit(values: F64) -> float:
        """Negative log-likelihood of log(length), log(sigma), and mean less median in units of the median error."""
        prior = ReliefPrior(*np.exp(values[:2]).tolist())
        centred, step = deviation - (middle + values[2] * error), prior.step(spacing)
        return -kernels.log_likelihood(centred, precision, prior.sigma**2, step, settings.outlier_share, 1 / extent)

    length, relief_sigma = settings.correlation_length_m, settings.relief_sigma_m
    lowest = np.array([*np.log([length or spacing / 3, relief_sigma or flattest(precision)]), -np.inf])
    highest = np.array([*np.log([length or 10 * swath, relief_sigma or 10 * extent]), np.inf])
    sigmas = max(float(high - low) / 2, error) * np.array([0.1, 0.4, 1.0])
    starts = [[*np.log(start), 0.0] for start in product(np.geomspace(spacing, swath, 6), sigmas)]
    found = least_misfit(misfit, np.array(starts), lowest, highest)
    length, relief_sigma = np.exp(found[:2]).tolist()
    return ReliefPrior(length, relief_sigma, float(middle + found[2] * error))


def evenly(items: Index, count: int) -> Index:
    """Up to `count` of some items, evenly spaced."""
    return items[np.linspace(0, len(items) - 1, min(len(items), count)).astype(np.intp)]


def flattest(precision: F64) -> float:
    """Least standard deviation (m) of a relief that can be told from level ground: FLATTEST times that of the mean."""
    known = precision[precision > 0]
    return FLATTEST * float(np.median(1 / np.sqrt(known)) / np.sqrt(len(known)))


def least_misfit(misfit: Callable[[F64], float], starts: F64, lowest: F64, highest: F64) -> F64:
    """Values within bounds that minimise a misfit, by the simplex of Nelder and Mead from the best of some starts."""
    values = min(np.clip(starts, lowest, highest), key=misfit)
    free = lowest < highest

    def misfit_of_free(some: F64) -> float:
        values[free] = some
        return misfit(values)

    options = {"xatol": TOLERANCE, "fatol": TOLERANCE}
    bounds = Bounds(lowest[free], highest[free])
    values[free] = minimize(misfit_of_free, values[free], method="Nelder-Mead", bounds=bounds, options=options).x
    return values


def steady_sigmas(prior: ReliefPrior, spacing: float, measured_sigma: float) -> tuple[float, float]:
    """Standard deviations (m) of `filtered` and `smoothed` heights far from the edges of the swath.

    All cells are measured with `measured_sigma` (m) and none is an outlier. The filter's predicted variance is
    the positive root of P^2 + P (R (1 - phi^2) - q) - q R = 0, what follows the measurement P R / (P + R); the
    smoother's is the fixed point of its recursion.
    """
    (phi, q), r = prior.step(spacing), measured_sigma**2
    off = q - r * q / prior.sigma**2
    predicted = (off + np.sqrt(off**2 + 4 * q * r)) / 2
    updated = predicted * r / (predicted + r)
    back = phi * updated / predicted
    return float(np.sqrt(updated)), float(np.sqrt((updated - back**2 * predicted) / (1 - back**2)))
