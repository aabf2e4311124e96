"""Items of a flight: sensor and platform states, and the phase history of one channel and dwell with its checks."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sal_height.engine.stage import DwellKey
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, quaternion_of, rotation_matrix
from sal_height.numeric import C64, F32, F64, U8
from sal_height.sensor import PhaseHistory, Sensor

FARTHEST = 1e7
"""Greatest distance from the origin of the map, m: what is farther, or higher, is no place that a platform sees."""

FASTEST = 1e5
"""Greatest speed of a platform, m/s: ten times that of satellites."""

FINEST = 1e-6
"""Least distance of pixels, m: finer than any wavelength."""

LONGEST_DWELL = 3600.0
"""Greatest time from the stamp of a frame to its last pulse, s."""

GREATEST_RANGE = 1e8
"""Greatest reference range of a frame, m."""

COMPLEX_FLOAT32, COMPLEX_INT16 = "complex_float32", "complex_int16"

SAMPLE_BYTES = {COMPLEX_FLOAT32: 8, COMPLEX_INT16: 4}
"""Bytes per complex sample by encoding."""


@dataclass(frozen=True, eq=False)
class Aperture:
    """State of the sensor in the middle of the aperture, with its rotation as a quaternion.

    A matrix and back gives another last bit; the numbers that a message carries are those of the quaternion.

    Attributes:
        position: position of the antenna in map, m, shape (3,).
        orientation: orientation of the sensor frame in map, quaternion x, y, z, w.
        velocity: velocity of the antenna in map axes, m/s, shape (3,).
        length: length of the synthetic aperture, m.
        covariance: covariance of position (m^2) and rotation about x, y, z of map (rad^2), shape (6, 6); 0: not known.
        sliding: True if the aperture slides along the flight with the columns.
    """

    position: F64
    orientation: tuple[float, float, float, float]
    velocity: F64
    length: float
    covariance: F64
    sliding: bool

    @classmethod
    def of(cls, state: ApertureState) -> Aperture:
        """The same as a message states it."""
        x, y, z, w = quaternion_of(state.rotation)
        covariance = np.asarray(state.covariance, np.float64).reshape(6, 6)
        return cls(
            state.position,
            (float(x), float(y), float(z), float(w)),
            state.velocity,
            float(state.length),
            covariance,
            state.sliding,
        )

    @cached_property
    def state(self) -> ApertureState:
        """The same as images and heights are made with."""
        return ApertureState(
            self.position, self.velocity, rotation_matrix(self.orientation), self.length, self.covariance, self.sliding
        )

    def __eq__(self, other: object) -> bool:
        """True if all numbers are equal."""
        return self is other or (
            isinstance(other, Aperture)
            and (self.orientation, self.length, self.sliding) == (other.orientation, other.length, other.sliding)
            and all(
                np.array_equal(ours, theirs)
                for ours, theirs in (
                    (self.position, other.position),
                    (self.velocity, other.velocity),
                    (self.covariance, other.covariance),
                )
            )
        )

    __hash__ = None  # type: ignore[assignment]


def are_equal(one: Grid, other: Grid) -> bool:
    """True if two grids have the same pixels."""
    return one is other or (
        (one.row_spacing, one.col_spacing, one.rows, one.cols)
        == (other.row_spacing, other.col_spacing, other.rows, other.cols)
        and np.array_equal(one.origin, other.origin)
        and np.array_equal(one.row_direction, other.row_direction)
        and np.array_equal(one.col_direction, other.col_direction)
    )


def check_geometry(grid: Grid, aperture: Aperture, where: str) -> None:
    """Check that the grid and the aperture of an image are finite and possible.

    Raises:
        Rejected: a value is not finite or beyond FARTHEST, a direction or the orientation has not the norm 1, a spacing
            is less than FINEST, or the velocity is 0; the message begins with `where`.
    """
    directions = grid.row_direction.tolist(), grid.col_direction.tolist()
    places = *grid.origin.tolist(), *aperture.position.tolist(), *aperture.velocity.tolist()
    spacings = grid.row_spacing, grid.col_spacing
    if not all(abs(number) <= FARTHEST for number in (*places, *directions[0], *directions[1], *spacings)):
        raise Rejected(
            "not finite",
            f"{where}: grid or aperture has values that are NaN, infinite or beyond {FARTHEST:g} m, farther than "
            "any platform sees.",
        )
    norms = [math.hypot(*numbers) for numbers in (*directions, aperture.orientation)]
    if not (all(abs(norm - 1) <= 0.01 for norm in norms) and min(spacings) >= FINEST):
        raise Rejected(
            "wrong geometry",
            f"{where}: row_direction, col_direction and orientation have the norms {np.round(norms, 3).tolist()}, the "
            f"spacings are {grid.row_spacing:g} and {grid.col_spacing:g} m; norms must be 1, spacings {FINEST:g} m or "
            "more.",
        )
    if not aperture.velocity.any():
        raise Rejected("wrong geometry", f"{where}: aperture.velocity is 0; a synthetic aperture needs motion.")


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Samples of one channel in one dwell.

    Attributes:
        key: sensor, number and stamp of the dwell.
        frame_id: name of the sensor's frame of coordinates.
        channel: number of the channel.
        pulse_count: number of pulses.
        sample_count: samples in each pulse.
        pulse_time: time of every pulse after the stamp, s, shape (pulses,).
        reference_range: range to which each pulse's phase refers, m, shape (pulses,).
        encoding: name of the encoding, one of SAMPLE_BYTES.
        scale: unit of the receiver per integer step.
        samples: bytes of the samples, in the encoding.
        size: size of the message, bytes.
    """

    key: DwellKey
    frame_id: str
    channel: int
    pulse_count: int
    sample_count: int
    pulse_time: F64
    reference_range: F64
    encoding: str
    scale: float
    samples: U8
    size: int = 0

    @property
    def end_ns(self) -> int:
        """Time of the last pulse, ns."""
        return self.key.stamp_ns + round(float(self.pulse_time[-1]) * 1e9)

    def blank(self, channel: int) -> Frame:
        """A frame of zeros for a channel that is missing: estimators leave such a channel out as dead."""
        return replace(self, channel=channel, samples=np.zeros_like(self.samples))


