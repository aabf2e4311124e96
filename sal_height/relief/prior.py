"""The prior of tracked heights, estimated from many dwells: each brings the estimate up to date.

The likelihood of the correlation length l and standard deviation s of the relief, given a dwell, is that of its
heights: the product of those of the filter's innovations (Schweppe, IEEE Trans. Information Theory 11, 1965). Outliers
would make the relief look rough. Therefore a measurement is assumed to be an outlier with the probability
`outlier_fraction`, and then to have any height between the least and the greatest; the filter weighs it by the
probability that it is not one (probabilistic data association, Bar-Shalom and Tse, Automatica 11, 1975).

The estimate of x = (log l, log s) from earlier dwells is a Gaussian, kept as its information I and moment I x. With
each dwell both lose 1 / `prior_dwells` of their weight (exponential forgetting) and gain those of the dwell: the most
likely x, given it and those before, and the information of its likelihood there. Until there is enough data, a Gaussian
so wide that it hardly matters (`_Heights.vague`) replaces it. Ground very different from that before makes the estimate
start again.

The mean of the relief is that of each dwell alone: Gaussian, with the standard deviation of the heights about their
median.

Tracked heights are stated with the sigma that they have under the most likely prior. The effect of its uncertainty was
measured on drawn reliefs, by the mean over priors as uncertain as stated: where the relief is smoother than its
measurements it is up to four points of coverage within one sigma in the first dwell, elsewhere half a point, and from
the tenth dwell on less than half a point everywhere. It is therefore left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sal_height.numeric import F64, Bool, ShortRepr
from sal_height.relief import _tracking_kernels as kernels
from sal_height.relief.settings import DEFAULT_TRACKING, TrackingSettings
from sal_height.relief.slope import median
from sal_height.relief.smoothing import MeasuredHeights, ReliefPrior

LEAST_STEPS = 20
"""Least number of pairs of consecutive measured cells of a column from which a prior can be estimated, to a third."""


DIFFERENCE = 0.05
"""Difference of logarithms from which slopes of the likelihood are computed, to a part in a thousand."""

AROUND = DIFFERENCE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Offsets in the logarithms at which the likelihood is evaluated for its slopes."""


@dataclass(frozen=True, eq=False)
class PriorEstimate(ShortRepr):
    """Estimate from the dwells so far of the prior of their relief; empty at the start.

    Attributes:
        information: information on log(length / m) and log(sigma / m), the inverse of their covariance, shape (2, 2).
        moment: the information times the most likely values, shape (2,).
    """

    information: F64 = field(default_factory=lambda: np.zeros((2, 2)))
    moment: F64 = field(default_factory=lambda: np.zeros(2))

    def after(
        self, measured: MeasuredHeights, settings: TrackingSettings = DEFAULT_TRACKING
    ) -> tuple[ReliefPrior, PriorEstimate] | None:
        """The most likely prior of one more dwell, and the estimate of it after that dwell.

        Length and sigma are those that `settings` give, unless they are 0. Up to `prior_columns` columns are used, in
        windows of `window_columns`, or each as a track of its own if heights are not smoothed along track; the mean is
        then taken as known. It is None for a first dwell with fewer than LEAST_STEPS pairs of consecutive measured
        cells of a column, and for a later one without any: nothing is known of its relief.
        """
        heights = _Heights.of(measured, settings, 1 if self.information.any() else LEAST_STEPS)
        if not heights:
            return None
        kept, vague = 1 - 1 / settings.prior_dwells, heights.vague()
        known = kept * self.information + vague.information
        expected = _solved(known, kept * self.moment + vague.moment)
        logs, gained, surprise = _most_likely(heights, expected, known, settings)
        if surprise > 10.0 and self.information.any():  # log-likelihood: the ground is another
            return PriorEstimate().after(measured, settings)
        length, sigma = np.exp(logs).tolist()
        prior = ReliefPrior(length, sigma, heights.mean, heights.mean_sigma)
        return prior, PriorEstimate(kept * self.information + gained, (known + gained) @ logs - vague.moment)


