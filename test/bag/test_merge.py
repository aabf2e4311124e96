"""A merged bag has every message of its parts once, in the order of time."""

from __future__ import annotations

from pathlib import Path

import pytest
from bags_at_hand import REFERENCE, reference, write_like_reference
from rosbags.highlevel import AnyReader

from sal_height.bag.check import check_bag
from sal_height.bag.merge import merge
from sal_height.bag.qos import TRANSIENT_LOCAL, Qos
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.writer import BagWriter, Packing
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.definition import Definition, known_definition
from sal_height.messages.types import Calibration, Odometry

FRAMES, INFO = "/phase_history", "/sensor_info"
LATCHED = Qos(depth=1, durability=TRANSIENT_LOCAL)
EMPTY = serialize(Odometry())
ODOMETRY = Odometry.__msgtype__


def contents(bag: Path) -> list[BagMessage]:
    return list(BagReader(bag).recorded_messages())


def write(folder: Path, messages: list[tuple[str, int, int]], qos: Qos = LATCHED, **custom: str) -> Path:
    """Messages of one content by topic, log time and publish time."""
    with BagWriter(folder, custom) as bag:
        for topic, log_ns, publish_ns in messages:
            bag.add_topic(topic, ODOMETRY, [qos])
            bag.write(topic, EMPTY, log_ns, publish_ns)
    return folder


def test_files_of_a_split_are_the_bag_that_was_split(tmp_path: Path) -> None:
    """Latched messages at the head of every file are left out, in whatever order the files are named."""
    split = write_like_reference(tmp_path / "split", reference(), packing=Packing(split_bytes=100_000))
    files = sorted(split.glob("*.mcap"))
    assert len(files) > 2
    merged = merge(files[::-1], tmp_path / "merged")
    assert contents(tmp_path / "merged") == contents(REFERENCE)
    assert merged.duplicates[INFO] + merged.latched[INFO] == len(files) - 1
    assert not merged.custom_data
    assert check_bag(tmp_path / "merged", lambda *_: None) == []


def test_two_recorders_have_a_message_once_as_it_was_received_first(tmp_path: Path) -> None:
    """They receive it at different times; foreign readers find each message once, too."""
    late = [one._replace(log_time_ns=one.log_time_ns + 1000) for one in reference() if one.topic != "/diagnostics"]
    bags = [
        write_like_reference(tmp_path / "one", [one for one in reference() if not one.topic.endswith("height")]),
        write_like_reference(tmp_path / "two", late),
    ]
    merged = merge(bags, tmp_path / "merged")
    kept = contents(tmp_path / "merged")
    assert sorted(map(repr, kept)) == sorted(
        repr(one._replace(log_time_ns=one.log_time_ns + 1000 * one.topic.endswith("height"))) for one in reference()
    )
    assert [one.log_time_ns for one in kept] == sorted(one.log_time_ns for one in kept)
    assert merged.duplicates[FRAMES] == 16
    with AnyReader([tmp_path / "merged"]) as reader:
        assert sum(1 for _ in reader.messages()) == len(kept) == sum(merged.counts.values())
        assert {c.topic: c.msgcount for c in reader.connections} == dict(merged.counts)


def test_what_one_bag_has_twice_stays_and_what_two_have_is_kept_once(tmp_path: Path) -> None:
    volatile = Qos()
    one = write(tmp_path / "one", [("/a", 5, 3), ("/a", 6, 3), ("/b", 7, 0)], volatile)
    two = write(tmp_path / "two", [("/a", 9, 3), ("/b", 7, 0), ("/b", 8, 0)], volatile)
    merged = merge([one, two], tmp_path / "merged")
    assert [(m.topic, m.log_time_ns) for m in contents(tmp_path / "merged")] == [
        ("/a", 5),
        ("/a", 6),
        ("/b", 7),
        ("/b", 8),
    ]
    assert (merged.duplicates, merged.latched) == ({"/a": 1, "/b": 1}, {})


def test_latched_messages_are_kept_once(tmp_path: Path) -> None:
    """Published anew, with another time, they tell nothing new."""
    one, two = write(tmp_path / "one", [("/a", 5, 3)]), write(tmp_path / "two", [("/a", 9, 8)])
    merged = merge([two, one], tmp_path / "merged")
    assert [m.log_time_ns for m in contents(tmp_path / "merged")] == [5]
    assert (merged.duplicates, merged.latched) == ({}, {"/a": 1})


def test_custom_data_of_the_earliest_bag_are_kept(tmp_path: Path) -> None:
    one = write(tmp_path / "one", [("/a", 5, 3)], preset="small")
    two = write(tmp_path / "two", [("/a", 9, 8)], preset="large", pilot="Ada")
    assert merge([two, one], tmp_path / "merged").custom_data == ["preset"]
    assert BagReader(tmp_path / "merged").custom_data == {"preset": "small", "pilot": "Ada"}


def test_other_definitions_and_types_are_refused(tmp_path: Path) -> None:
    one = write(tmp_path / "one", [("/a", 5, 3)])
    with BagWriter(tmp_path / "two") as bag:
        bag.add_topic("/b", ODOMETRY, [], Definition(known_definition(ODOMETRY).text + "\nint32 more\n", ""))
    with pytest.raises(UserError, match=f"different definitions of type {ODOMETRY}"):
        merge([one, tmp_path / "two"], tmp_path / "merged")
    with BagWriter(tmp_path / "three") as bag:
        bag.add_topic("/a", Calibration.__msgtype__)
    with pytest.raises(UserError, match=r"Topic /a has type .*; a topic must have one type"):
        merge([one, tmp_path / "three"], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_the_command_says_what_it_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = write(tmp_path / "one", [("/a", 5, 3)], preset="small")
    two = write(tmp_path / "two", [("/a", 9, 3), ("/a", 10, 9)], preset="large")
    assert main(["bag", "merge", str(one), str(two), "--out", str(tmp_path / "merged")]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "1 message of /a kept once, which several bags have",
        "1 latched message of /a left out: repeated for late subscribers",
        "custom data 'preset' differ; those of the earliest bag are kept",
        f"1 message in {tmp_path / 'merged'}",
    ]
