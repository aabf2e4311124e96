"""Recordings of a sensor on a flight, and their bag."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height import messages, topics
from sal_height.bag import qos
from sal_height.bag.bulk import frames_of, odometry_of
from sal_height.bag.files import PARAMETERS
from sal_height.bag.qos import Qos
from sal_height.bag.topics import FIX_TYPE, FRAME_TYPE, ODOMETRY_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.geometry import Origin, PlatformState
from sal_height.numeric import F64, I64
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.topics import MAP_ORIGIN

SENSOR_INFO, ODOMETRY, FRAMES = (f"/{name}" for name in (topics.SENSOR_INFO, topics.ODOMETRY, topics.PHASE_HISTORY))


@dataclass(frozen=True, eq=False)
class Collection:
    """A sensor, the dwells that it has recorded, and the track of the platform meanwhile.

    Attributes:
        sensor: sensor of all dwells.
        histories: phase histories of the dwells, in the order of time.
        states: states of base_link, in the order of time, from before the first pulse to after the last one.
        origin: origin of the map frame on the earth; None: not known.
        parameters: node parameters for processing the dwells, by node and name.
    """

    sensor: Sensor
    histories: Sequence[PhaseHistory]
    states: Sequence[PlatformState]
    origin: Origin | None = None
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def check(self) -> None:
        """Check that all parts fit each other.

        Raises:
            UserError: sizes that are not those of the sensor, samples or times that are not finite, times that go back,
                or a track that does not reach from the first pulse to the last one.
        """
        if not self.histories:
            raise UserError("The collection has no dwell; at least one is needed.")
        for number, history in enumerate(self.histories):
            if fault := _fault_of(history, self.sensor):
                raise UserError(f"Dwell {number} of the collection has {fault}.")
        if len(self.states) < 2:
            raise UserError(f"The track has {len(self.states)} states; two or more are needed.")
        first, last = self.histories[0].stamp_ns, self.histories[-1].stamp_of_last_pulse_ns
        begin, end = self.states[0].stamp_ns, self.states[-1].stamp_ns
        if any(later.stamp_ns <= earlier.stamp_ns for earlier, later in pairwise(self.states)):
            raise UserError("The track has times that do not increase from state to state.")
        if begin < 0:
            raise UserError(
                f"The track begins {-begin * 1e-9:.6g} s before 1970; state a start of all times after that (start_ns)."
            )
        if begin > first or end < last:
            raise UserError(
                f"The track reaches from {(begin - first) * 1e-9:.6g} s to {(end - first) * 1e-9:.6g} s after the "
                f"first pulse; pulses go from 0 to {(last - first) * 1e-9:.6g} s."
            )


def _fault_of(history: PhaseHistory, sensor: Sensor) -> str:
    """The reason why a dwell of a sensor cannot be used, as the end of a sentence; empty: none."""
    expected = sensor.detector_count, sensor.pulse_count, sensor.sample_count
    if history.samples.shape != expected:
        return f"samples of shape {history.samples.shape}; the sensor has {expected} channels, pulses and samples"
    for name in ("pulse_times", "reference_range"):
        values = np.asarray(getattr(history, name))
        if values.shape != expected[1:2] or not np.all(np.isfinite(values)):
            return f"{name} of shape {values.shape}; it must be {expected[1]} finite numbers, one per pulse"
    if np.any(np.diff(history.pulse_times) < 0):
        return "pulse times that go back; they must not decrease"
    if not np.all(np.isfinite(history.samples)):
        return "samples that are NaN or infinite; all must be finite"
    return ""


def write_collection(collection: Collection, out: Path | str) -> None:
    """Write a bag, each message logged at the time at which it would have been received.

    Args:
        collection: content of the bag.
        out: folder of the bag, new or empty.

    Raises:
        UserError: parts do not fit each other, or the bag cannot be written.
    """
    collection.check()
    sensor, begin_ns = collection.sensor, collection.states[0].stamp_ns
    start = messages.to_stamp(begin_ns)
    topics: dict[str, tuple[str, Qos]] = {
        SENSOR_INFO: (SENSOR_TYPE, qos.LATCHED),
        ODOMETRY: (ODOMETRY_TYPE, qos.ODOMETRY),
        FRAMES: (FRAME_TYPE, qos.FRAMES),
    }
    recorded = [(SENSOR_INFO, messages.serialize(messages.sensor_to_message(sensor, start)), begin_ns)]
    if collection.origin:
        topics[f"/{MAP_ORIGIN}"] = FIX_TYPE, qos.LATCHED
        origin = messages.origin_to_message(collection.origin, start, messages.MAP_FRAME)
        recorded.append((f"/{MAP_ORIGIN}", messages.serialize(origin), begin_ns))
    recorded += [
        (ODOMETRY, cdr, state.stamp_ns)
        for cdr, state in zip(odometry_of(collection.states), collection.states, strict=True)
    ]
    recorded.sort(key=lambda entry: entry[2])
    waiting = iter(recorded)
    entry = next(waiting, None)
    with BagWriter(Path(out), {PARAMETERS: json.dumps(collection.parameters)}) as bag:
        for topic, (type_name, offered) in topics.items():
            bag.add_topic(topic, type_name, [offered])
        for dwell, history in enumerate(collection.histories):
            # A dwell is complete once odometry from after its last pulse has arrived.
            end_ns = history.stamp_of_last_pulse_ns + 1
            after_ns = next((s.stamp_ns for s in collection.states if s.stamp_ns >= end_ns), end_ns)
            while entry and entry[2] <= after_ns:
                bag.write(entry[0], entry[1], entry[2], entry[2])
                entry = next(waiting, None)
            for cdr in frames_of(history, sensor, dwell):
                bag.write(FRAMES, cdr, after_ns, after_ns)
        while entry:
            bag.write(entry[0], entry[1], entry[2], entry[2])
            entry = next(waiting, None)


def level_states(stamps_ns: I64, positions: F64, velocities: F64 | None = None) -> list[PlatformState]:
    """States of a level platform whose x axis points along its track.

    Args:
        stamps_ns: increasing times, ns since 1970, shape (n,).
        positions: positions in map, m, shape (n, 3).
        velocities: velocities in map, m/s, shape (n, 3); None: the slope of the positions.
    """
    if velocities is None:
        velocities = np.asarray(np.gradient(positions, (stamps_ns - stamps_ns[0]) * 1e-9, axis=0), dtype=np.float64)
    heading = np.arctan2(velocities[:, 1], velocities[:, 0])
    attitudes = Rotation.from_euler("z", heading[:, None]).as_quat()
    return [
        PlatformState(int(stamp), position, attitude, velocity, np.zeros((6, 6)))
        for stamp, position, attitude, velocity in zip(stamps_ns, positions, attitudes, velocities, strict=True)
    ]
