"""The track of a platform from a file: CSV as people write it, and SBET of inertial post-processing."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry import Axes, Origin, PlatformState, quaternion_of
from sal_height.imports.collection import level_states
from sal_height.numeric import F64, I64

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


def read_track(path: Path, origin: Origin | None) -> PlatformTrack:
    """The track in a CSV file with a line of names, or in an SBET file (.sbet, .out).

    Columns of a CSV are time (s); x, y, z (map, m) or latitude, longitude (degrees), height (m above WGS 84); if they
    are there vx, vy, vz (map, m/s); and qx, qy, qz, qw, or roll, pitch, heading as in aviation (degrees: right wing
    down, nose up, from north over east). Times of SBET are seconds of the GPS week.

    Args:
        path: CSV or SBET file.
        origin: origin of the map; None: not known.

    Raises:
        UserError: it cannot be read, columns are missing or not numeric, or positions on the earth have no origin.
    """
    if path.suffix.lower() in {".sbet", ".out"}:
        return _read_sbet(path, origin)
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

    positions, attitudes, angles = stacked(MAP), stacked(QUATERNION), stacked(ANGLES)
    if positions is None:
        latitude, longitude, height = (columns[name] for name in EARTH)
        positions = on_earth(path, origin).to_map(np.radians(latitude), np.radians(longitude), height)
    if attitudes is None and angles is not None:
        attitudes = _attitudes(np.radians(angles), positions, origin)
    return PlatformTrack(columns["time"], positions, stacked(VELOCITY), attitudes)


def _read_sbet(path: Path, origin: Origin | None) -> PlatformTrack:
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
    positions = on_earth(path, origin).to_map(*place)
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
