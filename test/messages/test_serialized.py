"""Images decoded with a shared provenance are those that rclpy decodes."""

from __future__ import annotations

import array

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from sal_height_msgs.msg import ComplexImage

from sal_height.messages.serialized import HELD_PROVENANCES, SlcDecoder, provenance_offset, serialized_images


def image_of(channel: int, frame: str, samples: int, version: str, parameters: int) -> ComplexImage:
    image = ComplexImage(channel=channel, dwell=7, noise_power=0.25, saturated_share=0.5)
    image.header.frame_id, image.header.stamp.nanosec = frame, 5
    image.grid.rows, image.grid.col_spacing = 3, 0.125
    image.aperture.length, image.aperture.sliding = 8.5, True
    image.samples = array.array("f", np.arange(samples, dtype=np.float32))
    image.provenance.code_version, image.provenance.config_hash = version, "abc"
    image.provenance.parameters = [
        Parameter(f"p{n}", value=[0.5, float(n)]).to_parameter_msg() for n in range(parameters)
    ]
    image.provenance.autofocus_phase = array.array("f", [0.5] * parameters)
    return image


@pytest.mark.parametrize("frame", ["", "map", "maps", "a_long_frame"])
@pytest.mark.parametrize("samples", [0, 1, 2, 7])
@pytest.mark.parametrize(("version", "parameters"), [("", 0), ("0.1.0", 3), ("0.10.0", 2)])
def test_images_are_equal_to_those_of_rclpy(frame: str, samples: int, version: str, parameters: int) -> None:
    decoder = SlcDecoder()
    for channel in range(3):
        cdr = serialize_message(image_of(channel, frame, samples, version, parameters))
        assert provenance_offset(cdr) is not None
        assert decoder.decode(cdr) == deserialize_message(cdr, ComplexImage)


def test_channels_share_one_provenance_and_few_are_held() -> None:
    decoder = SlcDecoder()
    images = [decoder.decode(serialize_message(image_of(n, "map", 4, "1", 2))) for n in range(4)]
    assert all(image.provenance is images[0].provenance for image in images)
    for number in range(3 * HELD_PROVENANCES):
        decoder.decode(serialize_message(image_of(0, "map", 4, f"{number}", 2)))
    assert len(decoder._provenances) == HELD_PROVENANCES


@pytest.mark.parametrize("length", [0, 3, 4, 20, 100, 300])
def test_bytes_that_are_no_image_are_refused_as_rclpy_does(length: int) -> None:
    cdr = serialize_message(image_of(0, "map", 4, "1", 2))[:length]
    with pytest.raises(RuntimeError):
        deserialize_message(cdr, ComplexImage)
    with pytest.raises(RuntimeError):
        SlcDecoder().decode(cdr)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("sizes", [(4, 4, 4), (4, 5, 6)])
def test_images_serialized_together_are_those_serialized_alone(shared: bool, sizes: tuple[int, ...]) -> None:
    images = [image_of(n, "map", size, "1", 3) for n, size in enumerate(sizes)]
    for image in images[1:] if shared else []:
        image.provenance = images[0].provenance
    for cdr, image in zip(serialized_images(images), images, strict=True):
        assert deserialize_message(cdr, ComplexImage) == image
        assert image.provenance.code_version == "1"
