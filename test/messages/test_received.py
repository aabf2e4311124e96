"""Frames, images, heights and odometry read from their bytes are those of rclpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import make_aperture, make_sensor
from ros_messages import in_other_byte_order, of_rclpy, spoiled

from sal_height import messages
from sal_height.errors import Rejected
from sal_height.geometry import Grid
from sal_height.imaging import Slc
from sal_height.messages import (
    BrokenMessage,
    deserialize,
    received,
    received_frame,
    received_height,
    received_image,
    received_pose,
    serialize,
)
from sal_height.messages.codec import SHIPPED
from sal_height.messages.parameters import parameter_of
from sal_height.messages.plain import is_same
from sal_height.messages.received import KEPT, ReceivedPose, _geometry_of
from sal_height.messages.types import (
    ChannelFrame,
    ComplexImage,
    Doubt,
    FitTest,
    HeightImage,
    Odometry,
    Provenance,
    Surface,
)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


READERS = {
    ChannelFrame: received_frame,
    ComplexImage: received_image,
    Odometry: received_pose,
    HeightImage: received_height,
}


def frame_of(frame_id: str = "sensor", config_hash: str = "abc", pulses: int = 3) -> ChannelFrame:
    frame = ChannelFrame(dwell=7, channel=2, config_hash=config_hash, encoding="complex_float32", scale=0.25)
    frame.header.frame_id, frame.header.stamp.sec, frame.header.stamp.nanosec = frame_id, -3, 5
    frame.pulse_count, frame.sample_count = pulses, 2
    frame.pulse_time, frame.reference_range = np.arange(pulses) * 0.5, 7.0 + np.arange(pulses)
    frame.samples = np.arange(16 * pulses, dtype=np.uint8)
    return frame


def image_of(frame_id: str = "map", samples: int = 4, version: str = "0.1.0", parameters: int = 2) -> ComplexImage:
    image = ComplexImage(channel=3, dwell=7, noise_power=0.25, saturated_share=0.5)
    image.header.frame_id, image.header.stamp.nanosec = frame_id, 5
    image.grid.rows, image.grid.col_spacing = 3, 0.125
    image.aperture.length, image.aperture.sliding = 8.5, True
    image.samples = np.arange(samples, dtype=np.float32)
    image.provenance.code_version, image.provenance.config_hash = version, "abc"
    image.provenance.parameters = [parameter_of(f"p{n}", [0.5, float(n)]) for n in range(parameters)]
    image.provenance.autofocus_phase = np.full(parameters, 0.5, np.float32)
    return image


def odometry_of(frame_id: str = "map", child: str = "base_link") -> Odometry:
    odometry = Odometry(child_frame_id=child)
    odometry.header.frame_id, odometry.header.stamp.sec = frame_id, 8
    place, turn, velocity = odometry.pose.pose.position, odometry.pose.pose.orientation, odometry.twist.twist.linear
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, velocity.x, velocity.y, velocity.z = np.arange(
        1.0, 11.0
    ).tolist()
    odometry.pose.covariance = 0.5 * np.arange(36)
    odometry.twist.twist.angular.x = 99.0
    odometry.twist.covariance[0] = 98.0
    return odometry


def height_of(surfaces: int = 2, pixels: int = 3, estimator: str = "ml", version: str = "0.1.0") -> HeightImage:
    image = HeightImage(dwell=7, estimator=estimator, grid=image_of().grid, aperture=image_of().aperture, range_looks=2)
    image.header.frame_id, image.validity = "map", np.arange(pixels, dtype=np.uint8)
    for number in range(surfaces):
        values = np.full(pixels, number + 0.5, np.float32)
        image.surfaces.append(Surface(height=values, sigma=values, covariance=np.repeat(values, 6)))
    image.order_probability = np.full(pixels, 0.2, np.float32)
    image.provenance = image_of(version=version).provenance
    return image


EXAMPLES = [frame_of(), image_of(), odometry_of(), height_of()]


def assert_same(view: Any, message: Any) -> None:
    """What was read says what a plain message does."""
    if isinstance(message, Odometry):
        assert all(map(is_same, view, ReceivedPose.of(message)))
        return
    for name in message.__slots__:
        assert is_same(getattr(view, name), getattr(message, name)), name


@pytest.mark.parametrize("frame_id", ["", "map", "maps", "größer"])
@pytest.mark.parametrize("pulses", [0, 1, 4])
@pytest.mark.parametrize("config_hash", ["", "1234567", "a_long_hash"])
def test_frames_are_those_of_rclpy(frame_id: str, pulses: int, config_hash: str) -> None:
    frame = frame_of(frame_id, config_hash, pulses)
    assert_same(received_frame(of_rclpy(frame)), frame)


@pytest.mark.parametrize("frame_id", ["", "map", "maps", "a_long_frame"])
@pytest.mark.parametrize("samples", [0, 1, 2, 7])
@pytest.mark.parametrize(("version", "parameters"), [("", 0), ("0.1.0", 3), ("0.10.0", 2)])
@pytest.mark.parametrize("air_delay", ["", "removed"])
def test_images_are_those_of_rclpy(frame_id: str, samples: int, version: str, parameters: int, air_delay: str) -> None:
    image = image_of(frame_id, samples, version, parameters)
    image.air_delay = air_delay
    assert_same(received_image(of_rclpy(image)), image)


@pytest.mark.parametrize("covariances", [(0, 0), (36, 0), (0, 9), (36, 9)])
@pytest.mark.parametrize("doubts", [0, 1, 3])
def test_whatever_is_known_of_an_image_its_samples_and_provenance_are_found(
    covariances: tuple[int, int], doubts: int
) -> None:
    image = image_of()
    image.aperture.pose_covariance, image.aperture.velocity_covariance = map(np.arange, covariances)
    image.doubts = [Doubt(name="x" * number, channel=number) for number in range(doubts)]
    image.fit = [FitTest(p_value=0.5)] * (3 - doubts)
    image.order = 2**40
    assert_same(received_image(of_rclpy(image)), image)


@pytest.mark.parametrize("frame_id", ["", "map", "maps"])
@pytest.mark.parametrize("child", ["", "base_link", "of_another"])
def test_odometry_is_that_of_rclpy(frame_id: str, child: str) -> None:
    odometry = odometry_of(frame_id, child)
    assert_same(received_pose(of_rclpy(odometry)), odometry)


@pytest.mark.parametrize("surfaces", [0, 1, 3])
@pytest.mark.parametrize("pixels", [0, 1, 2, 5])
@pytest.mark.parametrize(("estimator", "version"), [("", "0.1.0"), ("tracked", ""), ("ml", "0.10")])
def test_heights_are_those_of_rclpy(surfaces: int, pixels: int, estimator: str, version: str) -> None:
    height = height_of(surfaces, pixels, estimator, version)
    cdr = of_rclpy(height)
    assert_same(received_height(cdr), height)
    assert received_height(cdr).provenance is received_height(cdr).provenance


@pytest.mark.parametrize("message", EXAMPLES, ids=["frame", "image", "odometry", "height"])
def test_messages_of_the_other_byte_order_are_read(message: Any) -> None:
    assert_same(READERS[type(message)](in_other_byte_order(message)), message)


@pytest.mark.parametrize("message", EXAMPLES, ids=["frame", "image", "odometry", "height"])
def test_whatever_bytes_come_are_read_or_refused_as_by_the_codec(message: Any, rng: np.random.Generator) -> None:
    """Bytes at random places are changed, as they are or to small numbers, and the end is cut off now and then."""
    whole, read, refused = np.frombuffer(serialize(message), np.uint8), 0, 0
    for number in range(1500):
        cdr = spoiled(whole, number, rng)
        try:
            expected = deserialize(cdr, type(message))
        except BrokenMessage:
            refused += 1
            with pytest.raises(BrokenMessage):
                READERS[type(message)](cdr)
        else:
            read += 1
            assert_same(READERS[type(message)](cdr), expected)
    assert min(read, refused) > 100


def test_samples_are_not_copied_and_no_message_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    cdr = serialize(frame_of())
    monkeypatch.setattr(received, "_read_frame", None)
    frame = received_frame(cdr)
    assert np.shares_memory(frame.samples, np.frombuffer(cdr, np.uint8))
    assert frame.size == len(cdr)


def test_images_share_geometry_and_provenance_and_few_are_held() -> None:
    images = [received_image(serialize(image_of())) for _ in range(4)]
    assert all(image.provenance is images[0].provenance for image in images)
    assert all(image.geometry is images[0].geometry for image in images)
    for number in range(3 * KEPT):
        image = image_of(version=f"{number}")
        image.grid.row_spacing = float(number)
        received_image(serialize(image))
    assert _geometry_of.cache_info().currsize == KEPT


def test_an_impossible_geometry_is_refused_in_every_channel() -> None:
    image = image_of(samples=6)
    image.grid.cols = 1
    cdr = serialize(image)
    for _ in range(3):
        with pytest.raises(Rejected, match="norms must be 1"):
            messages.check_slc(
                received_image(cdr), make_sensor(elevation_boresights=(0.1, 0.2, 0.3, 0.4), noise_power=(1.0,) * 4)
            )


@pytest.mark.parametrize("shape", [(3, 2), (1, 1), (2, 2)])
def test_images_serialized_together_are_those_serialized_alone(
    shape: tuple[int, int], rng: np.random.Generator
) -> None:
    images = rng.normal(size=(3, *shape)) + 1j * rng.normal(size=(3, *shape))
    share = np.array([0.0, 0.25, np.nan])
    grid = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, *shape)
    slc = Slc(images.astype(np.complex64), grid, make_aperture(), np.array([0.0, 1.0, 2.0]), share)
    provenance = Provenance(code_version="1", config_hash="abc")
    together = [
        SHIPPED.serialize(image, shared=True) for image in messages.slc_to_messages(slc, frame_of(), provenance)
    ]
    alone = messages.slc_to_messages(slc, frame_of(), provenance)
    assert len(together) == len(alone) == 3
    for cdr, image in zip(together, alone, strict=True):
        assert_same(deserialize(cdr, ComplexImage), image)
