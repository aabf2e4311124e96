"""The array estimator against theory and against a dense search: `python -m benchmarks accuracy-array`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.array_estimator import BEAMWIDTH, DETECTORS, beams_of, elevation_at
from benchmarks.row import Row, sized
from sal_height.beams import Beams
from sal_height.elevation import OBJECTIVES, Covariance, PeakSearches, covariance, stochastic_crb
from sal_height.numeric import F64, Bool
from sal_height.theory import TargetPixels

PATTERNS = ("sinc", "jinc")
TRIALS = sized(400_000, 2000)
CNR = 100.0
"""Well above the threshold, where one peak in 1000 is still another for four looks."""

PIXELS, PIXELS_AT_ONCE = sized((1_000_000, 12_500), (800, 100))
LEVELS_DB = (0, 5, 10, 20)
SEARCH_LOOKS = 4

STEP = 0.02
"""Of the dense search, beamwidths; a parabola of 1e-3 around its best node makes it exact to 1e-6."""

FINE = 1e-3

CLEAR = 0.999
"""Greatest height of the second peak over the first at which the first is clear."""


def against_theory() -> Iterator[Row]:
    """Efficiency above threshold over (K - 1) / K, and the bias at the array's end."""
    for pattern in PATTERNS:
        beams = beams_of(pattern)
        for looks in (4, 16):
            error = _errors(beams, 1.75, looks)
            inner = error[np.abs(error) < 1.0]
            bound = stochastic_crb(beams, elevation_at(1.75), 0.0, CNR, looks) / BEAMWIDTH
            efficiency = float(bound**2 / np.mean(inner**2))
            standard_error = np.std(inner**2) / np.mean(inner**2) / np.sqrt(len(inner))
            yield Row(
                f"array estimate, {pattern}, {looks} looks: efficiency over (K - 1) / K",
                efficiency / ((looks - 1) / looks),
                "1",
                ">= 0.97",
                f"20 dB, {TRIALS} trials: standard error {standard_error:.4f}; {len(error) - len(inner)} outliers left "
                "out",
            )
        error = _errors(beams, 3.75, 16)
        yield Row(
            f"array estimate, {pattern}: bias at the array's end",
            1e3 * abs(float(np.mean(error))),
            "1e-3 beamwidths",
            "<= 1",
            f"at 3.75, 20 dB, 16 looks: standard error {1e3 * np.std(error) / np.sqrt(len(error)):.3f}e-3",
        )


def against_dense_search() -> Iterator[Row]:
    """Elevations of a million pixels against a dense search in double precision over the beams themselves."""
    for pattern in PATTERNS:
        beams, rng = beams_of(pattern), np.random.default_rng(3)
        search = PeakSearches.over(beams, OBJECTIVES["normalised"], 0.0).at(0.0)
        squares, worst, unclear, count = 0.0, 0.0, 0, 0
        share = PIXELS // len(PATTERNS) // len(LEVELS_DB)
        for level_db in LEVELS_DB:
            for _ in range(share // PIXELS_AT_ONCE):
                offset = rng.uniform(-3.75, 3.75)
                target = TargetPixels(beams, elevation_at(offset), 10 ** (level_db / 10), SEARCH_LOOKS)
                pixels = covariance(target.draw(rng, PIXELS_AT_ONCE), hermitian=False)
                expected, clear = _dense_search(pixels, beams)
                error = (search.peaks(pixels).elevation - expected)[clear] / BEAMWIDTH
                squares += float(np.sum(error**2))
                worst = max(worst, float(np.max(np.abs(error))))
                unclear += int(np.count_nonzero(~clear))
                count += len(error)
        levels = ", ".join(str(level) for level in LEVELS_DB)
        reference = f"{count + unclear} pixels of {SEARCH_LOOKS} looks at {levels} dB"
        yield Row(
            f"array search, {pattern}: rms error",
            1e6 * float(np.sqrt(squares / count)),
            "1e-6 beamwidths",
            "<= 1000",
            reference,
        )
        yield Row(f"array search, {pattern}: worst error", 1e3 * worst, "1e-3 beamwidths", "<= 5", reference)
        yield Row(
            f"array search, {pattern}: left out, two peaks within 0.1 %",
            100 * unclear / (count + unclear),
            "%",
            "<= 0.1",
            reference,
        )


def _errors(beams: Beams, offset: float, looks: int) -> F64:
    """Errors of independent pixels with a fluctuating target, beamwidths, searched to half a pitch beyond the array."""
    pixels = TargetPixels(beams, elevation_at(offset), CNR, looks)
    found = pixels.peak_elevations(1, TRIALS, OBJECTIVES["normalised"], 0.0)
    return (found - elevation_at(offset)) / BEAMWIDTH


def _dense_search(pixels: Covariance, beams: Beams) -> tuple[F64, Bool]:
    """Elevation (rad) of the highest peak of each pixel, and whether the second one is clearly lower."""
    first, last = beams.domain(0.0)
    nodes = np.linspace(first, last, int(np.ceil((last - first) / (STEP * BEAMWIDTH))) + 1)
    m, n = np.triu_indices(DETECTORS)
    units = _units(beams, nodes)
    forms = units[:, m] * units[:, n] * np.where(m == n, 1, 2)
    value = pixels[:, m, n].astype(np.float64) @ forms.T
    padded = np.pad(value, ((0, 0), (1, 1)), constant_values=-1)
    before, after = padded[:, :-2], padded[:, 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = value + (after - before) ** 2 / (8 * (2 * value - before - after))
    heights = np.where((value >= before) & (value > after), np.where(before * after < 0, value, vertex), 0)
    best = np.argmax(heights, axis=1)
    rows = np.arange(len(value))
    highest = heights[rows, best]
    heights[rows, best] = 0
    return _polished(pixels, beams, nodes[best], first, last), heights.max(axis=1) < CLEAR * highest


def _polished(pixels: Covariance, beams: Beams, near: F64, first: float, last: float) -> F64:
    """The vertex of parabolas through three points, first as far apart as the nodes, then as FINE."""
    for step in (STEP * BEAMWIDTH, STEP / 5 * BEAMWIDTH, FINE * BEAMWIDTH):
        low, middle, high = (_objective(pixels, beams, near + shift) for shift in (-step, 0.0, step))
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = step * (low - high) / (2 * (low - 2 * middle + high))
        near = np.clip(near + np.where(np.abs(moved) <= step, moved, step * np.sign(high - low)), first, last)
    return near


def _objective(pixels: Covariance, beams: Beams, elevation: F64) -> F64:
    units = _units(beams, elevation)
    return np.asarray(np.einsum("pm,pmn,pn->p", units, pixels, units, optimize=True))


def _units(beams: Beams, elevation: F64) -> F64:
    response = beams.response(elevation, 0.0)
    return np.asarray(response / np.linalg.norm(response, axis=-1, keepdims=True))
