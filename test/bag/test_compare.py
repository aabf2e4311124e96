"""Comparison of bags: every difference that can be put in is found, and turns the verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sal_height.bag.compare import CHANGED, EQUAL, WITHIN, TopicComparison, compare_bags, content_hash, fields_of
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import EXACT, ROUNDING, Tolerance, Tolerances, read_tolerances
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, DiagnosticArray, Doubt, FitTest, HeightImage, Odometry, Surface

ROWS, COLS = 3, 4
FLOAT_FIELDS = ("height", "sigma", "cnr_db", "east", "north")
TENTH_OF_SIGMA = Tolerances({"surfaces.height": Tolerance(sigma=0.1)})


def image(dwell: int = 0) -> HeightImage:
    message = HeightImage(dwell=dwell, estimator="ml", range_looks=4, azimuth_looks=1)
    message.grid.rows, message.grid.cols = ROWS, COLS
    values = np.random.default_rng(dwell).normal(size=(len(FLOAT_FIELDS), ROWS * COLS)).astype(np.float32)
    values[1] = 0.5
    values[:, 5] = np.nan
    message.surfaces = [Surface(**dict(zip(FLOAT_FIELDS, values, strict=True)))]
    message.validity = np.zeros(ROWS * COLS, np.uint8)
    message.validity[5] = HeightImage.LOW_CNR
    return message


class Bags:
    """Writes two bags with messages by topic, and compares them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.written = folder, 0

    def write(self, messages: dict[str, list[Any]], kind: str = HEIGHT_TYPE) -> BagReader:
        self.written += 1
        with BagWriter(self.folder / str(self.written)) as writer:
            for topic, sequence in messages.items():
                writer.add_topic(topic, kind)
                for time, message in enumerate(sequence):
                    writer.write(topic, serialize(message), time, time)
        return BagReader(self.folder / str(self.written))

    def compare(self, golden: list[Any], made: list[Any], tolerances: Tolerances = EXACT) -> TopicComparison:
        return compare_bags(self.write({"/h": golden}), self.write({"/h": made}), tolerances)["/h"]


@pytest.fixture
def bags(tmp_path: Path) -> Bags:
    return Bags(tmp_path)


def test_equal_bags_are_equal_whatever_the_provenance_and_the_order(bags: Bags) -> None:
    topics = {"/ml/height": [image(0), image(1)], "/monopulse/height": [image(0)]}
    golden = bags.write(topics)
    for message in (message for sequence in topics.values() for message in sequence):
        message.provenance.code_version = "another"
    topics["/ml/height"].reverse()
    result = compare_bags(golden, bags.write(topics))
    assert {topic: (one.verdict, one.matched, one.missing, one.extra) for topic, one in result.items()} == {
        "/ml/height": (EQUAL, 2, 0, 0),
        "/monopulse/height": (EQUAL, 1, 0, 0),
    }
    for one in result.values():
        assert one.hashes[0] == one.hashes[1] != ""
        assert one.fields["surfaces[0].height"].greatest == 0
    assert result["/ml/height"].hashes != result["/monopulse/height"].hashes


def test_a_bag_that_is_older_than_the_tests_of_its_data_is_equal_to_one_that_has_them(bags: Bags) -> None:
    tested = image()
    tested.doubts = [Doubt(name="noise level", size=3.0)]
    tested.fit = [FitTest(name="noise level", size=3.0), FitTest(name="channel gain", channel=1)]
    assert bags.compare([image()], [tested]).verdict == bags.compare([tested], [image()]).verdict == EQUAL


@pytest.mark.parametrize("name", [*FLOAT_FIELDS, "validity"])
def test_the_least_difference_in_any_array_is_found(name: str, bags: Bags) -> None:
    other = image()
    values = np.asarray(getattr(other if name == "validity" else other.surfaces[0], name))
    before = values[2]
    values[2] = np.nextafter(values[2], np.float32(9)) if name in FLOAT_FIELDS else values[2] + 1
    result = bags.compare([image(3), image()], [image(3), other])
    full_name = name if name == "validity" else f"surfaces[0].{name}"
    assert [field for field, one in result.fields.items() if one.different] == [full_name]
    found = result.fields[full_name]
    assert (result.verdict, found.different, found.outside, result.outside) == (CHANGED, 1, 1, {0: 1})
    assert found.worst == (0, 2, str(before), str(values[2]))
    assert found.greatest == abs(float(values[2]) - float(before)) > 0
    assert result.hashes[0] != result.hashes[1]


