"""What `sal-height bag check` finds: each defect alone, in a bag in which nothing else is wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bags_at_hand import REFERENCE, changed, reference, write_like_reference
from helpers import assert_one_sentence
from mcap.writer import Writer

from sal_height.bag.check import check_bag
from sal_height.bag.check_sensor import Finding
from sal_height.bag.files import ACCOUNT, read_index
from sal_height.bag.reader import BagMessage
from sal_height.bag.topics import IMAGE_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.definition import Definition, known_definition
from sal_height.messages.types import ComplexImage

FRAMES, ODOMETRY, INFO = "/phase_history", "/platform/odometry", "/sensor_info"


def findings(bag: Path) -> list[Finding]:
    return check_bag(bag, lambda *_: None)


def the_finding(bag: Path, severity: str, *parts: str) -> None:
    """Assert that there is one finding, with these parts in its sentence or fix."""
    found = findings(bag)
    assert [one.severity for one in found] == [severity], found
    assert_one_sentence(found[0].sentence, *parts[:-1])
    assert_one_sentence(found[0].fix, parts[-1])


def frames_only(change: Callable[[list[BagMessage]], list[BagMessage]]) -> list[BagMessage]:
    """The reference messages with others in place of its frames."""
    frames = [m for m in reference() if m.topic == FRAMES]
    return [*(m for m in reference() if m.topic != FRAMES), *change(frames)]


def each_odometry(change: Callable[[int, Any], None]) -> list[BagMessage]:
    """The reference messages with odometry changed, given its number."""
    odometry = [m for m in reference() if m.topic == ODOMETRY]
    others = [m for m in reference() if m.topic != ODOMETRY]
    return [*others, *(changed(m, lambda one, n=n: change(n, one)) for n, m in enumerate(odometry))]


@pytest.mark.parametrize("source", ["reference", "written", "converted"])
def test_nothing_is_wrong_with_a_good_bag(source: str, tmp_path: Path) -> None:
    """Nor with one that rosbags has written."""
    bag = REFERENCE
    if source == "written":
        bag = write_like_reference(tmp_path / "bag", reference())
    elif source == "converted":
        bag = tmp_path / "bag"
        convert = [str(Path(sys.executable).with_name("rosbags-convert")), "--src", str(REFERENCE), "--dst", str(bag)]
        subprocess.run([*convert, "--dst-storage", "mcap"], check=True, timeout=60)  # noqa: S603
    assert findings(bag) == []


def test_a_cut_file_is_to_be_recovered(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-1])
    the_finding(bag, "error", str(file), "is cut off", "bag recover")


def test_a_bag_without_metadata_is_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    (bag / "metadata.yaml").unlink()
    the_finding(bag, "warning", "no metadata.yaml", "ros2 bag reindex")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("message_count: 69", "message_count: 70", "count of messages is 70 and not 69"),
        ("nanoseconds: ", "nanoseconds: 1", "duration in ns is 1"),
        ("message_count: 16", "message_count: 17", "count of /phase_history is 17 and not 16"),
        ("name: /ml/height", "name: /ml/heights", "count of /ml/heights is 2 and not 0"),
        ("type: nav_msgs/msg/Odometry", "type: nav_msgs/msg/Path", "type of /platform/odometry is nav_msgs/msg/Path"),
    ],
)
def test_metadata_that_contradict_the_files_are_found(old: str, new: str, said: str, tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    text = (bag / "metadata.yaml").read_text()
    assert old in text
    (bag / "metadata.yaml").write_text(text.replace(old, new, 1))
    the_finding(bag, "warning", "contradicts the files", said, "ros2 bag reindex")


def test_a_file_that_is_not_listed_is_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    (bag / "more.mcap").write_bytes((bag / "bag_0.mcap").read_bytes())
    the_finding(bag, "warning", "does not list more.mcap", "ros2 bag reindex")


def test_a_file_that_is_listed_and_not_there_is_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace("- bag_0.mcap", "- bag_0.mcap\n  - bag_1.mcap"))
    the_finding(bag, "error", "bag_1.mcap cannot be read", "bag recover")


@pytest.mark.parametrize(
    ("profile", "encoding", "said"), [("ros1", "cdr", "profile 'ros1'"), ("ros2", "json", "encoding 'json'")]
)
def test_other_profiles_and_encodings_are_found(profile: str, encoding: str, said: str, tmp_path: Path) -> None:
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile=profile)
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        writer.add_message(writer.register_channel("/a", encoding, schema), 0, b"", 0)
        writer.finish()
    (found,) = findings(tmp_path / "bag.mcap")
    assert (found.severity, said in found.sentence) == ("error", True)


STRING = known_definition("std_msgs/msg/String")
OTHER_HASH = STRING.type_hash[:-1] + ("0" if STRING.type_hash[-1] != "0" else "1")


@pytest.mark.parametrize(
    ("type_name", "definition", "severity", "said", "fix"),
    [
        ("std_msgs/msg/String", Definition("int32 data", ""), "error", "another definition", "package std_msgs"),
        ("std_msgs/msg/String", Definition(STRING.text, OTHER_HASH), "error", "not that of the type hash", "std_msgs"),
        ("std_msgs/msg/String", Definition("no text", STRING.type_hash), "error", "not that of the type hash", "std_"),
        ("foreign_msgs/msg/A", Definition("int32 data", ""), "warning", "is not installed", "package foreign_msgs"),
    ],
)
def test_types_that_cannot_be_decoded_are_found(
    type_name: str, definition: Definition, severity: str, said: str, fix: str, tmp_path: Path
) -> None:
    bag = rewritten(tmp_path / "bag", lambda bag: bag.add_topic("/other", type_name, (), definition))
    the_finding(bag, severity, "/other", said, fix)


def rewritten(folder: Path, more: Callable[[BagWriter], object], records: Any = None) -> Path:
    """A bag with the messages of the reference bag, and more."""
    messages = reference()
    with BagWriter(folder, {"parameters": "{}"}) as bag:
        more(bag)
        for message in messages:
            bag.add_topic(message.topic, message.type_name)
            bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
        bag.close(records or {})
    return folder


def test_a_damaged_chunk_is_found_and_the_rest_is_checked(tmp_path: Path) -> None:
    """The chunk holds a frame, so that a dwell lacks a channel, too."""
    bag = write_like_reference(tmp_path / "bag", reference())
    file = bag / "bag_0.mcap"
    frame = next(m for m in reference() if m.topic == FRAMES)
    content = bytearray(file.read_bytes())
    content[content.index(frame.cdr) + len(frame.cdr) // 2] ^= 1
    file.write_bytes(content)
    damage, dwell = findings(bag)
    place = content.index(frame.cdr[:100])
    (chunk,) = (c for c in read_index(file).summary.chunk_indexes if 0 < place - c.chunk_start_offset < c.chunk_length)
    assert (damage.severity, dwell.severity) == ("error", "warning")
    assert_one_sentence(damage.sentence, f"at byte {chunk.chunk_start_offset} of file {file}", "crc")
    assert "bag recover" in damage.fix
    assert "1 of 2 dwells" in dwell.sentence
    assert "lacks channel 0" in dwell.sentence


def test_a_damaged_message_index_is_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", reference())
    file = bag / "bag_0.mcap"
    chunk = read_index(file).summary.chunk_indexes[3]
    content = bytearray(file.read_bytes())
    content[chunk.chunk_start_offset + chunk.chunk_length] ^= 1
    file.write_bytes(content)
    the_finding(bag, "error", str(file), "there is no message index at byte", "bag recover")


@pytest.mark.parametrize("topic", [FRAMES, ODOMETRY])
def test_a_topic_that_is_needed_and_absent_is_found(topic: str, tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", [m for m in reference() if m.topic != topic])
    the_finding(bag, "error", f"no messages on {topic}", "Record it")


def test_frames_that_nothing_describes_are_found(tmp_path: Path) -> None:
    found = findings(write_like_reference(tmp_path / "bag", [m for m in reference() if m.topic != INFO]))
    assert [one.severity for one in found] == ["error", "error"]
    assert "no messages on /sensor_info" in found[0].sentence
    assert "2 of 2 dwells cannot be used" in found[1].sentence


def test_a_bag_of_images_needs_neither_frames_nor_odometry(tmp_path: Path) -> None:
    """Such as sal-height import slc makes."""
    (info,) = (m for m in reference() if m.topic == INFO)
    image = info._replace(topic="/slc", type_name=IMAGE_TYPE, cdr=serialize(ComplexImage()))
    bag = write_like_reference(tmp_path / "bag", [info, image])
    the_finding(bag, "warning", "images on /slc and no messages on /phase_history", "--from slc")
    nameless = write_like_reference(tmp_path / "nameless", [image])
    the_finding(nameless, "error", "no messages on phase_history and sensor_info", "Record it")


def test_a_bag_without_any_sensor_is_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", [m for m in reference() if m.topic not in (FRAMES, INFO)])
    the_finding(bag, "error", "no messages on phase_history and sensor_info", "Record it")


def test_frames_before_the_description_are_found(tmp_path: Path) -> None:
    last_ns = reference()[-1].log_time_ns
    late = [m._replace(log_time_ns=last_ns) if m.topic == INFO else m for m in reference()]
    bag = write_like_reference(tmp_path / "bag", late)
    the_finding(bag, "warning", "Frames of 2 dwells on /phase_history come before", "latched")


def test_dwells_that_lack_channels_are_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", frames_only(lambda frames: [*frames[:2], *frames[4:]]))
    the_finding(bag, "warning", "1 of 2 dwells", "lacks channels 2, 3", "--dwells")


def test_frames_that_are_there_twice_are_found(tmp_path: Path) -> None:
    bag = write_like_reference(tmp_path / "bag", frames_only(lambda frames: [*frames, frames[-1]]))
    the_finding(bag, "warning", "1 of 2 dwells", "has twice channel 7", "recorded once")


def test_frames_that_nodes_refuse_are_found(tmp_path: Path) -> None:
    def break_two(frames: list[BagMessage]) -> list[BagMessage]:
        def shorten(frame: Any) -> None:
            frame.pulse_time = frame.pulse_time[:-1]

        return [*(changed(frame, shorten) for frame in frames[:2]), *frames[2:]]

    bag = write_like_reference(tmp_path / "bag", frames_only(break_two))
    the_finding(bag, "error", "2 messages on /phase_history (wrong size)", "channel 0", "put right")


def test_bytes_that_are_no_frame_are_found(tmp_path: Path) -> None:
    first, second = findings(
        write_like_reference(
            tmp_path / "bag", frames_only(lambda frames: [frames[0]._replace(cdr=b"\0\1\0\0"), *frames[1:]])
        )
    )
    assert "1 message on /phase_history (cannot be decoded)" in first.sentence
    assert "lacks channel 0" in second.sentence


def test_a_sensor_that_nodes_refuse_is_found(tmp_path: Path) -> None:
    def age(info: Any) -> None:
        info.contract_version = 99

    found = findings(
        write_like_reference(tmp_path / "bag", [changed(m, age) if m.topic == INFO else m for m in reference()])
    )
    assert "/sensor_info (sensor info)" in found[0].sentence
    assert "99" in found[0].sentence


def test_dwells_without_odometry_around_them_are_found(tmp_path: Path) -> None:
    def delay(_: int, odometry: Any) -> None:
        odometry.header.stamp.sec += 1

    bag = write_like_reference(tmp_path / "bag", each_odometry(delay))
    the_finding(bag, "warning", "do not reach", "2 of 2 dwells", "before the first dwell")


@pytest.mark.parametrize("late", [4, 6, 7])
def test_gaps_of_the_odometry_in_dwells_are_found(late: int, tmp_path: Path) -> None:
    """Of seven samples those from number `late` on come a second later: in a dwell, after all of them, or none.

    Between passes odometry may pause.
    """

    def stretch(number: int, odometry: Any) -> None:
        odometry.header.stamp.sec += number >= late

    bag = write_like_reference(tmp_path / "bag", each_odometry(stretch))
    if late == 4:
        the_finding(bag, "warning", "1 gaps in dwells that are longer", "the longest of 1", "more often")
    else:
        assert findings(bag) == []


@pytest.mark.parametrize("seconds", [1, 2])
def test_odometry_that_runs_back_is_found_if_nodes_do_not_put_up_with_it(seconds: int, tmp_path: Path) -> None:
    """A copy of the fourth sample, stamped earlier, comes last: a second early is put up with, or nearly."""
    messages = reference()
    odometry = [m for m in messages if m.topic == ODOMETRY]

    def set_back(one: Any) -> None:
        one.header.stamp.sec -= seconds

    again = changed(odometry[3], set_back)._replace(log_time_ns=messages[-1].log_time_ns)
    found = findings(write_like_reference(tmp_path / "bag", [*messages, again]))
    sentences = [one.sentence for one in found]
    assert any("run back by up to 2.0" in sentence for sentence in sentences) == (seconds == 2)


def test_dwells_whose_stamps_run_back_are_found(tmp_path: Path) -> None:
    def swap(frames: list[BagMessage]) -> list[BagMessage]:
        order = [*frames[8:], *frames[:8]]
        return [m._replace(log_time_ns=frames[-1].log_time_ns + n) for n, m in enumerate(order)]

    bag = write_like_reference(tmp_path / "bag", frames_only(swap))
    the_finding(bag, "warning", "Stamps on /phase_history run back", "dwell 0", "steady clock")


@pytest.mark.parametrize("seconds", [0.9, 1.1])
def test_messages_published_after_they_were_received_are_found(seconds: float, tmp_path: Path) -> None:
    ahead = [
        m._replace(publish_time_ns=m.log_time_ns + round(seconds * 1e9)) if m.topic == FRAMES else m
        for m in reference()
    ]
    bag = write_like_reference(tmp_path / "bag", ahead)
    if seconds > 1:
        the_finding(bag, "warning", "up to 1.100 s", "16 on /phase_history", "clocks")
    else:
        assert findings(bag) == []


def test_a_bag_without_parameters_is_found(tmp_path: Path) -> None:
    sensor = [m for m in reference() if m.topic in (FRAMES, ODOMETRY, INFO)]
    the_finding(write_like_reference(tmp_path / "bag", sensor, {}), "warning", "parameters of nodes", "--param")
    (tmp_path / "bag" / "parameters.yaml").write_text("{}")
    assert findings(tmp_path / "bag") == []


def test_losses_of_the_recorder_are_found(tmp_path: Path) -> None:
    account = {
        FRAMES: json.dumps({"received": 20, "written": 16, "left_out": {"queue full": 4, "lost on the way": 2}}),
        INFO: json.dumps({"received": 1, "written": 1, "left_out": {}}),
        ODOMETRY: "no JSON",
    }
    bag = rewritten(tmp_path / "bag", lambda _: None, {ACCOUNT: account})
    the_finding(bag, "warning", "topic /phase_history", "4 queue full, 2 lost on the way", "faster disk")


def test_a_bag_of_an_older_version_is_to_be_upgraded() -> None:
    the_finding(REFERENCE.parent / "version_1", "warning", "older version", "/ml/height", "bag upgrade")


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("no bag at all")
    (tmp_path / "empty").mkdir()
    for path, said in (("text.mcap", "not an MCAP file"), ("empty", "not a bag"), ("missing", "does not exist")):
        with pytest.raises(UserError, match=said):
            findings(tmp_path / path)


def test_statuses_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "check", str(REFERENCE)]) == 0
    assert capsys.readouterr().out == f"Nothing is wrong with {REFERENCE}.\n"
    assert main(["bag", "check", str(REFERENCE.parent / "version_0"), "--json"]) == 1
    (found,) = json.loads(capsys.readouterr().out)
    assert set(found) == {"severity", "sentence", "fix"}
    assert main(["bag", "check", str(REFERENCE.parent / "version_0")]) == 1
    assert capsys.readouterr().out.startswith("warning: Bag ")
    assert main(["bag", "check", str(tmp_path)]) == 2
