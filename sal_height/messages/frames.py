"""Conversion of platform states (Odometry) and phase histories (ChannelFrame)."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from sal_height.errors import Rejected
from sal_height.geometry import PlatformState, rotation_matrix
from sal_height.messages.basics import (
    FARTHEST,
    FASTEST,
    USUAL,
    Frames,
    check_channel,
    check_finite,
    check_rotation,
    to_ns,
    xyz,
)
from sal_height.messages.received import Pose, ReceivedFrame
from sal_height.messages.types import ChannelFrame, Header, Odometry, Point, Quaternion, Time, Vector3
from sal_height.numeric import C64, F32, F64, U8
from sal_height.sensor import PhaseHistory, Sensor

LONGEST_DWELL = 3600.0
"""Greatest time from the stamp of a frame to its last pulse, s."""

GREATEST_RANGE = 1e8
"""Greatest reference range of a frame, m."""

Frame: TypeAlias = ChannelFrame | ReceivedFrame
"""A frame, as a message or as received."""

SAMPLE_BYTES = {ChannelFrame.COMPLEX_FLOAT32: 8, ChannelFrame.COMPLEX_INT16: 4}
"""Bytes per complex sample by ChannelFrame.encoding."""


def state_to_message(state: PlatformState, stamp: Time, frames: Frames = USUAL) -> Odometry:
    """Return the Odometry of a platform state: pose of the body in map, velocity in the axes of the body."""
    message = Odometry(header=Header(stamp=stamp, frame_id=frames.map), child_frame_id=frames.body)
    message.pose.pose.position = Point(**xyz(state.position))
    message.pose.pose.orientation = Quaternion(**dict(zip("xyzw", state.orientation.tolist(), strict=True)))
    message.pose.covariance = state.covariance.ravel()
    body_velocity = state.velocity @ rotation_matrix(state.orientation)
    message.twist.twist.linear = Vector3(**xyz(body_velocity))
    message.twist.covariance = twist_covariance(state).ravel()
    return message


def twist_covariance(state: PlatformState) -> F64:
    """Covariance of the twist of a platform state, shape (6, 6); that of its rotation is not known."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = state.velocity_covariance
    return covariance


def state_from_message(message: Odometry) -> PlatformState:
    """Return the platform state that an Odometry describes, with the velocity in the axes of map.

    Raises:
        Rejected: as `state_of_pose` does.
    """
    return state_of_pose(Pose.of(message))


def state_of_pose(pose: Pose, frames: Frames = USUAL) -> PlatformState:
    """Return the platform state of the pose in an Odometry, with the velocity in the axes of map, which are ROS's.

    Raises:
        Rejected: the frames are others than `frames`, a value is not finite, place or speed are not those of a
            platform, or the quaternion of the orientation has not the norm 1.
    """
    if (pose.frame_id, pose.child_frame_id) != (frames.map, frames.body):
        raise Rejected(
            "wrong frames",
            f"Odometry has child_frame_id {pose.child_frame_id!r} and frame_id {pose.frame_id!r}; it must be of "
            f"{frames.body!r} in {frames.map!r}. Parameters map_frame and body_frame set these names, map_axes and "
            "body_axes how their axes point.",
        )
    orientation = pose.orientation
    check_finite((*pose.position, *pose.velocity), "Odometry")
    if math.hypot(*pose.position) > FARTHEST or math.hypot(*pose.velocity) > FASTEST:
        raise Rejected(
            "no platform",
            f"Odometry has the position {np.round(pose.position).tolist()} m and the velocity "
            f"{np.round(pose.velocity).tolist()} m/s; at most {FARTHEST:g} m from the origin and {FASTEST:g} m/s are "
            "allowed.",
        )
    check_rotation(orientation, "Odometry")
    state = PlatformState(
        stamp_ns=pose.stamp_ns,
        position=np.array(pose.position),
        orientation=np.array(orientation),
        velocity=rotation_matrix(orientation) @ pose.velocity,
        covariance=pose.covariance.reshape(6, 6),
        velocity_covariance=pose.velocity_covariance,
    )
    return frames.axes.state(state)