@pytest.mark.parametrize(("sigmas", "verdict"), [(0.1 - 1e-4, WITHIN), (0.1 + 1e-4, CHANGED)])
def test_a_change_of_a_ten_thousandth_of_sigma_decides(sigmas: float, verdict: str, bags: Bags) -> None:
    other = image()
    other.surfaces[0].height[7] += np.float32(sigmas * 0.5)
    result = bags.compare([image()], [other], TENTH_OF_SIGMA)
    assert result.verdict == verdict
    assert result.fields["surfaces[0].height"].greatest == pytest.approx(sigmas * 0.5, abs=1e-6)


@pytest.mark.parametrize("pattern", [name for name in ROUNDING.rules if name not in {"samples", "noise_power"}])
@pytest.mark.parametrize(("share", "verdict"), [(0.99, WITHIN), (1.01, CHANGED)])
def test_each_default_tolerance_ends_where_it_says(pattern: str, share: float, verdict: str, bags: Bags) -> None:
    """In values of a size of which the digits of their type suffice for it."""
    golden, made = image(), image()
    for side in (golden, made):
        for field in ("covariance", "common_covariance"):
            setattr(side.surfaces[0], field, np.full(6 * ROWS * COLS, 0.25, np.float32))
        side.surfaces[0].spread = np.full(ROWS * COLS, 0.25, np.float32)
        side.order_probability = np.full(5 * ROWS * COLS, 0.2, np.float32)
        side.grid.row_spacing = side.aperture.length = 2.0
    name = {"grid.*": "grid.row_spacing", "aperture.*": "aperture.length"}.get(pattern, pattern)
    full_name = name.replace("surfaces.", "surfaces[0].")
    values, sigma = fields_of(golden)[full_name], fields_of(golden)["surfaces[0].sigma"]
    value = values[0] + share * ROUNDING.rules[pattern].allowed(values, sigma)[0]
    holder, _, field = name.rpartition(".")
    owner = {"": made, "surfaces": made.surfaces[0]}.get(holder) or getattr(made, holder)
    if values.size == 1:
        setattr(owner, field, value)
    else:
        getattr(owner, field)[0] = value
    found = bags.compare([golden], [made], ROUNDING)
    assert [one for one, difference in found.fields.items() if difference.different] == [full_name]
    assert found.verdict == verdict


def later(message: HeightImage) -> None:
    message.header.stamp.nanosec += 1


def refuse(message: HeightImage) -> None:
    message.validity[0] = HeightImage.AMBIGUOUS


def lose(message: HeightImage) -> None:
    message.surfaces[0].height[0] = float("nan")


def shorten(message: HeightImage) -> None:
    message.surfaces[0].sigma = message.surfaces[0].sigma[:-1]


def move(message: HeightImage) -> None:
    message.grid.origin.x += 1e-12


def rename(message: HeightImage) -> None:
    message.estimator = "mk"


def put_a_second_surface_in(message: HeightImage) -> None:
    message.surfaces = [*message.surfaces, *image(7).surfaces]


@pytest.mark.parametrize("change", [later, refuse, lose, shorten, rename, put_a_second_surface_in])
def test_what_is_no_rounding_turns_the_verdict_whatever_the_tolerance(
    change: Callable[[HeightImage], None], bags: Bags
) -> None:
    other = image()
    change(other)
    result = bags.compare([image()], [other], Tolerances({"*": Tolerance(0.9, relative=1e9, rms=1e9, sigma=1e9)}))
    assert result.verdict == CHANGED
    assert result.worst == 0


def test_a_moved_grid_is_within_a_tolerance_that_allows_it(bags: Bags) -> None:
    other = image()
    move(other)
    assert bags.compare([image()], [other]).verdict == CHANGED
    assert bags.compare([image()], [other], Tolerances({"grid.*": Tolerance(absolute=1e-9)})).verdict == WITHIN


