"""`sal-height adjust` with one detector: Gotcha's recorded positions, as they are and with errors put in."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.geometry import PlatformState, Trajectory
from sal_height.imports import read_gotcha
from sal_height.imports.collection import Collection, write_collection
from sal_height.numeric import F64

DWELLS = 3
STATED = [
    f"--set={name}"
    for name in ("position_sigma_m=0.3", "velocity_sigma_mps=0.02", "position_step_m=0.3", "correlation_s=10")
]
SMALL = ["--param", "sar_compression.rows=251", "--param", "sar_compression.cols=251"]

ERRORS = {1: ((-0.25, 0.1, 0.2), (0.004, -0.003, 0.006)), 2: ((0.3, 0.2, -0.15), (-0.008, 0.0, -0.003))}
"""Of the position (m) in the middle of a dwell, and of the velocity (m/s), by its number."""


@pytest.fixture(scope="module")
def collection(shared_data: Callable[[str], Path]) -> Collection:
    """Three degrees of azimuth as three dwells."""
    return read_gotcha(sorted(shared_data("afrl_gotcha").glob("*.mat")), DWELLS)


def spoilt(collection: Collection) -> Collection:
    """The same with ERRORS."""
    states = list(collection.states)
    for dwell, (place, velocity) in ERRORS.items():
        history = collection.histories[dwell]
        middle = (history.stamp_ns + history.stamp_of_last_pulse_ns) / 2
        for number, state in enumerate(states):
            if history.stamp_ns <= state.stamp_ns <= history.stamp_of_last_pulse_ns:
                off = np.array(place) + (state.stamp_ns - middle) * 1e-9 * np.array(velocity)
                states[number] = replace(
                    state, position=state.position + off, velocity=state.velocity + np.array(velocity)
                )
    return replace(collection, states=states)


@pytest.fixture(scope="module")
def adjusted(collection: Collection, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What `sal-height adjust` makes of the recorded positions, and of those with errors."""
    folder = tmp_path_factory.mktemp("gotcha")
    made = {}
    for name, one in {"recorded": collection, "spoilt": spoilt(collection)}.items():
        write_collection(one, folder / name)
        made[name] = folder / f"{name}_out"
        assert main(["adjust", str(folder / name), "--out", str(made[name]), *STATED, *SMALL]) == 0
    return made


def report_of(folder: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def found_in(folder: Path) -> tuple[F64, F64]:
    """Errors towards the ground and along the flight against the mean of all dwells, and their sigmas, (dwells, 2)."""
    images = report_of(folder)["images"]
    names = ("towards_ground", "along_flight")
    values, sigmas = ([[one[name + kind] for name in names] for one in images] for kind in ("_m", "_sigma_m"))
    return np.array(values), np.array(sigmas)


def moved(collection: Collection, states: Sequence[PlatformState]) -> F64:
    """How far other states than those of a collection move images on the ground, of their mean, in the same axes."""
    shifts, axes = [], []
    for history in collection.histories:
        own, other = (
            Trajectory([s for s in track if history.stamp_ns <= s.stamp_ns <= history.stamp_of_last_pulse_ns]).aperture(
                history.stamp_ns, history.pulse_times
            )
            for track in (collection.states, states)
        )
        slant_range, speed = np.linalg.norm(own.position), np.linalg.norm(own.velocity)
        sight, along = -own.position / slant_range, own.direction
        circle = np.cross(sight, along)
        off = other.position - own.position - slant_range / speed * (sight @ (other.velocity - own.velocity)) * along
        shifts.append((off - circle * off[2] / circle[2])[:2])
        axes.append(np.stack([sight[:2], along[:2]]))
    return np.array([one @ shift for one, shift in zip(axes, shifts - np.mean(shifts, axis=0), strict=True)])


def test_recorded_positions_stay(adjusted: dict[str, Path]) -> None:
    """Within three sigma, of millimetres towards the ground and 3 cm along the flight, 0.3 mm/s of velocity."""
    values, sigmas = found_in(adjusted["recorded"])
    assert np.all(sigmas < [0.006, 0.04])
    assert np.all(np.abs(values) < 3 * sigmas), (values, sigmas)


def test_errors_that_were_put_in_are_found(collection: Collection, adjusted: dict[str, Path]) -> None:
    """Decimetres and millimetres per second, within three sigma; and to 3 mm and 2 cm of what is found without them."""
    expected = moved(collection, spoilt(collection).states)
    assert np.all(np.abs(expected).max(axis=0) > [0.05, 0.5])
    values, sigmas = found_in(adjusted["spoilt"])
    assert np.all(np.abs(values - expected) < 3 * sigmas), (values, expected, sigmas)
    recorded, _ = found_in(adjusted["recorded"])
    assert np.all(np.abs(values - recorded - expected) < [0.003, 0.02]), values - recorded - expected
    assert report_of(adjusted["spoilt"])["comparisons"] == 3


def test_the_new_bag_has_the_antenna_where_it_was(collection: Collection, adjusted: dict[str, Path]) -> None:
    """As its images show it, within three sigma; what images do not show is in the covariance.

    Within a dwell it is corrected by a position and a velocity, so that images stay as sharp as they are.
    """
    reader = BagReader(adjusted["spoilt"] / "bag")
    states = [
        messages.state_from_message(reader.decode(one.type_name, one.cdr))
        for one in reader.messages(["/platform/odometry"])
    ]
    assert len(states) == len(collection.states)
    _, sigmas = found_in(adjusted["spoilt"])
    left = moved(collection, states)
    assert np.all(np.abs(left) < 3 * sigmas), (left, sigmas)
    for state, before in zip(states, collection.states, strict=True):
        off = state.position - before.position
        assert off @ np.linalg.solve(state.covariance[:3, :3], off) < 16.3, "99.9 % of chi-square"
    first = states[: collection.sensor.pulse_count]
    off = np.array([one.position - before.position for one, before in zip(first, collection.states, strict=False)])
    number = np.arange(len(off))
    bend = off - np.polynomial.polynomial.polyval(number, np.polynomial.polynomial.polyfit(number, off, 1)).T
    assert np.abs(bend).max() < 1e-4


def test_report_says_what_images_do_not_tell(adjusted: dict[str, Path]) -> None:
    report = report_of(adjusted["recorded"])
    said = " ".join(report["warnings"])
    assert (
        "do not separate an error of the position along the flight from one of the velocity along the line of "
        "sight" in said
    )
    assert "Without known ground all dwells together may lie off by" in said
    assert report["parameters"] == {}
    assert report["images_against"] == "mean"


@pytest.fixture(scope="module")
def bag(collection: Collection, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag") / "flown"
    write_collection(collection, folder)
    return folder


def test_odometry_that_states_no_errors_is_told(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ["--param", "sar_compression.rows=51", "--param", "sar_compression.cols=51"]
    assert main(["adjust", str(bag), "--out", str(tmp_path / "out"), *small]) == 2
    assert_one_sentence(
        capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: "),
        "states no errors of position",
        "position_sigma_m",
    )


def test_an_elevation_model_is_refused(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    terrain = tmp_path / "ground.npz"
    np.savez(terrain, elevation=np.zeros((3, 3)), dx=1.0, dy=1.0)
    arguments = ["adjust", str(bag), "--out", str(tmp_path / "out"), "--terrain", str(terrain), *STATED]
    assert main(arguments) == 2
    assert_one_sentence(
        capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: "), "one detector", "give targets"
    )
    assert not (tmp_path / "out").exists()
