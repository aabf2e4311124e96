"""The track of a platform from a file (CSV as people write it, SBET of inertial post-processing) or from a bag.

Of a bag it is odometry, or satellite fixes and the attitudes of an inertial unit.
"""

from __future__ import annotations

import csv
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE, ODOMETRY_TYPE
from sal_height.errors import Rejected, UserError
from sal_height.geometry import UNKNOWN_LEVEL, Altitudes, Axes, Navigation, Origin, PlatformState, Sample, quaternion_of
from sal_height.imports.collection import level_states
from sal_height.numeric import F64, I64
from sal_height.topics import MAP_ORIGIN

MAP = ("x", "y", "z")
EARTH = ("latitude", "longitude", "height")
VELOCITY = ("vx", "vy", "vz")
QUATERNION = ("qx", "qy", "qz", "qw")
ANGLES = ("roll", "pitch", "heading")

SBET = np.dtype(
    [
        *((name, "<f8") for name in ("time", *EARTH, "x_velocity", "y_velocity", "z_velocity", *ANGLES, "wander")),
        *((f"{kind}_{axis}", "<f8") for kind in ("acceleration", "rate") for axis in "xyz"),
    ]
)
"""A record of Applanix's smoothed best estimate of trajectory: angles in rad, heights above the ellipsoid, m."""


@dataclass(frozen=True, eq=False)
class PlatformTrack:
    """Position and attitude of a platform over time.

    Attributes:
        seconds: increasing times, s, shape (n,).
        positions: positions of base_link in map, m, shape (n, 3).
        velocities: velocities in map, m/s, shape (n, 3); None: the slope of the positions.
        attitudes: quaternions (x, y, z, w) that turn body (forward, left, up) into map axes, shape (n, 4); None: level,
            along the track.
        covariances: covariances of position (m^2) and attitude (rad^2) in map axes, shape (n, 6, 6); None: not known.
        start_ns: start of the seconds, ns since 1970; None: the start of the pulse times.
    """

    seconds: F64
    positions: F64
    velocities: F64 | None = None
    attitudes: F64 | None = None
    covariances: F64 | None = None
    start_ns: int | None = None

    def states(self, start_ns: int) -> list[PlatformState]:
        """The states; the seconds count from `start_ns`, ns since 1970, unless the track states a start.

        Raises:
            UserError: sizes that do not fit, values that are not finite, or times that do not increase.
        """
        sizes = {"seconds": (), "positions": (3,), "velocities": (3,), "attitudes": (4,), "covariances": (6, 6)}
        for name, tail in sizes.items():
            values = getattr(self, name)
            if values is None:
                continue
            if np.shape(values) != (len(self.seconds), *tail) or not np.all(np.isfinite(values)):
                raise UserError(
                    f"The track has {name} of shape {np.shape(values)}; they must be finite numbers of shape "
                    f"{(len(self.seconds), *tail)}."
                )
        begin_ns = start_ns if self.start_ns is None else self.start_ns
        stamps: I64 = begin_ns + np.rint(np.asarray(self.seconds) * 1e9).astype(np.int64)
        if len(stamps) < 2 or np.any(np.diff(stamps) <= 0):
            raise UserError("The track must have two or more samples whose times increase.")
        states = level_states(stamps, np.asarray(self.positions), self.velocities)
        for field, values in (("orientation", self.attitudes), ("covariance", self.covariances)):
            if values is not None:
                states = [replace(state, **{field: value}) for state, value in zip(states, values, strict=True)]
        return states


LEVEL_NOT_KNOWN = Altitudes()
"""Altitudes above a level that nobody states."""


