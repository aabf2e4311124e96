"""Provenance: what is known of the images stays known of all that is made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import elevation_at, make_aperture, make_sensor
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sal_height import __version__, messages
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging import Centroid, ImageSettings, Placement, Slc
from sal_height.imaging.pixels import image_beams
from sal_height.messages import deserialize
from sal_height.messages.codec import SHIPPED
from sal_height.messages.parameters import KEPT, _kept_parameter, shared_parameter
from sal_height.messages.products import provenance_of, provenance_to_message
from sal_height.messages.types import ComplexImage, HeightImage, Parameter, ParameterValue, Provenance, Surface
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


@pytest.mark.parametrize(("count", "is_kept"), [(3, True), (300, False)])
def test_lists_and_texts_that_are_not_long_are_kept(count: int, is_kept: bool) -> None:
    for value in (("a",) * count, "a" * count, (0.0,) * count):
        assert (shared_parameter("ml.value", value) is shared_parameter("ml.value", value)) == is_kept


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
    parameter = Parameter(name="ml_height.range_looks", value=ParameterValue(type=244))
    with pytest.raises(Rejected, match="of type 244; 0 to 9 are allowed") as refusal:
        messages.stages_of([parameter])
    assert refusal.value.reason == "wrong provenance"


ELEVATION = elevation_at(np.linspace(-1, 1, 5))
STRIP = make_sensor(mode="stripmap", detector_rotation=0.26, pulse_repetition_frequency=20e3)


def made_with(window: object, stage: str = "sar_compression") -> list[Parameter]:
    return messages.with_stage([], stage, {"azimuth_window": window})


def test_spotlight_has_the_beams_of_the_sensor() -> None:
    sensor = replace(STRIP, mode="spotlight", config_hash="")
    assert image_beams(sensor, "hamming") is sensor.beams


@pytest.mark.parametrize(
    ("provenance", "window"),
    [
        (made_with("hamming"), "hamming"),
        (made_with("taylor"), "taylor"),
        (made_with("rectangular"), "rectangular"),
        (made_with("unheard of"), "rectangular"),
        (made_with(["hamming"]), "rectangular"),
        (made_with(7), "rectangular"),
        ([], "rectangular"),
        (made_with("hamming", stage="other"), "rectangular"),
    ],
)
def test_stripmap_averages_with_the_window_that_the_image_was_made_with(
    provenance: list[Parameter], window: str
) -> None:
    recorded = messages.recorded_window(Provenance(parameters=provenance), "azimuth")
    assert recorded == window
    seen = image_beams(STRIP, recorded).response(ELEVATION, 0.0)
    np.testing.assert_array_equal(seen, image_beams(STRIP, window).response(ELEVATION, 0.0))
    others = {"hamming", "taylor", "rectangular"} - {window}
    assert all(np.abs(seen - image_beams(STRIP, o).response(ELEVATION, 0.0)).max() > 1e-4 for o in others)


PLACED = [
    Placement(0.001, -2e-5, 0.0005, Centroid(0.0023, 1e-4, 3e-4)),
    Placement(0.0, 0.0, 0.01, by_beams=True, beams_error=2e-4, own_error=1e-4),
]


X, Y = np.eye(3)[:2]
SLC = Slc(
    np.zeros((2, 3, 4), np.complex64),
    Grid(np.zeros(3), X, Y, 1.0, 1.0, 3, 4),
    ApertureState(np.zeros(3), X, np.eye(3), 1.0, np.zeros((6, 6)), sliding=False),
    np.ones(2),
    np.zeros(2),
)


def stated(values: Mapping[str, Any]) -> Any:
    """What a message states of the compression."""
    return provenance_of(Provenance(parameters=messages.with_stage([], "sar_compression", values)))


def through_messages(slc: Slc) -> tuple[Placement, float]:
    found = stated({"rows": 3, **messages.autofocus_values(slc)})
    return found.placement, found.residual_phase


@pytest.mark.parametrize("placement", PLACED)
def test_what_data_told_comes_back(placement: Placement) -> None:
    assert through_messages(replace(SLC, placement=placement, residual_phase=0.047)) == (placement, 0.047)


def test_what_data_did_not_tell_is_not_told() -> None:
    assert messages.autofocus_values(replace(SLC, placement=Placement(0.0, 0.0, 0.01))) == {}
    assert through_messages(SLC) == (Placement(0.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speed", float("nan")),
        ("pointing", float("inf")),
        ("speed_error", -1.0),
        ("beams_error", -1e-9),
        ("centroid.error", -1e-9),
        ("centroid.vibration", "much"),
    ],
)
def test_numbers_that_are_none_are_refused(name: str, value: object) -> None:
    with pytest.raises(Rejected, match=f"sar_compression.placement.{name}"):
        _ = stated({f"placement.{name}": value}).placement


@pytest.mark.parametrize("value", [float("nan"), -0.1, "much"])
def test_a_phase_that_is_none_is_refused(value: object) -> None:
    with pytest.raises(Rejected, match=r"sar_compression.residual.phase_rad"):
        _ = stated({"residual.phase_rad": value}).residual_phase
