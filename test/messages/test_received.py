"""Frames and images read from their bytes: views of these, with parts that the images of a dwell share."""

from __future__ import annotations

import pickle
from itertools import product

import numpy as np
import pytest
from helpers import make_aperture, make_sensor
from ros_messages import random_message, spoiled

from sal_height import messages
from sal_height.errors import Rejected
from sal_height.geometry import Grid
from sal_height.imaging import Slc
from sal_height.messages import BrokenMessage, deserialize, frames, received_frame, received_image, serialize
from sal_height.messages.codec import SHIPPED
from sal_height.messages.frames import _key_of, _pulses_of, frame_of
from sal_height.messages.products import _place_of
from sal_height.messages.types import ChannelFrame, ComplexImage, Header, Provenance


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def image_of(spacing: float = 1.0, **fields: object) -> ComplexImage:
    image = ComplexImage(channel=3, dwell=7, samples=np.arange(6, dtype=np.float32), **fields)
    image.grid.rows, image.grid.cols, image.grid.row_spacing = 3, 1, spacing
    image.provenance.config_hash = "abc"
    return image


@pytest.mark.parametrize("name", ["ComplexImage", "HeightImage"])
def test_with_shared_provenance_the_same_bytes_are_refused(name: str, rng: np.random.Generator) -> None:
    type_name, read, refused = f"sal_height_msgs/msg/{name}", 0, 0
    for number in range(600):
        cdr = spoiled(np.frombuffer(serialize(random_message(type_name, rng)), np.uint8), number, rng)
        try:
            expected = deserialize(cdr, type_name)
        except BrokenMessage:
            refused += 1
            with pytest.raises(BrokenMessage):
                deserialize(cdr, type_name, shared=True)
        else:
            read += 1
            assert deserialize(cdr, type_name, shared=True) == expected
    assert min(read, refused) > 50


def test_samples_are_not_copied() -> None:
    frame = ChannelFrame(samples=np.arange(16, dtype=np.uint8), pulse_time=np.arange(3.0), config_hash="abc")
    for message, read in ((frame, received_frame), (image_of(), received_image)):
        cdr = serialize(message)
        received = read(cdr)
        assert np.shares_memory(received.samples, np.frombuffer(cdr, np.uint8))
        assert (received.size, received.key.sensor) == (len(cdr), "abc")


def test_frames_of_a_dwell_share_times_ranges_and_key_also_when_they_are_sent() -> None:
    dwell = [
        received_frame(serialize(ChannelFrame(channel=n, pulse_time=np.arange(3.0), reference_range=np.full(3, 5e3))))
        for n in range(4)
    ]
    for some in (dwell, pickle.loads(pickle.dumps(dwell))):  # noqa: S301 (our own bytes)
        assert [one.channel for one in some] == [0, 1, 2, 3]
        for name in ("key", "pulse_time", "reference_range"):
            assert all(getattr(one, name) is getattr(some[0], name) for one in some)
    for number in range(100):
        received_frame(serialize(ChannelFrame(dwell=number, pulse_time=np.arange(float(number)))))
    assert max(cache.cache_info().currsize for cache in (_pulses_of, _key_of)) < 10


def test_a_frame_is_read_as_without_those_of_its_dwell_before_it(rng: np.random.Generator) -> None:
    def frame(**fields: object) -> ChannelFrame:
        common = {"config_hash": "abc", "encoding": "complex_int16", "pulse_time": np.arange(3.0), "scale": 0.5}
        return ChannelFrame(**{**common, "samples": rng.integers(0, 256, 12, np.uint8), **fields})

    named, none = Header(frame_id="radar"), np.zeros(0, np.uint8)
    ordinary = serialize(frame(channel=1))
    others = [
        serialize(frame(channel=2, **fields))
        for fields in (
            {},
            {"scale": np.nan},
            {"dwell": 1},
            {"header": named},
            {"samples": none},
            {"samples": none, "pulse_time": np.arange(4.0)},
            {"encoding": "complex_int32"},
        )
    ]
    others += [spoiled(np.frombuffer(ordinary, np.uint8), number, rng) for number in range(300)]
    others += [ordinary + bytes(3), ordinary[:-1], ordinary[:-14], ordinary[:40], b""]
    read = refused = 0
    for one, before in product(others, (ordinary, ordinary + b"tail", others[3])):
        received_frame(before)
        try:
            expected = frame_of(deserialize(one, ChannelFrame), len(one))
        except BrokenMessage:
            refused += 1
            with pytest.raises(BrokenMessage):
                received_frame(one)
        else:
            read += 1
            assert repr(received_frame(one)) == repr(expected)
    assert min(read, refused) > 50


def test_frames_of_a_dwell_are_deserialized_once(monkeypatch: pytest.MonkeyPatch) -> None:
    cdrs = [serialize(ChannelFrame(channel=n, scale=n / 2, samples=np.full(8, n, np.uint8))) for n in range(4)]
    received_frame(cdrs[0])
    monkeypatch.setattr(frames, "deserialize", None)
    for number, cdr in enumerate(cdrs):
        found = received_frame(cdr)
        assert (found.channel, found.scale, found.samples.tolist()) == (number, number / 2, [number] * 8)


def test_images_share_geometry_and_provenance_and_few_are_held() -> None:
    images = [received_image(serialize(image_of())) for _ in range(4)]
    assert all(image.provenance is images[0].provenance for image in images)
    assert all(image.place is images[0].place for image in images)
    most = _place_of.cache_info().maxsize
    assert most
    for number in range(3 * most):
        received_image(serialize(image_of(float(number))))
    assert _place_of.cache_info().currsize == most


def test_an_impossible_geometry_is_refused_in_every_channel() -> None:
    sensor = make_sensor(elevation_boresights=(0.1, 0.2, 0.3, 0.4), noise_power=(1.0,) * 4)
    for _ in range(3):
        with pytest.raises(Rejected, match="norms must be 1"):
            messages.check_slc(deserialize(serialize(image_of()), ComplexImage, shared=True), sensor)


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
        SHIPPED.serialize(image, shared=True) for image in messages.slc_to_messages(slc, ChannelFrame(), provenance)
    ]
    alone = messages.slc_to_messages(slc, ChannelFrame(), provenance)
    assert [deserialize(cdr, ComplexImage) for cdr in together] == alone
    assert len(alone) == 3
