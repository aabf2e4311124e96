"""Frames, images and odometry as nodes receive them: views of their bytes.

rclpy makes an object of every part of a message and copies all samples: for the images of a small dwell this takes
longer than their transport. Here samples stay where they are, the few numbers beside them are read by their place, and
what the messages of a dwell share is made once. Bytes that are not laid out as expected (another byte order, a text
without its end, too few bytes) are left to rclpy, which reads or refuses them.

The layout is that of plain CDR (OMG DDS-XTypes 1.3, section 7.4.3), which ROS middlewares use.
"""

from __future__ import annotations

import functools
import struct
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sal_height_msgs import msg as messages
from std_msgs.msg import Header

from sal_height.messages.basics import to_ns
from sal_height.messages.provenance import Same
from sal_height.numeric import F32, F64, U8

HELD = 8
"""Provenances held, and as many geometries: those that were used last."""

LITTLE_ENDIAN = b"\x00\x01"
"""First bytes of a message in plain CDR; offsets within a message count from ENCAPSULATION."""

ENCAPSULATION = 4

STAMP, UINT, PAIR, TRIPLE = (struct.Struct(layout) for layout in ("<iI", "<I", "<II", "<III"))
SCALE, NOISE = struct.Struct("<d"), struct.Struct("<dfI")

ODOMETRY = struct.Struct("<7d288x3d312x")
"""Pose, its covariance (passed over), velocity, and what is not used of an Odometry: rotation rate and covariance."""

GEOMETRY_BYTES = 8 * 11 + 2 * 4 + 8 * (7 + 36 + 3 + 1) + 1
"""From origin to cols of a grid, and from pose to sliding of an aperture, without padding."""

NO_PROVENANCE = 3 * b"\x01\x00\x00\x00\x00\x00\x00\x00" + 8 * b"\x00"
"""An empty provenance: three empty texts and two empty lists."""


@dataclass(slots=True, eq=False)
class Received:
    """What frames and images have in common.

    Attributes:
        stamp: of the header, s and ns.
        frame_id: of the header.
        dwell: number of the dwell.
        channel: number of the channel.
        size: bytes of the message.
    """

    stamp: tuple[int, int]
    frame_id: str
    dwell: int
    channel: int
    size: int

    @property
    def stamp_ns(self) -> int:
        """The stamp in nanoseconds."""
        return self.stamp[0] * 1_000_000_000 + self.stamp[1]

    @property
    def header(self) -> Header:
        """The header, made anew."""
        return Header(stamp=Time(sec=self.stamp[0], nanosec=self.stamp[1]), frame_id=self.frame_id)


@dataclass(slots=True, eq=False)
class ReceivedFrame(Received):
    """A ChannelFrame; further attributes are its fields, arrays as NumPy has them."""

    config_hash: str
    pulse_count: int
    sample_count: int
    pulse_time: F64
    reference_range: F64
    encoding: str
    scale: float
    samples: U8

    @property
    def end_ns(self) -> int:
        """Time of the last pulse, ns."""
        return self.stamp_ns + round(self.pulse_time[-1] * 1e9)

    @classmethod
    def of(cls, message: messages.ChannelFrame) -> Self:
        """The same content as a message."""
        samples = np.frombuffer(message.samples, np.uint8) if message.samples else np.empty(0, np.uint8)
        return cls(
            (message.header.stamp.sec, message.header.stamp.nanosec),
            message.header.frame_id,
            message.dwell,
            message.channel,
            samples.nbytes,
            message.config_hash,
            message.pulse_count,
            message.sample_count,
            np.array(message.pulse_time),
            np.array(message.reference_range),
            message.encoding,
            message.scale,
            samples,
        )


@dataclass(slots=True, eq=False)
class Geometry:
    """Where the pixels of images lie, and from where they are seen; the images of a dwell share it.

    Attributes:
        grid: of the pixels.
        aperture: that they are seen from.
        checked: whether it was found to be possible.
    """

    grid: messages.ImageGrid
    aperture: messages.Aperture
    checked: bool = False


