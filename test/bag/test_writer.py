"""A written bag, as other programs see it: rosbags, mcap alone, and metadata.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import file_size_limit
from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos as RosbagsQos
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from sal_height.bag.mcap_file import CHUNK_SIZE
from sal_height.bag.qos import TRANSIENT_LOCAL, Qos
from sal_height.bag.reader import BagReader
from sal_height.bag.salvage import recover
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.definition import known_definition
from sal_height.messages.parameters import parameter_of
from sal_height.messages.types import HeightImage, Surface

STRING, HEIGHT = "std_msgs/msg/String", "sal_height_msgs/msg/HeightImage"
LATCHED = Qos(depth=1, durability=TRANSIENT_LOCAL)


def height_image(dwell: int) -> HeightImage:
    image = HeightImage(dwell=dwell, estimator="ml", range_looks=4, azimuth_looks=1)
    image.header.frame_id = "map"
    image.grid.rows, image.grid.cols, image.grid.row_spacing = 2, 3, 0.05
    image.surfaces = [Surface(height=np.array([0.5, np.nan, -1.25, 3.0, 4.0, dwell], np.float32))]
    image.validity = np.array([0, 1, 0, 0, 0, 0], np.uint8)
    image.provenance.parameters = [parameter_of("ml_height.range_looks", 4)]
    return image


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Bag of three latched strings and two height images."""
    directory = tmp_path / "run"
    with BagWriter(directory) as writer:
        writer.add_topic("/note", STRING, [LATCHED])
        writer.add_topic("/ml/height", HEIGHT, [Qos(depth=4), Qos(depth=4)])
        for i in range(3):
            writer.write("/note", serialize_message(String(data="x" * i)), 1000 + 10 * i, 990 + 10 * i)
        for dwell in range(2):
            writer.write("/ml/height", serialize(height_image(dwell)), 1005 + 10 * dwell, 1004)
    return directory