@dataclass(frozen=True, eq=False)
class _Heights:
    """The heights of a dwell from which a prior is estimated.

    Attributes:
        deviation: deviation of windows of the image from the mean, m, shape (windows, rows, size).
        precision: precision of each measurement, 1/m^2, same shape; 0: not measured.
        spacings: ground spacing between rows and between columns, m.
        swath: length of a column of the image, m.
        mean: median of all heights, m.
        mean_sigma: standard deviation of the mean of the relief about it, m.
        spread: half the distance between 16th and 84th percentile of the heights, m, at least the error.
        error: median standard deviation of a measurement, m.
        outliers: expected fraction of outliers, and the density of their heights, 1/m.
        flattest: least standard deviation of a relief that can be distinguished from level ground, m.
    """

    deviation: F64
    precision: F64
    spacings: tuple[float, float]
    swath: float
    mean: float
    mean_sigma: float
    spread: float
    error: float
    outliers: tuple[float, float]
    flattest: float

    @classmethod
    def of(cls, measured: MeasuredHeights, settings: TrackingSettings, least_steps: int) -> _Heights | None:
        """Heights of a dwell; None: it has fewer than `least_steps` pairs of consecutive measured cells of a column."""
        deviation, precision = measured.deviations(0.0)
        seen = precision > 0
        steps = int(np.count_nonzero(seen) - np.count_nonzero(seen.any(axis=0)))
        if steps < least_steps:
            return None
        error = median(precision[seen]) ** -0.5
        least, low, middle, high, greatest = _quantiles(deviation[seen], (0.0, 0.16, 0.5, 0.84, 1.0))
        spread = max((high - low) / 2, error)
        windows, centred = _windows(seen, settings), np.where(seen, deviation - middle, 0.0)
        # Least standard deviation of an estimated relief over that of the mean of all measurements. A smaller
        # one cannot be distinguished from level ground.
        flattest = 2.0
        return cls(
            deviation=np.array([centred[window] for window in windows]),
            precision=np.array([precision[window] for window in windows]),
            spacings=measured.spacings,
            swath=measured.spacings[0] * len(seen),
            mean=middle,
            mean_sigma=spread if settings.along_track else 0.0,
            spread=spread,
            error=error,
            outliers=(settings.outlier_fraction, 1 / (greatest - least + error)),
            flattest=flattest * error / math.sqrt(np.count_nonzero(seen)),
        )

    def vague(self) -> PriorEstimate:
        """Estimate before any dwell: lengths from the spacing to the swath, sigma a 30th to 30 times the error."""
        spacing = self.spacings[0]
        middle = np.array([math.log(spacing * self.swath) / 2, math.log(self.error)])
        deviation = np.array([max(math.log(self.swath / spacing) / 2, 1.0), math.log(30.0)])
        return PriorEstimate(np.diag(deviation**-2), middle * deviation**-2)

    def starts(self) -> list[F64]:
        """Starts of the search for the most likely logarithms, independent of earlier dwells."""
        length = math.sqrt(self.spacings[0] * self.swath)
        return [np.log([length, share * self.spread]) for share in (0.1, 0.4, 1.0)]

    def bounds(self, settings: TrackingSettings) -> F64:
        """Least and greatest logarithms, shape (2, 2); equal if they are given."""
        length, sigma = settings.correlation_length_m, settings.relief_sigma_m
        lowest = length or self.spacings[0] / 3, sigma or self.flattest
        return np.log([lowest, (length or math.inf, sigma or math.inf)])

    def likelihoods(self, logs: F64) -> F64:
        """Likelihood of each measurement given those before it, under priors of these logarithms.

        Args:
            logs: logarithms of length and sigma of each prior, shape (priors, 2).

        Returns:
            1/m, shape (priors, measurements), with 1 where nothing was measured.
        """
        length, sigma = np.exp(logs).T
        steps = np.exp(-np.array(self.spacings) / length[:, None])
        variances, found = np.empty((len(logs), 2)), np.empty((len(logs), *self.deviation.shape))
        variances[:, 0], variances[:, 1] = sigma**2, self.mean_sigma**2
        kernels.likelihoods(self.deviation, self.precision, variances, steps, self.outliers, found)
        return found.reshape(len(logs), -1)

    def log_likelihood(self, logs: F64) -> float:
        """Log-likelihood of all measurements under the prior of these logarithms."""
        return float(np.log(self.likelihoods(logs[None])).sum())

    def slopes(self, logs: F64) -> tuple[F64, F64]:
        """Derivatives of the log-likelihood by both logarithms, shape (2,), and their information, shape (2, 2).

        The information is the sum of the squares and products of the slopes of each measurement.
        """
        rise, information = np.zeros(2), np.zeros((2, 2))
        kernels.add_slopes(self.likelihoods(logs + AROUND), DIFFERENCE, rise, information)
        return rise, information


