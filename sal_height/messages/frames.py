"""Conversion of platform states (Odometry) and phase histories (ChannelFrame)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from struct import Struct
from typing import NamedTuple

import numpy as np

from sal_height.engine.frame_items import Frame, frames_of, history_of
from sal_height.engine.frames import USUAL, Frames
from sal_height.engine.geometry_items import FARTHEST, FASTEST
from sal_height.engine.results import DwellKey
from sal_height.errors import Rejected
from sal_height.geometry import PlatformState, rotation_matrix
from sal_height.messages.basics import check_finite, check_rotation, numbers_of, to_ns, to_stamp, xyz
from sal_height.messages.cdr_parts import COUNT, ENCAPSULATION
from sal_height.messages.codec import LITTLE_ENDIAN, deserialize
from sal_height.messages.types import ChannelFrame, Header, Odometry, Point, Quaternion, Time, Vector3
from sal_height.numeric import F64, U8
from sal_height.sensor import PhaseHistory, Sensor


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


def state_from_message(message: Odometry, frames: Frames = USUAL) -> PlatformState:
    """Return the platform state that an Odometry describes, with the velocity in the axes of map, which are ROS's.

    Raises:
        Rejected: the frames are others than `frames`, a value is not finite, position or speed are not those
            of a platform, or the quaternion of the orientation has not the norm 1.
    """
    frame_id, child_frame_id = message.header.frame_id, message.child_frame_id
    if (frame_id, child_frame_id) != (frames.map, frames.body):
        raise Rejected(
            "wrong frames",
            f"Odometry has child_frame_id {child_frame_id!r} and frame_id {frame_id!r}; it must be of "
            f"{frames.body!r} in {frames.map!r}. Parameters map_frame and body_frame set these names, map_axes and "
            "body_axes how their axes point.",
        )
    q = message.pose.pose.orientation
    orientation = q.x, q.y, q.z, q.w
    position, velocity = numbers_of(message.pose.pose.position), numbers_of(message.twist.twist.linear)
    check_finite((*position, *velocity), "Odometry")
    if math.hypot(*position) > FARTHEST or math.hypot(*velocity) > FASTEST:
        raise Rejected(
            "no platform",
            f"Odometry has the position {np.round(position).tolist()} m and the velocity "
            f"{np.round(velocity).tolist()} m/s; at most {FARTHEST:g} m from the origin and {FASTEST:g} m/s are "
            "allowed.",
        )
    check_rotation(orientation, "Odometry")
    state = PlatformState(
        stamp_ns=to_ns(message.header.stamp),
        position=np.array(position),
        orientation=np.array(orientation),
        velocity=rotation_matrix(orientation) @ velocity,
        covariance=message.pose.covariance.reshape(6, 6),
        velocity_covariance=message.twist.covariance.reshape(6, 6)[:3, :3],
    )
    return frames.axes.state(state)


_SCALE_AND_COUNT = Struct("<dI")
"""Scale of a serialized frame, and the number of bytes of its samples, which follow."""


_NO_SAMPLES = np.zeros(0, np.uint8)


class _Shared(NamedTuple):
    """Bytes that the serialized frames of a dwell share: all but those of channel, scale and samples.

    Attributes:
        before: bytes before the channel.
        after: bytes from the channel to the scale.
        frame: the frame that they are of, without samples.
    """

    before: bytes
    after: bytes
    frame: Frame

    def read(self, cdr: bytes) -> Frame | None:
        """The frame that bytes are of; None: they are not of a frame of this dwell."""
        place = len(self.before)
        end = place + COUNT.size + len(self.after)
        begin = end + _SCALE_AND_COUNT.size
        if begin > len(cdr) or not (cdr.startswith(self.before) and cdr.startswith(self.after, place + COUNT.size)):
            return None
        (channel,), (scale, count) = COUNT.unpack_from(cdr, place), _SCALE_AND_COUNT.unpack_from(cdr, end)
        if not 0 < count <= len(cdr) - begin:
            return None
        like = self.frame
        return Frame(
            like.key,
            like.frame_id,
            channel,
            like.pulse_count,
            like.sample_count,
            like.pulse_time,
            like.reference_range,
            like.encoding,
            scale,
            np.frombuffer(cdr, np.uint8, count, begin),
            len(cdr),
        )


def _shared_by(cdr: bytes, frame: Frame) -> _Shared | None:
    """The bytes that the other frames of its dwell share with a frame; None: it has no samples or is big-endian."""
    if not (len(frame.samples) and cdr.startswith(LITTLE_ENDIAN)):
        return None
    frame_id_at = ENCAPSULATION + 8  # after the stamp; it is followed by the number of the dwell
    (length,) = COUNT.unpack_from(cdr, frame_id_at)
    place = frame_id_at + 4 + length + (-length & 3) + 4
    end = _address(frame.samples) - _address(np.frombuffer(cdr, np.uint8)) - _SCALE_AND_COUNT.size
    return _Shared(cdr[:place], cdr[place + COUNT.size : end], frame._replace(samples=_NO_SAMPLES))


def _address(numbers: U8) -> int:
    """Address of an array in memory."""
    return int(numbers.__array_interface__["data"][0])


class _FrameReader:
    """Reads serialized frames; what those of a dwell share is read once."""

    def __init__(self) -> None:
        self._shared: _Shared | None = None

    def read(self, cdr: bytes) -> Frame:
        """Read the bytes of a ChannelFrame; samples are a view of them.

        Raises:
            BrokenMessage: the bytes are not a ChannelFrame.
        """
        frame = self._shared.read(cdr) if self._shared else None
        if frame is None:
            frame = frame_of(deserialize(cdr, ChannelFrame), len(cdr))
            self._shared = _shared_by(cdr, frame)
        return frame


received_frame = _FrameReader().read


@lru_cache(4)  # the frames of a dwell share theirs
def _pulses_of(pulse_time: bytes, reference_range: bytes) -> tuple[F64, F64]:
    """Times and ranges of pulses from their bytes."""
    return np.frombuffer(pulse_time), np.frombuffer(reference_range)


_key_of = lru_cache(4)(DwellKey)
"""The key of a dwell: the same object for all its frames."""


def frame_of(message: ChannelFrame, size: int = 0) -> Frame:
    """Return the frame that a ChannelFrame describes; `size`: bytes of the serialized message."""
    pulse_time, reference_range = _pulses_of(message.pulse_time.tobytes(), message.reference_range.tobytes())
    return Frame(
        _key_of(message.config_hash, message.dwell, to_ns(message.header.stamp)),
        message.header.frame_id,
        message.channel,
        message.pulse_count,
        message.sample_count,
        pulse_time,
        reference_range,
        message.encoding,
        message.scale,
        message.samples,
        size,
    )


def frame_to_message(frame: Frame) -> ChannelFrame:
    """Return the ChannelFrame that describes a frame."""
    return ChannelFrame(
        header=Header(stamp=to_stamp(frame.key.stamp_ns), frame_id=frame.frame_id),
        dwell=frame.key.number,
        channel=frame.channel,
        config_hash=frame.key.sensor,
        pulse_count=frame.pulse_count,
        sample_count=frame.sample_count,
        pulse_time=frame.pulse_time,
        reference_range=frame.reference_range,
        encoding=frame.encoding,
        scale=frame.scale,
        samples=frame.samples,
    )


def history_to_messages(history: PhaseHistory, sensor: Sensor, dwell: int, stamp: Time) -> list[ChannelFrame]:
    """Return one ChannelFrame per channel of a dwell, with samples encoded as "complex_float32"."""
    return [frame_to_message(frame) for frame in frames_of(history, sensor, dwell, to_ns(stamp))]


def history_from_messages(frames: Sequence[ChannelFrame]) -> PhaseHistory:
    """Return the phase history of a dwell from the frames of all channels, in order, that `check_frame` has passed.

    Raises:
        Rejected: the channels differ in pulse times or reference ranges.
    """
    return history_of([frame_of(frame) for frame in frames])
