"""Odometry of many messages read at once: the same samples, to the bit, as of each message alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from sal_height.engine.frames import Frames
from sal_height.geometry import Axes, PlatformState
from sal_height.messages import deserialize, serialize, state_from_message, state_to_message, to_stamp
from sal_height.messages.odometry import samples_of
from sal_height.messages.types import Odometry

FRAMES = [Frames(), Frames("m", "a body with a longer name")]


def message(number: int, frames: Frames = FRAMES[0]) -> Odometry:
    rng = np.random.default_rng(number)
    attitude = rng.normal(size=4)
    covariance, velocity_covariance = rng.normal(size=(6, 6)), rng.normal(size=(3, 3))
    state = PlatformState(
        1_700_000_000_000_000_000 + 12_345_678 * number,
        1e4 * rng.normal(size=3),
        attitude / np.linalg.norm(attitude),
        50 * rng.normal(size=3),
        covariance,
        velocity_covariance,
    )
    return state_to_message(state, to_stamp(state.stamp_ns), frames)


@pytest.mark.parametrize("frames", FRAMES)
def test_samples_are_those_of_each_message(frames: Frames) -> None:
    messages = [serialize(message(number, frames)) for number in range(200)]
    samples = samples_of(messages, frames)
    assert samples is not None
    for found, cdr in zip(samples.states(), messages, strict=True):
        expected = state_from_message(deserialize(cdr, Odometry), frames)
        assert found.stamp_ns == expected.stamp_ns
        for field in fields(PlatformState)[1:]:
            assert getattr(found, field.name).tobytes() == getattr(expected, field.name).tobytes(), field.name


def far(odometry: Odometry) -> None:
    odometry.pose.pose.position.y = 2e7


def fast(odometry: Odometry) -> None:
    odometry.twist.twist.linear.z = -2e5


def not_finite(odometry: Odometry) -> None:
    odometry.pose.pose.position.x = np.nan


def infinite(odometry: Odometry) -> None:
    odometry.twist.twist.linear.x = np.inf


def no_rotation(odometry: Odometry) -> None:
    odometry.pose.pose.orientation.w += 1.0


def huge_rotation(odometry: Odometry) -> None:
    odometry.pose.pose.orientation.w = 1e300


def other_map(odometry: Odometry) -> None:
    odometry.header.frame_id = "pam"


def other_body(odometry: Odometry) -> None:
    odometry.child_frame_id = "base_knil"


def longer(odometry: Odometry) -> None:
    odometry.child_frame_id = "base_link of another platform"


@pytest.mark.parametrize("place", [0, 5])
@pytest.mark.parametrize(
    "spoil", [far, fast, not_finite, infinite, no_rotation, huge_rotation, other_map, other_body, longer]
)
def test_a_message_that_may_be_faulty_has_all_read_one_by_one(spoil: Callable[[Odometry], None], place: int) -> None:
    messages = [message(number) for number in range(10)]
    spoil(messages[place])
    assert samples_of([serialize(one) for one in messages], FRAMES[0]) is None


def test_bytes_that_differ_in_the_byte_order_are_read_one_by_one() -> None:
    messages = [serialize(message(number)) for number in range(3)]
    messages[1] = b"\x00\x00" + messages[1][2:]
    assert samples_of(messages, FRAMES[0]) is None
    assert samples_of([one[:100] for one in messages], FRAMES[0]) is None


def test_padding_may_have_any_value() -> None:
    """Other serializers leave it as it is in memory."""
    frames = FRAMES[0]._replace(map="map of a")
    messages = [bytearray(serialize(message(number, frames))) for number in range(3)]
    at = messages[0].index(b"map of a\0") + len(b"map of a\0")
    assert messages[0][at : at + 3] == bytes(3)  # before the length of the next text, which is aligned
    messages[1][at] = 77
    samples = samples_of([bytes(one) for one in messages], frames)
    assert samples is not None
    assert len(samples.stamps_ns) == 3


def test_axes_other_than_those_of_ros_are_turned_one_by_one() -> None:
    assert samples_of([serialize(message(1))], FRAMES[0]._replace(axes=Axes("ned", "frd"))) is None
