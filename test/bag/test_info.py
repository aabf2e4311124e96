"""What a bag holds, told from its indexes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bags_at_hand import REFERENCE, reference, write_like_reference
from mcap.writer import IndexType, Writer

from sal_height.bag.described import dwell_report, sensors_in
from sal_height.bag.files import read_index, read_log_times
from sal_height.bag.info import FileInfo, bag_info, info_text
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import Packing
from sal_height.commands import main
from sal_height.errors import UserError

SECOND = 1_000_000_000


def test_counts_rates_and_gaps_are_those_of_the_messages() -> None:
    info = bag_info(REFERENCE)
    messages = list(BagReader(REFERENCE).messages())
    assert info.count == len(messages) > 60
    assert info.begin_ns == messages[0].log_time_ns
    assert info.end_ns == messages[-1].log_time_ns
    assert info.duration_s == pytest.approx((messages[-1].log_time_ns - messages[0].log_time_ns) * 1e-9, rel=1e-12)
    for topic in info.topics:
        times = np.array([m.log_time_ns for m in messages if m.topic == topic.name])
        assert topic.count == len(times)
        if len(times) > 1:
            assert topic.rate_hz == pytest.approx((len(times) - 1) / ((times[-1] - times[0]) * 1e-9), rel=1e-12)
            assert topic.longest_gap_s == pytest.approx(np.diff(times).max() * 1e-9, rel=1e-12)
        else:
            assert (topic.rate_hz, topic.longest_gap_s) == (None, None)
    assert info.files == [FileInfo("bag_0.mcap", (REFERENCE / "bag_0.mcap").stat().st_size, "none")]


def test_no_message_is_read_but_the_description_of_the_sensor(tmp_path: Path) -> None:
    """Every byte of every other chunk may be anything."""
    bag = write_like_reference(tmp_path / "bag", sorted(reference(), key=lambda m: m.topic != "/sensor_info"))
    before = bag_info(bag)
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    first, *others = sorted(read_index(file).summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
    assert len(others) > 60
    for chunk in others:
        content[chunk.chunk_start_offset : chunk.chunk_start_offset + chunk.chunk_length] = bytes(chunk.chunk_length)
    file.write_bytes(content)
    assert bag_info(bag) == before
    content[first.chunk_start_offset : first.chunk_start_offset + first.chunk_length] = bytes(first.chunk_length)
    file.write_bytes(content)
    assert bag_info(bag) == replace(before, frames=[replace(before.frames[0], detectors=None)])


@pytest.mark.parametrize(
    ("left_out", "lacking", "said"), [(0, 0, "as many as 2 whole"), (3, 3, "3 frames are lacking")]
)
def test_frames_that_are_lacking_of_whole_dwells_are_counted(
    left_out: int, lacking: int, said: str, tmp_path: Path
) -> None:
    frames = [m for m in reference() if m.topic == "/phase_history"]
    others = [m for m in reference() if m.topic != "/phase_history"]
    info = bag_info(write_like_reference(tmp_path / "bag", [*others, *frames[left_out:]]))
    (one,) = info.frames
    assert (one.frames, one.detectors, one.dwells, one.lacking) == (16 - left_out, 8, 2, lacking)
    assert said in info_text(info)


def test_dwells_are_told_exactly_by_their_messages(tmp_path: Path) -> None:
    """One frame of the first dwell is lacking, and one of the second is there twice: by their number nothing lacks."""
    frames = [m for m in reference() if m.topic == "/phase_history"]
    others = [m for m in reference() if m.topic != "/phase_history"]
    bag = write_like_reference(tmp_path / "bag", [*others, *frames[1:], frames[-1]])
    assert bag_info(bag).frames[0].lacking == 0
    reader = BagReader(bag)
    report = dwell_report(reader, sensors_in(reader.topics)[0])
    assert report.dwells == 2
    assert [(one.absent, one.doubled, one.described) for one in report.faults] == [([0], [], True), ([], [7], True)]
    first, second, third = str(report).splitlines()
    assert first == "/phase_history: 2 dwells, 0 of them whole."
    assert second.endswith("lacks channel 0")
    assert third.endswith("has twice channel 7")


def test_sensors_in_namespaces_are_told_apart(tmp_path: Path) -> None:
    messages = reference()
    moved = [m._replace(topic=f"/lidar{m.topic}") for m in messages]
    bag = write_like_reference(tmp_path / "bag", [*messages, *moved[:-1], *(m for m in moved if "info" in m.topic)])
    assert [(one.topic, one.detectors) for one in bag_info(bag).frames] == [
        ("/phase_history", 8),
        ("/lidar/phase_history", 8),
    ]


def test_messages_that_stand_in_the_file_before_count_once(tmp_path: Path) -> None:
    """The description of the sensor is repeated at the head of each file."""
    messages = [m._replace(log_time_ns=n * SECOND) for n, m in enumerate(reference())]
    split = bag_info(write_like_reference(tmp_path / "split", messages, packing=Packing("zstd", split_ns=20 * SECOND)))
    whole = bag_info(write_like_reference(tmp_path / "whole", messages))
    assert split.topics == whole.topics
    assert [file.compression for file in split.files] == ["zstd"] * 4
    assert split.size == sum(file.stat().st_size for file in (tmp_path / "split").glob("*.mcap"))


def test_a_file_without_message_indexes_tells_no_rates(tmp_path: Path) -> None:
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream, index_types=IndexType.CHUNK)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", b""))
        for second in range(3):
            writer.add_message(channel, second * SECOND, b"", 0)
        writer.finish()
    (topic,) = bag_info(tmp_path / "bag.mcap").topics
    assert (topic.count, topic.rate_hz, topic.longest_gap_s) == (3, None, None)


def test_a_damaged_message_index_is_said(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    file = bag / "bag_0.mcap"
    index = read_index(file)
    place = min(min(chunk.message_index_offsets.values()) for chunk in index.summary.chunk_indexes)
    content = bytearray(file.read_bytes())
    content[place] ^= 1
    file.write_bytes(content)
    with pytest.raises(UserError, match=f"no message index at byte {place}"):
        read_log_times(index)


def test_the_command_prints_a_table_or_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "info", str(REFERENCE), "--dwells"]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {line.split()[0]: line.split()[1:] for line in lines if line}
    assert rows["/phase_history"][0] == "16"
    assert lines[-1] == "/phase_history: 2 dwells, 2 of them whole."
    assert main(["bag", "info", str(REFERENCE), "--dwells", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["frames"] == [{"topic": "/phase_history", "frames": 16, "detectors": 8, "dwells": 2, "lacking": 0}]
    assert values["dwells"] == [{"topic": "/phase_history", "dwells": 2, "faults": []}]
    assert main(["bag", "info", "no_such_bag"]) == 2
