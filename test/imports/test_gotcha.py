"""Import of AFRL Gotcha: files that cannot be used are refused by name, in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused
from scipy.io import savemat

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.imports.followed_point import focusing
from sal_height.imports.gotcha import SPEED, import_gotcha, read_gotcha

PULSES, FREQUENCIES = 5, 16
STEP = 1.5e6


def write_mat(path: Path, first_degree: float = 0.0, step: float = 0.01, **changes: Any) -> Path:
    """A file in the format of Gotcha, from an azimuth on, a pulse every `step` degrees; with other values of fields."""
    rng = np.random.default_rng(1)
    azimuth = np.radians(first_degree + step * np.arange(PULSES))[None]
    values = {
        "fp": rng.standard_normal((FREQUENCIES, PULSES)) + 1j * rng.standard_normal((FREQUENCIES, PULSES)),
        "freq": (9.3e9 + STEP * np.arange(FREQUENCIES))[:, None].astype(np.float32),
        "x": 7000 * np.cos(azimuth),
        "y": 7000 * np.sin(azimuth),
        "z": np.full((1, PULSES), 7000.0),
        "r0": np.full((1, PULSES), 7000.0 * np.sqrt(2)),
    }
    savemat(path, {"data": values | changes})
    return path


def with_nan(shape: tuple[int, ...]) -> Any:
    values = np.ones(shape)
    values.flat[-1] = np.nan
    return values


def bent(deviation: float) -> Any:
    """Frequencies, the fourth of them off by a part of a step."""
    return 9.3e9 + STEP * (np.arange(FREQUENCIES) + deviation * (np.arange(FREQUENCIES) == 3))


def test_whole_file_becomes_a_bag(tmp_path: Path) -> None:
    path = write_mat(tmp_path / "a.mat", freq=bent(0.009))
    assert import_gotcha([path], tmp_path / "bag") == PULSES
    assert len(list(BagReader(tmp_path / "bag").messages(["/phase_history"]))) == 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({name: np.ones((1, 1)) for name in ("x", "y", "z", "r0")} | {"fp": np.ones((FREQUENCIES, 1))}, "1 antenna"),
        ({"freq": [9e9], "fp": np.ones((1, PULSES))}, "1 frequencies"),
        ({"fp": np.ones((FREQUENCIES, PULSES - 1))}, ".fp of shape (16, 4); it must be (16, 5)"),
        ({"fp": np.ones((PULSES, FREQUENCIES))}, ".fp of shape (5, 16); it must be (16, 5)"),
        ({"y": np.ones((1, PULSES - 1))}, "4 values of .y; they must be 5"),
        ({"r0": np.ones((1, PULSES + 1))}, "6 values of .r0; they must be 5"),
        ({"fp": with_nan((FREQUENCIES, PULSES))}, "values of .fp that are not finite"),
        ({"freq": with_nan((FREQUENCIES, 1))}, "values of .freq that are not finite"),
        ({"x": with_nan((1, PULSES))}, "values of .x that are not finite"),
        ({"r0": np.full((1, PULSES), np.inf)}, "values of .r0 that are not finite"),
        ({"freq": bent(0.011)}, "uneven .freq"),
        ({"freq": bent(0.0)[::-1]}, "uneven .freq"),
        ({"freq": np.full(FREQUENCIES, 9e9)}, "uneven .freq"),
        ({"freq": bent(0.0) - 9.3e9}, "uneven .freq"),
        ({"x": ["a"] * PULSES}, "is not AFRL Gotcha phase history"),
        ({"fp": np.ones((FREQUENCIES, PULSES))}, "real samples .fp"),
        ({"freq": bent(0.0) / 1e9}, "in Hz it must be between 1e+09 and 1e+11"),
        ({"r0": np.full((1, PULSES), 9.8995)}, "in m it must be between 1000 and 1e+06"),
        ({"r0": np.full((1, PULSES), 7000.0 * np.sqrt(2) + 0.02)}, "0.02 m off"),
    ],
)
def test_useless_file_is_refused_by_name(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    good, bad = write_mat(tmp_path / "good.mat"), write_mat(tmp_path / "bad.mat", **changes)
    for files in ([bad], [good, bad]):
        with refused(UserError, f"File {bad} ", said):
            import_gotcha(files, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("size", [0, 1, 127, 128, 400], ids=str)
def test_file_that_was_cut_off_is_refused_by_name(tmp_path: Path, size: int) -> None:
    path = write_mat(tmp_path / "cut.mat")
    path.write_bytes(path.read_bytes()[:size])
    with refused(UserError, f"File {path} is not AFRL Gotcha phase history"):
        import_gotcha([path], tmp_path / "bag")


def test_pulses_less_than_a_nanosecond_apart_are_refused(tmp_path: Path) -> None:
    path = write_mat(tmp_path / "a.mat", x=np.full((1, PULSES), 7e3), y=np.arange(PULSES) * 1e-9)
    with refused(UserError, "same antenna position"):
        import_gotcha([path], tmp_path / "bag")


def import_pass(folder: Path, degrees: list[float], step: float = 0.01) -> list[Any]:
    """Import files that begin at these azimuths, one after the other; the odometry that the bag has of them."""
    files = [write_mat(folder / f"az{number}_HH.mat", degree, step) for number, degree in enumerate(degrees)]
    import_gotcha(files, folder / "bag")
    reader = BagReader(folder / "bag")
    return [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/platform/odometry"])]


@pytest.mark.parametrize("turn", [1, -1])
def test_files_in_any_order_are_put_into_that_of_flight(tmp_path: Path, turn: int) -> None:
    """Also across north, where azimuth goes from 360 to 0 degrees, and whichever way the pass was flown."""
    states = import_pass(tmp_path, [0.0, turn * 359.95, turn * 0.05], turn * 0.01)
    azimuth = [np.degrees(np.arctan2(s.pose.pose.position.y, s.pose.pose.position.x)) for s in states]
    np.testing.assert_allclose(azimuth, turn * (-0.05 + 0.01 * np.arange(3 * PULSES)), atol=1e-6)


def test_what_is_read_is_the_pass_in_one_piece(tmp_path: Path) -> None:
    """Samples in the order of flight, at the times at which SPEED brings the antenna to their places."""
    samples = np.arange(2 * FREQUENCIES * PULSES).reshape(2, FREQUENCIES, PULSES) * (1 + 1j)
    second, first = (write_mat(tmp_path / f"{n}.mat", 0.05 * n, fp=samples[n]) for n in (1, 0))
    collection = read_gotcha([second, first])
    collection.check()
    (history,) = collection.histories
    np.testing.assert_array_equal(history.samples[0], np.concatenate([samples[0].T, samples[1].T]))
    places = np.array([state.position for state in collection.states])
    chord = 2 * 7000 * np.sin(np.radians(0.01) / 2)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), chord, rtol=1e-6)
    np.testing.assert_allclose(history.pulse_times, np.arange(2 * PULSES) * chord / SPEED, atol=1e-9)


@pytest.mark.parametrize("degrees", [[0.0, 0.06], [0.0, 0.04], [0.0, 0.0], [0.0, 0.02], [0.05, 0.0, 0.15]], ids=str)
def test_files_with_a_gap_or_an_overlap_are_refused(tmp_path: Path, degrees: list[float]) -> None:
    """A file takes 0.05 degrees; a pulse more or less than that, the same pulses twice, and half of them."""
    with refused(UserError, "which has one every 1.222 m", "consecutive files of one pass"):
        import_pass(tmp_path, degrees)


def test_file_named_twice_and_polarisations_mixed_are_refused(tmp_path: Path) -> None:
    first = write_mat(tmp_path / "az001_HH.mat")
    second = write_mat(tmp_path / "az002_VV.mat", 0.05)
    with refused(UserError, str(first), "named twice"):
        import_gotcha([first, first], tmp_path / "bag")
    with refused(UserError, str(second), "VV", "HH"):
        import_gotcha([first, second], tmp_path / "bag")


def test_pixels_are_as_close_as_the_aperture_resolves(tmp_path: Path) -> None:
    """Wavelength times range over twice the aperture: 0.2 m up to 6 degrees at 7 km on the ground, then less."""
    import_pass(tmp_path, [0.0])
    reader = BagReader(tmp_path / "bag")
    (message,) = reader.messages(["/sensor_info"])
    sensor = messages.sensor_from_message(reader.decode(message.type_name, message.cdr))
    for degrees, spacing in ((3.0, 0.2), (6.0, 0.2), (12.0, None)):
        angle = np.radians(np.linspace(0, degrees, 1000))
        antenna = 7000 * np.stack([np.cos(angle), np.sin(angle), np.ones(1000)], axis=-1)
        resolution = sensor.wavelength * 7000 * np.sqrt(2) / (2 * 7000 * np.radians(degrees))
        image = focusing(sensor, antenna, float(np.linalg.norm(antenna[len(antenna) // 2])), 100.0, 0.2, "none")[
            "sar_compression"
        ]
        assert image["ground_spacing_m"] == pytest.approx(spacing or resolution, rel=1e-4)
        assert image["rows"] == image["cols"] == 2 * round(50 / image["ground_spacing_m"]) + 1
        assert image["ground_spacing_m"] < 1.0001 * resolution


def test_pulses_are_split_into_dwells(tmp_path: Path) -> None:
    """Ten pulses as three dwells of three, one after the other on the same track; the last one is left out."""
    files = [write_mat(tmp_path / f"{number}.mat", 0.05 * number) for number in range(2)]
    whole, split = read_gotcha(files), read_gotcha(files, 3)
    split.check()
    (history,) = whole.histories
    assert split.sensor.pulse_count == 3
    for number, dwell in enumerate(split.histories):
        own = slice(3 * number, 3 * number + 3)
        np.testing.assert_array_equal(dwell.samples, history.samples[:, own])
        np.testing.assert_array_equal(dwell.reference_range, history.reference_range[own])
        assert dwell.stamp_ns == whole.states[own.start].stamp_ns
        np.testing.assert_allclose(dwell.pulse_times + dwell.stamp_ns * 1e-9, history.pulse_times[own], atol=1e-9)
    assert [state.stamp_ns for state in split.states] == [state.stamp_ns for state in whole.states]


@pytest.mark.parametrize("dwells", [-1, 0, 3])
def test_dwells_without_pulses_are_refused(tmp_path: Path, dwells: int) -> None:
    with refused(UserError, f"5 pulses, which cannot be split into {dwells} dwells; allowed are 1 to 2"):
        import_gotcha([write_mat(tmp_path / "a.mat")], tmp_path / "bag", dwells)
