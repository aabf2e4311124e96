"""Real data, Gotcha, with errors of phase and of the antenna positions put in, with autofocus and without."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from helpers import few
from phase_errors import residual_phase
from scipy.io import loadmat, savemat

from sal_height.bag.reader import BagReader
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.imports import read_gotcha
from sal_height.imports.gotcha import FIELDS, import_gotcha
from sal_height.pipeline import Compressor
from sal_height.response import measure_brightest
from sal_height.runs.replay.bag_replay import replay

CYCLES = 3.0
"""Quadratic phase error at both ends of the aperture, in cycles."""


def quadratic(pulses: int) -> np.ndarray:
    """The phase error of every pulse, rad."""
    return 2 * np.pi * CYCLES * np.linspace(-1, 1, pulses) ** 2


def blurred_bag(shared_data: Callable[[str], Path], folder: Path) -> Path:
    """The three files as a bag, with the phase error."""
    files = sorted(shared_data("afrl_gotcha").glob("*.mat"))
    parts = [{name: loadmat(path)["data"][0][0][name] for name in FIELDS} for path in files]
    error = quadratic(sum(part["fp"].shape[1] for part in parts))
    begin = 0
    blurred = []
    for path, part in zip(files, parts, strict=True):
        pulses = part["fp"].shape[1]
        part["fp"] = part["fp"] * np.exp(1j * error[begin : begin + pulses])
        begin += pulses
        blurred.append(folder / path.name)
        savemat(blurred[-1], {"data": part})
    import_gotcha(blurred, folder / "blurred")
    return folder / "blurred"


def focus(bag: Path, out: Path, autofocus: str) -> float:
    """Peak over median of the image that the nodes make, dB."""
    replay(bag, out, {"sar_compression": {"autofocus": autofocus}})
    (image,) = json.loads((out / "report.json").read_text())["images"]
    return float(image["peak_over_median_db"])


def test_autofocus_takes_a_three_cycle_quadratic_off(tmp_path: Path, shared_data: Callable[[str], Path]) -> None:
    """Without it the error costs more than 10 dB; with it less than 1 dB of the clean image is missing.

    That nodes make the clean image is in `test_replay`.
    """
    files = tuple(sorted(shared_data("afrl_gotcha").glob("*.mat")))
    clean = contrast(image(files, autofocus="never"))
    assert clean == pytest.approx(48.84, abs=0.1)
    assert focus(blurred_bag(shared_data, tmp_path), tmp_path / "focused", autofocus="always") > clean - 1
    assert contrast(image(files, phase=THREE_CYCLES, autofocus="never")) < clean - 10
    assert contrast(image(files)) > clean - 0.1
    reader = BagReader(tmp_path / "focused" / "bag")
    (message,) = reader.messages(["/slc"])
    phase = np.array(reader.decode(message.type_name, message.cdr).provenance.autofocus_phase)
    found = residual_phase(phase, quadratic(len(phase)))
    assert np.sqrt(np.mean(found**2)) < 0.3  # the recording itself has an error of .2 rad


def cycles(amplitude: float, count: float) -> Callable[[np.ndarray], np.ndarray]:
    """A sine of `amplitude` with `count` cycles over the time -1 to 1."""
    return lambda t: amplitude * np.sin(np.pi * count * t + 1)


def walk(rms: float) -> Callable[[np.ndarray], np.ndarray]:
    """A random walk that ends `rms` off."""
    return lambda t: np.cumsum(np.random.default_rng(5).standard_normal(len(t))) * rms / np.sqrt(len(t))


SMOOTH_PHASES = {
    "quadratic, 6 cycles": lambda t: 2 * np.pi * 6 * t**2,
    "cubic, 6 cycles": lambda t: 2 * np.pi * 6 * t**3,
    "random walk": walk(2 * np.pi),
    "slow": cycles(6, 2),
    "fast": cycles(1.5, 10),
    "white": lambda t: 0.3 * np.random.default_rng(6).standard_normal(len(t)),
}
"""Phase errors in rad over the time -1 to 1."""

HARD_PHASES = {
    "quadratic, 20 cycles": lambda t: 2 * np.pi * 20 * t**2,
    "vibration": cycles(1.5, 40),
    "strong vibration": cycles(6, 10),
}
"""Others, that need many pulses."""

THREE_CYCLES = "quadratic, 3 cycles"

PHASES = SMOOTH_PHASES | HARD_PHASES | {THREE_CYCLES: lambda t: 2 * np.pi * CYCLES * t**2}

STEADY = "30 mm/s"
DIRECTION = np.array([0.6, -0.5, 0.6])

POSITIONS = {
    STEADY: lambda t: 0.03 * 0.88 * t,
    "acceleration of 50 mm/s^2": lambda t: 0.05 / 2 * (0.88 * t) ** 2,
    "random walk of 10 mm": walk(0.01),
    "vibration of 20 mm at 2 Hz": cycles(0.02, 3.5),
    "vibration of 2 mm at 20 Hz": cycles(0.002, 35),
}
"""Errors in m of the antenna's position along DIRECTION, over the time -1 to 1: 1.76 s of flight for one file."""


