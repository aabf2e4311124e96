"""Frames, images and odometry read from their bytes, and images written to them, are those of rclpy."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
import pytest
from helpers import make_aperture, make_sensor
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from sal_height_msgs.msg import ChannelFrame, ComplexImage, HeightImage, Provenance, Surface

from sal_height import messages
from sal_height.bag.codec import _plain, _type_name, typestore
from sal_height.bag.definitions import installed_definition
from sal_height.errors import Rejected
from sal_height.geometry import Grid
from sal_height.imaging import Slc
from sal_height.messages import received, received_frame, received_height, received_image, received_pose
from sal_height.messages.received import HELD, Pose, _geometry_of, _provenance_of


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
    frame.samples = array.array("B", range(16 * pulses))
    return frame


def image_of(frame_id: str = "map", samples: int = 4, version: str = "0.1.0", parameters: int = 2) -> ComplexImage:
    image = ComplexImage(channel=3, dwell=7, noise_power=0.25, saturated_share=0.5)
    image.header.frame_id, image.header.stamp.nanosec = frame_id, 5
    image.grid.rows, image.grid.col_spacing = 3, 0.125
    image.aperture.length, image.aperture.sliding = 8.5, True
    image.samples = array.array("f", np.arange(samples, dtype=np.float32))
    image.provenance.code_version, image.provenance.config_hash = version, "abc"
    image.provenance.parameters = [
        Parameter(f"p{n}", value=[0.5, float(n)]).to_parameter_msg() for n in range(parameters)
    ]
    image.provenance.autofocus_phase = array.array("f", [0.5] * parameters)
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
    image.header.frame_id, image.validity = "map", array.array("B", range(pixels))
    for number in range(surfaces):
        values = array.array("f", [number + 0.5] * pixels)
        image.surfaces.append(Surface(height=values, sigma=values, covariance=values * 6))
    image.order_probability = array.array("f", [0.2] * pixels)
    image.provenance = image_of(version=version).provenance
    return image


EXAMPLES = [frame_of(), image_of(), odometry_of(), height_of()]


def same(one: Any, other: Any) -> bool:
    """Whether a field has the same value in a message and as it was read."""
    if isinstance(other, array.array):
        return np.array_equal(np.array(one), np.array(other), equal_nan=True)
    return bool(one == other) or str(one) == str(other)  # with NaN


def assert_same(view: Any, message: Any) -> None:
    if isinstance(message, Odometry):
        assert str(view) == str(Pose.of(message))
        return
    for name in message.get_fields_and_field_types():
        assert same(getattr(view, name), getattr(message, name)), name


@pytest.mark.parametrize("frame_id", ["", "map", "maps", "größer"])
@pytest.mark.parametrize("pulses", [0, 1, 4])
@pytest.mark.parametrize("config_hash", ["", "1234567", "a_long_hash"])
def test_frames_are_those_of_rclpy(frame_id: str, pulses: int, config_hash: str) -> None:
    cdr = serialize_message(frame_of(frame_id, config_hash, pulses))
    assert_same(received_frame(cdr), deserialize_message(cdr, ChannelFrame))


@pytest.mark.parametrize("frame_id", ["", "map", "maps", "a_long_frame"])
@pytest.mark.parametrize("samples", [0, 1, 2, 7])
@pytest.mark.parametrize(("version", "parameters"), [("", 0), ("0.1.0", 3), ("0.10.0", 2)])
def test_images_are_those_of_rclpy(frame_id: str, samples: int, version: str, parameters: int) -> None:
    cdr = serialize_message(image_of(frame_id, samples, version, parameters))
    assert_same(received_image(cdr), deserialize_message(cdr, ComplexImage))


@pytest.mark.parametrize("frame_id", ["", "map", "maps"])
@pytest.mark.parametrize("child", ["", "base_link", "of_another"])
def test_odometry_is_that_of_rclpy(frame_id: str, child: str) -> None:
    cdr = serialize_message(odometry_of(frame_id, child))
    assert_same(received_pose(cdr), deserialize_message(cdr, Odometry))


@pytest.mark.parametrize("surfaces", [0, 1, 3])
@pytest.mark.parametrize("pixels", [0, 1, 2, 5])
@pytest.mark.parametrize(("estimator", "version"), [("", "0.1.0"), ("tracked", ""), ("ml", "0.10")])
def test_heights_are_those_of_rclpy(surfaces: int, pixels: int, estimator: str, version: str) -> None:
    cdr = serialize_message(height_of(surfaces, pixels, estimator, version))
    assert_same(received_height(cdr), deserialize_message(cdr, HeightImage))
    assert received_height(cdr).provenance is received_height(cdr).provenance


@pytest.mark.parametrize("message", EXAMPLES, ids=["frame", "image", "odometry", "height"])
def test_messages_of_the_other_byte_order_are_read(message: Any) -> None:
    name = _type_name(message)
    store = typestore(name, installed_definition(name))
    cdr = bytes(store.serialize_cdr(_plain(message, store), name, little_endian=False))
    assert_same(READERS[type(message)](cdr), message)


@pytest.mark.parametrize("message", EXAMPLES, ids=["frame", "image", "odometry", "height"])
def test_whatever_bytes_come_are_read_or_refused_as_by_rclpy(message: Any, rng: np.random.Generator) -> None:
    """Bytes at random places are changed, as they are or to small numbers, and the end is cut off now and then."""
    whole, read, refused = np.frombuffer(serialize_message(message), np.uint8), 0, 0
    for number in range(1500):
        spoiled = whole[: rng.integers(len(whole) + 1) if number % 3 == 0 else None].copy()
        if len(spoiled) and number % 3 != 1:
            spoiled[rng.integers(len(spoiled), size=2)] = rng.integers(4 if number % 2 else 256, size=2)
        elif len(spoiled):
            spoiled[4 * rng.integers(len(spoiled) // 4) + np.arange(4)] = (rng.integers(256), 0, 0, 0)
        cdr = spoiled.tobytes()
        try:
            expected = deserialize_message(cdr, type(message))
        except RuntimeError:
            refused += 1
            with pytest.raises(RuntimeError):
                READERS[type(message)](cdr)
        else:
            read += 1
            assert_same(READERS[type(message)](cdr), expected)
    assert min(read, refused) > 100


def test_samples_are_not_copied_and_no_message_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    cdr = serialize_message(frame_of())
    monkeypatch.setattr(received, "deserialize_message", None)
    frame = received_frame(cdr)
    assert np.shares_memory(frame.samples, np.frombuffer(cdr, np.uint8))
    assert frame.size == len(cdr)


def test_images_share_geometry_and_provenance_and_few_are_held() -> None:
    images = [received_image(serialize_message(image_of())) for _ in range(4)]
    assert all(image.provenance is images[0].provenance for image in images)
    assert all(image.geometry is images[0].geometry for image in images)
    for number in range(3 * HELD):
        image = image_of(version=f"{number}")
        image.grid.row_spacing = float(number)
        received_image(serialize_message(image))
    for cache in (_geometry_of, _provenance_of):
        assert cache.cache_info().currsize == HELD


def test_an_impossible_geometry_is_refused_in_every_channel() -> None:
    image = image_of(samples=6)
    image.grid.cols = 1
    cdr = serialize_message(image)
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
    together = messages.serialized_slc(slc, frame_of(), provenance)
    alone = messages.slc_to_messages(slc, frame_of(), provenance)
    assert len(together) == len(alone) == 3
    for cdr, image in zip(together, alone, strict=True):
        assert_same(deserialize_message(cdr, ComplexImage), image)