def history_to_messages(history: PhaseHistory, sensor: Sensor, dwell: int, stamp: Time) -> list[ChannelFrame]:
    """Return one ChannelFrame per channel of a dwell, with samples encoded as "complex_float32"."""
    return [
        ChannelFrame(
            header=Header(stamp=stamp, frame_id=sensor.mounting.frame_id),
            dwell=dwell,
            channel=channel,
            config_hash=sensor.config_hash,
            pulse_count=samples.shape[0],
            sample_count=samples.shape[1],
            pulse_time=history.pulse_times,
            reference_range=history.reference_range,
            encoding=ChannelFrame.COMPLEX_FLOAT32,
            samples=_bytes_of(samples),
        )
        for channel, samples in enumerate(history.samples)
    ]


def check_frame(frame: Frame, sensor: Sensor) -> None:
    """Check that a frame has the sizes that its sensor states, and values that can be processed.

    Raises:
        Rejected: it has not; the sentence names the field, its value and what is allowed.
    """
    where = f"ChannelFrame of dwell {frame.dwell}, channel {frame.channel}"
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
    if frame.encoding == ChannelFrame.COMPLEX_INT16 and not 0 < frame.scale < np.inf:
        raise Rejected("wrong scale", f"{where}: scale is {frame.scale}; it must be finite and greater than 0.")
    if not _are_finite(samples_of(frame).view(np.float32).ravel()):
        raise Rejected("not finite", f"{where}: samples has NaN or infinite entries; all must be finite.")
    if fault := _fault_of_pulses(frame.pulse_time.tobytes(), frame.reference_range.tobytes()):
        raise Rejected(fault[0], f"{where}: {fault[1]}")


def _are_finite(numbers: F32) -> bool:
    """Whether all numbers are finite, as they are if the sum of their squares is, which takes less time to tell."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.dot(numbers, numbers)) or np.isfinite(numbers).all())


@functools.lru_cache(maxsize=2)
def _fault_of_pulses(pulse_time: bytes, reference_range: bytes) -> tuple[str, str] | None:
    """What is wrong with the times and ranges of a dwell's pulses, which all its frames share: reason and sentence."""
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


def samples_of(frame: Frame) -> C64:
    """Return the samples of a frame in the unit of the receiver, complex64, shape (pulses, samples).

    Of "complex_float32" they are a view, of "complex_int16" a copy multiplied by the scale.
    """
    shape = frame.pulse_count, frame.sample_count
    if frame.encoding == ChannelFrame.COMPLEX_FLOAT32:
        return np.frombuffer(frame.samples, "<c8").reshape(shape)
    scaled = np.frombuffer(frame.samples, "<i2") * np.float32(frame.scale)
    return scaled.view(np.complex64).reshape(shape)


def _bytes_of(samples: C64) -> U8:
    """Return the value of ChannelFrame.samples in the encoding "complex_float32", a view of them."""
    return np.ascontiguousarray(samples, dtype="<c8").reshape(-1).view(np.uint8)


def history_from_messages(frames: Sequence[Frame]) -> PhaseHistory:
    """Return the phase history of a dwell from the frames of all channels, in order, that `check_frame` has passed.

    Raises:
        Rejected: the channels differ in pulse times or reference ranges.
    """
    first = frames[0]
    times, ranges = first.pulse_time.tobytes(), first.reference_range.tobytes()
    for frame in frames[1:]:
        if frame.pulse_time.tobytes() != times or frame.reference_range.tobytes() != ranges:
            raise Rejected(
                "channels disagree",
                f"Dwell {first.dwell}: channel {frame.channel} has other pulse times or reference ranges than "
                f"channel {first.channel}; those of all channels must be equal.",
            )
    return PhaseHistory(
        stamp_ns=to_ns(first.header.stamp),
        pulse_times=np.array(first.pulse_time),
        reference_range=np.array(first.reference_range),
        samples=np.stack([samples_of(frame) for frame in frames]),
    )