def test_rosbags_decodes_our_messages_from_the_schema_in_the_bag(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        images = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/ml/height"]
    assert [image.dwell for image in images] == [0, 1]
    np.testing.assert_array_equal(
        images[1].surfaces[0].height, np.array([0.5, np.nan, -1.25, 3.0, 4.0, 1.0], np.float32)
    )
    assert images[0].grid.row_spacing == 0.05
    (parameter,) = images[0].provenance.parameters
    assert (parameter.name, parameter.value.integer_value) == ("ml_height.range_looks", 4)


def test_rosbags_reads_times_counts_hashes_and_qos_from_metadata_yaml(bag: Path) -> None:
    with Reader(bag) as reader:
        assert (reader.start_time, reader.end_time, reader.message_count) == (1000, 1021, 5)
        assert reader.ros_distro == "jazzy"
        note, heights = sorted(reader.connections, key=lambda connection: -connection.msgcount)
    assert (note.topic, note.msgtype, note.msgcount) == ("/note", STRING, 3)
    assert note.digest == known_definition(STRING).type_hash
    assert [profile.durability for profile in offered(note)] == [QosDurability.TRANSIENT_LOCAL]
    assert [profile.durability for profile in offered(heights)] == [QosDurability.VOLATILE] * 2
    assert {profile.reliability for profile in offered(heights)} == {QosReliability.RELIABLE}


def offered(connection: object) -> list[RosbagsQos]:
    profiles: list[RosbagsQos] = connection.ext.offered_qos_profiles  # type: ignore[attr-defined]
    return profiles


def test_mcap_alone_finds_everything_rosbag2_writes(bag: Path) -> None:
    with (bag / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        channels = {channel.topic: channel for channel in summary.channels.values()}
        counts = summary.statistics.channel_message_counts
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        messages = [(c.topic, m.log_time, m.publish_time) for _, c, m in reader.iter_messages()]

    assert {topic: counts[channel.id] for topic, channel in channels.items()} == {"/note": 3, "/ml/height": 2}
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (1000, 1020)
    assert [index.compression for index in summary.chunk_indexes] == [""]
    assert all(index.message_index_offsets for index in summary.chunk_indexes)
    assert messages[:2] == [("/note", 1000, 990), ("/ml/height", 1005, 1004)]

    note = channels["/note"]
    assert note.message_encoding == "cdr"
    assert note.metadata["topic_type_hash"].startswith("RIHS01_")
    (profile,) = yaml.safe_load(note.metadata["offered_qos_profiles"])
    assert profile == {
        "history": "keep_last",
        "depth": 1,
        "reliability": "reliable",
        "durability": "transient_local",
        "deadline": {"sec": 0, "nsec": 0},
        "lifespan": {"sec": 0, "nsec": 0},
        "liveliness": "system_default",
        "liveliness_lease_duration": {"sec": 0, "nsec": 0},
        "avoid_ros_namespace_conventions": False,
    }

    schema = summary.schemas[channels["/ml/height"].schema_id]
    assert (schema.name, schema.encoding) == (HEIGHT, "ros2msg")
    _, *dependencies = schema.data.decode().split("\n" + "=" * 80 + "\n")
    assert sorted(text.splitlines()[0] for text in dependencies) == [
        "MSG: builtin_interfaces/Time",
        "MSG: geometry_msgs/Point",
        "MSG: geometry_msgs/Pose",
        "MSG: geometry_msgs/Quaternion",
        "MSG: geometry_msgs/Vector3",
        *(f"MSG: rcl_interfaces/{name}" for name in ("Parameter", "ParameterValue")),
        "MSG: sal_height_msgs/Aperture",
        "MSG: sal_height_msgs/Doubt",
        "MSG: sal_height_msgs/FitTest",
        "MSG: sal_height_msgs/ImageGrid",
        "MSG: sal_height_msgs/Provenance",
        "MSG: sal_height_msgs/Surface",
        "MSG: std_msgs/Header",
    ]

    beside = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert yaml.safe_load(metadata["rosbag2"]["serialized_metadata"]) == beside
    assert (beside["version"], beside["storage_identifier"]) == (9, "mcap")
    assert beside["relative_file_paths"] == ["run_0.mcap"]
    assert beside["duration"] == {"nanoseconds": 20}


def test_the_folder_holds_the_file_and_its_metadata_only(bag: Path) -> None:
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "run_0.mcap"]
    assert "&" not in (bag / "metadata.yaml").read_text(), "yaml-cpp readers must not meet aliases"


def test_messages_keep_their_bytes(tmp_path: Path) -> None:
    sizes = [0, 1, CHUNK_SIZE - 1, CHUNK_SIZE, 3 * CHUNK_SIZE, 5]
    payloads = [np.random.default_rng(size).bytes(size) for size in sizes]
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/bytes", STRING)
        for i, payload in enumerate(payloads):
            writer.write("/bytes", payload, i, i)
    assert [message.cdr for message in BagReader(tmp_path / "run").messages()] == payloads


def test_two_topics_of_one_type_share_its_schema(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        for topic in ("/a", "/b", "/a"):
            writer.add_topic(topic, STRING)
    with (tmp_path / "run/run_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert (len(summary.schemas), len(summary.channels)) == (1, 2)


def test_a_bag_without_messages_can_be_opened(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/note", STRING)
    with Reader(tmp_path / "run") as reader:
        assert [(c.topic, c.msgcount) for c in reader.connections] == [("/note", 0)]
    assert list(BagReader(tmp_path / "run").messages()) == []


def test_a_folder_in_use_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("data")
    with pytest.raises(UserError, match=r"is not empty; name a new or an empty folder"):
        BagWriter(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("data")
    with pytest.raises(UserError, match=r"cannot be written: File exists"):
        BagWriter(tmp_path / "file")


@pytest.mark.parametrize(
    ("type_name", "sentence"),
    [
        ("no_such_msgs/msg/Thing", "install or source a package no_such_msgs"),
        ("std_msgs/msg/NoSuchThing", "Message type std_msgs/msg/NoSuchThing is not installed"),
        ("std_msgs/String", "which has the form package/msg/Type"),
    ],
)
def test_an_unknown_type_is_refused(tmp_path: Path, type_name: str, sentence: str) -> None:
    with BagWriter(tmp_path / "run") as writer, pytest.raises(UserError, match=sentence):
        writer.add_topic("/thing", type_name)


def test_a_second_type_for_a_topic_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic("/note", STRING)
        with pytest.raises(UserError, match="carries 'std_msgs/msg/String' and cannot carry"):
            writer.add_topic("/note", HEIGHT)


def test_an_error_in_the_recording_program_still_leaves_a_complete_bag(tmp_path: Path) -> None:
    def fail_while_recording() -> None:
        with BagWriter(tmp_path / "run") as writer:
            writer.add_topic("/note", STRING)
            writer.write("/note", serialize_message(String(data="last words")), 1, 1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_while_recording()
    assert BagReader(tmp_path / "run").message_count == 1


def test_after_a_full_disk_the_bag_is_cut_where_it_was_full(tmp_path: Path) -> None:
    cdr = serialize_message(String(data="x" * (CHUNK_SIZE // 4)))
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/note", STRING)
        written = 0

        def write_for_ever() -> None:
            nonlocal written
            while True:
                writer.write("/note", cdr, written, written)
                written += 1

        with file_size_limit(10 * CHUNK_SIZE), pytest.raises(OSError, match="File too large"):
            write_for_ever()
        with pytest.raises(OSError, match="an earlier write error has cut"):
            writer.write("/note", cdr, 0, 0)
    assert not (tmp_path / "run/metadata.yaml").exists()
    with pytest.raises(UserError, match="is cut off"):
        BagReader(tmp_path / "run")
    saved = recover(tmp_path / "run", tmp_path / "saved").count
    assert 30 <= saved <= written
    assert [message.cdr for message in BagReader(tmp_path / "saved").messages()] == [cdr] * saved


def test_custom_data_are_found_by_others_and_by_us(tmp_path: Path) -> None:
    """In metadata.yaml and the record of rosbag2, as ros2 bag record --custom-data leaves them."""
    texts = {"parameters": '{"ml_height": {"range_looks": 2}}', "note": "first line\nand = another"}
    with BagWriter(tmp_path / "run", texts):
        pass
    assert (
        yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]["custom_data"]
        == texts
    )
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        (record,) = [r for r in make_reader(stream).iter_metadata() if r.name == "rosbag2"]
    assert yaml.safe_load(record.metadata["serialized_metadata"])["custom_data"] == texts
    assert BagReader(tmp_path / "run").custom_data == texts
    with Reader(tmp_path / "run") as foreign:
        assert foreign.message_count == 0


@pytest.mark.parametrize("place", [bytes.find, bytes.rfind])
def test_damaged_custom_data_are_never_taken_for_good(place: Any, tmp_path: Path) -> None:
    """They are in the file twice; the checksum tells which one is whole."""
    with BagWriter(tmp_path / "run", {"range_looks": "2222"}):
        pass
    file = tmp_path / "run" / "run_0.mcap"
    data = bytearray(file.read_bytes())
    data[place(bytes(data), b"2222")] ^= 1
    file.write_bytes(data)
    assert BagReader(tmp_path / "run").custom_data == {"range_looks": "2222"}