def read_track(path: Path, origin: Origin | None, altitudes: Altitudes = LEVEL_NOT_KNOWN) -> PlatformTrack:
    """The track in a CSV file with a line of names, or in an SBET file (.sbet, .out).

    Columns of a CSV are time (s); x, y, z (map, m) or latitude, longitude (degrees), height (m, above a level); if they
    are there vx, vy, vz (map, m/s); and qx, qy, qz, qw, or roll, pitch, heading as in aviation (degrees: right wing
    down, nose up, from north over east). Times of SBET are seconds of the GPS week, and its heights are above the
    ellipsoid unless `altitudes` says otherwise.

    Args:
        path: CSV or SBET file.
        origin: origin of the map; None: not known.
        altitudes: level of heights.

    Raises:
        UserError: it cannot be read, columns are missing or not numeric, or positions on the earth have no origin.
    """
    if path.suffix.lower() in {".sbet", ".out"}:
        return _read_sbet(path, origin, altitudes)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            names, *lines = [[word.strip() for word in line] for line in csv.reader(file) if any(line)]
    except (OSError, ValueError, csv.Error) as error:
        raise UserError(f"Track {path} is not a readable CSV file with a line of names: {error}.") from error
    if "time" not in names or not ({*MAP} <= {*names} or {*EARTH} <= {*names}):
        raise UserError(
            f"Track {path} has the columns {', '.join(names)}; needed are time, and {', '.join(MAP)} or "
            f"{', '.join(EARTH)}."
        )
    try:
        table = np.array([[float(word) for word in line] for line in lines]).reshape(-1, len(names))
    except ValueError as error:
        raise UserError(f"Track {path} must have {len(names)} numbers in each line: {error}.") from error
    columns = dict(zip(names, table.T, strict=True))

    def stacked(wanted: Sequence[str]) -> F64 | None:
        return np.stack([columns[name] for name in wanted], axis=-1) if {*wanted} <= {*columns} else None

    positions, attitudes, angles, covariances = stacked(MAP), stacked(QUATERNION), stacked(ANGLES), None
    if positions is None:
        latitude, longitude, height = (columns[name] for name in EARTH)
        height = height + altitudes.offset_m
        positions = on_earth(path, origin).to_map(np.radians(latitude), np.radians(longitude), height)
        if not altitudes.is_known:
            _LOG.warning("Track %s: %s", path, UNKNOWN_LEVEL)
            covariances = np.zeros((len(table), 6, 6))
            covariances[:, :3, :3] = altitudes.added_to(np.zeros((3, 3)))
    if attitudes is None and angles is not None:
        attitudes = _attitudes(np.radians(angles), positions, origin)
    return PlatformTrack(columns["time"], positions, stacked(VELOCITY), attitudes, covariances)


def _read_sbet(path: Path, origin: Origin | None, altitudes: Altitudes) -> PlatformTrack:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"Track {path} cannot be read: {error.strerror}.") from error
    if not content or len(content) % SBET.itemsize:
        raise UserError(f"Track {path} has {len(content)} bytes; SBET has records of {SBET.itemsize}.")
    records = np.frombuffer(content, SBET)
    place = [records[name] for name in EARTH]
    if not np.all(np.isfinite(place)) or np.abs(records["latitude"]).max() > np.pi / 2:
        raise UserError(f"Track {path} has latitudes out of range; it is no SBET file.")
    latitude, longitude, height = place
    positions = on_earth(path, origin).to_map(latitude, longitude, height + altitudes.offset_m)
    roll, pitch, heading = (records[name] for name in ANGLES)
    angles = np.stack([roll, pitch, heading - records["wander"]], axis=-1)
    return PlatformTrack(records["time"].copy(), positions, None, _attitudes(angles, positions, origin))


def on_earth(path: Path, origin: Origin | None) -> Origin:
    """The origin of the map, which a track of positions on the earth needs.

    Raises:
        UserError: it is not known.
    """
    if origin is None:
        raise UserError(f"Track {path} has positions on the earth; state the origin of the map (key origin).")
    return origin


def _attitudes(angles: F64, positions: F64, origin: Origin | None) -> F64:
    """Quaternions of roll, pitch and heading (rad) against north, east and down at the platform, shape (n, 4)."""
    aviation = Axes("ned", "frd")
    locally = Rotation.from_quat(
        [aviation.attitude(turn) for turn in Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat()]
    )
    if origin is None:
        return np.asarray(locally.as_quat())
    return np.array(
        [
            quaternion_of(origin.turn_at(position) @ turn)
            for position, turn in zip(positions, locally.as_matrix(), strict=True)
        ]
    )


_LOG = logging.getLogger(__name__)

IMU_TYPE = "sensor_msgs/msg/Imu"


def read_recorded_track(bag: Path, origin: Origin | None, altitudes: Altitudes = LEVEL_NOT_KNOWN) -> PlatformTrack:
    """The track in a bag, with times counted from its first sample.

    It is read from nav_msgs/Odometry of base_link in map, if the bag has that; else from sensor_msgs/NavSatFix, with
    the attitudes of sensor_msgs/Imu against east, north and up (REP 145) if there are any. One topic of each type is
    allowed, whatever its name. Samples that cannot be used are left out and logged.

    Args:
        bag: folder or file, of any storage that `BagReader` reads.
        origin: origin of the map, which odometry does not need; None: not known.
        altitudes: level of the altitudes of fixes.

    Raises:
        UserError: the bag cannot be read, has no such topic or several of a type, has fewer than two samples, or has
            fixes and the origin is not known.
    """
    reader = BagReader(bag)
    if odometry := _topic(reader, ODOMETRY_TYPE):
        return _track_of(bag, _read(reader, odometry, messages.state_from_message))
    fixes = _topic(reader, FIX_TYPE)
    if fixes is None:
        raise UserError(f"Bag {bag} has no track; needed is a topic of type {ODOMETRY_TYPE} or {FIX_TYPE}.")
    place = on_earth(bag, origin)
    if not altitudes.is_known:
        _LOG.warning("Bag %s: %s", bag, UNKNOWN_LEVEL)
    positions = _read(reader, fixes, lambda message: messages.read_fix(message, place, altitudes))
    attitudes = _topic(reader, IMU_TYPE)
    if attitudes is None:
        return _track_of_positions(bag, positions)
    return _track_of(bag, _merged(bag, positions, _read(reader, attitudes, _attitude), place))