def _quantiles(values: F64, shares: tuple[float, ...]) -> list[float]:
    """Quantiles of some numbers, one at least and none NaN, as `np.quantile` finds them; of few at less cost."""
    last = len(values) - 1
    places = [share * last for share in shares]
    neighbours = [(int(place), min(int(place) + 1, last)) for place in places]
    ordered = np.partition(values, sorted({number for pair in neighbours for number in pair}))
    found = []
    for place, (below, above) in zip(places, neighbours, strict=True):
        least, greatest, part = float(ordered[below]), float(ordered[above]), place - below
        step = greatest - least
        found.append(least + step * part if part < 0.5 else greatest - step * (1 - part))
    return found


def _windows(seen: Bool, settings: TrackingSettings) -> list[tuple[slice, slice]]:
    """Windows of the part of an image that was seen, in its middle rows and evenly spaced along track."""
    rows, cols = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    first, height = int(rows[0]), int(rows[-1] - rows[0]) + 1
    rows_of_prior = 256  # number of rows in the middle of the image from which a prior is estimated
    top = first + max(0, (height - rows_of_prior) // 2)
    left, width = int(cols[0]), int(cols[-1] - cols[0]) + 1
    size = min(width, settings.window_columns if settings.along_track else 1)
    count = max(1, min(width, settings.prior_columns) // size)
    starts = left + ((np.arange(count) + 0.5) * width / count - size / 2).astype(np.intp)
    return [np.s_[top : top + min(height, rows_of_prior), start : start + size] for start in starts.tolist()]


def _most_likely(heights: _Heights, expected: F64, known: F64, settings: TrackingSettings) -> tuple[F64, F64, float]:
    """The most likely logarithms if heights are seen and `expected` is known with the information `known`.

    From the best of some starts, steps of Newton with the information of Berndt, Hall, Hall and Hausman (Annals of
    Economic and Social Measurement 3, 1974): the sum of the squared slopes of the log-likelihood of each measurement
    given those before it.

    Returns:
        The logarithms; the information of the heights there, shape (2, 2); and the log-likelihood that the best start
        has more than they.
    """
    lowest, highest = heights.bounds(settings)

    def doubt(logs: F64) -> float:
        """Negative log-density of these logarithms in the estimate before the dwell, but for a constant."""
        away = logs - expected
        return float(away @ known @ away) / 2

    starts = _within(np.array([expected, *heights.starts()]), lowest, highest)
    likelihoods = np.log(heights.likelihoods(starts)).sum(axis=1).tolist()
    merits = [likelihood - doubt(start) for likelihood, start in zip(likelihoods, starts, strict=True)]
    logs, merit = starts[int(np.argmax(merits))], max(merits)
    steps = 20  # most steps of a search, which takes two in most dwells and six in the first
    longest_step = 1.5  # longest step of the search in either logarithm; farther away the likelihood is another
    # Length of the last step of the search, in standard deviations of the estimate; its square is the error left.
    tolerance = 0.2
    for _ in range(steps):
        rise, gained = heights.slopes(logs)
        rise -= known @ (logs - expected)
        free, total = np.where(rise > 0, logs < highest, logs > lowest), known + gained
        if not free.all():
            total = np.where(np.outer(free, free), total, np.eye(2))
        step = _solved(total, rise * free)
        step *= longest_step / max(longest_step, float(np.abs(step).max()))
        while (length := math.sqrt(step @ total @ step)) > tolerance:
            there = _within(logs + step, lowest, highest)
            found = heights.log_likelihood(there) - doubt(there)
            if found > merit:
                break
            step /= 2
        logs = _within(logs + step, lowest, highest)
        if length <= tolerance:
            break
        merit = found
    return logs, gained, max(likelihoods) - heights.log_likelihood(logs)


def _within(logs: F64, lowest: F64, highest: F64) -> F64:
    """Logarithms no less and no greater than these."""
    return np.minimum(np.maximum(logs, lowest), highest)


def _solved(matrix: F64, vector: F64) -> F64:
    """The solution of two linear equations, by Cramer's rule."""
    (a, b), (c, d) = matrix.tolist()
    x, y = vector.tolist()
    determinant = a * d - b * c
    return np.array([d * x - b * y, a * y - c * x]) / determinant
