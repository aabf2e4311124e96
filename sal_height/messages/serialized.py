"""Complex images to bytes and back, with what all images of a dwell share made once.

Most of the time that rclpy takes for an image of a small dwell goes into the objects of its provenance, which are equal
in all channels.
"""

from __future__ import annotations

import struct
from collections import OrderedDict

from rclpy.serialization import deserialize_message, serialize_message
from sal_height_msgs import msg as messages

HELD_PROVENANCES = 8
"""Provenances held, the last that were used."""

LITTLE_ENDIAN = 1
"""Second byte of a message in the encoding that ROS middlewares use (plain CDR, OMG DDS-XTypes 1.3, section 7.4.3)."""

ENCAPSULATION = 4
"""Bytes before the first field; offsets within a message count from its end."""

NO_PROVENANCE = 3 * b"\x01\x00\x00\x00\x00\x00\x00\x00" + 8 * b"\x00"
"""An empty provenance: three empty texts and two empty lists."""

DOUBLES_OF_GRID, DOUBLES_OF_APERTURE = 11, 7 + 36 + 3 + 1


class SlcDecoder:
    """Makes ComplexImages of their bytes; images with the same bytes of provenance share its object."""

    def __init__(self) -> None:
        self._provenances: OrderedDict[bytes, messages.Provenance] = OrderedDict()

    def decode(self, cdr: bytes) -> messages.ComplexImage:
        """The image, equal to what rclpy makes of the same bytes; its provenance is to be left as it is.

        Raises:
            RuntimeError: the bytes are no image.
        """
        start = provenance_offset(cdr)
        if start is None:
            return deserialize_message(cdr, messages.ComplexImage)
        tail = cdr[start:]
        known = self._provenances.get(tail)
        if known is None:
            image = deserialize_message(cdr, messages.ComplexImage)
            self._provenances[tail] = image.provenance
            if len(self._provenances) > HELD_PROVENANCES:
                self._provenances.popitem(last=False)
            return image
        self._provenances.move_to_end(tail)
        image = deserialize_message(cdr[:start] + NO_PROVENANCE, messages.ComplexImage)
        image.provenance = known
        return image


def serialized_images(images: list[messages.ComplexImage]) -> list[bytes]:
    """The bytes of the images of a dwell, which share one object of provenance, a grid and the name of a frame."""
    first = serialize_message(images[0])
    start = provenance_offset(first)
    if start is None or any(image.provenance is not images[0].provenance for image in images):
        return [serialize_message(image) for image in images]
    serialized, tail, shared = [first], first[start:], images[0].provenance
    for image in images[1:]:
        image.provenance = messages.Provenance()
        cdr = serialize_message(image)
        image.provenance = shared
        serialized.append(cdr[:start] + tail if provenance_offset(cdr) == start else serialize_message(image))
    return serialized


def provenance_offset(cdr: bytes) -> int | None:
    """Where the provenance of a serialized image begins, its last field; None if the bytes cannot tell."""
    if len(cdr) < ENCAPSULATION or cdr[1] != LITTLE_ENDIAN:
        return None
    try:
        at = ENCAPSULATION + 8  # after the stamp: the text frame_id
        at = _aligned(at + 4 + _count(cdr, at), 4)
        at = _aligned(at + 2 * 4, 8)  # dwell, channel
        at = _aligned(at + 8 * DOUBLES_OF_GRID + 2 * 4, 8)  # and rows, cols
        at = _aligned(at + 8 * DOUBLES_OF_APERTURE + 1, 8)  # and sliding
        at += 8 + 4  # noise_power, saturated_share
        at += 4 + 4 * _count(cdr, at)  # samples
    except struct.error:
        return None
    return at if at < len(cdr) else None


def _count(cdr: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", cdr, at)[0])


def _aligned(at: int, size: int) -> int:
    """The next offset that a number of that many bytes may have."""
    return at + -(at - ENCAPSULATION) % size