def test_validities_are_counted_by_both_names(bags: Bags) -> None:
    other = image()
    refuse(other)
    found = bags.compare([image()], [other]).validity
    assert found == {("OK", "OK"): 10, ("OK", "AMBIGUOUS"): 1, ("LOW_CNR", "LOW_CNR"): 1}


def test_nan_differs_from_a_number_but_adds_no_difference(bags: Bags) -> None:
    other = image()
    lose(other)
    other.surfaces[0].height[5] = 1.0
    found = bags.compare([image()], [other]).fields["surfaces[0].height"]
    assert (found.different, found.nan_changes, found.greatest, found.rms) == (2, 2, 0.0, 0.0)


def test_differences_are_summed_up_over_all_images(bags: Bags) -> None:
    """23 of 24 pixels have a height; a quarter of a metre in one and half a metre in another."""
    first, second = image(0), image(1)
    first.surfaces[0].height[3] += np.float32(0.25)
    second.surfaces[0].height[4] -= np.float32(0.5)
    found = bags.compare([image(0), image(1)], [first, second]).fields["surfaces[0].height"]
    assert found.greatest == pytest.approx(0.5, abs=1e-6)
    assert found.rms == pytest.approx(np.sqrt((0.25**2 + 0.5**2) / 22), rel=1e-6)
    assert found.quantile(0.5) == 0
    assert found.quantile(0.95) == pytest.approx(0.25, rel=0.13)
    assert found.quantile(1) == found.greatest


def test_quantiles_are_those_of_all_differences_within_a_class(bags: Bags) -> None:
    rng = np.random.default_rng(5)
    golden, made = Odometry(), Odometry()
    golden.pose.covariance[:] = rng.normal(size=36)
    made.pose.covariance[:] = golden.pose.covariance + 10.0 ** rng.uniform(-9, 3, 36)
    one = compare_bags(
        *(bags.write({"/odometry": [m]}, "nav_msgs/msg/Odometry") for m in (golden, made)), EXACT, ["/odometry"]
    )["/odometry"].fields["pose.covariance"]
    differences = np.abs(made.pose.covariance - golden.pose.covariance)
    for share in (0.5, 0.95, 0.99):
        wanted = np.quantile(differences, share, method="inverted_cdf")
        assert wanted <= one.quantile(share) * (1 + 1e-12) <= 1.13 * wanted


def test_images_of_one_side_only_are_missing_or_extra(bags: Bags) -> None:
    golden = bags.write({"/h": [image(0), image(1)], "/old": [image(0)]})
    made = bags.write({"/h": [image(1), image(2), image(3)], "/new": [image(0)]})
    result = compare_bags(golden, made, TENTH_OF_SIGMA)
    assert (result["/h"].matched, result["/h"].missing, result["/h"].extra) == (1, 1, 2)
    assert sorted(result["/h"].lone) == [0, 2, 3]
    assert (result["/old"].missing, result["/new"].extra) == (1, 1)
    assert {one.verdict for one in result.values()} == {CHANGED}


def test_a_dwell_number_that_comes_twice_is_matched_twice(bags: Bags) -> None:
    changed = image(0)
    changed.surfaces[0].height[0] += 1
    result = bags.compare([image(0), image(0)], [image(1), image(0), changed])
    assert (result.matched, result.missing, result.extra) == (2, 0, 1)
    assert result.fields["surfaces[0].height"].different == 1


def test_by_stamp_dwells_of_one_number_are_not_confused(bags: Bags) -> None:
    """The first one was dropped on one side, and the last one on the other."""
    flown = [stamped(second, changed=second) for second in range(4)]
    golden, made = bags.write({"/h": flown[1:]}), bags.write({"/h": flown[:-1]})
    result = compare_bags(golden, made, by_stamp=True)["/h"]
    assert (result.matched, result.missing, result.extra, result.outside) == (2, 1, 1, {})
    assert compare_bags(golden, made)["/h"].outside


