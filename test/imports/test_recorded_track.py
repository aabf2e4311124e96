"""Tracks in bags: odometry, and fixes and attitudes as an aircraft's software records them."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.bag.qos import ODOMETRY
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.geometry import Altitudes, Origin, PlatformState, rotation_matrix
from sal_height.imports import read_recorded_track
from sal_height.messages import serialize
from sal_height.messages.types import Header, Imu, NavSatFix, NavSatStatus, Odometry, Quaternion

ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)
START_NS = 1_700_000_000_000_000_000
SPEED, HEIGHT = 50.0, 3500.0
DEVIATION = 0.3


def flown(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity on a climb that turns: a parabola, which the interpolation gives exactly."""
    position = np.array([SPEED * seconds, 0.5 * seconds**2, HEIGHT + seconds])
    return position, np.array([SPEED, seconds, 1.0])


def attitude(seconds: float) -> Rotation:
    """Against east, north and up where the aircraft is."""
    return Rotation.from_euler("ZYX", [0.02 * seconds, -0.03, 0.1])


def stamp(seconds: float) -> Any:
    return messages.to_stamp(START_NS + round(seconds * 1e9))


def fix(seconds: float, status: int = NavSatStatus.STATUS_FIX) -> NavSatFix:
    """The place by PROJ's topocentric coordinates."""
    pipeline = "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0=48.1 +lon_0=11.3 +h_0=560"
    x, y, z = Transformer.from_pipeline(pipeline).transform(*flown(seconds)[0])
    geodetic = Transformer.from_pipeline("+proj=pipeline +step +inv +proj=cart +ellps=WGS84")
    longitude, latitude, height = geodetic.transform(x, y, z, radians=True)
    message = NavSatFix(header=Header(stamp=stamp(seconds), frame_id="gps"), altitude=height)
    message.latitude, message.longitude = math.degrees(latitude), math.degrees(longitude)
    message.status.status = status
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    message.position_covariance = (DEVIATION**2 * np.eye(3)).ravel()
    return message


def imu(seconds: float) -> Imu:
    orientation = Quaternion(**dict(zip("xyzw", attitude(seconds).as_quat().tolist(), strict=True)))
    return Imu(header=Header(stamp=stamp(seconds), frame_id="imu_link"), orientation=orientation)


def odometry(seconds: float) -> Odometry:
    position, velocity = flown(seconds)
    covariance = 0.04 * np.eye(6)
    time_ns = START_NS + round(seconds * 1e9)
    state = PlatformState(time_ns, position, attitude(seconds).as_quat(), velocity, covariance)
    return messages.state_to_message(state, stamp(seconds))


def write(folder: Path, recorded: Iterable[tuple[str, Any]]) -> Path:
    """A bag with these messages, in this order."""
    listed = list(recorded)
    with BagWriter(folder, {}) as bag:
        for topic, kind in {topic: type(message) for topic, message in listed}.items():
            bag.add_topic(topic, kind.__msgtype__, [ODOMETRY])
        for time_ns, (topic, message) in enumerate(listed, START_NS):
            bag.write(topic, serialize(message), time_ns, time_ns)
    return folder


ELLIPSOID = Altitudes("ellipsoid")
FIXES = [("/gps/fix", fix(t)) for t in np.arange(0, 4, 0.5)]
ATTITUDES = [("/imu/data", imu(t)) for t in np.arange(0.01, 4, 0.02)]


def test_fixes_and_attitudes_are_a_track(tmp_path: Path) -> None:
    """Between fixes, half a second apart, on the parabola that the aircraft flies; attitudes turned into map."""
    track = read_recorded_track(write(tmp_path / "bag", [*ATTITUDES, *FIXES]), ORIGIN, ELLIPSOID)
    states = track.states(0)
    seconds = np.array([(state.stamp_ns - START_NS) * 1e-9 for state in states])
    # The first and the last fix have no slope: from the second to the last but one, every attitude is used.
    np.testing.assert_allclose(seconds, np.arange(0.51, 3.0, 0.02), rtol=0, atol=1e-9)
    for state, time in zip(states, seconds, strict=True):
        position, velocity = flown(time)
        np.testing.assert_allclose(state.position, position, rtol=0, atol=1e-4)
        np.testing.assert_allclose(state.velocity, velocity, rtol=0, atol=1e-3)
        turned = ORIGIN.turn_at(position) @ attitude(time).as_matrix()
        np.testing.assert_allclose(rotation_matrix(state.orientation), turned, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.sqrt(np.diag(state.covariance)[:3]), DEVIATION, rtol=1e-3)