def _topic(reader: BagReader, type_name: str) -> str | None:
    """The topic of a type, apart from that of the map's origin; None: absent.

    Raises:
        UserError: there are several.
    """
    names = [name for name, one in reader.topics.items() if one.type_name == type_name and one.count]
    names = [name for name in names if not name.endswith(f"/{MAP_ORIGIN}")]
    if len(names) > 1:
        raise UserError(
            f"Bag {reader.path} has several topics of type {type_name} ({', '.join(sorted(names))}); leave one of them "
            "in it (ros2 bag filter, or record that one alone)."
        )
    return names[0] if names else None


def _read(reader: BagReader, topic: str, read: Callable[[Any], Any]) -> list[Any]:
    """Samples from the messages on a topic, in the order of their stamps; of several with one stamp, the first."""
    found: dict[int, Any] = {}
    refused: list[Rejected] = []
    for recorded in reader.messages([topic]):
        try:
            sample = read(reader.decode(recorded.type_name, recorded.cdr))
        except Rejected as reason:
            refused.append(reason)
            continue
        found.setdefault(sample.stamp_ns, sample)
    if refused:
        _LOG.warning("Bag %s: %d messages on %s are not used. %s", reader.path, len(refused), topic, str(refused[0]))
    return [found[stamp_ns] for stamp_ns in sorted(found)]


def _attitude(message: Any) -> Sample:
    """The attitude in an Imu message, whatever the name of its frame, which must point as base_link does."""
    return messages.read_attitude(message, messages.Frames(body=message.header.frame_id))


def _merged(bag: Path, positions: Sequence[Sample], attitudes: Sequence[Sample], origin: Origin) -> list[PlatformState]:
    """A state for each attitude that positions lie around."""
    longest_gap_s = 2.0  # longest time between two fixes that is bridged, s: receivers give one to twenty a second
    navigation = Navigation(longest_gap_s, velocity_is_measured=False, local_to=origin)
    add = {"position": navigation.add_position, "attitude": navigation.add_attitude}
    kinds = (
        [(sample, kind) for sample in samples] for kind, samples in (("position", positions), ("attitude", attitudes))
    )
    states: list[PlatformState] = []
    declined: list[Rejected] = []
    for sample, kind in merge(*kinds, key=lambda entry: entry[0].stamp_ns):
        add[kind](sample)
        made, without = navigation.take()
        states += made
        declined += without
    if declined:
        _LOG.warning("Bag %s: %d attitudes are not used. %s", bag, len(declined), str(declined[-1]))
    return states


def _track_of(bag: Path, states: Sequence[PlatformState]) -> PlatformTrack:
    _check_number(bag, len(states))
    return PlatformTrack(
        _seconds([state.stamp_ns for state in states]),
        np.stack([state.position for state in states]),
        np.stack([state.velocity for state in states]),
        np.stack([state.orientation for state in states]),
        np.stack([state.covariance for state in states]),
        states[0].stamp_ns,
    )


def _track_of_positions(bag: Path, positions: Sequence[Sample]) -> PlatformTrack:
    _check_number(bag, len(positions))
    covariances = np.zeros((len(positions), 6, 6))
    covariances[:, :3, :3] = [sample.covariance for sample in positions]
    return PlatformTrack(
        _seconds([sample.stamp_ns for sample in positions]),
        np.stack([sample.value for sample in positions]),
        covariances=covariances,
        start_ns=positions[0].stamp_ns,
    )


def _check_number(bag: Path, count: int) -> None:
    if count < 2:
        raise UserError(f"Bag {bag} has {count} samples of a track that can be used; two or more are needed.")


def _seconds(stamps_ns: Sequence[int]) -> F64:
    """Seconds since the first stamp."""
    return np.array([stamp_ns - stamps_ns[0] for stamp_ns in stamps_ns], dtype=np.float64) * 1e-9
