"""A cut keeps whole dwells and what they need, byte for byte; an upgraded bag is of today and has the same content."""

from __future__ import annotations

import json
from collections import Counter
from decimal import Decimal
from pathlib import Path

import pytest
from bags_at_hand import REFERENCE, changed, reference, write_like_reference
from helpers import refused
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from sal_height.bag.check import check_bag
from sal_height.bag.copies import MARGIN_NS, Range, cut, time_of, upgrade
from sal_height.bag.files import ACCOUNT
from sal_height.bag.mcap_file import COMPRESSIONS
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.topics import stamp_ns_of
from sal_height.bag.writer import BagWriter, Packing
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.definition import known_definition
from sal_height.messages.types import Parameter, ParameterEvent, ParameterValue

FRAMES, ODOMETRY, INFO = "/phase_history", "/platform/odometry", "/sensor_info"
HEIGHTS = {"/ml/height", "/monopulse/height", "/tracked/height"}
SECOND = 1_000_000_000


def contents(bag: Path) -> list[BagMessage]:
    return list(BagReader(bag).recorded_messages())


def of(messages: list[BagMessage], topic: str) -> list[BagMessage]:
    return [message for message in messages if message.topic == topic]


@pytest.mark.parametrize("number", [0, 1])
def test_a_dwell_is_kept_with_all_that_is_made_of_it(number: int, tmp_path: Path) -> None:
    done = cut(REFERENCE, tmp_path / "cut", Range(dwells=(number, number)))
    assert done.dwells == {FRAMES: 1}
    before, kept = contents(REFERENCE), contents(tmp_path / "cut")
    assert done.counts == Counter(message.topic for message in kept)
    frames = of(before, FRAMES)[8 * number : 8 * number + 8]
    assert of(kept, FRAMES) == frames
    for topic in HEIGHTS:
        (height,) = of(kept, topic)
        assert height in before
        assert stamp_ns_of(height.cdr) == stamp_ns_of(frames[0].cdr)
    assert of(kept, ODOMETRY) == of(before, ODOMETRY)  # all within the margin
    (info,), (recorded,) = of(kept, INFO), of(before, INFO)
    assert info == recorded._replace(log_time_ns=info.log_time_ns)
    assert kept[0] == info
    reader = BagReader(tmp_path / "cut")
    assert reader.custom_data == BagReader(REFERENCE).custom_data
    assert {t.name: (t.definition, t.offered_qos) for t in reader.topics.values()} == {
        t.name: (t.definition, t.offered_qos) for t in BagReader(REFERENCE).topics.values()
    }
    assert check_bag(tmp_path / "cut", lambda *_: None) == []


def test_a_range_of_time_keeps_the_dwells_that_are_whole_in_it(tmp_path: Path) -> None:
    """The range begins with the last frame of the first dwell, which is left out, and its heights with it."""
    before = contents(REFERENCE)
    frames = of(before, FRAMES)
    done = cut(REFERENCE, tmp_path / "cut", Range(begin_ns=frames[7].log_time_ns))
    kept = contents(tmp_path / "cut")
    assert done.dwells == {FRAMES: 1}
    assert of(kept, FRAMES) == frames[8:]
    assert of(kept, "/diagnostics") == [m for m in of(before, "/diagnostics") if m.log_time_ns >= frames[7].log_time_ns]
    assert 0 < len(of(kept, "/diagnostics")) < len(of(before, "/diagnostics"))
    whole = cut(REFERENCE, tmp_path / "whole", Range(frames[0].log_time_ns, frames[15].log_time_ns))
    assert whole.dwells == {FRAMES: 2}
    short = cut(REFERENCE, tmp_path / "short", Range(frames[0].log_time_ns, frames[15].log_time_ns - 1))
    assert short.dwells == {FRAMES: 1}
    everything = cut(REFERENCE, tmp_path / "everything", Range())
    assert contents(tmp_path / "everything") == before
    assert everything.counts.total() == len(before)


@pytest.mark.parametrize(("offset_s", "kept"), [(-1.0, True), (-1.01, False), (1.0, True), (1.01, False)])
def test_odometry_is_kept_with_a_margin(offset_s: float, kept: bool, tmp_path: Path) -> None:
    """Around the pulses of the dwell; the nearest of the samples farther away is kept if none is nearer."""
    messages = reference()
    frames = of(messages, FRAMES)
    first_ns = stamp_ns_of(frames[0].cdr)
    decoded = BagReader(REFERENCE).decode(frames[0].type_name, frames[0].cdr)
    edge_ns = first_ns if offset_s < 0 else first_ns + round(decoded.pulse_time[-1] * 1e9)

    def move(one: object) -> None:
        stamp_ns = edge_ns + round(offset_s * SECOND)
        one.header.stamp.sec, one.header.stamp.nanosec = divmod(stamp_ns, SECOND)

    far = changed(of(messages, ODOMETRY)[0], move)._replace(log_time_ns=messages[-1].log_time_ns + SECOND)
    bag = write_like_reference(tmp_path / "bag", [*messages, far])
    cut(bag, tmp_path / "cut", Range(dwells=(0, 0)))
    assert (far in contents(tmp_path / "cut")) is kept
    assert MARGIN_NS == SECOND
    alone = write_like_reference(tmp_path / "alone", [*(m for m in messages if m.topic != ODOMETRY), far])
    cut(alone, tmp_path / "cut_alone", Range(dwells=(0, 0)))
    assert far in contents(tmp_path / "cut_alone")