def frames_of(history: PhaseHistory, sensor: Sensor, dwell: int, stamp_ns: int | None = None) -> list[Frame]:
    """The frames of all channels of a dwell, with samples encoded as "complex_float32".

    Args:
        history: phase history of all channels.
        sensor: sensor that recorded it.
        dwell: number of the dwell.
        stamp_ns: time of the first pulse, ns; None: that of the history.
    """
    key = DwellKey(sensor.config_hash, dwell, history.stamp_ns if stamp_ns is None else stamp_ns)
    return [
        Frame(
            key,
            sensor.mounting.frame_id,
            channel,
            samples.shape[0],
            samples.shape[1],
            history.pulse_times,
            history.reference_range,
            COMPLEX_FLOAT32,
            0.0,
            np.ascontiguousarray(samples, dtype="<c8").reshape(-1).view(np.uint8),
            samples.nbytes,
        )
        for channel, samples in enumerate(history.samples)
    ]


def check_frame(frame: Frame, sensor: Sensor) -> None:
    """Check that a frame has the sizes that its sensor states, and values that can be processed.

    Raises:
        Rejected: it has not; the message names the field, its value and what is allowed.
    """
    where = f"ChannelFrame of dwell {frame.key.number}, channel {frame.channel}"
    check_channel(frame.channel, sensor, where)
    expected = (sensor.pulse_count, sensor.sample_count)
    if (frame.pulse_count, frame.sample_count) != expected:
        raise Rejected(
            "contradicts sensor info",
            f"{where}: the frame has {frame.pulse_count} pulses of {frame.sample_count} samples; SensorInfo states "
            f"{expected[0]} of {expected[1]}.",
        )
    if frame.encoding not in SAMPLE_BYTES:
        raise Rejected(
            "unknown encoding", f"{where}: encoding is {frame.encoding!r}; allowed are {', '.join(SAMPLE_BYTES)}."
        )
    size = SAMPLE_BYTES[frame.encoding] * expected[0] * expected[1]
    wanted = {"samples": size, "pulse_time": expected[0], "reference_range": expected[0]}
    for field, count in wanted.items():
        if len(getattr(frame, field)) != count:
            raise Rejected(
                "wrong size", f"{where}: {field} has {len(getattr(frame, field))} entries; it must have {count}."
            )
    if frame.encoding == COMPLEX_INT16 and not 0 < frame.scale < np.inf:
        raise Rejected("wrong scale", f"{where}: scale is {frame.scale}; it must be finite and greater than 0.")
    if not _are_finite(samples_of(frame).view(np.float32).ravel()):
        raise Rejected("not finite", f"{where}: samples has NaN or infinite entries; all must be finite.")
    if fault := _fault_of_pulses(frame.pulse_time.tobytes(), frame.reference_range.tobytes()):
        raise Rejected(fault[0], f"{where}: {fault[1]}")


