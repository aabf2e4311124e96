"""Dwells of a bag from the heads of its frames: the same as from whole frames, and from these where heads do not do."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from sal_height.bag.files import read_index
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.played import part_of
from sal_height.bag.qos import TRANSIENT_LOCAL, Qos
from sal_height.bag.reader import HEAD_BYTES, PULSE_BYTES, ZEROS_BYTES, BagReader, TimedPart, read_frame_parts
from sal_height.bag.topics import FRAME_TYPE
from sal_height.bag.writer import ONE_FILE, BagWriter, Packing
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame

BAGS = Path(__file__).parents[2] / "bags"

FRAMES_TOPIC, FRAMES, SAMPLE = "/phase_history", 9, 0.5


def written_frames(
    folder: Path,
    pulses: int,
    packing: Packing = ONE_FILE,
    topic: str = FRAMES_TOPIC,
    qos: Sequence[Qos] = (),
    frame_id: str = "",
    cut: Mapping[int, int] = MappingProxyType({}),
) -> Path:
    """A bag of frames of so many pulses, one per dwell, received at the ns of its number; some with fewer bytes."""
    frame = ChannelFrame(config_hash="f00", pulse_count=pulses, pulse_time=1e-3 * np.arange(1, pulses + 1))
    frame.reference_range = np.zeros(pulses)
    frame.header.frame_id = frame_id
    frame.samples = np.full(25_000, SAMPLE, np.float32).view(np.uint8)
    with BagWriter(folder, {}, packing) as bag:
        bag.add_topic(topic, FRAME_TYPE, qos)
        for number in range(FRAMES):
            frame.dwell = frame.header.stamp.sec = number
            bag.write(topic, serialize(frame)[: cut.get(number)], number, number)
    return folder


def whole_parts(reader: BagReader, topic: str) -> list[TimedPart]:
    """What the whole frames say."""
    found = []
    for one in reader.messages([topic]):
        try:
            part = part_of(one)
        except RuntimeError:
            continue
        assert part is not None
        found.append(TimedPart(one.log_time_ns, part))
    return found


@pytest.mark.parametrize("name", sorted(path.name for path in BAGS.iterdir() if (path / "metadata.yaml").exists()))
def test_golden_bags_have_the_dwells_of_their_frames(name: str) -> None:
    """Of all versions: frames of older ones are read whole."""
    reader = BagReader(BAGS / name)
    parts = reader.frame_parts(FRAMES_TOPIC)
    assert len(parts) == reader.topics[FRAMES_TOPIC].count
    assert parts == whole_parts(reader, FRAMES_TOPIC)


@pytest.mark.parametrize("pulses", [1, 300, 3 * HEAD_BYTES // PULSE_BYTES])
@pytest.mark.parametrize("packing", [ONE_FILE, Packing("zstd"), Packing(split_ns=4)])
def test_frames_of_any_size_and_packing(tmp_path: Path, pulses: int, packing: Packing) -> None:
    reader = BagReader(written_frames(tmp_path / "bag", pulses, packing))
    parts = reader.frame_parts(FRAMES_TOPIC)
    assert parts == whole_parts(reader, FRAMES_TOPIC)
    assert [one.part.dwell.number for one in parts] == list(range(FRAMES))
    assert {one.part.end_ns - one.part.dwell.stamp_ns for one in parts} == {round(1e9 * pulses * 1e-3)}


def test_heads_are_read_alone(tmp_path: Path) -> None:
    index = read_index(written_frames(tmp_path / "bag", 300) / "bag_0.mcap")
    content = bytearray(index.path.read_bytes())
    parts = read_frame_parts(index, FRAMES_TOPIC)
    sample = struct.pack("<f", SAMPLE)
    assert content.count(sample) >= FRAMES * 25_000
    index.path.write_bytes(content.replace(sample, struct.pack("<f", 2.5)))
    assert parts == read_frame_parts(index, FRAMES_TOPIC)
    assert parts


def test_names_of_a_namespace(tmp_path: Path) -> None:
    bag = written_frames(tmp_path / "bag", 2, topic=f"/left{FRAMES_TOPIC}")
    assert len(NamespacedReader(bag, "left").frame_parts(FRAMES_TOPIC)) == FRAMES


def test_frames_that_are_latched_and_so_repeated_in_the_next_file_count_once(tmp_path: Path) -> None:
    latched = [Qos(depth=3, durability=TRANSIENT_LOCAL)]
    reader = BagReader(written_frames(tmp_path / "bag", 2, Packing(split_ns=4), qos=latched))
    assert [index.statistics.message_count for index in reader.indexes] == [4, 7, 4]
    assert reader.frame_parts(FRAMES_TOPIC) == whole_parts(reader, FRAMES_TOPIC)
    assert len(reader.frame_parts(FRAMES_TOPIC)) == FRAMES


@pytest.mark.parametrize("length", [100, 1500, HEAD_BYTES, 5 * HEAD_BYTES])
def test_texts_of_any_length(tmp_path: Path, length: int) -> None:
    reader = BagReader(written_frames(tmp_path / "bag", 300, frame_id="f" * length))
    parts = reader.frame_parts(FRAMES_TOPIC)
    assert parts == whole_parts(reader, FRAMES_TOPIC)
    assert {one.part.dwell.sensor for one in parts} == {"f00"}


def test_broken_frames_are_left_out(tmp_path: Path) -> None:
    bag = written_frames(tmp_path / "bag", 300, cut={4: 100, 6: 40_000})
    parts = BagReader(bag).frame_parts(FRAMES_TOPIC)
    assert [one.part.dwell.number for one in parts] == [0, 1, 2, 3, 5, 7, 8]


@pytest.mark.parametrize(
    ("at", "value"),
    [
        (0, b"\x01"),  # another record
        (1, struct.pack("<Q", 2**60)),  # longer than the file
        (1, struct.pack("<Q", 3)),  # shorter than its head
        (15, struct.pack("<Q", 77)),  # received at another time
        (31, bytes(ZEROS_BYTES)),  # a block of zeros
    ],
)
def test_where_the_index_does_not_fit_whole_frames_are_read(tmp_path: Path, at: int, value: bytes) -> None:
    index = read_index(written_frames(tmp_path / "bag", 2) / "bag_0.mcap")
    content = bytearray(index.path.read_bytes())
    begin = content.index(struct.pack("<QQ", 5, 5)) - 15  # times of the frame of dwell 5
    assert content[begin] == 5
    content[begin + at : begin + at + len(value)] = value
    index.path.write_bytes(content)
    assert read_frame_parts(index, FRAMES_TOPIC) is None
    assert BagReader(tmp_path / "bag").frame_parts(FRAMES_TOPIC) == []  # for its chunk is damaged


@pytest.mark.parametrize("offset", [3, 2**63 + 5, 2**64 - 1])
def test_where_the_index_of_a_chunk_is_damaged_whole_frames_are_read(tmp_path: Path, offset: int) -> None:
    """No checksum covers it, and nothing else reads it."""
    index = read_index(written_frames(tmp_path / "bag", 2) / "bag_0.mcap")
    (chunk,) = index.summary.chunk_indexes
    content = bytearray(index.path.read_bytes())
    at = chunk.chunk_start_offset + chunk.chunk_length + 9 + 2 + 4 + 5 * 16
    assert struct.unpack_from("<Q", content, at) == (5,)
    struct.pack_into("<Q", content, at + 8, offset)
    index.path.write_bytes(content)
    assert read_frame_parts(index, FRAMES_TOPIC) is None
    assert len(BagReader(tmp_path / "bag").frame_parts(FRAMES_TOPIC)) == FRAMES
