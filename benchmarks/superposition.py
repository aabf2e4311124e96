"""False alarms of the test of superposition on linear systems, by what their noise has passed, and what it finds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from benchmarks.row import Row, sized
from benchmarks.spread import in_processes
from sal_height.figures.psf_speckle import noise_weights
from sal_height.figures.psf_theory import chip_transform
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, Saturation, TapeTarget, make_tape
from sal_height.numeric import F64, frequencies
from sal_height.response import estimate_speckle_spectra, find_pure_speckle, superposition
from sal_height.simulation import RangeSawtooth

TAPES = sized(240, 2)
ROWS, SPECKLE_COLS = 256, 960
CHIPS = (64, 128, 256)
LEVELS = np.array([0.01, 0.05, 0.25, 0.5])
NOISES = {
    "white noise of 0.6": (0.6, None, 0.1),
    "Taylor-weighted noise of 0.6": (0.6, "taylor", 0.1),
    "Taylor-weighted noise of 0.3": (0.3, "taylor", 0.1),
    "Hamming-weighted noise of 0.6": (0.6, "hamming", 0.1),
    "Hamming-weighted noise of 0.1": (0.1, "hamming", 0.1),
    "receivers calibrated, noise of 0.6": (0.6, "taylor", 0.0),
}
"""Rms over that of speckle, window over the band, and sawtooth of the response; without one it was divided out."""


def false_alarms() -> Iterator[Row]:
    """Shares of p-values below nominal levels; the target of one kind of noise allows for 1.5 standard errors."""
    cases = dict(list(NOISES.items())[: sized(len(NOISES), 1)])
    values = np.array(list(in_processes(partial(_p_values_by_noise, cases=list(cases.values())), range(TAPES))))
    shares = dict(zip(cases, np.mean(values[..., None] < LEVELS, axis=0), strict=True))
    for name, below in shares.items():
        for chip, share in zip(CHIPS, below, strict=True):
            listed = ", ".join(f"{value:.3f}" for value in share)
            yield Row(
                f"superposition, {name}, chips of {chip}: distance from 0.05",
                abs(share[1] - LEVELS[1]),
                "1",
                "<= 0.041",
                f"shares below {', '.join(map(str, LEVELS))}: {listed} of {TAPES} tapes",
            )
    mean = np.mean(list(shares.values()), axis=(0, 1))
    for level, share in zip(LEVELS, mean, strict=True):
        name = f"superposition, all noises and chips: distance from {level}"
        yield Row(name, abs(share - level), "1", "<= 0.02", f"{share:.3f} of {TAPES * len(cases)} tapes")


def power() -> Iterator[Row]:
    """Limited systems that are found."""
    for name, window in (("white", None), ("Taylor-weighted", "taylor")):
        for level, target in ((12.0, ">= 1"), (16.0, ">= 0")):
            tape = partial(_p_values, noise=0.6, fault=RangeFault(), weights=noise_weights(window), level=level)
            values = in_processes(tape, [(13, number) for number in range(max(TAPES // 6, 2))])
            found = [value[1] < 0.05 for value in values]
            yield Row(
                f"superposition, {name} noise, limiter at {level:g} times the rms: found",
                float(np.mean(found)),
                "1",
                target,
                f"p < 0.05 in chips of 128, {len(found)} tapes",
            )


def _p_values_by_noise(tape: int, cases: Sequence[tuple[float, str | None, float]]) -> list[list[float]]:
    """P-values of one scene in some kinds of noise, by the length of chips; cases are the values of NOISES."""
    values = []
    for noise, window, sawtooth in cases:
        fault, weights = RangeFault(sawtooth=sawtooth), noise_weights(window)
        if weights is not None and not sawtooth:  # divided by the response that receivers had before calibration
            weights = np.abs(RangeSawtooth(0.1, 16.0).response(frequencies(ROWS)))
        values.append(_p_values((12, tape), noise, fault, weights))
    return values


def _p_values(
    seed: tuple[int, int], noise: float, fault: RangeFault, weights: F64 | None, level: float | None = None
) -> list[float]:
    """P-values of a new tape with 8 targets of 40 dB beside 960 columns of speckle, by the length of chips."""
    rng = np.random.default_rng(seed)
    cols = [SPECKLE_COLS + 96 + 64 * number for number in range(8)]
    targets = tuple(TapeTarget(ROWS // 2, col, 40.0) for col in cols)
    limiter = Saturation(level) if level else None
    shape = ROWS, SPECKLE_COLS + 576
    tape = make_tape(shape, rng, targets, fault, AzimuthFault(), noise, 0.0, limiter, weights)
    clutter = tape[:, :SPECKLE_COLS]
    speckle = estimate_speckle_spectra(clutter, find_pure_speckle(clutter))
    values = []
    for rows in CHIPS:
        chips = tape[(ROWS - rows) // 2 :][:rows, cols]
        peaks = chips[rows // 2]
        response = chip_transform(np.mean(chips / peaks, axis=1))
        over_clutter = len(cols) * np.mean(np.abs(peaks) ** 2) / np.mean(np.abs(clutter) ** 2)
        power = np.interp(frequencies(rows), frequencies(64), speckle.range.power, period=1)
        values.append(superposition(response, np.sqrt(rows * power / over_clutter), speckle).p_value)
    return values
