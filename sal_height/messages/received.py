"""Frames, images, heights and odometry as nodes receive them: views of their bytes.

Samples are not copied, the fields that are read most often are read at their offset, and the parts that messages of a
dwell share are made once. Bytes of another layout than expected (another byte order, too few bytes) are left to the
codec, which reads or refuses them.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from sal_height.messages.basics import to_ns
from sal_height.messages.cdr_parts import ENCAPSULATION
from sal_height.messages.codec import LITTLE_ENDIAN, SHIPPED
from sal_height.messages.types import (
    Aperture,
    ChannelFrame,
    ComplexImage,
    Doubt,
    FitTest,
    Header,
    HeightImage,
    ImageGrid,
    Odometry,
    Provenance,
    Time,
)
from sal_height.numeric import F32, F64, U8

KEPT = 8
"""Number of cached geometries: those used last."""

STAMP, UINT, PAIR, TRIPLE = (struct.Struct(layout) for layout in ("<iI", "<I", "<II", "<III"))
SCALE, NOISE, TAIL = struct.Struct("<dI"), struct.Struct("<df"), struct.Struct("<QII")

ODOMETRY = struct.Struct("<7d288x3d312x")
"""Pose, its covariance (skipped), velocity, and unused fields of an Odometry: rotation rate and covariance."""

GRID_AND_POSE, VELOCITY, LENGTH_AND_SLIDING = 8 * 11 + 2 * 4 + 8 * 7, 8 * 3, 8 + 1
"""Bytes of parts of a geometry, after the first and the second of which a list of numbers follows."""

_read_frame, _read_image, _read_height, _read_odometry = (
    SHIPPED.reader(kind.__msgtype__, shared=True) for kind in (ChannelFrame, ComplexImage, HeightImage, Odometry)
)
_read_geometry = SHIPPED.fields_reader(ComplexImage.__msgtype__, "grid", "aperture")
_read_rest = SHIPPED.fields_reader(ComplexImage.__msgtype__, "noise_power", "provenance")
_read_provenance = SHIPPED.fields_reader(ComplexImage.__msgtype__, "provenance", "provenance")


@dataclass(slots=True, eq=False)
class Received:
    """Common attributes of frames and images.

    Attributes:
        stamp: stamp of the header, s and ns.
        frame_id: frame_id of the header.
        dwell: number of the dwell.
        channel: number of the channel.
        size: size of the message, bytes.
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
        """A new object of the header."""
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
    def of(cls, message: ChannelFrame) -> Self:
        """The same content as a message."""
        samples = np.asarray(message.samples, np.uint8)
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
    """Pixel grid and aperture of images; the images of a dwell share it.

    Attributes:
        grid: grid of the pixels.
        aperture: aperture of the images.
        checked: True if it was found to be possible.
    """

    grid: ImageGrid
    aperture: Aperture
    checked: bool = False


@dataclass(slots=True, eq=False)
class ReceivedImage(Received):
    """A ComplexImage; further attributes are its fields, samples as NumPy has them.

    Its geometry and provenance must not be changed: other images share them.
    """

    geometry: Geometry
    noise_power: float
    saturated_share: float
    air_delay: str
    samples: F32
    order: int
    doubts: Sequence[Doubt]
    fit: Sequence[FitTest]
    provenance: Provenance

    @classmethod
    def of(cls, message: ComplexImage) -> Self:
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
            message.air_delay,
            samples,
            message.order,
            message.doubts,
            message.fit,
            message.provenance,
        )

    @property
    def grid(self) -> ImageGrid:
        """Grid of its pixels."""
        return self.geometry.grid

    @property
    def aperture(self) -> Aperture:
        """Aperture from which they are seen."""
        return self.geometry.aperture

    @property
    def config_hash(self) -> str:
        """The config_hash of the sensor that it was made with."""
        return str(self.provenance.config_hash)


def received_frame(cdr: bytes) -> ReceivedFrame:
    """Read bytes as a frame.

    Raises:
        BrokenMessage: the bytes are not a ChannelFrame.
    """
    try:
        return _frame(cdr)
    except (struct.error, ValueError):
        return ReceivedFrame.of(_read_frame(cdr))


def received_image(cdr: bytes) -> ReceivedImage:
    """Read bytes as an image; images with the same bytes of geometry or provenance share these.

    Raises:
        BrokenMessage: the bytes are not a ComplexImage.
    """
    try:
        return _image(cdr)
    except (struct.error, ValueError):
        return ReceivedImage.of(_read_image(cdr))


