"""Width and gains of the beams from a scene: how near to the truth, what heights gain by it, and how long it takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.array_estimator import azimuth_looks, beams_of, elevation_at
from benchmarks.row import Row, sized
from sal_height.beams import Beams
from sal_height.calibration import BeamCalibration, calibrate_beams
from sal_height.elevation import OBJECTIVES, Looks, covariance, peak_elevation
from sal_height.numeric import C64, root_mean_square
from sal_height.theory.array_trials import TARGETS, TargetPixels

ROWS, COLS = sized((400, 500), (40, 50))
LOOKS, CNR = 4, 10**1.5
WIDTH, GAIN_DB, PHASE = 1.05, 0.5, np.radians(5)
"""Errors of the description: the width factor, and standard deviations of gains (dB) and phases (rad)."""

TRIALS, OFFSETS = 4000, (-3.4, -1.75, 0.1, 1.75, 3.4)
"""Pixels of each target, and its elevation in beamwidths from the middle of the array, for the bias of elevations."""

DB = np.log(10) / 20


def from_a_scene() -> Iterator[Row]:
    """A description that is wrong in width, gains and phases, and 200 000 pixels of speckle at 15 dB."""
    for name in ("sinc", "jinc"):
        yield from _from_a_scene(name)


def _from_a_scene(name: str) -> Iterator[Row]:
    rng, beams = np.random.default_rng(3), beams_of(name)
    truth = _truth(rng, beams.count)
    looks = azimuth_looks(_slc(rng, _calibrated(beams, truth)), LOOKS, hermitian=True)
    begin = time.perf_counter()
    found = calibrate_beams(looks, beams)
    took = time.perf_counter() - begin
    ratio = np.log(found.gains / truth.gains)
    stated = f"from {found.pixels} pixels of {beams.count} detectors; the stated standard deviation is"
    label = f"beam calibration, {name}"
    yield Row(
        f"{label}, error of the width",
        100 * abs(found.width_factor / truth.width_factor - 1),
        "%",
        "<= 0.5",
        f"5 % wrong before; {stated} {100 * found.width_sigma:.4f} %",
    )
    yield Row(
        f"{label}, rms error of the gains",
        float(root_mean_square(ratio.real)) / DB,
        "dB",
        "<= 0.05",
        f"{root_mean_square(np.log(np.abs(truth.gains))) / DB:.2f} dB wrong before; {stated} "
        f"{root_mean_square(found.gain_sigmas) / DB:.4f} dB",
    )
    yield Row(
        f"{label}, rms error of the phases",
        float(np.degrees(root_mean_square(ratio.imag))),
        "degrees",
        "<= 0.5",
        f"{np.degrees(root_mean_square(np.angle(truth.gains))):.1f} degrees wrong before; {stated} "
        f"{np.degrees(root_mean_square(found.phase_sigmas)):.3f} degrees",
    )
    actual = _calibrated(beams, truth)
    before, after = (_greatest_bias(actual, used) for used in (beams, _calibrated(beams, found)))
    yield Row(
        f"{label}, bias of elevations over that before",
        after / before,
        "1",
        "<= 0.1",
        f"greatest of {len(OFFSETS)} targets at 20 dB: {after:.1e} over {before:.1e} beamwidths",
    )
    yield Row(f"{label}, time", took, "s", "<= 30", f"{found.steps} steps through {ROWS * COLS} pixels")


def _truth(rng: np.random.Generator, channels: int) -> BeamCalibration:
    amplitude, phase = GAIN_DB * DB * rng.standard_normal(channels), PHASE * rng.standard_normal(channels)
    gains = np.exp(amplitude - amplitude.mean() + 1j * (phase - phase.mean()))
    return replace(BeamCalibration.as_described(channels), width_factor=WIDTH, gains=gains)


def _calibrated(beams: Beams, calibration: BeamCalibration) -> Beams:
    return beams.widened(calibration.width_factor).scaled(calibration.gains)


def _slc(rng: np.random.Generator, beams: Beams) -> C64:
    """Images of speckle whose pixels have elevations spread over the array, (detectors, ROWS, COLS * LOOKS)."""
    slc = np.empty((beams.count, ROWS, COLS * LOOKS), np.complex64)
    for row in range(ROWS):
        elevation = np.repeat(rng.uniform(*beams.span, COLS), LOOKS)
        amplitude, noise = _circular(rng, COLS * LOOKS), _circular(rng, beams.count * COLS * LOOKS)
        response = np.sqrt(CNR) * beams.response(elevation, 0.0)
        slc[:, row] = (amplitude[:, None] * response).T + noise.reshape(beams.count, -1)
    return slc


def _circular(rng: np.random.Generator, count: int) -> C64:
    return TARGETS["gaussian"](rng, (1, count)).reshape(-1)


def _greatest_bias(actual: Beams, used: Beams) -> float:
    """Of mean elevations of targets, in beamwidths, estimated with beams that are not the actual ones."""
    rng, biases = np.random.default_rng(4), []
    for elevation in map(elevation_at, OFFSETS):
        samples = TargetPixels(actual, elevation, 100.0, LOOKS).draw(rng, TRIALS)
        seen = Looks.of(covariance(samples, hermitian=True)[:, None], LOOKS)
        found = peak_elevation(seen, used, OBJECTIVES["normalised"], 0.0)
        biases.append(abs(float(np.mean(found)) - elevation) / used.beamwidth)
    return max(biases)
