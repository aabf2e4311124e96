"""Arrays and tracks of anybody's sensor: a flight that is known gives the heights that it gives by itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import few, refused
from pyproj import Geod
from scipy.io import savemat
from written_arrays import write_hdf5, write_mat73

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.geometry import Altitudes, Origin, PlatformState, rotation_matrix
from sal_height.imports import Collection, import_arrays, level_states, read_track, write_collection
from sal_height.imports.arrays import OF_TRACK
from sal_height.imports.collection import read_description
from sal_height.imports.track import SBET
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.sensor import NOTHING_STATED, PhaseHistory, SensorUncertainty
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

SEED, DWELLS = 3, 2
ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    return flight_of(replace(load_preset("small"), dwells=DWELLS), SEED)


def description_of(flight: SimulatedFlight, **changes: Any) -> dict[str, Any]:
    """What its maker would write of the sensor."""
    sensor, preset = flight.sensor, flight.preset
    return {
        "name": "mine",
        "look_side": {1: "right", -1: "left"}[sensor.look_side],
        "wavelength_m": sensor.wavelength,
        "bandwidth_hz": sensor.bandwidth,
        "elevation_diameter_m": sensor.elevation_diameter,
        "azimuth_diameter_m": sensor.azimuth_diameter,
        "pattern": sensor.pattern,
        "elevation_boresights_rad": list(sensor.elevation_boresights),
        "noise_power": list(sensor.noise_power),
        "uncertainty": asdict(preset.sensor.uncertainty),
        "processing": {"sar_compression": {"rows": preset.image.rows, "cols": preset.image.cols, "air": "none"}},
        **changes,
    }


def arrays_of(flight: SimulatedFlight) -> dict[str, Any]:
    """Its dwells and its track as arrays."""
    histories = [flight.phase_history(dwell) for dwell in range(flight.dwells)]
    states = [state for dwell in range(flight.dwells) for state in flight.platform_states(dwell)]
    return {
        "samples": np.stack([history.samples for history in histories]),
        "pulse_times": np.stack([history.stamp_ns * 1e-9 + history.pulse_times for history in histories]),
        "reference_range": np.stack([history.reference_range for history in histories]),
        "times": np.array([state.stamp_ns * 1e-9 for state in states]),
        "positions": np.stack([state.position for state in states]),
        "velocities": np.stack([state.velocity for state in states]),
        "attitudes": np.stack([state.orientation for state in states]),
        "start_ns": np.array(10**18),
    }


WRITERS: dict[str, Callable[..., None]] = {
    "npz": np.savez,
    "mat": lambda path, **arrays: savemat(path, arrays),
    "mat73": write_mat73,
    "h5": write_hdf5,
}


def write_description(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def heights_of(bag: Path) -> list[Any]:
    reader = BagReader(bag)
    images = [reader.decode(one.type_name, one.cdr) for one in reader.messages(["/ml/height"])]
    return sorted(images, key=lambda image: image.dwell)


@pytest.fixture(scope="module")
def expected(flight: SimulatedFlight, tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """Heights of the flight by its own bag."""
    folder = tmp_path_factory.mktemp("expected")
    record_sensor(flight.preset, SEED, folder / "bag")
    replay(folder / "bag", folder / "out", {})
    return heights_of(folder / "out" / "bag")


@pytest.mark.parametrize("kind", few(2, WRITERS))
def test_arrays_give_the_heights_of_the_flight(
    kind: str, flight: SimulatedFlight, expected: list[Any], tmp_path: Path
) -> None:
    """Times in s are rounded by 0.1 ns, which is 5 nm of flight."""
    data = tmp_path / f"data.{kind.removesuffix('73')}"
    WRITERS[kind](data, **arrays_of(flight))
    content = description_of(flight, processing=description_of(flight)["processing"] | {"ml_height": looks(flight)})
    description = write_description(tmp_path / "mine.yaml", content)
    assert import_arrays(description, data, tmp_path / "bag") == DWELLS
    replay(tmp_path / "bag", tmp_path / "out", {}, estimators=["ml"])
    made = heights_of(tmp_path / "out" / "bag")
    assert [image.dwell for image in made] == [image.dwell for image in expected] == [0, 1]
    for mine, true in zip(made, expected, strict=True):
        np.testing.assert_array_equal(mine.validity, true.validity)
        found, wanted = (np.array(image.surfaces[0].height) for image in (mine, true))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4)
    assert messages.to_ns(made[0].header.stamp) == 10**18


def looks(flight: SimulatedFlight) -> dict[str, int]:
    return dict(zip(("range_looks", "azimuth_looks"), flight.preset.looks, strict=True))


def test_what_a_description_does_not_state_of_its_accuracy_is_unknown(flight: SimulatedFlight, tmp_path: Path) -> None:
    size = 64, 64, 1000.0
    path = tmp_path / "mine.yaml"
    sensor = read_description(write_description(path, description_of(flight, uncertainty={}))).sensor(*size)
    assert (sensor.uncertainty, sensor.mounting.rotation_covariance) == (NOTHING_STATED, None)
    stated = {"range_delay_m": 0.02, "beam_pitch": 0.0, "lever_arm_m": 0.1}
    sensor = read_description(write_description(path, description_of(flight, uncertainty=stated))).sensor(*size)
    assert sensor.uncertainty == SensorUncertainty(range_delay=0.02, beam_pitch=0.0)
    assert sensor.mounting.lever_arm_covariance == pytest.approx(tuple((0.01 * np.eye(3)).ravel()))


def test_a_collection_is_written_by_ten_lines_of_python(flight: SimulatedFlight, tmp_path: Path) -> None:
    """Those of docs/import.md."""
    arrays = arrays_of(flight)
    samples, times, ranges = (arrays[name][0] for name in ("samples", "pulse_times", "reference_range"))
    start_ns = 10**18
    stamps = start_ns + np.rint(arrays["times"] * 1e9).astype(np.int64)
    states = level_states(stamps, arrays["positions"], arrays["velocities"])
    history = PhaseHistory(start_ns + round(times[0] * 1e9), times - times[0], ranges, samples)
    write_collection(Collection(flight.sensor, [history], states, ORIGIN), tmp_path / "bag")
    topics = BagReader(tmp_path / "bag").topics
    assert {name: topic.count for name, topic in topics.items()} == {
        "/sensor_info": 1,
        "/map_origin": 1,
        "/platform/odometry": len(states),
        "/phase_history": len(samples),
    }


def odometry_of(bag: Path) -> list[PlatformState]:
    reader = BagReader(bag)
    recorded = reader.messages(["/platform/odometry"])
    return [messages.state_from_message(reader.decode(one.type_name, one.cdr)) for one in recorded]


def test_a_bag_may_be_the_track(flight: SimulatedFlight, tmp_path: Path) -> None:
    """The odometry of the flight's own bag, beside arrays without a track."""
    record_sensor(flight.preset, SEED, tmp_path / "flown")
    wanted = odometry_of(tmp_path / "flown")
    begin_ns = wanted[0].stamp_ns - flight.platform_states(0)[0].stamp_ns
    arrays = {name: values for name, values in arrays_of(flight).items() if name not in OF_TRACK}
    np.savez(tmp_path / "data.npz", **arrays | {"start_ns": np.array(begin_ns)})
    description = write_description(tmp_path / "mine.yaml", description_of(flight))
    assert import_arrays(description, tmp_path / "data.npz", tmp_path / "bag", tmp_path / "flown") == DWELLS
    made = odometry_of(tmp_path / "bag")
    assert [state.stamp_ns for state in made] == [state.stamp_ns for state in wanted]
    for field in ("position", "orientation", "velocity", "covariance"):
        mine, true = (np.array([getattr(state, field) for state in states]) for states in (made, wanted))
        np.testing.assert_allclose(mine, true, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"samples": None}, "The arrays lack samples"),
        ({"samples": np.ones((2, 3, 4))}, "must be complex"),
        ({"positions": None}, "lack positions of the track"),
        ({"pulse_times": np.zeros((3, 5))}, "Array pulse_times has the shape (3, 5)"),
        ({"times": np.zeros(12)}, "whose times increase"),
        ({"times": "late"}, "reaches from"),
        ({"samples": "nan"}, "samples that are NaN or infinite"),
        ({"samples": "fewer channels"}, "channels, pulses"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    change: dict[str, Any], words: str, flight: SimulatedFlight, tmp_path: Path
) -> None:
    arrays = arrays_of(flight)
    special = {
        "nan": arrays["samples"] * np.nan,
        "fewer channels": arrays["samples"][:, 1:],
        "late": arrays["times"] + 1.0,
    }
    for name, value in change.items():
        arrays[name] = special[value] if isinstance(value, str) else value
    if "times" in change and not isinstance(change["times"], str):
        arrays["times"] = np.zeros(len(arrays["positions"]))
    np.savez(tmp_path / "data.npz", **{name: value for name, value in arrays.items() if value is not None})
    description = write_description(tmp_path / "mine.yaml", description_of(flight))
    with refused(UserError, words):
        import_arrays(description, tmp_path / "data.npz", tmp_path / "bag")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"carrier_hz": 1e9}, "either wavelength_m or carrier_hz"),
        ({"look_side": "up"}, "look_side is 'up'"),
        ({"colour": "red"}, "colour is not a known key"),
        ({"elevation_boresights_rad": []}, "elevation_boresights_rad"),
        # With a heading as uncertain it would pass for a placeholder of drivers.
        ({"assumed_attitude_sigma_rad": 1.0}, "assumed_attitude_sigma_rad is 1.0; it must be less than 1"),
    ],
)
def test_descriptions_that_are_none_are_refused(
    change: dict[str, Any], words: str, flight: SimulatedFlight, tmp_path: Path
) -> None:
    description = write_description(tmp_path / "mine.yaml", description_of(flight, **change))
    with refused(UserError, "mine.yaml", words):
        import_arrays(description, tmp_path / "data.npz", tmp_path / "bag")