class ReceivedPose(NamedTuple):
    """The used fields of an Odometry.

    Attributes:
        stamp_ns: stamp of the header, ns.
        frame_id: frame_id of the header.
        child_frame_id: name of the child frame, whose pose it is.
        position: position of the child in the frame, m.
        orientation: orientation of the child in the frame, a quaternion x, y, z, w.
        velocity: velocity of the child in its own axes, m/s.
        covariance: covariance of the pose, 36 numbers.
        velocity_covariance: covariance of the velocity in axes of the child, (m/s)^2, shape (3, 3).
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


def received_pose(cdr: bytes) -> ReceivedPose:
    """Read the used fields of an Odometry from its bytes.

    Raises:
        BrokenMessage: the bytes are not an Odometry.
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
        return ReceivedPose.of(_read_odometry(cdr))
    stamp_ns = seconds * 1_000_000_000 + nanoseconds
    return ReceivedPose(
        stamp_ns, frame_id, child_frame_id, numbers[:3], numbers[3:7], numbers[7:10], covariance, of_twist[:3, :3]
    )


def received_height(cdr: bytes) -> HeightImage:
    """Read bytes as a height image; its provenance must not be changed, for others share it.

    Raises:
        BrokenMessage: the bytes are not a HeightImage.
    """
    return _read_height(cdr)


class HeightOrigin(NamedTuple):
    """Dwell and provenance of a height image.

    Attributes:
        dwell: number of the dwell.
        stamp_ns: stamp of its frames, ns.
        provenance: provenance of the image, which must not be changed, for others share it.
    """

    dwell: int
    stamp_ns: int
    provenance: Provenance


def height_origin(cdr: bytes) -> HeightOrigin:
    """Read dwell and provenance of a height image from its bytes.

    Raises:
        BrokenMessage: the bytes are not a HeightImage.
    """
    image = _read_height(cdr)
    return HeightOrigin(image.dwell, to_ns(image.header.stamp), image.provenance)


def _frame(cdr: bytes) -> ReceivedFrame:
    """Read a frame by the offsets of its fields.

    Raises:
        ValueError: the bytes have another layout.
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
    scale, count = SCALE.unpack_from(cdr, at)
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
    """Read an image by the offsets of its fields.

    Raises:
        ValueError: the bytes have another layout.
        struct.error: they are too few.
    """
    stamp, frame_id, at = _header(cdr)
    dwell, channel = PAIR.unpack_from(cdr, at)
    at = _aligned(at + PAIR.size)
    end = _end_of_geometry(cdr, at)
    labels = stamp, frame_id, dwell, channel, len(cdr), _geometry_of(cdr[at:end])
    at = _aligned(end)
    noise_power, saturated_share = NOISE.unpack_from(cdr, at)
    air_delay, at = _text(cdr, at + NOISE.size)
    (count,) = UINT.unpack_from(cdr, at)
    samples = np.frombuffer(cdr, np.float32, count, at + 4)
    at = _aligned(at + 4 + 4 * count)
    order, doubts, tests = TAIL.unpack_from(cdr, at)
    if doubts or tests:
        return ReceivedImage(*labels, *_read_rest(cdr, end)[0])
    (provenance,), _ = _read_provenance(cdr, at + TAIL.size)
    return ReceivedImage(*labels, noise_power, saturated_share, air_delay, samples, order, [], [], provenance)


def _end_of_geometry(cdr: bytes, at: int) -> int:
    """The offset after grid and aperture of an image that start at an offset.

    Raises:
        struct.error: the bytes are too few.
    """
    at += GRID_AND_POSE
    at += 8 + 8 * int(UINT.unpack_from(cdr, at)[0]) + VELOCITY
    return at + 8 + 8 * int(UINT.unpack_from(cdr, at)[0]) + LENGTH_AND_SLIDING


@functools.lru_cache(maxsize=KEPT)
def _geometry_of(numbers: bytes) -> Geometry:
    """Grid and aperture from their bytes."""
    (grid, aperture), _ = _read_geometry(bytes(ENCAPSULATION) + numbers, ENCAPSULATION)
    return Geometry(grid, aperture)


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
    """`count` numbers of eight bytes at the next aligned offset, and the offset after them."""
    start = _aligned(at)
    end = start + 8 * count
    if count == 0 or end > len(cdr):
        raise ValueError("no numbers")
    return np.frombuffer(cdr[start:end]), end  # a copy: without it they are not aligned in memory


def _aligned(at: int) -> int:
    """The next offset that a number of eight bytes may have."""
    return at + -(at - ENCAPSULATION) % 8
