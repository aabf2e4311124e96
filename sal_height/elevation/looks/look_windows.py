"""The looks of a pixel along an axis of an image, and the energy that they receive from the samples around them.

All sums over samples separate into one along range and one along azimuth, each with a few weights for every pixel
(`Bands`). They depend on the window, on the number of samples and on the response of the image, and are cached for the
next dwells (`axis_looks`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sal_height.elevation.looks._look_kernels import sum_across, sum_down
from sal_height.elevation.looks.cell_response import REACH, AxisResponse
from sal_height.numeric import F64, Index, ShortRepr, in_parallel

LOOK_WINDOWS: dict[str, Callable[[int], F64]] = {
    "boxcar": np.ones,
    "triangular": lambda count: np.bartlett(count + 2)[1:-1],
    "hamming": np.hamming,
}
"""Weights of the looks of a pixel, all greater than 0."""

EVEN_VARIANCE = 1 / 12
"""Variance of a position that is uniform over a row, rows squared."""

LEAST_PRODUCTS = 2**18
"""Least number of products of weights and samples for which another thread pays."""


@dataclass(frozen=True, eq=False)
class Window(ShortRepr):
    """The samples along one axis of an image that are the looks of a pixel, and their weights.

    Pixel i has the n samples from i step + (step - n) // 2 on, n the number of weights: consecutive blocks if the step
    is n, a window that slides by one sample if it is 1. Samples beyond the edge of the image are left out.

    Attributes:
        weights: weights of the looks, greater than 0, shape (n,).
        step: number of samples from one pixel to the next.
    """

    weights: F64
    step: int

    @classmethod
    def named(cls, name: str, looks: int, step: int = 0) -> Window:
        """The window of that name in LOOK_WINDOWS over `looks` samples; step 0 makes blocks without overlap."""
        return _window(name, looks, step or looks)

    def pixels(self, samples: int) -> int:
        """Number of pixels along an axis of `samples`: every sample is a look of one of them."""
        return -(-samples // self.step)

    @property
    def first(self) -> int:
        """First sample of pixel 0; negative if it is beyond the edge."""
        return (self.step - len(self.weights)) // 2

    @property
    def middle(self) -> float:
        """Middle of pixel 0 in samples, with a fraction."""
        return self.first + (len(self.weights) - 1) / 2

    @property
    def apart(self) -> int:
        """Distance of two pixels that have no sample in common, pixels."""
        return -(-len(self.weights) // self.step)

    def looks(self, samples: int) -> Index:
        """The sample of each look of each pixel, shape (pixels, n), some of them beyond the edge."""
        pixel, look = np.indices((self.pixels(samples), len(self.weights)))
        return np.asarray(self.first + pixel * self.step + look)

    def inside(self, samples: int) -> F64:
        """Weight of each look of each pixel, 0 beyond the edge, shape (pixels, n)."""
        looks = self.looks(samples)
        return np.where((looks >= 0) & (looks < samples), self.weights, 0.0)


@lru_cache(maxsize=64)
def _window(name: str, looks: int, step: int) -> Window:
    return Window(LOOK_WINDOWS[name](looks), step)


@dataclass(frozen=True, eq=False)
class Bands:
    """Weighted sums over neighbouring samples along an axis, one for every pixel.

    Attributes:
        first: sample of the first weight of each pixel, shape (pixels,).
        weights: weights of that sample and the next ones, shape (pixels, n).
    """

    first: Index
    weights: F64

    @classmethod
    def of(cls, positions: Index, weights: F64, samples: int) -> Bands:
        """Sums with weights at consecutive samples `positions`, (pixels, n); those beyond an edge count as the edge."""
        first = np.clip(positions[:, 0], 0, max(0, samples - positions.shape[1]))
        folded = np.zeros((len(positions), min(positions.shape[1], samples)))
        at = np.arange(len(positions))[:, None], np.clip(positions, 0, samples - 1) - first[:, None]
        np.add.at(folded, at, weights)
        return cls(first, folded)

    @property
    def sums(self) -> F64:
        """Sum of the weights of each pixel, shape (pixels,)."""
        return np.asarray(self.weights.sum(axis=1))

    def down(self, samples: F64) -> F64:
        """Sums along the first axis: from shape (samples, n) to (pixels, n)."""
        sums = np.empty((len(self.first), samples.shape[1]))

        def add(part: slice) -> None:
            sum_down(self.first[part], self.weights[part], samples, sums[part])

        in_parallel(add, len(sums), -(-LEAST_PRODUCTS // (self.weights.shape[1] * samples.shape[1])))
        return sums

    def across(self, samples: F64) -> F64:
        """Sums along the second axis: from shape (n, samples) to (n, pixels)."""
        sums = np.empty((len(samples), len(self.first)))

        def add(part: slice) -> None:
            sum_across(self.first, self.weights, samples[part], sums[part])

        in_parallel(add, len(sums), -(-LEAST_PRODUCTS // self.weights.size))
        return sums


@dataclass(frozen=True, eq=False)
class Leakage:
    """Energy that the looks of pixels receive from the samples around them, by the impulse response along an axis.

    Attributes:
        near: energy through main lobes; beyond an edge the image continues as bright as the edge.
        whole: energy through main lobes and sidelobes, likewise.
        own: part of `near` from the samples of the pixel itself.
    """

    near: Bands
    whole: Bands
    own: Bands


@dataclass(frozen=True, eq=False)
class AxisLooks:
    """The looks of all pixels along one axis of an image.

    Attributes:
        apart: distance of two pixels that have no sample in common, pixels.
        looks: weights of the looks.
        moments: weights of the looks times their positions in samples.
        middle: middle of each pixel, shape (pixels,), samples.
        count: effective number of looks of each pixel along this axis, shape (pixels,).
        displaced: variance of the position of a pixel's speckle about that of its looks, for a great number of looks,
            shape (pixels,), samples squared.
        between: variance of the positions of the looks of a pixel, samples squared.
        within: variance of a scatterer's position about that of its look, samples squared.
        leakage: energy from other samples in the looks; None: the samples are independent.
    """

    apart: int
    looks: Bands
    moments: Bands
    middle: F64
    count: F64
    displaced: F64
    between: float
    within: float
    leakage: Leakage | None


@lru_cache(maxsize=16)
def axis_looks(window: Window, samples: int, response: AxisResponse | None) -> AxisLooks:
    """The looks of a window along an axis of `samples`.

    Args:
        window: looks of a pixel.
        samples: number of samples along the axis, not less than the window has weights.
        response: impulse response along the axis; None: samples are independent, without sidelobes.
    """
    positions, inside, taps = window.looks(samples), window.inside(samples), len(window.weights)
    sums = inside.sum(axis=1)
    alike = response.likeness(taps) if response else np.ones(1)
    displaced = response.position_error(taps) if response else np.full(1, EVEN_VARIANCE)
    looks = Bands.of(positions, inside, samples)
    moments = Bands(looks.first, looks.weights * (looks.first[:, None] + np.arange(looks.weights.shape[1])))
    return AxisLooks(
        apart=window.apart,
        looks=looks,
        moments=moments,
        middle=moments.sums / sums,
        count=sums**2 / _pair_sums(inside, alike),
        displaced=_pair_sums(inside, displaced) / sums**2,
        between=float(np.cov(np.arange(taps), aweights=window.weights, ddof=0)),
        within=2 * float(response.position_error(1)[0]) if response else EVEN_VARIANCE,
        leakage=_leakage(window, samples, response) if response else None,
    )


def _pair_sums(weights: F64, alike: F64) -> F64:
    """Sum of w_i w_j c_ij over the looks i and j of each pixel, shape (pixels,).

    Args:
        weights: weights of the looks, shape (pixels, looks).
        alike: c of two looks at distances of 0, 1, ... samples, shape (n,); 0 at greater distances.
    """
    total = alike[0] * np.sum(weights**2, axis=1)
    for apart in range(1, min(len(alike), weights.shape[1])):
        total += 2 * alike[apart] * np.sum(weights[:, apart:] * weights[:, :-apart], axis=1)
    return np.asarray(total)


def _leakage(window: Window, samples: int, response: AxisResponse) -> Leakage:
    """Convolve the looks of each pixel with the fractions of a scatterer's energy in the samples around it."""
    positions, inside = window.looks(samples), window.inside(samples)
    taps = inside.shape[1]
    around = positions[:, :1] + np.arange(-REACH, taps + REACH)
    whole, near = (_spread(inside, fractions) for fractions in response.fractions())
    own = np.where(inside > 0, near[:, REACH : REACH + taps], 0.0)
    reached = np.flatnonzero(near.any(axis=0))
    lobe = slice(reached[0], reached[-1] + 1)
    return Leakage(
        near=Bands.of(around[:, lobe], near[:, lobe], samples),
        whole=Bands.of(around, whole, samples),
        own=Bands.of(positions, own, samples),
    )


def _spread(weights: F64, fractions: F64) -> F64:
    """Convolve each row of `weights`, shape (pixels, n), with 2 REACH + 1 fractions: shape (pixels, n + 2 REACH)."""
    spread = np.zeros((len(weights), weights.shape[1] + len(fractions) - 1))
    for look in range(weights.shape[1]):
        spread[:, look : look + len(fractions)] += weights[:, look : look + 1] * fractions
    return spread