def write_latched(folder: Path) -> Path:
    """The reference messages and, before the second dwell, what changed meanwhile: sensor, transforms, parameters."""
    source = BagReader(REFERENCE)
    messages = [m._replace(log_time_ns=n * SECOND) for n, m in enumerate(sorted_by_dwell(reference()))]
    with BagWriter(folder) as bag:
        for topic in source.topics.values():
            bag.add_topic(topic.name, topic.type_name, topic.offered_qos)
        for name in ("/tf_static", "/notes"):
            bag.add_topic(name, "std_msgs/msg/String", source.topics[INFO].offered_qos)
        bag.add_topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
        for number, text in enumerate(("one", "two")):
            bag.write("/tf_static", serialize_message(String(data=text)), number, number + 5)
        bag.write("/notes", serialize_message(String(data="late")), len(messages) * SECOND, 0)
        for number, node in enumerate(("/a", "/b", "/a")):
            bag.write("/parameter_events", event(node, number), number, 7)
        for message in messages:
            bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
    return folder


def sorted_by_dwell(messages: list[BagMessage]) -> list[BagMessage]:
    return [*(m for m in messages if m.topic != FRAMES), *(m for m in messages if m.topic == FRAMES)]


def event(node: str, value: int) -> bytes:
    parameters = [Parameter(name=f"value_{value}", value=ParameterValue(type=2, integer_value=value))]
    return serialize(ParameterEvent(node=node, new_parameters=parameters))


def test_what_was_latched_before_is_kept_as_it_was_last(tmp_path: Path) -> None:
    bag = write_latched(tmp_path / "bag")
    cut(bag, tmp_path / "cut", Range(dwells=(1, 1)))
    kept = contents(tmp_path / "cut")
    begin_ns = kept[0].log_time_ns
    (transform,) = of(kept, "/tf_static")
    assert transform == BagMessage(
        "/tf_static", "std_msgs/msg/String", serialize_message(String(data="two")), begin_ns, 6
    )
    assert not of(kept, "/notes")
    assert len(of(kept, INFO)) == 1
    reader = BagReader(bag)
    events = [reader.decode(m.type_name, m.cdr) for m in of(kept, "/parameter_events")]
    assert {one.node: [p.name for p in one.new_parameters] for one in events} == {
        "/a": ["value_0", "value_2"],
        "/b": ["value_1"],
    }
    assert event("/b", 1) in [m.cdr for m in of(kept, "/parameter_events")]
    first_odometry_ns = min(m.log_time_ns for m in of(contents(bag), ODOMETRY))
    assert begin_ns == first_odometry_ns == min(m.log_time_ns for m in kept)


def test_sensors_in_namespaces_are_cut_each_by_its_own_dwells(tmp_path: Path) -> None:
    """The dwells of the second sensor have other numbers."""

    def renumber(frame: object) -> None:
        frame.dwell += 10

    messages = reference()
    other = [m._replace(topic=f"/lidar{m.topic}") for m in messages]
    other = [changed(m, renumber) if m.topic == "/lidar/phase_history" else m for m in other]
    bag = write_like_reference(tmp_path / "bag", [*messages, *other])
    done = cut(bag, tmp_path / "cut", Range(dwells=(11, 11)))
    assert done.dwells == {FRAMES: 0, "/lidar/phase_history": 1}
    assert {name for name, count in done.counts.items() if "height" in name and count} == {
        f"/lidar{name}" for name in HEIGHTS
    }
    assert len(of(contents(tmp_path / "cut"), "/lidar/phase_history")) == 8


@pytest.mark.parametrize("version", [0, 1])
def test_messages_of_older_versions_stay_as_they_are(version: int, tmp_path: Path) -> None:
    """The parameters in a file beside the bag come along."""
    bag = REFERENCE.parent / f"version_{version}"
    cut(bag, tmp_path / "cut", Range(dwells=(1, 1)))
    assert {(m.topic, m.cdr) for m in contents(tmp_path / "cut")} <= {(m.topic, m.cdr) for m in contents(bag)}
    assert [m.type_name for m in of(contents(tmp_path / "cut"), FRAMES)] == [contents_type(bag)] * 8
    assert "ml_height" in BagReader(tmp_path / "cut").custom_data["parameters"]


def contents_type(bag: Path) -> str:
    return next(m.type_name for m in contents(bag) if m.topic == FRAMES)


