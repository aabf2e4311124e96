"""Serialized odometry to samples as arrays, many messages at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sal_height.engine.frames import Frames
from sal_height.engine.geometry_items import FARTHEST, FASTEST
from sal_height.engine.track import Samples
from sal_height.errors import Rejected
from sal_height.geometry import ROS_AXES, rotation_matrix
from sal_height.messages.cdr_parts import COUNT, ENCAPSULATION
from sal_height.messages.codec import LITTLE_ENDIAN, BrokenMessage, deserialize
from sal_height.messages.frames import state_from_message
from sal_height.messages.types import Odometry
from sal_height.numeric import F64

_STAMP_BYTES, _NUMBERS = 8, 7 + 36 + 6 + 36
"""Bytes of the stamp of an Odometry, and numbers of its pose, twist and their covariances."""


def samples_of(messages: Sequence[bytes], frames: Frames) -> Samples | None:
    """The samples of serialized Odometry messages, each the same as `state_from_message` gives.

    Args:
        messages: serialized messages, in the order of their arrival, one or more.
        frames: names and axes of the frames that they must have.

    Returns:
        The samples; None: the messages differ in their layout, or one may be faulty; they must be read one by one.
    """
    first = messages[0]
    if frames.axes != ROS_AXES or any(len(one) != len(first) for one in messages) or not _is_usable(first, frames):
        return None
    parts, numbers_at = _layout_of(first)
    whole = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), -1)
    if not all((whole[:, part] == whole[0, part]).all() for part in parts):
        return None
    stamps = whole[:, ENCAPSULATION : ENCAPSULATION + _STAMP_BYTES].copy()
    seconds, nanoseconds = stamps[:, :4].copy().view("<i4")[:, 0], stamps[:, 4:].copy().view("<u4")[:, 0]
    numbers = whole[:, numbers_at : numbers_at + 8 * _NUMBERS].copy().view("<f8")
    position, orientation, velocity = numbers[:, :3], numbers[:, 3:7], numbers[:, 43:46]
    if not (_are_within(position, FARTHEST) and _are_within(velocity, FASTEST) and _are_rotations(orientation)):
        return None
    rotations = np.moveaxis(rotation_matrix(orientation.T), 2, 0)
    turned = np.ascontiguousarray(rotations) @ np.ascontiguousarray(velocity)[:, :, np.newaxis]
    return Samples(
        1_000_000_000 * seconds.astype(np.int64) + nanoseconds,
        np.concatenate([position, orientation, turned[:, :, 0]], axis=1),
        numbers[:, 7:43].reshape(-1, 6, 6),
        numbers[:, 49:].reshape(-1, 6, 6)[:, :3, :3],
    )


def _is_usable(cdr: bytes, frames: Frames) -> bool:
    """True if a message is in little-endian plain CDR, and describes a state of the platform in these frames."""
    try:
        state_from_message(deserialize(cdr, Odometry), frames)
    except (BrokenMessage, Rejected):
        return False
    return cdr.startswith(LITTLE_ENDIAN)


def _layout_of(cdr: bytes) -> tuple[list[slice], int]:
    """Bytes that messages with the same frames share, and the offset of the numbers."""
    at, parts = ENCAPSULATION + _STAMP_BYTES, [slice(0, ENCAPSULATION)]
    for _ in range(2):
        at += -at & 3
        (length,) = COUNT.unpack_from(cdr, at)
        parts.append(slice(at, at + COUNT.size + length))
        at += COUNT.size + length
    return parts, at + (ENCAPSULATION - at & 7)


def _are_within(vectors: F64, most: float) -> bool:
    """True if all components of vectors are clearly less than a length; False if one is not finite."""
    return bool((np.abs(vectors) < 0.5 * most).all())


def _are_rotations(quaternions: F64) -> bool:
    """True if all quaternions, shape (n, 4), have the norm 1, clearly within what is allowed."""
    if not _are_within(quaternions, 4.0):
        return False
    norms = np.linalg.norm(quaternions, axis=1)
    return bool(((norms > 0.991) & (norms < 1.009)).all())
