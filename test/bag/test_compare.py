"""Comparison of height images: every difference that can be put in is found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from sal_height_msgs.msg import HeightImage, Surface

from sal_height.bag.compare import HEIGHT_IMAGE, HeightComparison, compare_heights
from sal_height.bag.writer import BagWriter

ROWS, COLS = 3, 4
FLOAT_FIELDS = ("height", "sigma", "cnr_db", "east", "north")


def image(dwell: int = 0) -> HeightImage:
    message = HeightImage(dwell=dwell, estimator="ml", range_looks=4, azimuth_looks=1)
    message.grid.rows, message.grid.cols = ROWS, COLS
    values = np.random.default_rng(dwell).normal(size=(len(FLOAT_FIELDS), ROWS * COLS)).astype(np.float32)
    values[:, 5] = np.nan
    message.surfaces = [Surface(**dict(zip(FLOAT_FIELDS, values, strict=True)))]
    message.validity = np.zeros(ROWS * COLS, np.uint8)
    message.validity[5] = HeightImage.LOW_CNR
    return message


def write_bag(directory: Path, images: dict[str, list[HeightImage]]) -> Path:
    with BagWriter(directory) as writer:
        for topic, sequence in images.items():
            writer.add_topic(topic, HEIGHT_IMAGE)
            for time, message in enumerate(sequence):
                writer.write(topic, serialize_message(message), time, time)
    return directory


def test_equal_bags_are_equal_whatever_the_provenance(tmp_path: Path) -> None:
    topics = {"/ml/height": [image(0), image(1)], "/monopulse/height": [image(0)]}
    recorded = write_bag(tmp_path / "recorded", topics)
    for message in (message for sequence in topics.values() for message in sequence):
        message.provenance.code_version = "another"
        message.header.stamp.sec = 7
    result = compare_heights(recorded, write_bag(tmp_path / "replayed", topics))
    assert result == {
        "/ml/height": HeightComparison(matched=2, pixels=2 * ROWS * COLS, greatest_height_difference=0.0),
        "/monopulse/height": HeightComparison(matched=1, pixels=ROWS * COLS, greatest_height_difference=0.0),
    }
    assert all(comparison.equal for comparison in result.values())


@pytest.mark.parametrize(("change", "different"), [(None, 0), (1.5, 1), ([], ROWS * COLS)])
def test_a_second_surface_is_compared_too(change: float | list[float] | None, different: int) -> None:
    ours, theirs = image(), image()
    for side in (ours, theirs):
        side.surfaces = [*side.surfaces, *image(7).surfaces]
    if isinstance(change, list):
        theirs.surfaces[1].sigma = change
    elif change is not None:
        theirs.surfaces[1].sigma[3] = change
    result = compare_heights({"/ml/height": [ours]}, {"/ml/height": [theirs]})["/ml/height"]
    assert (result.pixels, result.pixels_different) == (ROWS * COLS, different)


def test_a_bag_compares_with_messages_at_hand(tmp_path: Path) -> None:
    recorded = write_bag(tmp_path / "recorded", {"/ml/height": [image(0), image(1)]})
    assert compare_heights(recorded, {"/ml/height": [image(1), image(0)]})["/ml/height"].equal


@pytest.mark.parametrize("name", [*FLOAT_FIELDS, "validity"])
def test_the_least_difference_in_any_array_is_one_pixel(name: str) -> None:
    other = image()
    values = np.asarray(getattr(other if name == "validity" else other.surfaces[0], name))
    values[2] = np.nextafter(values[2], np.float32(9)) if name in FLOAT_FIELDS else values[2] + 1
    result = compare_heights({"/h": [image()]}, {"/h": [other]})["/h"]
    assert (result.pixels_different, result.equal) == (1, False)
    greatest = result.greatest_height_difference
    assert greatest is not None
    assert (greatest > 0) == (name == "height")


def test_nan_differs_from_a_number_but_adds_no_height_difference() -> None:
    other = image()
    other.surfaces[0].height[0] = float("nan")
    other.surfaces[0].height[5] = 1.0
    result = compare_heights({"/h": [image()]}, {"/h": [other]})["/h"]
    assert (result.pixels_different, result.greatest_height_difference) == (2, 0.0)


def test_the_greatest_height_difference_is_in_metres_over_all_images() -> None:
    first, second = image(0), image(1)
    first.surfaces[0].height[3] += 0.25
    second.surfaces[0].height[4] -= 0.5
    result = compare_heights({"/h": [image(0), image(1)]}, {"/h": [first, second]})["/h"]
    assert result.greatest_height_difference == pytest.approx(0.5, abs=1e-6)
    assert result.pixels_different == 2


def move(message: HeightImage) -> None:
    message.grid.origin.x += 0.01


def turn(message: HeightImage) -> None:
    message.grid.row_direction.z = 1e-9


def stretch(message: HeightImage) -> None:
    message.grid.col_spacing += 0.01


def reshape(message: HeightImage) -> None:
    message.grid.rows, message.grid.cols = COLS, ROWS


def relook(message: HeightImage) -> None:
    message.azimuth_looks += 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (move, "pixels at other places"),
        (turn, "pixels at other places"),
        (stretch, "pixels at other places"),
        (relook, "4 x 2 looks instead of 4 x 1"),
    ],
)
def test_another_grid_makes_the_images_differ(change: Callable[[HeightImage], None], said: str) -> None:
    other = image()
    change(other)
    result = compare_heights({"/h": [image(1), image()]}, {"/h": [image(1), other]})["/h"]
    assert (result.grids_different, result.pixels_different, result.equal) == (1, 0, False)
    assert (result.grid_change, result.greatest_height_difference) == (said, 0.0)


@pytest.mark.parametrize("tolerance_m", [0.0, 9.0])
def test_images_of_another_shape_have_no_pixel_in_common(tolerance_m: float) -> None:
    other = image()
    reshape(other)
    result = compare_heights({"/h": [image()]}, {"/h": [other]}, tolerance_m)["/h"]
    assert (result.grids_different, result.pixels_different) == (1, ROWS * COLS)
    assert result.grid_change == "4 x 3 pixels instead of 3 x 4"
    assert result.greatest_height_difference is None


def test_arrays_of_other_length_differ_in_every_pixel() -> None:
    other = image()
    other.surfaces[0].sigma = other.surfaces[0].sigma[:-1]
    assert compare_heights({"/h": [image()]}, {"/h": [other]})["/h"].pixels_different == ROWS * COLS


def test_images_of_one_side_only_are_missing_or_extra() -> None:
    result = compare_heights({"/h": [image(0), image(1)], "/old": [image(0)]}, {"/h": [image(1), image(2), image(3)]})
    assert (result["/h"].matched, result["/h"].missing, result["/h"].extra) == (1, 1, 2)
    assert result["/old"] == HeightComparison(missing=1)
    assert not result["/h"].equal
    assert not result["/old"].equal


def test_a_dwell_number_that_comes_twice_is_matched_twice() -> None:
    changed = image(0)
    changed.surfaces[0].height[0] += 1
    result = compare_heights({"/h": [image(0), image(0)]}, {"/h": [image(1), image(0), changed]})["/h"]
    assert (result.matched, result.missing, result.extra, result.pixels_different) == (2, 0, 1, 1)


def test_nothing_is_not_equal_to_nothing() -> None:
    assert compare_heights({}, {}) == {}
    assert not HeightComparison().equal


def test_from_a_bag_without_height_images_all_are_missing(tmp_path: Path) -> None:
    recorded = write_bag(tmp_path / "recorded", {"/ml/height": [image(0), image(1)]})
    empty = write_bag(tmp_path / "empty", {"/ml/height": []})
    with BagWriter(tmp_path / "foreign") as writer:
        writer.add_topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        writer.write("/diagnostics", serialize_message(DiagnosticArray()), 0, 0)
    for replayed in (empty, tmp_path / "foreign"):
        assert compare_heights(recorded, replayed) == {"/ml/height": HeightComparison(missing=2)}
        assert compare_heights(replayed, recorded) == {"/ml/height": HeightComparison(extra=2)}
