"""Reliefs that are drawn and measured, and what all their measurements together say, for tests of the tracking."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.relief.smoothing import MeasuredHeights, ReliefPrior, TrackedRelief

Array = npt.NDArray[np.float64]

SPACING = 0.5  # of cells, m


def of(height: Array, sigma: Array, spacings: tuple[float, float] = (SPACING, SPACING)) -> MeasuredHeights:
    return MeasuredHeights(height, sigma, spacings)


def draw(rng: np.random.Generator, prior: ReliefPrior, shape: tuple[int, int], spacings: tuple[float, float]) -> Array:
    """A relief whose covariance is the product of two exponentials."""
    roots = [
        np.linalg.cholesky(prior.correlation(np.subtract.outer(np.arange(n), np.arange(n)) * step))
        for n, step in zip(shape, spacings, strict=True)
    ]
    return prior.mean + prior.sigma * roots[0] @ rng.standard_normal(shape) @ roots[1].T


def tracks(rng: np.random.Generator, prior: ReliefPrior, shape: tuple[int, int]) -> Array:
    """A relief whose columns have nothing to do with each other."""
    steps = np.subtract.outer(np.arange(shape[0]), np.arange(shape[0])) * SPACING
    return prior.mean + prior.sigma * np.linalg.cholesky(prior.correlation(steps)) @ rng.standard_normal(shape)


def measure(rng: np.random.Generator, height: Array, sigma: Array, missing: float = 0.0) -> Array:
    """Heights with noise, NaN in a share of the cells."""
    measured = height + sigma * rng.standard_normal(height.shape)
    return np.where(rng.random(height.shape) < missing, np.nan, measured)


def uneven(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Standard deviations from about 0.3 to 3 m."""
    return np.exp(0.6 * rng.standard_normal(shape))


def conditioned(height: Array, sigma: Array, covariance: Array, mean: float) -> tuple[Array, Array]:
    """Mean and standard deviation of Gaussian heights given measurements (NaN: none), by their whole covariance."""
    seen = np.isfinite(height)
    gain = np.linalg.solve(covariance[np.ix_(seen, seen)] + np.diag(sigma[seen] ** 2), covariance[seen]).T
    return mean + gain @ (height[seen] - mean), np.sqrt(
        np.diag(covariance) - np.sum(gain * covariance[:, seen], axis=1)
    )


def within(result: TrackedRelief, height: Array) -> float:
    """Share of cells whose error is less than their sigma."""
    return float(np.mean(np.abs(result.height - height) < result.sigma))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
