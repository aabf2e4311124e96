"""Which samples along an axis of an image are the looks of a pixel, and what they hold of the samples around them.

All sums over samples separate into one along range and one along azimuth, each with a few weights for every pixel
(`Bands`). They depend on the window, on the number of samples and on the response of the image, and are held for the
dwells to come (`axis_looks`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sal_height.elevation.looks._look_kernels import sum_across, sum_down
from sal_height.elevation.looks.cell_response import REACH, AxisResponse
from sal_height.numeric import F64, Index, in_parallel

LOOK_WINDOWS: dict[str, Callable[[int], F64]] = {
    "boxcar": np.ones,
    "triangular": lambda count: np.bartlett(count + 2)[1:-1],
    "hamming": np.hamming,
}
"""Weights of the looks of a pixel, all greater than 0."""

EVEN_VARIANCE = 1 / 12
"""Variance of a place that is anywhere in its row with the same probability, rows squared."""

LEAST_PRODUCTS = 2**18
"""Products of weights and samples that are worth a thread."""


@dataclass(frozen=True, eq=False)
class Window:
    """Which samples along one axis of an image are the looks of a pixel, and their weights.

    Pixel i has the n samples from i step + (step - n) // 2 on, n the number of weights: consecutive blocks if the step
    is n, a window that slides by one sample if it is 1. Samples beyond the edge of the image are left out.

    Attributes:
        weights: of the looks, greater than 0, shape (n,).
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
        """Number of pixels from one to the next that shares no sample with it."""
        return -(-len(self.weights) // self.step)

    def places(self, samples: int) -> Index:
        """The sample of each look of each pixel, shape (pixels, n), some of them beyond the edge."""
        pixel, look = np.indices((self.pixels(samples), len(self.weights)))
        return np.asarray(self.first + pixel * self.step + look)

    def inside(self, samples: int) -> F64:
        """Weight of each look of each pixel, 0 beyond the edge, shape (pixels, n)."""
        places = self.places(samples)
        return np.where((places >= 0) & (places < samples), self.weights, 0.0)


@lru_cache(maxsize=64)
def _window(name: str, looks: int, step: int) -> Window:
    return Window(LOOK_WINDOWS[name](looks), step)


@dataclass(frozen=True, eq=False)
class Bands:
    """Weighted sums over neighbouring samples along an axis, one for every pixel.

    Attributes:
        first: sample of the first weight of each pixel, shape (pixels,).
        weights: of that sample and those after it, shape (pixels, n).
    """

    first: Index
    weights: F64

    @classmethod
    def of(cls, places: Index, weights: F64, samples: int) -> Bands:
        """Sums of weights at consecutive `places`, shape (pixels, n); what lies beyond an edge counts as the edge."""
        first = np.clip(places[:, 0], 0, max(0, samples - places.shape[1]))
        folded = np.zeros((len(places), min(places.shape[1], samples)))
        np.add.at(folded, (np.arange(len(places))[:, None], np.clip(places, 0, samples - 1) - first[:, None]), weights)
        return cls(first, folded)

    @property
    def sums(self) -> F64:
        """Of the weights of each pixel, shape (pixels,)."""
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
    """What the looks of pixels hold of the samples around them, by the response of the image along an axis.

    Attributes:
        near: by main lobes; beyond an edge the image goes on as bright as the edge.
        whole: by main lobes and sidelobes, likewise.
        own: the part of `near` that comes from the samples of the pixel itself.
    """

    near: Bands
    whole: Bands
    own: Bands


@dataclass(frozen=True, eq=False)
class AxisLooks:
    """The looks of all pixels along one axis of an image.

    Attributes:
        apart: number of pixels from one to the next that shares no sample with it.
        looks: their weights.
        places: their weights times their place in samples.
        middle: of each pixel, in samples, shape (pixels,).
        count: effective number of looks of each pixel along this axis, shape (pixels,).
        displaced: variance of the place of a pixel's speckle about that of its looks, samples squared, if the number of
            looks is great, shape (pixels,).
        between: variance of the places of the looks of a pixel, samples squared.
        within: variance of a scatterer's place about that of its look, samples squared.
        leakage: of other samples into the looks; None: the samples are independent.
    """

    apart: int
    looks: Bands
    places: Bands
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
        samples: along the axis; at least as many as the window has weights.
        response: of the image along the axis; None: samples are independent, and have no sidelobes.
    """
    places, inside, taps = window.places(samples), window.inside(samples), len(window.weights)
    sums = inside.sum(axis=1)
    alike = response.likeness(taps) if response else np.ones(1)
    displaced = response.place_error(taps) if response else np.full(1, EVEN_VARIANCE)
    looks = Bands.of(places, inside, samples)
    moments = Bands(looks.first, looks.weights * (looks.first[:, None] + np.arange(looks.weights.shape[1])))
    return AxisLooks(
        apart=window.apart,
        looks=looks,
        places=moments,
        middle=moments.sums / sums,
        count=sums**2 / _pair_sums(inside, alike),
        displaced=_pair_sums(inside, displaced) / sums**2,
        between=float(np.cov(np.arange(taps), aweights=window.weights, ddof=0)),
        within=2 * float(response.place_error(1)[0]) if response else EVEN_VARIANCE,
        leakage=_leakage(window, samples, response) if response else None,
    )


def _pair_sums(weights: F64, alike: F64) -> F64:
    """Sum of w_i w_j c_ij over the looks i and j of each pixel, shape (pixels,).

    Args:
        weights: of the looks, shape (pixels, looks).
        alike: c of two looks 0, 1, ... samples apart, shape (n,); 0 for those farther apart.
    """
    total = alike[0] * np.sum(weights**2, axis=1)
    for apart in range(1, min(len(alike), weights.shape[1])):
        total += 2 * alike[apart] * np.sum(weights[:, apart:] * weights[:, :-apart], axis=1)
    return np.asarray(total)


def _leakage(window: Window, samples: int, response: AxisResponse) -> Leakage:
    """Convolve the looks of each pixel with the shares of a scatterer's energy in the samples around it."""
    places, inside = window.places(samples), window.inside(samples)
    taps = inside.shape[1]
    around = places[:, :1] + np.arange(-REACH, taps + REACH)
    whole, near = (_spread(inside, shares) for shares in response.shares())
    own = np.where(inside > 0, near[:, REACH : REACH + taps], 0.0)
    reached = np.flatnonzero(near.any(axis=0))
    lobe = slice(reached[0], reached[-1] + 1)
    return Leakage(
        near=Bands.of(around[:, lobe], near[:, lobe], samples),
        whole=Bands.of(around, whole, samples),
        own=Bands.of(places, own, samples),
    )


def _spread(weights: F64, shares: F64) -> F64:
    """Convolve each row of `weights`, shape (pixels, n), with 2 REACH + 1 shares: shape (pixels, n + 2 REACH)."""
    spread = np.zeros((len(weights), weights.shape[1] + len(shares) - 1))
    for look in range(weights.shape[1]):
        spread[:, look : look + len(shares)] += weights[:, look : look + 1] * shares
    return spread
