"""The array estimator: its Monte Carlo against the random numbers that it takes, and images against the paper's way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import scipy.fft

from benchmarks.row import Row, medians
from sal_height import array_trials
from sal_height.array_ml import OBJECTIVES, ml_elevation
from sal_height.beams import Beams
from sal_height.compiled import in_parallel
from sal_height.estimate import ElevationEstimate
from sal_height.looks import multilook
from sal_height.optics import pattern_named

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

DETECTORS, PITCH, BEAMWIDTH, LOOKS = 16, 0.5, 1.55e-4, 4
TRIALS = 100_000
ROWS, COLS = 400, 250
CNR = 10.0

UPSAMPLING = 16
"""Of the paper's way: steps of 1/32 beamwidth."""

MIN_CNR = 3.0

PIXELS_AT_ONCE = 256
"""Whose convolutions NumPy holds at a time."""


def against_random_numbers() -> Iterator[Row]:
    """Draw targets and noise, sum up covariances, find the peaks; over drawing the same numbers on as many threads."""
    beams, target = _beams("sinc"), array_trials.TARGETS["gaussian"]
    elevation, normalised = _elevation(1.75), OBJECTIVES["normalised"]

    def draw(rng: np.random.Generator, part: slice) -> None:
        count = part.stop - part.start
        rng.standard_normal((count, LOOKS, 2 * DETECTORS), dtype=np.float32)
        rng.standard_normal((count, 2 * LOOKS), dtype=np.float32)

    at_once = array_trials.SAMPLES_AT_ONCE // (LOOKS * DETECTORS)
    whole, bare = medians(
        lambda: array_trials.array_trials(1, beams, elevation, CNR, LOOKS, TRIALS, normalised, 0.0, target),
        lambda: array_trials.with_streams(draw, 1, TRIALS, at_once),
    )
    yield Row(
        f"array Monte Carlo, {DETECTORS} detectors, {LOOKS} looks, over its random numbers",
        whole / bare,
        "1",
        "<= 2.5",
        f"{1e6 * whole / TRIALS:.2f} µs a trial over {1e6 * bare / TRIALS:.2f} µs for its normal float32 numbers",
    )


def throughput() -> Iterator[Row]:
    """Images of single looks to elevations, against the paper's way in NumPy on as many threads."""
    for name in ("sinc", "jinc"):
        yield from _throughput(name)


def _throughput(name: str) -> Iterator[Row]:
    beams, normalised, target = _beams(name), OBJECTIVES["normalised"], array_trials.TARGETS["gaussian"]
    rng = np.random.default_rng(2)
    samples = array_trials.draw_pixels(rng, beams, _elevation(1.75), 0.0, CNR, LOOKS, ROWS * COLS, target)
    slc = np.ascontiguousarray(samples.reshape(ROWS, COLS * LOOKS, DETECTORS).transpose(2, 0, 1))
    one, many = np.zeros(COLS), np.linspace(-0.5, 0.5, COLS) * BEAMWIDTH

    def estimate(squint: Array) -> ElevationEstimate:
        return ml_elevation(multilook(slc, 1, LOOKS), beams, squint, 1.0, normalised, MIN_CNR)

    there = np.zeros_like(slc)
    single, several, paper, copy = medians(
        lambda: estimate(one),
        lambda: estimate(many),
        lambda: by_convolution(slc, LOOKS, beams),
        lambda: np.copyto(there, slc),
    )
    mega = ROWS * COLS / 1e6
    size = f"{ROWS} × {COLS} pixels of {LOOKS} looks, {DETECTORS} detectors"
    yield Row(
        f"array estimate with sigma and validity, {name}, times the paper's",
        paper / single,
        "1",
        ">= 6",
        f"{size}: {1e3 * single:.0f} ms, {mega / single:.2f} Mpixel/s; the convolution upsampled to steps of "
        f"1/{UPSAMPLING} pitch, and nothing else, {1e3 * paper:.0f} ms",
    )
    yield Row(
        f"array estimate with sigma and validity, {name}, over a copy",
        single / copy,
        "1",
        "<= 10",
        f"one plain copy of the images to memory at hand: {1e3 * copy:.0f} ms",
    )
    yield Row(
        f"array estimate, {name}, every column its squint",
        mega / several,
        "Mpixel/s",
        ">= 0.1",
        f"{1e3 * several:.0f} ms",
    )


def by_convolution(slc: ComplexArray, looks: int, beams: Beams) -> Array:
    """Elevation (rad) as the paper has it: profiles convolved with the beam, upsampled, powers averaged, the highest.

    By FFT over detectors, zero-padded against wrapping, and zero-padded again in frequency.

    Args:
        slc: shape (detectors, rows, cols).
        looks: columns to average.
        beams: of equally spaced detectors.
    """
    count, rows, cols = slc.shape
    length = scipy.fft.next_fast_len(2 * count, real=False)
    pitch = (beams.boresights[-1] - beams.boresights[0]) / (count - 1)
    steps = (np.arange(length) + length // 2) % length - length // 2
    kernel = scipy.fft.fft(beams.response(beams.boresights[0] - steps * pitch, 0.0)[:, 0]).real.astype(np.float32)
    profiles = slc.reshape(count, rows, cols // looks, looks).transpose(1, 2, 3, 0).reshape(-1, looks, count)
    place = np.arange(-UPSAMPLING // 2, (count - 1) * UPSAMPLING + UPSAMPLING // 2 + 1)
    best = np.empty(len(profiles), dtype=np.intp)

    def work(part: slice) -> None:
        for first in range(part.start, part.stop, PIXELS_AT_ONCE):
            block = slice(first, min(first + PIXELS_AT_ONCE, part.stop))
            spectrum = scipy.fft.fft(profiles[block], n=length, axis=-1) * kernel
            padded = np.zeros((*spectrum.shape[:2], UPSAMPLING * length), dtype=np.complex64)
            padded[..., : length // 2], padded[..., -length // 2 :] = (
                spectrum[..., : length // 2],
                spectrum[..., length // 2 :],
            )
            fine = scipy.fft.ifft(padded, axis=-1, overwrite_x=True)[..., place]
            best[block] = np.argmax(np.sum(fine.real**2 + fine.imag**2, axis=1), axis=-1)

    in_parallel(work, len(profiles))
    elevation: Array = beams.boresights[0] + place[best] * (pitch / UPSAMPLING)
    return elevation.reshape(rows, -1)


def _beams(name: str) -> Beams:
    steps = np.arange(DETECTORS, dtype=np.float64) - (DETECTORS - 1) / 2
    boresights = _elevation(0) + PITCH * BEAMWIDTH * steps
    return Beams((pattern_named(name),), boresights, BEAMWIDTH)


def _elevation(offset: float) -> float:
    """Elevation (rad) that many beamwidths above the middle of the array."""
    return float(np.pi / 4 + offset * BEAMWIDTH)