def test_files_of_other_kinds_and_damaged_ones_are_refused(flight: SimulatedFlight, tmp_path: Path) -> None:
    description = write_description(tmp_path / "mine.yaml", description_of(flight))
    for name, words in (("data.txt", "read from .npz, .mat, .h5 and .hdf5"), ("data.mat", "not a whole .mat file")):
        (tmp_path / name).write_bytes(b"nothing")
        with refused(UserError, name, words):
            import_arrays(description, tmp_path / name, tmp_path / "bag")


COLUMNS = "time,latitude,longitude,height,roll,pitch,heading"


def test_a_track_of_places_and_angles_of_aviation(tmp_path: Path) -> None:
    """20 m north-east along a geodesic by a wholly other formula, nose 3 degrees up and to 45 degrees, 2 right."""
    longitude, latitude, _ = Geod(ellps="WGS84").fwd(11.3, 48.1, 45.0, 20.0)
    lines = [COLUMNS, "0, 48.1, 11.3, 3560, 2, 3, 45", f"0.5, {latitude!r}, {longitude!r}, 3560, 2, 3, 45"]
    (tmp_path / "track.csv").write_text("\n".join(lines))
    track = read_track(tmp_path / "track.csv", ORIGIN, Altitudes("ellipsoid"))
    assert track.covariances is None
    above = read_track(tmp_path / "track.csv", ORIGIN, Altitudes("geoid", 47.0))
    np.testing.assert_allclose(above.positions - track.positions, [[0, 0, 47.0]] * 2, rtol=0, atol=1e-3)
    unknown = read_track(tmp_path / "track.csv", ORIGIN)
    np.testing.assert_array_equal(unknown.positions, track.positions)
    np.testing.assert_array_equal(np.diag(unknown.states(0)[0].covariance), [0, 0, 900.0, 0, 0, 0])
    np.testing.assert_allclose(track.positions[0], [0, 0, 3000], rtol=0, atol=1e-8)
    way = track.positions[1] - track.positions[0]
    stretched = 20.0 * (1 + 3560 / 6.38e6)
    np.testing.assert_allclose(way, [stretched / math.sqrt(2)] * 2 + [0.0], rtol=0, atol=1e-3)
    assert track.attitudes is not None
    nose, left, up = rotation_matrix(track.attitudes[0]).T
    level = math.cos(math.radians(3)) / math.sqrt(2)
    np.testing.assert_allclose(nose, [level, level, math.sin(math.radians(3))], rtol=0, atol=1e-12)
    assert left[2] == pytest.approx(math.sin(math.radians(2)) * math.cos(math.radians(3))), "the right wing is down"
    assert up[2] > 0.99
    states = track.states(10**18)
    np.testing.assert_allclose(states[0].velocity, 2 * way, rtol=0, atol=1e-6)


