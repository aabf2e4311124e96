"""Reading bags: order, memory, decoding, foreign writers, and what is refused with which sentence."""

from __future__ import annotations

import re
import resource
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from sal_height.bag import qos
from sal_height.bag.mcap_file import CHUNK_SIZE
from sal_height.bag.qos import RELIABLE, TRANSIENT_LOCAL, VOLATILE, Qos
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter, Packing
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.definition import Definition, known_definition
from sal_height.messages.types import KeyValue

STRING = "std_msgs/msg/String"
HELLO = serialize_message(String(data="hello"))
PAIR, PAIRED = "diagnostic_msgs/msg/KeyValue", serialize(KeyValue(key="hello", value="x"))
MAGIC_BYTES = 8


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Bag with one greeting."""
    return write_bag(tmp_path / "run")


def write_bag(directory: Path, definition: Definition | None = None, type_name: str = STRING) -> Path:
    with BagWriter(directory) as writer:
        writer.add_topic("/greeting", type_name, definition=definition)
        writer.write("/greeting", HELLO, 7, 6)
    return directory


def write_mcap(file: Path, *, profile: str = "ros2", encoding: str = "cdr", **options: Any) -> Path:
    """File of three greetings as another program might have written it."""
    with file.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile=profile)
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        channel = writer.register_channel("/greeting", encoding, schema)
        for i in range(3):
            writer.add_message(channel, i, HELLO, i)
        writer.finish()
    return file


def test_messages_come_in_order_of_log_time_across_chunks(tmp_path: Path) -> None:
    times = [5, 3, 9, 1, 4, 8, 2]
    with BagWriter(tmp_path / "run") as writer:
        for topic in ("/even", "/odd"):
            writer.add_topic(topic, STRING)
        for time in times:
            writer.write(("/even", "/odd")[time % 2], HELLO + bytes(CHUNK_SIZE // 2), time, 0)
    reader = BagReader(tmp_path / "run")
    assert [message.log_time_ns for message in reader.messages()] == sorted(times)
    assert [message.log_time_ns for message in reader.messages(["/odd"])] == [1, 3, 5, 9]
    assert list(reader.messages([])) == []
    assert {name: (topic.type_name, topic.count) for name, topic in reader.topics.items()} == {
        "/even": (STRING, 3),
        "/odd": (STRING, 4),
    }


def test_reading_takes_the_memory_of_a_few_chunks_not_of_the_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/bytes", STRING)
        for i in range(64):
            writer.write("/bytes", bytes(CHUNK_SIZE), i, i)
    tracemalloc.start()
    count = sum(1 for _ in BagReader(tmp_path / "run").messages())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 64
    assert peak < 10 * CHUNK_SIZE


def test_a_bag_of_several_files_is_one_sequence(tmp_path: Path) -> None:
    directory = tmp_path / "split"
    directory.mkdir()
    names = []
    for i, times in enumerate([(0, 4), (1, 5), (2, 3)]):
        with BagWriter(tmp_path / f"part{i}") as writer:
            writer.add_topic("/greeting", STRING)
            for time in times:
                writer.write("/greeting", HELLO, time, time)
        names.append(f"split_{i}.mcap")
        writer.file.rename(directory / names[-1])
    information = {"storage_identifier": "mcap", "compression_mode": "", "relative_file_paths": names}
    (directory / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
    reader = BagReader(directory)
    assert reader.topics["/greeting"].count == reader.message_count == 6
    assert [message.log_time_ns for message in reader.messages()] == list(range(6))


def test_the_offered_qos_comes_back(tmp_path: Path) -> None:
    latched = Qos(depth=3, durability=TRANSIENT_LOCAL, liveliness="automatic")
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/greeting", STRING, [latched])
    assert BagReader(tmp_path / "run").topics["/greeting"].offered_qos == (latched,)


@pytest.mark.parametrize("compression", CompressionType)
def test_every_compression_is_read(tmp_path: Path, compression: CompressionType) -> None:
    reader = BagReader(write_mcap(tmp_path / "foreign.mcap", compression=compression))
    assert [message.cdr for message in reader.messages()] == [HELLO] * 3


def test_bags_written_by_rosbag2_are_read_whole(shared_data: Callable[[str], Path]) -> None:
    files = sorted(shared_data("rosbag2_mcap").glob("*.mcap"))
    assert files
    for file in files:
        reader = BagReader(file)
        with file.open("rb") as stream:
            expected = [(c.topic, m.data, m.log_time) for _, c, m in make_reader(stream).iter_messages()]
        assert [(m.topic, m.cdr, m.log_time_ns) for m in reader.messages()] == expected
        assert len(expected) == reader.message_count > 0


def test_a_bag_written_by_rosbag2_is_decoded(shared_data: Callable[[str], Path]) -> None:
    reader = BagReader(shared_data("rosbag2_mcap") / "rosbag2_py_test_resources_mcap_talker_talker.mcap")
    messages = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/topic"])]
    assert [message.data for message in messages[:2]] == ["Hello, world! 0", "Hello, world! 1"]
    # The comments in this definition changed since; its fields did not.
    logs = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/rosout"])]
    assert logs[0].name == "minimal_publisher"
    (profile,) = reader.topics["/topic"].offered_qos
    assert profile.reliability == RELIABLE
    assert profile.durability == VOLATILE


def test_a_definition_with_another_hash_is_refused(tmp_path: Path) -> None:
    text, type_hash = known_definition(PAIR).text, "RIHS01_" + "0" * 64
    reader = BagReader(write_bag(tmp_path / "run", Definition(text, type_hash), PAIR))
    with pytest.raises(UserError, match=f"^Topic .* another definition of {PAIR} \\({type_hash}\\) than .*\\.$"):
        reader.decode(PAIR, PAIRED)


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("string key\nstring value", True),
        ("# the text\n\n  string   key   # said\nuint8 OK=0\nstring value\n", True),
        ("string key\nstring value 'default'", True),
        ("string value\nstring key", False),
        ("wstring key\nstring value", False),
        ("string key\nstring value\nuint8 more", False),
        ("", False),
    ],
)
def test_without_a_hash_the_fields_decide(tmp_path: Path, text: str, same: bool) -> None:
    reader = BagReader(write_bag(tmp_path / "run", Definition(text, ""), PAIR))
    if same:
        assert reader.decode(PAIR, PAIRED) == KeyValue(key="hello", value="x")
    else:
        with pytest.raises(UserError, match="another definition"):
            reader.decode(PAIR, PAIRED)


@pytest.mark.parametrize("type_name", [STRING, "no_such_msgs/msg/Thing"])
def test_a_type_of_others_is_decoded_by_the_definition_in_the_bag(tmp_path: Path, type_name: str) -> None:
    """Whether or not it is installed."""
    text = "uint8 OK=3\nstring data\n"
    reader = BagReader(write_bag(tmp_path / "run", Definition(text, ""), type_name))
    read = reader.decode(type_name, HELLO)
    assert (read.data, read.OK, read.__msgtype__) == ("hello", 3, type_name)


@pytest.mark.parametrize("text", ["string", "a/A data", "no text at all", "a_msgs/Other data"])
def test_a_definition_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    reader = BagReader(write_bag(tmp_path / "run", Definition(text, ""), "a/msg/A"))
    with pytest.raises(UserError, match=r"^The definition of type a/msg/A in bag .* cannot be read: .*\.$"):
        reader.decode("a/msg/A", HELLO)


def test_a_type_with_two_definitions_in_a_bag_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/one", "a/msg/A", definition=Definition("string data", ""))
        writer.add_topic("/other", "a/msg/A", definition=Definition("string text", ""))
    with pytest.raises(UserError, match=r"^Topic /other of bag .* another definition of a/msg/A"):
        BagReader(tmp_path / "run").decode("a/msg/A", HELLO)


def test_a_change_inside_a_contained_type_is_seen() -> None:
    ours = known_definition("std_msgs/msg/Header")
    older = Definition(ours.text.replace("uint32 nanosec", "uint32 nsec"), "")
    assert ours.text != older.text
    assert not older.same_layout(ours)
    assert Definition(ours.text, "").same_layout(ours)


def test_a_cut_message_is_refused(bag: Path) -> None:
    with pytest.raises(UserError, match=rf"^A message of type {STRING} in bag .* cannot be decoded: .*\.$"):
        BagReader(bag).decode(STRING, HELLO[:-3])


def test_what_is_not_a_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not exist"):
        BagReader(tmp_path / "nowhere")
    with pytest.raises(UserError, match=r"is not a bag; it must contain an \.mcap file"):
        BagReader(tmp_path)
    empty, text = tmp_path / "empty.mcap", tmp_path / "text.mcap"
    empty.touch()
    with pytest.raises(UserError, match="is empty"):
        BagReader(empty)
    text.write_text("no bag at all, but long enough")
    with pytest.raises(UserError, match="is not an MCAP file"):
        BagReader(text)


def test_metadata_that_names_a_missing_file_is_refused(bag: Path) -> None:
    (bag / "run_0.mcap").unlink()
    with pytest.raises(UserError, match="cannot be read: No such file"):
        BagReader(bag)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("storage_identifier: sqlite3", "cannot be read as the metadata of a bag"),
        ("[", "cannot be read as the metadata of a bag"),
        (
            "rosbag2_bagfile_information: {version: 9, storage_identifier: sqlite3, relative_file_paths: [run_0.db3]}",
            "cannot be read .*run_0.db3",
        ),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, compression_mode: FILE, relative_file_paths: [a]}",
            "cannot be read .*metadata key is missing",
        ),
    ],
)
def test_unreadable_metadata_is_refused(bag: Path, text: str, sentence: str) -> None:
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(UserError, match=sentence):
        BagReader(bag)


def test_another_profile_or_encoding_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="has the profile 'ros1'; only"):
        BagReader(write_mcap(tmp_path / "ros1.mcap", profile="ros1"))
    with pytest.raises(UserError, match=r"Topic /greeting .* has the encoding 'json'"):
        BagReader(write_mcap(tmp_path / "json.mcap", encoding="json"))


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"index_types": IndexType.NONE}])
def test_a_file_without_index_is_refused(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="has no index of its messages; 'sal-height salvage"):
        BagReader(write_mcap(tmp_path / "stream.mcap", **options))


def test_a_file_cut_anywhere_is_refused(bag: Path) -> None:
    file = bag / "run_0.mcap"
    data = file.read_bytes()
    for size in range(1, len(data), 7):
        file.write_bytes(data[:size])
        with pytest.raises(UserError, match=f"is cut off .* 'sal-height salvage {file} --out DIR'"):
            BagReader(bag)


def test_a_flipped_byte_never_passes_as_a_good_message(bag: Path) -> None:
    file = bag / "run_0.mcap"
    data = file.read_bytes()
    good = list(BagReader(bag).messages())
    refused = 0
    for position in range(0, len(data), 3):
        file.write_bytes(data[:position] + bytes([data[position] ^ 4]) + data[position + 1 :])
        try:
            assert list(BagReader(bag).messages()) == good
        except UserError:
            refused += 1
    # Not covered by a checksum, and not used in reading: header, message index and metadata record.
    assert refused > len(data) // 6


def test_a_flipped_byte_in_a_message_names_the_remedy(bag: Path) -> None:
    file = bag / "run_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data.replace(b"hello", b"jello"))
    with pytest.raises(UserError, match=r"is damaged .*crc.*; 'sal-height salvage"):
        list(BagReader(bag).messages())


def test_qos_that_is_not_a_list_of_profiles_is_refused() -> None:
    assert qos.from_yaml("") == []
    for text in ("[", "just text", "- history: 1", "- {history: nonsense}"):
        with pytest.raises(UserError, match="offered_qos_profiles contains no list"):
            qos.from_yaml(text)


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_lengths_that_are_far_too_large_are_refused_or_make_no_difference(tmp_path: Path, compression: str) -> None:
    """Of every record, and of every number in one: with 2 GB of memory more than is in use."""
    with BagWriter(tmp_path / "bag", packing=Packing(compression=compression)) as writer:
        writer.add_topic("/greeting", STRING)
        for time_ns in range(50):
            writer.write("/greeting", HELLO, time_ns, time_ns)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    whole, expected = file.read_bytes(), list(BagReader(tmp_path / "bag").messages())
    used = 1024 * int(re.findall(r"VmSize:\s+(\d+)", Path("/proc/self/status").read_text())[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2 * 10**9, before[1]))
    refused = []
    try:
        for begin, size in records_of(whole):
            for place in (begin + 1, *range(begin + 9, begin + 9 + min(size - 8, 48))):
                file.write_bytes(whole[:place] + (2**62).to_bytes(8, "little") + whole[place + 8 :])
                try:
                    assert list(BagReader(tmp_path / "bag").messages()) == expected
                except UserError as error:
                    refused.append(str(error))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert len(refused) > 100
    assert all(str(file) in sentence for sentence in refused)


def records_of(file: bytes) -> Iterator[tuple[int, int]]:
    """Where each record of an MCAP file begins, and the size of what follows its code and length, bytes."""
    begin = MAGIC_BYTES
    while begin < len(file) - MAGIC_BYTES:
        size = int.from_bytes(file[begin + 1 : begin + 9], "little")
        yield begin, size
        begin += 9 + size
