"""Monte Carlo of the array estimator: a target in unit noise, seen again and again (SAL paper, figures 10 and 11)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation import Objective, PeakSearches, covariance
from sal_height.numeric import C64, F64, WORKERS, compiled

Target = Callable[[np.random.Generator, tuple[int, int]], C64]

SAMPLES_AT_ONCE = 2**16
"""Samples that a thread draws at a time; it also decides which random numbers a trial gets."""


def _gaussian(rng: np.random.Generator, shape: tuple[int, int]) -> C64:
    """Circular Gaussian: speckle, independent from look to look."""
    parts = rng.standard_normal((shape[0], 2 * shape[1]), dtype=np.float32)
    parts *= np.float32(np.sqrt(0.5))
    return parts.view(np.complex64)


def _steady(rng: np.random.Generator, shape: tuple[int, int]) -> C64:
    """Modulus 1 and a random phase in each look."""
    return np.asarray(np.exp(2j * np.pi * rng.random(shape)), dtype=np.complex64)


TARGETS: dict[str, Target] = {"gaussian": _gaussian, "steady": _steady}
"""Amplitudes of mean power 1, by name."""


def draw_pixels(
    rng: np.random.Generator,
    beams: Beams,
    elevation: float,
    squint: float,
    cnr: float,
    looks: int,
    trials: int,
    target: Target,
) -> C64:
    """Samples of some pixels that hold the same target in circular noise of mean power 1.

    Args:
        rng: of noise and amplitudes.
        beams: of the channels.
        elevation: of the target, rad.
        squint: of the target, rad.
        cnr: mean power of the target in a detector with h = 1 there.
        looks: independent samples of a pixel.
        trials: number of pixels.
        target: one of TARGETS.

    Returns:
        Shape (trials, looks, channels), as `looks.covariance` takes them.
    """
    noise = rng.standard_normal((trials, looks, 2 * beams.count), dtype=np.float32)
    response = (np.sqrt(cnr) * beams.response(elevation, squint)).astype(np.complex64)
    samples = noise.view(np.complex64)
    _add_target(samples, target(rng, (trials, looks)), response)
    return samples


def run_array_trials(
    seed: int,
    beams: Beams,
    elevation: float,
    cnr: float,
    looks: int,
    trials: int,
    objective: Objective,
    guard: float,
    target: Target,
) -> F64:
    """Elevations (rad) that `peak_elevation` finds in independent pixels with the same target at squint 0: (trials,).

    On all processors; the seed alone decides the result, and the memory does not grow with the number of trials but
    for the result.

    Args:
        seed: of the random numbers.
        beams: of the channels.
        elevation: of the target, rad.
        cnr: mean power ratio in a detector with h = 1 at the target.
        looks: independent samples of a pixel.
        trials: number of pixels.
        objective: one of `elevation.OBJECTIVES`.
        guard: how far beyond the array is searched, rad.
        target: one of TARGETS.
    """
    search = PeakSearches.over(beams, np.zeros(1), objective, guard).at(0.0)
    estimates = np.empty(trials)

    def work(rng: np.random.Generator, part: slice) -> None:
        samples = draw_pixels(rng, beams, elevation, 0.0, cnr, looks, part.stop - part.start, target)
        estimates[part] = search.peaks(covariance(samples, beams.is_complex)).elevation

    with_streams(work, seed, trials, max(1, SAMPLES_AT_ONCE // (looks * beams.count)))
    return estimates


def with_streams(work: Callable[[np.random.Generator, slice], None], seed: int, trials: int, at_once: int) -> None:
    """Do `work` on slices of the trials, each with its own random numbers, on all processors."""
    parts = [slice(first, min(first + at_once, trials)) for first in range(0, trials, at_once)]
    streams = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(len(parts)))
    with ThreadPoolExecutor(WORKERS) as pool:
        list(pool.map(work, streams, parts))


@compiled
def _add_target(samples: C64, amplitude: C64, response: C64) -> None:
    """Scale noise of power 2 to 1 and add the amplitude of each pixel and look times the response."""
    half = np.float32(np.sqrt(0.5))
    for i in range(samples.shape[0]):
        for k in range(samples.shape[1]):
            line, scale = samples[i, k], amplitude[i, k]
            for m in range(response.size):
                line[m] = half * line[m] + scale * response[m]