def test_a_track_in_map_with_quaternions(tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text(
        "time,x,y,z,vx,vy,vz,qx,qy,qz,qw\n1,2,3,4,5,6,7,0,0,1,0\n2,3,4,5,6,7,8,0,0,0,1\n"
    )
    first, last = read_track(tmp_path / "track.csv", None).states(0)
    assert first.stamp_ns == 10**9
    np.testing.assert_array_equal(first.position, [2, 3, 4])
    np.testing.assert_array_equal(first.velocity, [5, 6, 7])
    np.testing.assert_array_equal(last.orientation, [0, 0, 0, 1])


def test_a_track_of_inertial_post_processing(tmp_path: Path) -> None:
    """Heading is that of the wander frame, which is turned by the wander angle."""
    records = np.zeros(3, SBET)
    records["time"] = [100.0, 100.005, 100.01]
    records["latitude"] = math.radians(48.1) + np.array([0.0, 1e-8, 2e-8])
    records["longitude"], records["height"] = math.radians(11.3), 3560.0
    records["heading"], records["wander"], records["roll"] = 0.5, 0.5, 0.1
    records.tofile(tmp_path / "flight.sbet")
    assert (tmp_path / "flight.sbet").stat().st_size == 3 * 17 * 8
    track = read_track(tmp_path / "flight.sbet", ORIGIN)  # whose format says that heights are above the ellipsoid
    above = read_track(tmp_path / "flight.sbet", ORIGIN, Altitudes("geoid", 47.0))
    assert above.positions[0] == pytest.approx([0, 0, 3047], abs=1e-6)
    assert track.covariances is None
    assert track.positions[0] == pytest.approx([0, 0, 3000], abs=1e-6)
    assert track.positions[2, 1] == pytest.approx(2e-8 * 6.38e6, rel=0.01)
    assert track.attitudes is not None
    np.testing.assert_allclose(rotation_matrix(track.attitudes[0])[:, 0], [0, 1, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", "time,x,y\n1,2,3\n", "has the columns time, x, y; needed are time, and x, y, z"),
        ("a.csv", "time,x,y,z\n1,2,3,high\n", "must have 4 numbers in each line"),
        ("a.csv", "time,x,y,z\n1,2,3\n", "must have 4 numbers in each line"),
        ("a.csv", "", "not a readable CSV file"),
        ("a.csv", f"{COLUMNS}\n1,2,3,4,5,6,7\n", "state the origin of the map"),
        ("a.sbet", "short", "has 5 bytes; SBET has records of 136"),
    ],
)
def test_tracks_that_are_none_are_refused(name: str, content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with refused(UserError, f"Track {tmp_path / name}", words):
        read_track(tmp_path / name, None)