@cache
def image(files: tuple[Path, ...], phase: str = "", position: str = "", autofocus: str = "always") -> Slc:
    """The image of files, with an error that was put in."""
    collection = read_gotcha(list(files))
    history, states = collection.histories[0], collection.states
    if phase:
        turn = np.exp(1j * PHASES[phase](np.linspace(-1, 1, collection.sensor.pulse_count)))
        history = replace(history, samples=history.samples * turn[:, None].astype(np.complex64))
    if position:
        off = POSITIONS[position](np.linspace(-1, 1, len(states)))[:, None] * DIRECTION
        states = tuple(replace(state, position=state.position + by) for state, by in zip(states, off, strict=True))
    settings = ImageSettings(**collection.parameters["sar_compression"] | {"autofocus": autofocus})
    return Compressor().add(history, Trajectory(list(states)), collection.sensor, settings)


@cache
def contrast(slc: Slc) -> float:
    """Of the brightest target over the median, dB."""
    return measure_brightest(slc.images[0]).peak_over_median_db


FILES = {"first": slice(1), "third": slice(2, 3), "two": slice(2)}


@pytest.fixture(params=FILES)
def files(request: pytest.FixtureRequest, shared_data: Callable[[str], Path]) -> tuple[Path, ...]:
    return tuple(sorted(shared_data("afrl_gotcha").glob("*.mat"))[FILES[request.param]])


def in_files(errors: Iterable[str]) -> list[tuple[str, str]]:
    """Every error in one of the files or in two, by turns; the first error in all of these."""
    by_turns = list(zip(errors, cycle(FILES), strict=False))
    return [(one, by_turns[0][0]) for one in FILES] + [(one, error) for error, one in by_turns[1:]]


def assert_comes_off(files: tuple[Path, ...], error: str) -> None:
    """Less than 0.12 rad rms of a phase error is left, and the image has the contrast that it has without it."""
    own, focused = image(files), image(files, phase=error)
    assert focused.focus
    assert focused.focus.trusted
    injected = PHASES[error](np.linspace(-1, 1, len(own.autofocus_phase)))
    assert np.std(residual_phase(focused.autofocus_phase - own.autofocus_phase, injected)) < 0.12
    assert contrast(focused) > contrast(own) - 0.4


@pytest.mark.parametrize(("files", "error"), few(2, in_files(SMOOTH_PHASES)), indirect=["files"])
def test_phase_errors_come_off(files: tuple[Path, ...], error: str) -> None:
    assert_comes_off(files, error)


@pytest.mark.parametrize("error", few(1, HARD_PHASES))
def test_phase_errors_wider_than_a_picture_come_off(shared_data: Callable[[str], Path], error: str) -> None:
    """Three files: a blur over more cells than stay in a range cell, and echoes 40 cells off, that first look right."""
    assert_comes_off(tuple(sorted(shared_data("afrl_gotcha").glob("*.mat"))), error)


@pytest.mark.parametrize(("files", "error"), few(2, in_files(POSITIONS)), indirect=["files"])
def test_errors_of_the_antenna_position_come_off(files: tuple[Path, ...], error: str) -> None:
    own, focused = image(files), image(files, position=error)
    assert focused.focus
    assert focused.focus.trusted
    assert contrast(focused) > contrast(own) - 0.7
    if error != STEADY:
        assert contrast(image(files, position=error, autofocus="never")) < contrast(focused) - 0.7


def test_a_steady_velocity_moves_the_image(files: tuple[Path, ...]) -> None:
    """By R / V times that along the line of sight: within 0.1 m, a fifth of the resolution of two files."""
    own, off = image(files), image(files, position=STEADY)
    peaks = [measure_brightest(slc.images[0]) for slc in (own, off)]
    before, after = (slc.grid.points(peak.row, peak.col) for slc, peak in zip((own, off), peaks, strict=True))
    at_the_ends = float(POSITIONS[STEADY](np.ones(1))[0])
    drift = (before - own.aperture.position) @ DIRECTION * 2 * at_the_ends / own.aperture.length
    assert np.linalg.norm(after - before) == pytest.approx(abs(drift), abs=0.1)


def test_a_phase_that_tells_no_place_is_refused(files: tuple[Path, ...]) -> None:
    """Phases from -pi to pi: targets focus, but at places that nothing tells."""
    collection = read_gotcha(list(files))
    (history,) = collection.histories
    turn = np.exp(1j * np.random.default_rng(7).uniform(-np.pi, np.pi, collection.sensor.pulse_count))
    history = replace(history, samples=history.samples * turn[:, None].astype(np.complex64))
    settings = ImageSettings(**collection.parameters["sar_compression"] | {"autofocus": "always"})
    slc = Compressor().add(history, Trajectory(list(collection.states)), collection.sensor, settings)
    assert slc.focus
    assert not slc.focus.trusted