@dataclass(slots=True, eq=False)
class ReceivedImage(Received):
    """A ComplexImage; further attributes are its fields, samples as NumPy has them.

    Its geometry and provenance are to be left as they are: other images share them.
    """

    geometry: Geometry
    noise_power: float
    saturated_share: float
    samples: F32
    provenance: messages.Provenance

    @classmethod
    def of(cls, message: messages.ComplexImage) -> Self:
        """The same content as a message."""
        samples = np.array(message.samples, dtype=np.float32)
        return cls(
            (message.header.stamp.sec, message.header.stamp.nanosec),
            message.header.frame_id,
            message.dwell,
            message.channel,
            samples.nbytes,
            Geometry(message.grid, message.aperture),
            message.noise_power,
            message.saturated_share,
            samples,
            message.provenance,
        )

    @property
    def grid(self) -> messages.ImageGrid:
        """Where its pixels lie."""
        return self.geometry.grid

    @property
    def aperture(self) -> messages.Aperture:
        """From where they are seen."""
        return self.geometry.aperture

    @property
    def config_hash(self) -> str:
        """The config_hash of the sensor that it was made with."""
        return str(self.provenance.config_hash)


def received_frame(cdr: bytes) -> ReceivedFrame:
    """The frame that these bytes are.

    Raises:
        RuntimeError: they are none.
    """
    try:
        return _frame(cdr)
    except (struct.error, ValueError):
        return ReceivedFrame.of(deserialize_message(cdr, messages.ChannelFrame))


def received_image(cdr: bytes) -> ReceivedImage:
    """The image that these bytes are; images with the same bytes of geometry or provenance share these.

    Raises:
        RuntimeError: they are none.
    """
    try:
        return _image(cdr)
    except (struct.error, ValueError):
        return ReceivedImage.of(deserialize_message(cdr, messages.ComplexImage))


