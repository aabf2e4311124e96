"""The track of a platform from a bag: odometry, or satellite fixes and the attitudes of an inertial unit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE, ODOMETRY_TYPE
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Navigation, Origin, PlatformState, Sample
from sal_height.imports.track import PlatformTrack, on_earth
from sal_height.numeric import F64
from sal_height.topics import MAP_ORIGIN

_LOG = logging.getLogger(__name__)

IMU_TYPE = "sensor_msgs/msg/Imu"


def read_recorded_track(bag: Path, origin: Origin | None) -> PlatformTrack:
    """The track in a bag, with times counted from its first sample.

    It is read from nav_msgs/Odometry of base_link in map, if the bag has that; else from sensor_msgs/NavSatFix, with
    the attitudes of sensor_msgs/Imu against east, north and up (REP 145) if there are any. One topic of each type is
    allowed, whatever its name. Samples that cannot be used are left out and logged.

    Args:
        bag: folder or file, of any storage that `BagReader` reads.
        origin: origin of the map, which odometry does not need; None: not known.

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
    positions = _read(reader, fixes, lambda message: messages.read_fix(message, place))
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
