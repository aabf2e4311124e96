"""CDR bytes of the odometry of a whole track and of the frames of a dwell: common parts are serialized once."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sal_height import messages
from sal_height.geometry import PlatformState, rotation_matrix
from sal_height.sensor import PhaseHistory, Sensor

STAMP_BYTES = slice(4, 12)
"""Position of the stamp of a header in the CDR bytes of a message that starts with it."""


def odometry_of(states: Sequence[PlatformState]) -> Iterator[bytes]:
    """The odometry of states: the bytes of the first one, with the stamp and the numbers of each.

    The frames in the header are the same, so that all messages have one layout. It ends with pose, covariance of the
    pose, twist (of which the rotation is not known) and covariance of the twist: 85 numbers of 8 bytes.
    """
    first = messages.serialize(messages.state_to_message(states[0], messages.to_stamp(states[0].stamp_ns)))
    count = 7 + 36 + 6 + 36  # pose, its covariance, twist, its covariance
    frames = first[STAMP_BYTES.stop : -8 * count]
    turning = np.zeros(3)
    for state in states:
        stamp = struct.pack("<iI", *divmod(state.stamp_ns, 1_000_000_000))
        velocity = state.velocity @ rotation_matrix(state.orientation)  # in the axes of the body
        parts = state.position, state.orientation, state.covariance.ravel(), velocity, turning
        numbers = np.concatenate([*parts, messages.twist_covariance(state).ravel()], dtype="<f8").tobytes()
        yield b"".join([first[: STAMP_BYTES.start], stamp, frames, numbers])


def frames_of(history: PhaseHistory, sensor: Sensor, dwell: int) -> Iterator[bytes]:
    """The frames of a dwell, one per channel.

    Samples are the last field of a frame, so they follow the bytes of a frame without samples, and are copied once.
    """
    count = history.samples.shape[2]
    without = replace(history, samples=history.samples[:, :, :0])
    frames = messages.history_to_messages(without, sensor, dwell, messages.to_stamp(history.stamp_ns))
    for frame, samples in zip(frames, history.samples, strict=True):
        frame.sample_count = count
        stored = np.ascontiguousarray(samples, dtype="<c8").reshape(-1).view(np.uint8)
        yield b"".join([messages.serialize(frame)[:-4], struct.pack("<I", stored.size), stored.data])