def test_fixes_above_another_level_than_the_ellipsoid(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    bag, found = write(tmp_path / "bag", FIXES), []
    for altitudes in (ELLIPSOID, Altitudes("geoid", -20.0), Altitudes()):
        caplog.clear()
        found.append((read_recorded_track(bag, ORIGIN, altitudes).states(0)[3], caplog.text))
    (above, _), (below, _), (unknown, said) = found
    np.testing.assert_allclose(below.position - above.position, [0, 0, -20.0], rtol=0, atol=0.02)
    np.testing.assert_array_equal(unknown.position, above.position)
    np.testing.assert_allclose(np.diag(unknown.covariance - above.covariance)[:3], [0, 0, 900.0])
    assert "Nobody states whether altitudes are above the ellipsoid or the geoid" in said
    assert not found[0][1]


def test_fixes_alone_are_a_track_of_a_level_platform(tmp_path: Path) -> None:
    states = read_recorded_track(write(tmp_path / "bag", FIXES), ORIGIN, ELLIPSOID).states(0)
    assert [state.stamp_ns for state in states] == [START_NS + i * 500_000_000 for i in range(8)]
    position, velocity = flown(1.5)
    np.testing.assert_allclose(states[3].position, position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(states[3].velocity, velocity, rtol=0, atol=1e-5)
    heading = rotation_matrix(states[3].orientation)[:, 0]
    np.testing.assert_allclose(heading[:2], velocity[:2] / math.hypot(*velocity[:2]), rtol=0, atol=1e-6)
    assert heading[2] == 0


def test_odometry_is_the_track_as_it_is_whatever_else_there_is(tmp_path: Path) -> None:
    """It needs no origin; stamps in any order are sorted, and a second sample of a stamp is left out."""
    sent = [odometry(t) for t in (0.0, 0.4, 0.2, 0.4)]
    origin = replace(ORIGIN)
    latched = messages.origin_to_message(origin, stamp(0.0), "map")
    recorded = [*FIXES, ("/map_origin", latched), *(("/uav/odom", message) for message in sent)]
    states = read_recorded_track(write(tmp_path / "bag", recorded), None).states(0)
    assert [state.stamp_ns - START_NS for state in states] == [0, 200_000_000, 400_000_000]
    for state, sent_one in zip(states, (sent[0], sent[2], sent[1]), strict=True):
        wanted = messages.state_from_message(sent_one)
        np.testing.assert_array_equal(state.position, wanted.position)
        np.testing.assert_array_equal(state.velocity, wanted.velocity)
        np.testing.assert_array_equal(state.orientation, wanted.orientation)
        np.testing.assert_array_equal(state.covariance, wanted.covariance)


def test_fixes_without_satellites_are_left_out_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lost = [("/gps/fix", fix(t, NavSatStatus.STATUS_NO_FIX)) for t in (0.25, 0.75)]
    with caplog.at_level(logging.WARNING):
        states = read_recorded_track(write(tmp_path / "bag", [*FIXES, *lost]), ORIGIN, ELLIPSOID).states(0)
    assert len(states) == len(FIXES)
    assert "2 messages on /gps/fix are not used. NavSatFix says that it has no fix" in caplog.text


def test_attitudes_beside_a_gap_of_fixes_are_left_out_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing is known of the velocity beside a gap, so that neighbouring intervals are left out, too."""
    fixes = [("/gps/fix", fix(t)) for t in (*np.arange(0, 3, 0.5), *np.arange(6, 9, 0.5))]
    attitudes = [("/imu/data", imu(t)) for t in np.arange(0.1, 8.5, 0.2)]
    with caplog.at_level(logging.WARNING):
        states = read_recorded_track(write(tmp_path / "bag", [*fixes, *attitudes]), ORIGIN, ELLIPSOID).states(0)
    seconds = [(state.stamp_ns - START_NS) * 1e-9 for state in states]
    assert seconds
    assert all(0.5 <= time <= 2.0 or 6.5 <= time <= 8.0 for time in seconds)
    assert "attitudes are not used" in caplog.text


@pytest.mark.parametrize(
    ("recorded", "origin", "words"),
    [
        ([("/imu/data", imu(0))], ORIGIN, "has no track; needed is a topic of type nav_msgs/msg/Odometry"),
        ([("/one/fix", fix(0)), ("/two/fix", fix(0))], ORIGIN, "several topics of type sensor_msgs/msg/NavSatFix"),
        (FIXES, None, "state the origin of the map"),
        (FIXES[:1], ORIGIN, "has 1 samples of a track"),
        ([*FIXES[:1], *ATTITUDES], ORIGIN, "has 0 samples of a track"),
    ],
)
def test_bags_without_a_track_are_refused(
    recorded: list[tuple[str, Any]], origin: Origin | None, words: str, tmp_path: Path
) -> None:
    with refused(UserError, words):
        read_recorded_track(write(tmp_path / "bag", recorded), origin)