def check_channel(channel: int, sensor: Sensor, where: str) -> None:
    """Check that the sensor has a channel of that number.

    Raises:
        Rejected: it has not; the message begins with `where`.
    """
    if not 0 <= channel < sensor.detector_count:
        raise Rejected("unknown channel", f"{where}: SensorInfo has channels 0 to {sensor.detector_count - 1}.")


def samples_of(frame: Frame) -> C64:
    """The samples of a frame in the unit of the receiver, complex64, shape (pulses, samples).

    Of "complex_float32" they are a view, of "complex_int16" a copy multiplied by the scale.
    """
    shape = frame.pulse_count, frame.sample_count
    if frame.encoding == COMPLEX_FLOAT32:
        return np.frombuffer(frame.samples, "<c8").reshape(shape)
    scaled = np.frombuffer(frame.samples, "<i2") * np.float32(frame.scale)
    return scaled.view(np.complex64).reshape(shape)


def history_of(frames: Sequence[Frame]) -> PhaseHistory:
    """The phase history of a dwell from the frames of all channels, in order, that `check_frame` has passed.

    Raises:
        Rejected: the channels differ in pulse times or reference ranges.
    """
    first = frames[0]
    times, ranges = first.pulse_time.tobytes(), first.reference_range.tobytes()
    for frame in frames[1:]:
        if frame.pulse_time.tobytes() != times or frame.reference_range.tobytes() != ranges:
            raise Rejected(
                "channels disagree",
                f"Dwell {first.key.number}: channel {frame.channel} has other pulse times or reference ranges than "
                f"channel {first.channel}; those of all channels must be equal.",
            )
    return PhaseHistory(
        stamp_ns=first.key.stamp_ns,
        pulse_times=np.array(first.pulse_time),
        reference_range=np.array(first.reference_range),
        samples=np.stack([samples_of(frame) for frame in frames]),
    )


def _are_finite(numbers: F32) -> bool:
    """True if all numbers are finite, as they are if the sum of their squares is, which takes less time to find."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.dot(numbers, numbers)) or np.isfinite(numbers).all())


@functools.lru_cache(maxsize=2)
def _fault_of_pulses(pulse_time: bytes, reference_range: bytes) -> tuple[str, str] | None:
    """Fault of the times and ranges of a dwell's pulses, which all its frames share: reason and message; or None."""
    times, ranges = np.frombuffer(pulse_time), np.frombuffer(reference_range)
    for field, numbers in (("pulse_time", times), ("reference_range", ranges)):
        if not np.isfinite(numbers).all():
            return "not finite", f"{field} has NaN or infinite entries; all must be finite."
    if (times[1:] < times[:-1]).any() or times[0] < 0 or not times[0] < times[-1] <= LONGEST_DWELL:
        return (
            "wrong pulse times",
            (
                f"pulse_time runs from {times[0]:g} to {times[-1]:g} s; it must not decrease, must not be constant, "
                f"and must lie between 0 and {LONGEST_DWELL:g} s."
            ),
        )
    if not (ranges.min() > 0 and ranges.max() <= GREATEST_RANGE):
        return (
            "wrong reference range",
            (
                f"reference_range runs from {ranges.min():g} to {ranges.max():g} m; it must be greater than 0 and at "
                f"most {GREATEST_RANGE:g} m."
            ),
        )
    return None
