"""Provenance: what is known of the images stays known of all that is made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import make_aperture
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sal_height import __version__, messages
from sal_height.errors import Rejected
from sal_height.geometry import Grid
from sal_height.imaging import ImageSettings, Slc
from sal_height.messages import deserialize
from sal_height.messages.codec import SHIPPED
from sal_height.messages.parameters import KEPT, _kept_parameter
from sal_height.messages.products import provenance_of, provenance_to_message
from sal_height.messages.types import ComplexImage, HeightImage, ParameterValue, Provenance, Surface
from sal_height.messages.types import Parameter as ParameterMessage
from sal_height.settings import Settings


@pytest.fixture(scope="module")
def store() -> Typestore:
    """What rosbags knows of messages, with ours: it refuses bytes that are too many or too few."""
    known, types = get_typestore(Stores.ROS2_JAZZY), {}
    for file in Path(__file__).parents[2].glob("msg_defs/msg/*.msg"):
        types |= get_types_from_msg(file.read_text(encoding="utf-8"), f"sal_height_msgs/msg/{file.stem}")
    known.register(types)
    return known


class Looks(Settings):
    """Parameters of some stage."""

    range_looks: int = 3


def test_a_product_keeps_what_is_known_of_the_images_it_is_made_of() -> None:
    images = Provenance(
        code_version="0",
        config_hash="f00",
        calibration_id="ca1",
        parameters=messages.with_stage([], "sar_compression", {"autofocus": True}),
        autofocus_phase=[0.5, -0.25],
    )
    heights = provenance_to_message(provenance_of(images).derived("ml_height", Looks()))
    assert (heights.code_version, heights.config_hash, heights.calibration_id) == (__version__, "f00", "ca1")
    assert list(heights.autofocus_phase) == [0.5, -0.25]
    stages = messages.stages_of(heights.parameters)
    assert stages == {"sar_compression": {"autofocus": True}, "ml_height": {"range_looks": 3}}


def test_a_stage_that_comes_again_replaces_what_it_had() -> None:
    before = messages.with_stage([], "ml", {"looks": 2, "prior": {"length": 5.0, "mean": None}, "window": "boxcar"})
    assert [parameter.name for parameter in before] == ["ml.looks", "ml.prior.length", "ml.window"]
    made = messages.with_stage(before, "ml", Looks(range_looks=4))
    assert messages.stages_of(made) == {"ml": {"range_looks": 4}}


def test_equal_values_of_other_types_are_other_parameters() -> None:
    for value in (1, True, 1.0, "1", [1, 2], [1.0, 2.0], 0.0, -0.0, 0, False):
        (parameter,) = messages.with_stage([], "ml", {"value": value})
        found = messages.stages_of([parameter])["ml"]["value"]
        assert repr(found) == repr(value)


def test_parameters_kept_are_bounded() -> None:
    _kept_parameter.cache_clear()
    for number in range(KEPT + 9):
        messages.with_stage([], "ml", {"value": number})
    info = _kept_parameter.cache_info()
    assert (info.misses, info.currsize) == (KEPT + 9, KEPT)


def test_what_follows_from_a_provenance_is_the_same_object_for_the_very_same_one_alone() -> None:
    settings = Looks()
    images, equal = (
        provenance_of(Provenance(config_hash="f00", parameters=messages.with_stage([], "slc", {"autofocus": True})))
        for _ in range(2)
    )
    assert images == equal
    heights = images.derived("ml", settings)
    assert images.derived("ml", settings) is heights
    for other in (
        equal.derived("ml", settings),
        images.derived("ml", Looks()),
        images.derived("ml", {"range_looks": 3}),
    ):
        assert other == heights
        assert other is not heights
    assert images.derived("capon", settings) != heights
    assert images.derived("ml", Looks(range_looks=4)) != heights
    assert images.stages is images.stages
    assert equal.stages == images.stages == {"slc": {"autofocus": True}}


@pytest.mark.parametrize("pixels", range(1, 9))
def test_serialized_heights_are_read_by_rclpy_and_to_the_last_byte_by_rosbags(store: Typestore, pixels: int) -> None:
    """Whatever the length of the lists before the provenance, whose numbers of eight bytes lie on multiples of it."""
    settings = {
        "windows": [0.5, 1.5], "names": ["a", "bcd"], "margin": 2.0, "looks": 3, "name": "text", "some": [1, 2, 3],
        "flags": [True, False, True], "flag": True, "none": "",
    }  # fmt: skip
    provenance = Provenance(
        code_version="1.2",
        config_hash="f" * pixels,
        parameters=messages.with_stage([], "ml", settings),
        autofocus_phase=[0.5, -0.25],
    )
    for _ in range(2):  # made, and held
        image = HeightImage(dwell=7, estimator="ml", validity=bytes(pixels), provenance=provenance)
        image.surfaces = [Surface(height=pixels * [1.5])]
        cdr = SHIPPED.serialize(image, shared=True)
        assert deserialize(cdr, HeightImage) == image
        assert store.deserialize_cdr(cdr, "sal_height_msgs/msg/HeightImage").dwell == 7
        assert image.provenance is provenance


def test_serialized_images_end_with_their_provenance(store: Typestore) -> None:
    provenance = Provenance(parameters=messages.with_stage([], "sar_compression", ImageSettings()))
    grid = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, 1, 3)
    slc = Slc(np.ones((2, 1, 3), np.complex64), grid, make_aperture(), np.ones(2), np.zeros(2))
    for image in messages.slc_to_messages(slc, ComplexImage(dwell=5), provenance):
        cdr = SHIPPED.serialize(image, shared=True)
        assert store.deserialize_cdr(cdr, "sal_height_msgs/msg/ComplexImage").dwell == 5


def test_a_parameter_of_an_unknown_type_is_refused_in_a_sentence() -> None:
    parameter = ParameterMessage(name="ml_height.range_looks", value=ParameterValue(type=244))
    with pytest.raises(Rejected, match="of type 244; 0 to 9 are allowed") as refusal:
        messages.stages_of([parameter])
    assert refusal.value.reason == "wrong provenance"
