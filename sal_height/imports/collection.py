"""Recordings of a sensor on a flight, its description in YAML, and the bag made of both."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic_core import PydanticCustomError
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sal_height import messages, topics
from sal_height.bag import qos
from sal_height.bag.files import PARAMETERS
from sal_height.bag.qos import Qos
from sal_height.bag.topics import FIX_TYPE, FRAME_TYPE, ODOMETRY_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.configuration import Float, StrictKeys, read_yaml, validated
from sal_height.errors import UserError
from sal_height.geometry import Altitudes, Mounting, Origin, PlatformState
from sal_height.messages.types import ChannelFrame
from sal_height.numeric import F64, I64
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import MountingSettings, OriginSettings, UncertaintySettings
from sal_height.topics import MAP_ORIGIN

Positive = Annotated[Float, Gt(0)]

SENSOR_INFO, ODOMETRY, FRAMES = (f"/{name}" for name in (topics.SENSOR_INFO, topics.ODOMETRY, topics.PHASE_HISTORY))


@dataclass(frozen=True)
class Description(StrictKeys):
    """A sensor without the sizes of its dwells, which their arrays have; keys are in docs/import.md."""

    name: Annotated[str, MinLen(1)]
    look_side: Literal["left", "right"]
    bandwidth_hz: Positive
    elevation_diameter_m: Positive
    azimuth_diameter_m: Positive
    elevation_boresights_rad: Annotated[tuple[Float, ...], MinLen(1)]
    wavelength_m: Positive | None = None
    carrier_hz: Positive | None = None
    pattern: Literal["gaussian", "sinc", "jinc"] = "sinc"
    noise_power: tuple[Annotated[Float, Ge(0)], ...] = ()
    mode: Literal["spotlight", "stripmap"] = "spotlight"
    waveform: Literal["spectrum", "chirp", "deramped"] = "spectrum"
    chirp_rate_hz_per_s: Float = 0.0
    pulse_duration_s: Annotated[Float, Ge(0)] = 0.0
    sampling_rate_hz: Annotated[Float, Ge(0)] = 0.0
    full_scale: Annotated[Float, Ge(0)] = 0.0
    mounting: MountingSettings = field(default_factory=MountingSettings)
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)
    assumed_attitude_sigma_rad: Annotated[Float, Gt(0), Lt(1)] = 0.05
    assumed_heading_sigma_rad: Annotated[Float, Gt(0), Le(np.pi)] = 0.1
    altitude_above: Literal["unknown", "ellipsoid", "geoid"] = "unknown"
    geoid_height_m: Annotated[Float, Ge(-120), Le(100)] = 0.0
    origin: OriginSettings | None = None
    processing: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.wavelength_m is None) == (self.carrier_hz is None):
            raise PydanticCustomError("carrier", "it must have either wavelength_m or carrier_hz")

    @property
    def place(self) -> Origin | None:
        """The map's origin on the earth; None: not known."""
        return self.origin.place if self.origin else None

    @property
    def altitudes(self) -> Altitudes:
        """The level above which altitudes of the track are.

        Raises:
            UserError: the height of the geoid is not given, or is given though altitudes are not above it.
        """
        return Altitudes(self.altitude_above, self.geoid_height_m)

    def sensor(self, pulse_count: int, sample_count: int, pulse_repetition_frequency: float) -> Sensor:
        """The sensor of dwells of that size.

        Args:
            pulse_count: number of pulses in a dwell.
            sample_count: number of samples in a pulse.
            pulse_repetition_frequency: pulse repetition frequency, Hz.

        Raises:
            UserError: a value that no sensor has.
        """
        x, y, z, w = Rotation.from_euler("ZYX", self.mounting.boresight_rad[::-1]).as_quat().tolist()
        return Sensor(
            name=self.name,
            look_side={"right": 1, "left": -1}[self.look_side],
            wavelength=self.wavelength_m or speed_of_light / (self.carrier_hz or 1.0),
            bandwidth=self.bandwidth_hz,
            sample_count=sample_count,
            pulse_count=pulse_count,
            pulse_repetition_frequency=pulse_repetition_frequency,
            elevation_diameter=self.elevation_diameter_m,
            azimuth_diameter=self.azimuth_diameter_m,
            pattern=self.pattern,
            elevation_boresights=self.elevation_boresights_rad,
            noise_power=self.noise_power or (0.0,) * len(self.elevation_boresights_rad),
            mode=self.mode,
            waveform=self.waveform,
            chirp_rate=self.chirp_rate_hz_per_s,
            pulse_duration=self.pulse_duration_s,
            sampling_rate=self.sampling_rate_hz,
            full_scale=self.full_scale,
            mounting=self.uncertainty.mounted(
                Mounting(self.mounting.frame_id, self.mounting.lever_arm_m, (x, y, z, w))
            ),
            uncertainty=self.uncertainty.of_sensor,
        )


def read_description(path: Path | str) -> Description:
    """The description in a YAML file.

    Raises:
        UserError: it cannot be read, or a key is missing, unknown or has a value out of its range.
    """
    content = read_yaml(Path(path), f"Sensor {path}", f"File {path} cannot be read.")
    return validated(Description, content, f"Sensor {path}")


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
    recorded = [(begin_ns, SENSOR_INFO, messages.sensor_to_message(sensor, start))]
    if collection.origin:
        topics[f"/{MAP_ORIGIN}"] = FIX_TYPE, qos.LATCHED
        origin = messages.origin_to_message(collection.origin, start, messages.MAP_FRAME)
        recorded.append((begin_ns, f"/{MAP_ORIGIN}", origin))
    odometry = (
        (state.stamp_ns, ODOMETRY, messages.state_to_message(state, messages.to_stamp(state.stamp_ns)))
        for state in collection.states
    )
    with BagWriter(Path(out), {PARAMETERS: json.dumps(collection.parameters)}) as bag:
        for topic, (type_name, offered) in topics.items():
            bag.add_topic(topic, type_name, [offered])
        for time_ns, topic, message in heapq.merge(recorded, odometry, _frames(collection), key=lambda entry: entry[0]):
            bag.write(topic, messages.serialize(message), time_ns, time_ns)


def _frames(collection: Collection) -> Iterator[tuple[int, str, ChannelFrame]]:
    """Time of reception (ns), topic and message of each frame.

    A dwell is complete once odometry from after its last pulse has arrived.
    """
    for dwell, history in enumerate(collection.histories):
        end_ns = history.stamp_of_last_pulse_ns + 1
        after_ns = next((state.stamp_ns for state in collection.states if state.stamp_ns >= end_ns), end_ns)
        start = messages.to_stamp(history.stamp_ns)
        for frame in messages.history_to_messages(history, collection.sensor, dwell, start):
            yield after_ns, FRAMES, frame


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
