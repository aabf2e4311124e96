"""Monte Carlo of the array estimator: repeated observations of a target in unit noise (SAL paper, figures 10, 11)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation import Objective, PeakSearches, covariance
from sal_height.numeric import C64, F64, in_threads

SAMPLES_AT_ONCE = 2**16
"""Number of samples that a thread draws at a time; it also decides which random numbers a trial gets."""


def _gaussian(rng: np.random.Generator, shape: tuple[int, int]) -> C64:
    """Circular Gaussian amplitudes: speckle, independent from look to look."""
    parts = rng.standard_normal((shape[0], 2 * shape[1]), dtype=np.float32)
    parts *= np.float32(np.sqrt(0.5))
    return parts.view(np.complex64)


def _steady(rng: np.random.Generator, shape: tuple[int, int]) -> C64:
    """Amplitudes of modulus 1 with a random phase in each look."""
    return np.exp(2j * np.pi * rng.random(shape)).astype(np.complex64)


TARGETS: dict[str, Callable[[np.random.Generator, tuple[int, int]], C64]] = {"gaussian": _gaussian, "steady": _steady}
"""Kinds of targets by name: functions that draw amplitudes of mean power 1 for (pixels, looks)."""


@dataclass(frozen=True, eq=False)
class TargetPixels:
    """Independent pixels with the same target in circular noise of mean power 1.

    Attributes:
        beams: beams of the channels.
        elevation: elevation of the target, rad.
        cnr: mean power of the target in a detector with h = 1 there.
        looks: number of independent samples of a pixel.
        target: kind of target, one of TARGETS.
        squint: squint of the target, rad.
    """

    beams: Beams
    elevation: float
    cnr: float
    looks: int
    target: str = "gaussian"
    squint: float = 0.0

    def draw(self, rng: np.random.Generator, trials: int) -> C64:
        """Samples of pixels, shape (trials, looks, channels), for `looks.covariance`."""
        noise = rng.standard_normal((trials, self.looks, 2 * self.beams.count), dtype=np.float32)
        noise *= np.float32(np.sqrt(0.5))
        response = (np.sqrt(self.cnr) * self.beams.response(self.elevation, self.squint)).astype(np.complex64)
        samples = noise.view(np.complex64)
        samples += TARGETS[self.target](rng, (trials, self.looks))[..., None] * response
        return samples

    def peak_elevations(self, seed: int, trials: int, objective: Objective, guard: float) -> F64:
        """Elevations (rad) at which an objective peaks up to `guard` (rad) beyond the array: shape (trials,).

        Computed on all processors; the seed alone decides the result.
        """
        search = PeakSearches.over(self.beams, objective, guard).at(self.squint)
        estimates = np.empty(trials)

        def work(rng: np.random.Generator, part: slice) -> None:
            samples = self.draw(rng, part.stop - part.start)
            estimates[part] = search.peaks(covariance(samples, self.beams.is_complex)).elevation

        with_streams(work, seed, trials, max(1, SAMPLES_AT_ONCE // (self.looks * self.beams.count)))
        return estimates


def with_streams(work: Callable[[np.random.Generator, slice], None], seed: int, trials: int, at_once: int) -> None:
    """Do `work` on slices of the trials, each with its own random numbers, on all processors."""
    parts = [slice(first, min(first + at_once, trials)) for first in range(0, trials, at_once)]
    streams = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(len(parts)))
    in_threads(work, streams, parts)