class Pose(NamedTuple):
    """What is used of an Odometry.

    Attributes:
        stamp_ns: of the header, ns.
        frame_id: of the header.
        child_frame_id: whose pose it is.
        position: of the child in the frame.
        orientation: of the child in the frame, a quaternion x, y, z, w.
        velocity: of the child in its own axes.
        covariance: of the pose, 36 numbers.
        velocity_covariance: of the velocity, in axes of the child, shape (3, 3).
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    position: tuple[float, ...]
    orientation: tuple[float, ...]
    velocity: tuple[float, ...]
    covariance: F64
    velocity_covariance: F64

    @classmethod
    def of(cls, message: Odometry) -> Self:
        """The same content as a message."""
        place, turn, velocity = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist.linear
        return cls(
            to_ns(message.header.stamp),
            message.header.frame_id,
            message.child_frame_id,
            (place.x, place.y, place.z),
            (turn.x, turn.y, turn.z, turn.w),
            (velocity.x, velocity.y, velocity.z),
            np.array(message.pose.covariance),
            np.array(message.twist.covariance).reshape(6, 6)[:3, :3],
        )


def received_pose(cdr: bytes) -> Pose:
    """What is used of the Odometry that these bytes are.

    Raises:
        RuntimeError: they are none.
    """
    try:
        (seconds, nanoseconds), frame_id, at = _header(cdr)
        child_frame_id, at = _text(cdr, at)
        at = _aligned(at)
        numbers = ODOMETRY.unpack_from(cdr, at)
        after_pose, after_twist = at + 8 * (7 + 36), at + 8 * (7 + 36 + 6)
        covariance = np.frombuffer(cdr[at + 8 * 7 : after_pose])
        of_twist = np.frombuffer(cdr[after_twist : after_twist + 8 * 36]).reshape(6, 6)
    except (struct.error, ValueError):
        return Pose.of(deserialize_message(cdr, Odometry))
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    return Pose(
        stamp_ns, frame_id, child_frame_id, numbers[:3], numbers[3:7], numbers[7:10], covariance, of_twist[:3, :3]
    )


def received_height(cdr: bytes) -> messages.HeightImage:
    """The height image that these bytes are; its provenance is to be left as it is, for others share it.

    Raises:
        RuntimeError: they are none.
    """
    try:
        at = end_of_heights(cdr)
    except (struct.error, ValueError):
        return deserialize_message(cdr, messages.HeightImage)
    image = deserialize_message(cdr[:at] + NO_PROVENANCE, messages.HeightImage)
    image.provenance = _provenance_at(cdr, at)
    return image


class HeightOrigin(NamedTuple):
    """What a height image was made of, and how.

    Attributes:
        dwell: number of the dwell.
        stamp_ns: of its frames, ns.
        provenance: to be left as it is, for others share it.
    """

    dwell: int
    stamp_ns: int
    provenance: messages.Provenance


def height_origin(cdr: bytes) -> HeightOrigin:
    """What the height image that these bytes are was made of; its pixels are passed over.

    Raises:
        RuntimeError: they are none.
    """
    try:
        (seconds, nanoseconds), _, at = _header(cdr)
        (dwell,) = UINT.unpack_from(cdr, at)
        return HeightOrigin(dwell, seconds * 1_000_000_000 + nanoseconds, _provenance_at(cdr, end_of_heights(cdr)))
    except (struct.error, ValueError):
        image = deserialize_message(cdr, messages.HeightImage)
        return HeightOrigin(image.dwell, to_ns(image.header.stamp), image.provenance)


def end_of_heights(cdr: bytes) -> int:
    """Where the provenance of a serialized height image begins, its last field.

    Raises:
        ValueError: the bytes are not laid out so.
        struct.error: they are too few.
    """
    *_, at = _header(cdr)
    _, at = _text(cdr, at + 4)  # dwell, estimator
    at = _aligned(at) + GEOMETRY_BYTES
    at += -at % 4 + 8  # looks
    at = _end_of_list(cdr, at, 1)  # validity
    (surfaces,) = UINT.unpack_from(cdr, at)
    at += 4
    for _ in range(8 * min(surfaces, 4)):  # height to common_covariance; rclpy refuses more than three surfaces
        at = _end_of_list(cdr, at, 4)
    at = _end_of_list(cdr, at, 4)  # order_probability
    if at >= len(cdr):
        raise ValueError("nothing follows")
    return at


def _end_of_list(cdr: bytes, at: int, size: int) -> int:
    """Where the next number of four bytes follows a list of numbers of `size` bytes."""
    (count,) = UINT.unpack_from(cdr, at)
    end = at + 4 + size * int(count)
    return end + -end % 4


def _frame(cdr: bytes) -> ReceivedFrame:
    """Read a frame by the places of its fields.

    Raises:
        ValueError: the bytes are not laid out so.
        struct.error: they are too few.
    """
    stamp, frame_id, at = _header(cdr)
    dwell, channel = PAIR.unpack_from(cdr, at)
    config_hash, at = _text(cdr, at + PAIR.size)
    pulse_count, sample_count, times = TRIPLE.unpack_from(cdr, at)
    pulse_time, at = _doubles(cdr, at + 12, times)
    (ranges,) = UINT.unpack_from(cdr, at)
    reference_range, at = _doubles(cdr, at + 4, ranges)
    encoding, at = _text(cdr, at)
    at = _aligned(at)
    (scale,) = SCALE.unpack_from(cdr, at)
    (count,) = UINT.unpack_from(cdr, at + 8)
    samples = np.frombuffer(cdr, np.uint8, count, at + 12)
    return ReceivedFrame(
        stamp,
        frame_id,
        dwell,
        channel,
        len(cdr),
        config_hash,
        pulse_count,
        sample_count,
        pulse_time,
        reference_range,
        encoding,
        scale,
        samples,
    )


def _image(cdr: bytes) -> ReceivedImage:
    """Read an image by the places of its fields.

    Raises:
        ValueError: the bytes are not laid out so.
        struct.error: they are too few.
    """
    stamp, frame_id, at = _header(cdr)
    dwell, channel = PAIR.unpack_from(cdr, at)
    at = _aligned(at + PAIR.size)
    geometry = cdr[at : at + GEOMETRY_BYTES]
    at = _aligned(at + GEOMETRY_BYTES)
    noise_power, saturated_share, count = NOISE.unpack_from(cdr, at)
    at += NOISE.size
    samples = np.frombuffer(cdr, np.float32, count, at)
    return ReceivedImage(
        stamp,
        frame_id,
        dwell,
        channel,
        len(cdr),
        _geometry_of(geometry),
        noise_power,
        saturated_share,
        samples,
        _provenance_at(cdr, at + 4 * count),
    )


@functools.lru_cache(maxsize=HELD)
def _geometry_of(numbers: bytes) -> Geometry:
    """Grid and aperture of their bytes."""
    head = _empty_image()[0]
    padding = bytes(-(len(head) + len(numbers) - ENCAPSULATION) % 8)
    cdr = head + numbers + padding + NOISE.pack(0.0, 0.0, 0) + NO_PROVENANCE
    image = deserialize_message(cdr, messages.ComplexImage)
    return Geometry(image.grid, image.aperture)


def _provenance_at(cdr: bytes, at: int) -> messages.Provenance:
    """The provenance that ends a serialized message.

    Raises:
        RuntimeError: the bytes are none.
    """
    return _provenance_of(cdr[at:], (at - len(_empty_image()[1]) - 4) % 8 // 4)


@functools.lru_cache(maxsize=HELD)
def _provenance_of(tail: bytes, odd: int) -> messages.Provenance:
    """The provenance of its bytes, made the last ones of an image with so many samples, 0 or 1.

    Numbers of eight bytes among them lie at other places after an odd number of samples.
    """
    cdr = _empty_image()[1] + UINT.pack(odd) + odd * UINT.pack(0) + tail
    return deserialize_message(cdr, messages.ComplexImage).provenance


def provenance_bytes(provenance: messages.Provenance, at: int) -> bytes:
    """The bytes of a provenance that is never changed, as the last field of a message whose other fields take `at`."""
    return _bytes_of(Same(provenance), (at - len(_empty_image()[1]) - 4) % 8 // 4)


@functools.lru_cache(maxsize=HELD)
def _bytes_of(provenance: Same[messages.Provenance], odd: int) -> bytes:
    """The bytes of a provenance, made the last ones of an image with so many samples, 0 or 1."""
    cdr = serialize_message(messages.ComplexImage(samples=odd * [0.0], provenance=provenance.one))
    begin = len(_empty_image()[1]) + 4 + 4 * odd
    return cdr[begin : end_of_provenance(cdr, begin)]


def end_of_provenance(cdr: bytes, at: int) -> int:
    """Where a provenance ends that begins at an offset; rclpy may serialize more bytes than a message has.

    Raises:
        ValueError: the bytes are not laid out so.
        struct.error: they are too few.
    """
    for _ in range(3):  # code_version, config_hash, calibration_id
        _, at = _text(cdr, at)
    (parameters,) = UINT.unpack_from(cdr, at)
    at += 4
    for _ in range(parameters):
        at = _end_of_parameter(cdr, at)
    return _end_of_list(cdr, at, 4)  # autofocus_phase


def _end_of_parameter(cdr: bytes, at: int) -> int:
    """Where the next number of four bytes follows a parameter."""
    (name,) = UINT.unpack_from(cdr, at)
    at = _aligned(at + 4 + name + 2) + 16  # type, bool_value; integer_value, double_value
    _, at = _text(cdr, at)  # string_value
    for _ in range(2):  # byte_array_value, bool_array_value
        at = _end_of_list(cdr, at, 1)
    for _ in range(2):  # integer_array_value, double_array_value
        (count,) = UINT.unpack_from(cdr, at)
        at = _aligned(at + 4) + 8 * count if count else at + 4
    (texts,) = UINT.unpack_from(cdr, at)  # string_array_value
    at += 4
    for _ in range(texts):
        _, at = _text(cdr, at)
    return at


@functools.cache
def _empty_image() -> tuple[bytes, bytes]:
    """The bytes of an image without content, up to its geometry and up to the number of its samples."""
    cdr = serialize_message(messages.ComplexImage())
    return cdr[: _aligned(channel_offset(cdr) + 4)], cdr[: noise_offset(cdr) + NOISE.size - 4]


def channel_offset(cdr: bytes) -> int:
    """Where a serialized image has the number of its channel.

    Raises:
        ValueError: the bytes are not laid out so.
        struct.error: they are too few.
    """
    return _header(cdr)[-1] + 4


def noise_offset(cdr: bytes) -> int:
    """Where a serialized image has its noise power, which saturated share and samples follow.

    Raises:
        ValueError: the bytes are not laid out so.
        struct.error: they are too few.
    """
    return _aligned(_aligned(channel_offset(cdr) + 4) + GEOMETRY_BYTES)


def _header(cdr: bytes) -> tuple[tuple[int, int], str, int]:
    """Stamp (s and ns) and frame_id of the header, the first field, and the offset of the next number."""
    if cdr[:2] != LITTLE_ENDIAN:
        raise ValueError("another encoding")
    return STAMP.unpack_from(cdr, ENCAPSULATION), *_text(cdr, ENCAPSULATION + STAMP.size)


def _text(cdr: bytes, at: int) -> tuple[str, int]:
    """The text at an offset, and the offset of the next number of four bytes."""
    (length,) = UINT.unpack_from(cdr, at)
    end = at + 4 + length
    text = cdr[at + 4 : end]
    if text.find(0) != length - 1 or not length:
        raise ValueError("a text that does not end where it says")
    return text[:-1].decode("utf-8", "replace"), end + -end % 4


def _doubles(cdr: bytes, at: int, count: int) -> tuple[F64, int]:
    """So many numbers of eight bytes at the next offset that these may have, and the offset after them."""
    start = _aligned(at)
    end = start + 8 * count
    if count == 0 or end > len(cdr):
        raise ValueError("no numbers")
    return np.frombuffer(cdr[start:end]), end  # a copy: in place they are not aligned in memory


def _aligned(at: int) -> int:
    """The next offset that a number of eight bytes may have."""
    return at + -(at - ENCAPSULATION) % 8