def stamped(second: int, changed: float) -> HeightImage:
    message = image(0)
    message.header.stamp.sec = second
    message.surfaces[0].height[0] += np.float32(changed)
    return message


def test_nothing_is_not_equal_to_nothing(bags: Bags) -> None:
    assert compare_bags(bags.write({}), bags.write({})) == {}
    assert TopicComparison().verdict == CHANGED


def test_from_a_bag_without_height_images_all_are_missing(bags: Bags) -> None:
    golden, empty = bags.write({"/ml/height": [image(0), image(1)]}), bags.write({"/ml/height": []})
    foreign = bags.write({"/diagnostics": [DiagnosticArray()]}, "diagnostic_msgs/msg/DiagnosticArray")
    for made in (empty, foreign):
        assert compare_bags(golden, made)["/ml/height"].missing == 2
        assert compare_bags(made, golden)["/ml/height"].extra == 2


def test_samples_are_compared_as_complex_numbers(bags: Bags) -> None:
    """One part in a million of the root mean square, which is no part of the exponents in the bytes."""
    samples = np.arange(1, 9, dtype=np.float32).view(np.complex64)
    golden, made = (
        ChannelFrame(encoding="complex_float32", samples=(samples * factor).view(np.uint8)) for factor in (1, 1 + 1e-6)
    )
    sides = [bags.write({"/f": [message]}, "sal_height_msgs/msg/ChannelFrame") for message in (golden, made)]
    for share, verdict in ((1e-7, CHANGED), (3e-6, WITHIN)):
        result = compare_bags(*sides, Tolerances({"samples": Tolerance(rms=share)}), ["/f"])["/f"]
        assert (result.verdict, result.fields["samples"].values) == (verdict, 4)


def test_hashes_are_of_the_content() -> None:
    """Not of the padding of a serialized message, the bits of a NaN, or the sign of zero."""
    one, other = image(), image()
    np.asarray(other.surfaces[0].height).view(np.uint32)[5] ^= 1
    one.surfaces[0].height[6], other.surfaces[0].height[6] = 0.0, -0.0
    assert content_hash(fields_of(one)) == content_hash(fields_of(other))
    other.surfaces[0].height[6] = 1e-30
    assert content_hash(fields_of(one)) != content_hash(fields_of(other))


def test_times_are_compared_to_the_nanosecond(bags: Bags) -> None:
    golden, made = image(), image()
    for message in (golden, made):
        message.header.stamp.sec = 2**31 - 1
    later(made)
    found = bags.compare([golden], [made]).fields["header.stamp"]
    assert (found.outside, found.greatest) == (1, 1.0)
    assert bags.compare([golden], [made], Tolerances({"header.stamp": Tolerance(absolute=1)})).verdict == WITHIN


def test_tolerances_of_a_file_come_before_those_of_rounding(tmp_path: Path) -> None:
    file = tmp_path / "tolerances.yaml"
    file.write_text("surfaces.height: {absolute: 0.5, sigma: 2}\n'*': {}\n")
    tolerances = read_tolerances(file)
    golden, sigma = np.array([1.0, -4.0, np.nan]), np.array([0.25, np.nan, 1.0])
    assert tolerances.of("surfaces[1].height", golden).allowed(golden, sigma).tolist() == [1.0, 0.5, 2.5]
    assert tolerances.of("surfaces[1].sigma", golden) == Tolerance()
    parts = Tolerance(relative=0.5, rms=1.0).allowed(np.array([3.0, -4.0]), None)
    assert parts == pytest.approx(np.array([1.5, 2.0]) + np.sqrt(12.5))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("height: {absolut: 1}", "height.absolut is not a known key"),
        ("height: {absolute: -1}", "greater than or equal to 0"),
        ("height: {absolute: .nan}", "finite"),
        ("height: 3", "a mapping"),
        ("- 3", "a mapping"),
        ("{", "is not valid YAML"),
    ],
)
def test_a_tolerance_file_is_refused_with_a_sentence(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "tolerances.yaml"
    file.write_text(text)
    with pytest.raises(UserError, match=said):
        read_tolerances(file)
    with pytest.raises(UserError, match="cannot be read"):
        read_tolerances(tmp_path / "none.yaml")
