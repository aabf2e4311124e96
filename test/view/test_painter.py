"""What is drawn of messages: places, colours, means over channels, tracks and accounts; and what is refused."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence

from benchmarks.hostile_messages import hostile
from sal_height.bag.reader import BagReader
from sal_height.elevation import Validity
from sal_height.errors import Rejected
from sal_height.messages import deserialize, field_from_message, to_floats, to_stamp
from sal_height.messages.types import ComplexImage, HeightImage, Odometry
from sal_height.nodes.accounts.account import Account
from sal_height.view.drawings import (
    EMPTY,
    VALIDITY_COLOURS,
    Classes,
    Cloud,
    Drawing,
    Line,
    Note,
    Number,
    Picture,
    ReceivedMessage,
    Sheet,
    Span,
    Spans,
    coloured,
)
from sal_height.view.painter import (
    COMPLEX_IMAGE,
    DIAGNOSTICS,
    HEIGHT_IMAGE,
    MOST_PATHS,
    ODOMETRY,
    Painter,
    is_shown,
)

BAG = Path(__file__).parents[2] / "bags" / "version_3"
STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope="module")
def recorded() -> dict[str, list[Any]]:
    """Decoded messages of a bag by topic."""
    reader, found = BagReader(BAG), {}
    for message in reader.messages():
        found.setdefault(message.topic, []).append(reader.decode(message.type_name, message.cdr))
    return found


def received(topic: str, type_name: str, received_ns: int = 1) -> ReceivedMessage:
    return ReceivedMessage(topic, type_name, received_ns, lambda: None)


def drawings_of(sheets: list[Sheet]) -> dict[str, Drawing]:
    return {drawing.path: drawing for sheet in sheets for drawing in sheet.drawings}


def paint_heights(painter: Painter, image: HeightImage, topic: str = "/ml/height") -> dict[str, Drawing]:
    return drawings_of(painter.paint(received(topic, HEIGHT_IMAGE), image))


def moved(image: HeightImage, east: float) -> HeightImage:
    """The same image farther to the east."""
    image = copy.deepcopy(image)
    image.grid.origin.x += east
    image.aperture.pose.position.x += east
    return image


def test_points_keep_millimetres_far_from_the_origin_of_the_map(recorded: dict[str, list[Any]]) -> None:
    image = moved(recorded["/ml/height"][0], 1_234_567.0)
    field, drawn = field_from_message(image), paint_heights(Painter(), image)
    cloud = drawn["map/ml/surface_1"]
    assert isinstance(cloud, Cloud)
    there = field.first.is_determined
    exact = field.first.positions[there]
    off = cloud.places - (exact - np.round(exact.mean(axis=0)))
    assert cloud.places.dtype == np.float32
    assert 0 < len(cloud.places) == there.sum()
    assert np.abs(off).max() < 1e-5
    assert np.abs(exact.astype(np.float32) - exact).max() > 1e-2  # what would be drawn without an origin
    assert np.allclose(cloud.height, field.first.height[there], atol=1e-6)
    assert np.allclose(cloud.sigma, field.first.sigma[there], rtol=1e-6)


def test_the_origin_stays_and_is_told_once(recorded: dict[str, list[Any]]) -> None:
    painter, image = Painter(), recorded["/ml/height"][0]
    first = paint_heights(painter, image)
    second = paint_heights(painter, moved(image, 100.0))
    note = first["messages/origin"]
    assert isinstance(note, Note)
    assert_one_sentence(note.text, "m east")
    assert "messages/origin" not in second
    apart = [drawn["map/ml/surface_1"].places.mean(axis=0) for drawn in (first, second)]
    assert np.allclose(apart[1] - apart[0], [100.0, 0.0, -(100.0**2) / 2 / 6371008.8], atol=2e-3)


def test_pictures_have_the_colours_of_the_points_and_none_where_there_is_no_height(
    recorded: dict[str, list[Any]],
) -> None:
    image = recorded["/ml/height"][0]
    field, drawn = field_from_message(image), paint_heights(Painter(), image)
    picture, cloud, classes = drawn["ml/height"], drawn["map/ml/surface_1"], drawn["ml/validity"]
    assert isinstance(picture, Picture)
    assert isinstance(classes, Classes)
    there = np.isfinite(field.first.height)
    assert there.any()
    assert not there.all()
    assert np.array_equal(picture.pixels[there], cloud.colours)
    assert (picture.pixels[~there] == EMPTY).all()
    assert np.array_equal(classes.values, field.validity)


def test_colours_grow_with_height_and_are_those_of_the_span() -> None:
    table = coloured(np.linspace(0.0, 1.0, 256), (0.0, 1.0), "viridis")
    assert len(np.unique(table, axis=0)) > 200
    beyond = coloured(np.array([-5.0, 5.0, np.nan, np.inf]), (0.0, 1.0), "viridis")
    assert np.array_equal(beyond, [table[0], table[-1], EMPTY, EMPTY])
    assert set(VALIDITY_COLOURS) == set(Validity)
    assert len(set(VALIDITY_COLOURS.values())) == len(Validity)


def test_a_single_outlier_decides_no_span_and_an_image_of_outliers_is_forgotten() -> None:
    span = Span(1.0, 99.0, images=3)
    assert span.ends == (0.0, 1.0)
    level = np.linspace(0.0, 1.0, 1001)
    span.add(np.append(level, 1e6))
    assert span.ends[1] < 1.01
    span.add(np.full(10, 1e6))
    assert span.ends[1] == 1e6
    for _ in range(3):
        span.add(level)
    assert span.ends[1] < 1.01
    span.add(np.full(4, np.nan))
    assert span.ends[1] < 1.01


@pytest.mark.parametrize("value", [0.0, 5.0, -1e30])
def test_the_ends_of_a_span_differ_though_all_values_are_the_same(value: float) -> None:
    span = Span(1.0, 99.0, images=3)
    span.add(np.full(10, value))
    assert span.ends[0] < value < span.ends[1]


def test_settled_colours_do_not_change(recorded: dict[str, list[Any]]) -> None:
    spans = Spans()
    spans.add(field_from_message(recorded["/ml/height"][0]))
    spans.are_settled = True
    before = spans.heights.ends
    painter = Painter(spans=spans)
    paint_heights(painter, recorded["/monopulse/height"][1])
    assert spans.heights.ends == before
    assert painter.subject.spans == (before, spans.sigmas.ends)


def test_a_surface_that_is_missing_in_a_later_dwell_is_taken_away(recorded: dict[str, list[Any]]) -> None:
    painter, image = Painter(), recorded["/ml/height"][0]
    assert len(image.surfaces) == 3
    paint_heights(painter, image)
    fewer = copy.deepcopy(image)
    fewer.surfaces = fewer.surfaces[:1]
    drawn = paint_heights(painter, fewer)
    assert len(drawn["map/ml/surface_2"].places) == len(drawn["map/ml/surface_3"].places) == 0


def channel_image(like: HeightImage, channel: int, amplitude: float, stamp_ns: int) -> ComplexImage:
    image = ComplexImage(header=copy.deepcopy(like.header), channel=channel, grid=copy.deepcopy(like.grid))
    image.aperture = copy.deepcopy(like.aperture)
    image.header.stamp = to_stamp(stamp_ns)
    image.samples = to_floats(np.full((like.grid.rows, like.grid.cols), amplitude, np.complex64))
    return image


def test_power_is_the_mean_over_the_channels_that_came(
    recorded: dict[str, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    like, painter = recorded["/ml/height"][0], Painter()
    means: list[float] = []

    def colours(values: np.ndarray, *_: Any) -> np.ndarray:
        means.append(float(values[0, 0]))
        return np.zeros((*values.shape, 3), np.uint8)

    monkeypatch.setattr("sal_height.view.painter.coloured", colours)

    def paint(channel: int, amplitude: float, dwell: int) -> list[Sheet]:
        image = channel_image(like, channel, amplitude, STAMP_NS + dwell)
        return painter.paint(received("/slc", COMPLEX_IMAGE, dwell), image)

    assert [paint(0, 1.0, 0), paint(1, 3.0, 0)] == [[], []]
    (first,) = paint(0, 10.0, 1)  # of another dwell: the first one is over
    assert (first.stamp_ns, first.received_ns) == (STAMP_NS, 0)
    assert first.drawings[0].path == "slc/power"
    (second,) = paint(1, 10.0, 1)  # as many channels as before: no need to wait
    assert second.stamp_ns == STAMP_NS + 1
    assert paint(1, 0.0, 2) == []
    (third,) = painter.finish()
    assert third.stamp_ns == STAMP_NS + 2
    assert np.allclose(means, [10 * np.log10(5.0), 20.0, -300.0])


def test_power_is_that_of_all_channels_though_the_first_dwell_was_met_in_its_middle(
    recorded: dict[str, list[Any]],
) -> None:
    like, painter, drawn = recorded["/ml/height"][0], Painter(), Counter[int]()
    for dwell, channels in enumerate([range(11, 16), range(16), range(16), range(15, -1, -1), range(16)]):
        for number, channel in enumerate(channels):
            image = channel_image(like, channel, 1.0, STAMP_NS + dwell)
            for sheet in painter.paint(received("/slc", COMPLEX_IMAGE), image):
                drawn[sheet.stamp_ns - STAMP_NS] += 1
                assert dwell < 2 or number == 15
    assert [drawn[dwell] for dwell in (2, 3, 4)] == [1, 1, 1]
    assert painter.finish() == []


def odometry(seconds: float, east: float, speed: float = 50.0) -> Odometry:
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id, message.header.stamp = "map", to_stamp(STAMP_NS + round(seconds * 1e9))
    message.pose.pose.position.x, message.pose.pose.position.z = east, 5000.0
    message.twist.twist.linear.x = speed
    return message


def test_a_track_is_drawn_in_pieces_that_join_and_is_cut_where_the_platform_jumps() -> None:
    painter, lines = Painter(), []
    times = np.arange(0.0, 20.0, 0.01)
    for seconds in times:
        east = 50.0 * (seconds if seconds < 10 else seconds - 10)  # it begins anew
        lines += painter.paint(received("/platform/odometry", ODOMETRY), odometry(seconds, east))
    lines += painter.finish()
    places = [s.drawings[0].places for s in lines if isinstance(s.drawings[0], Line)]
    assert 10 < len(places) < 120
    assert max(map(len, places)) <= 32
    steps = [np.abs(np.diff(one[:, 0])).max() for one in places]
    assert max(steps) < 50.0
    ends = np.array([[one[0, 0], one[-1, 0]] for one in places])
    gaps = ends[1:, 0] - ends[:-1, 1]
    assert np.sum(gaps != 0) == 1  # where it jumped back
    assert ends[-1, 1] == pytest.approx(50.0 * (times[-1] - 10) - round(float(ends[0, 0])), abs=1.0)


def test_accounts_become_series_at_the_stamp_of_the_last_data(recorded: dict[str, list[Any]]) -> None:
    painter, message = Painter(), copy.deepcopy(recorded["/diagnostics"][-1])
    status = message.status[0]
    status.name = "ml_height"
    numbers = {"in": 16, "processed": 8, "offered_hz": 2.5, "achieved_hz": 2.0, "latency_p50_ms": 3.0}
    numbers |= {"latency_p95_ms": 7.0, "dropped.overload": 5, "dropped.queue full": 3}
    status.values = Account.of_numbers(numbers, "Too much came.").to_values()
    (early,) = painter.paint(received("/diagnostics", DIAGNOSTICS, 7), message)
    assert (early.stamp_ns, early.received_ns) == (None, 7)
    assert {d.path: d.value for d in early.drawings if isinstance(d, Number)} == {
        "rates/ml_height/offered": 2.5,
        "rates/ml_height/achieved": 2.0,
        "latency/ml_height/p50": 3.0,
        "latency/ml_height/p95": 7.0,
        "drops/ml_height": 8.0,
    }
    assert Note("messages/ml_height", "Too much came.") in early.drawings
    image = recorded["/ml/height"][0]
    paint_heights(painter, image)
    (late,) = painter.paint(received("/diagnostics", DIAGNOSTICS, 8), message)
    assert late.stamp_ns == image.header.stamp.sec * 10**9 + image.header.stamp.nanosec
    assert not [d for d in late.drawings if isinstance(d, Note)]  # it was told


def test_endless_new_names_of_nodes_are_refused(recorded: dict[str, list[Any]]) -> None:
    painter, message = Painter(), copy.deepcopy(recorded["/diagnostics"][-1])
    message.status = message.status[:1]
    message.status[0].values = Account({"in": 1}).to_values()

    def paint(number: int) -> None:
        message.status[0].name = f"node_{number}"
        painter.paint(received("/diagnostics", DIAGNOSTICS), message)

    for number in range(MOST_PATHS):
        paint(number)
    with pytest.raises(Rejected) as refusal:
        paint(MOST_PATHS)
    assert_one_sentence(str(refusal.value), str(MOST_PATHS))
    paint(0)  # known ones go on


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda image: setattr(image.header, "frame_id", "odom"), "wrong frames"),
        (lambda image: setattr(image, "samples", image.samples[:-2]), "wrong size"),
        (lambda image: setattr(image.grid, "rows", 0), "wrong size"),
    ],
)
def test_images_that_cannot_be_drawn_are_refused_in_a_sentence(
    spoil: Callable[[ComplexImage], None], reason: str, recorded: dict[str, list[Any]]
) -> None:
    image = channel_image(recorded["/ml/height"][0], 0, 1.0, STAMP_NS)
    spoil(image)
    with pytest.raises(Rejected) as refusal:
        Painter().paint(received("/slc", COMPLEX_IMAGE), image)
    assert refusal.value.reason == reason
    assert_one_sentence(str(refusal.value), "ComplexImage")


def test_another_name_of_the_map_frame_is_that_of_all_messages(recorded: dict[str, list[Any]]) -> None:
    image, state = copy.deepcopy(recorded["/ml/height"][0]), odometry(0.0, 0.0)
    power = channel_image(image, 0, 1.0, STAMP_NS)
    state.child_frame_id = "uav1/base_link"
    messages = {HEIGHT_IMAGE: image, ODOMETRY: state, COMPLEX_IMAGE: power}
    for type_name, message in messages.items():
        message.header.frame_id = "odom"
        Painter("odom").paint(received("/x", type_name), message)
        with pytest.raises(Rejected) as refusal:
            Painter().paint(received("/x", type_name), message)
        assert refusal.value.reason == "wrong frames"


def test_hostile_messages_are_drawn_or_refused_but_fail_in_no_other_way(recorded: dict[str, list[Any]]) -> None:
    rng, painter = np.random.default_rng(5), Painter()
    good = {
        "/ml/height": (HEIGHT_IMAGE, recorded["/ml/height"][0]),
        "/slc": (COMPLEX_IMAGE, channel_image(recorded["/ml/height"][0], 0, 1.0, STAMP_NS)),
        "/platform/odometry": (ODOMETRY, recorded["/platform/odometry"][0]),
        "/diagnostics": (DIAGNOSTICS, recorded["/diagnostics"][-1]),
    }
    drawn = refused = 0
    for topic, (type_name, message) in good.items():
        for cdr in hostile(message, 150, rng):
            try:
                decoded = deserialize(cdr, type(message))
            except Exception:  # noqa: BLE001, S112 (the middleware refuses it)
                continue
            try:
                sheets = painter.paint(received(topic, type_name), decoded)
            except Rejected as error:
                assert_one_sentence(str(error))
                refused += 1
                continue
            drawn += 1
            for drawing in drawings_of(sheets).values():
                if isinstance(drawing, (Cloud, Line)):
                    assert np.isfinite(drawing.places).all()
    assert drawn > 100
    assert refused > 50
    painter.finish()
    assert np.isfinite(painter.subject.size)


def test_topics_to_be_shown() -> None:
    shown = [
        ("/ml/height", HEIGHT_IMAGE),
        ("/uav1/tracked/height", HEIGHT_IMAGE),
        ("/uav1/slc", COMPLEX_IMAGE),
        ("/uav1/platform/odometry", ODOMETRY),
        ("/diagnostics", DIAGNOSTICS),
    ]
    assert all(is_shown(*one) for one in shown)
    assert not is_shown("/visual/odometry", ODOMETRY)
    assert not is_shown("/phase_history", "sal_height_msgs/msg/ChannelFrame")
    assert [topic for topic, kind in shown if is_shown(topic, kind, "uav1")] == [topic for topic, _ in shown[1:]]