def test_times_are_from_the_begin_or_since_1970() -> None:
    reader = BagReader(REFERENCE)
    begin_ns = contents(REFERENCE)[0].log_time_ns
    assert time_of(reader, Decimal("0.25")) == begin_ns + 250_000_000
    assert time_of(reader, Decimal(99999999)) == begin_ns + 99_999_999 * SECOND
    assert time_of(reader, Decimal("1795404227.673045290")) == 1795404227673045290


def test_a_range_without_dwells_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with refused(UserError, "no dwell", "2 dwells, with numbers from 0 to 1"):
        cut(REFERENCE, tmp_path / "cut", Range(dwells=(2, 9)))
    assert not (tmp_path / "cut").exists()
    out = ["--out", str(tmp_path / "cut")]
    assert main(["bag", "cut", str(REFERENCE), "--from", "100", *out]) == 2
    assert main(["bag", "cut", str(REFERENCE), "--dwells", "1", *out]) == 2
    assert main(["bag", "cut", str(REFERENCE), "--from", "-1", *out]) == 2
    capsys.readouterr()
    assert main(["bag", "cut", str(REFERENCE), "--dwells", "1:1", "--to", "1795404229", *out]) == 0
    assert "1 dwell of /phase_history" in capsys.readouterr().out


def test_a_bag_without_sensor_is_cut_by_time(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/notes", "std_msgs/msg/String")
        for number in range(5):
            bag.write("/notes", serialize_message(String(data=str(number))), number, number)
    cut(tmp_path / "bag", tmp_path / "cut", Range(1, 3))
    assert [m.log_time_ns for m in contents(tmp_path / "cut")] == [1, 2, 3]


OLD = {
    0: {"/ml/height", "/monopulse/height", "/phase_history", "/sensor_info", "/tracked/height"},
    1: {"/ml/height", "/monopulse/height", "/sensor_info", "/tracked/height"},
    2: {"/ml/height", "/monopulse/height", "/sensor_info", "/tracked/height"},
    3: set[str](),
}
"""Topics by version whose messages have changed since."""


@pytest.mark.parametrize("version", OLD)
def test_the_result_has_the_definitions_of_today(version: int, tmp_path: Path) -> None:
    old = BagReader(REFERENCE.parent / f"version_{version}")
    made = upgrade(old.path, tmp_path / "new")
    new = BagReader(tmp_path / "new")
    assert made == {name: old.topics[name].count for name in OLD[version]}
    assert list(new.recorded_messages()) == list(old.messages())
    raw = {(m.topic, m.log_time_ns): m for m in old.recorded_messages()}
    for message in new.recorded_messages():
        before = raw[message.topic, message.log_time_ns]
        assert message.publish_time_ns == before.publish_time_ns
        if message.topic not in OLD[version]:
            assert message == before
    for name, topic in new.topics.items():
        assert not topic.is_old
        assert topic.offered_qos == old.topics[name].offered_qos
        if topic.type_name.startswith("sal_height_msgs"):
            assert topic.definition == known_definition(topic.type_name)
        else:
            assert topic.definition == old.topics[name].definition
    assert check_bag(new.path, lambda *_: None) == []


def test_custom_data_and_parameters_are_kept(tmp_path: Path) -> None:
    for version in (0, 1):
        old = BagReader(REFERENCE.parent / f"version_{version}")
        upgrade(old.path, tmp_path / str(version))
        kept = BagReader(tmp_path / str(version)).custom_data
        assert kept.items() >= old.custom_data.items()
        assert json.loads(kept["parameters"])["ml_height"]["azimuth_looks"] == 2
    assert "parameters" not in BagReader(REFERENCE.parent / "version_0").custom_data


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_compression_and_the_recorder_s_account_are_kept(compression: str, tmp_path: Path) -> None:
    source = BagReader(REFERENCE)
    with BagWriter(tmp_path / "old", {}, Packing(compression)) as bag:
        for message in source.messages():
            bag.add_topic(message.topic, message.type_name)
            bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
        bag.close({ACCOUNT: {"/a": "{}"}})
    upgrade(tmp_path / "old", tmp_path / "new")
    (index,) = BagReader(tmp_path / "new").indexes
    assert {chunk.compression or "none" for chunk in index.summary.chunk_indexes} == {compression}
    assert index.records[ACCOUNT] == {"/a": "{}"}


def test_the_command_says_what_is_made_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "upgrade", str(REFERENCE.parent / "version_1"), "--out", str(tmp_path / "new")]) == 0
    assert "2 messages of /ml/height made again" in capsys.readouterr().out
    assert main(["bag", "upgrade", str(REFERENCE), "--out", str(tmp_path / "same")]) == 0
    assert "all messages are of today's version" in capsys.readouterr().out
    assert main(["bag", "upgrade", str(tmp_path / "none"), "--out", str(tmp_path / "new_2")]) == 2
    assert not (tmp_path / "new_2").exists()
