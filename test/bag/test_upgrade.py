"""An upgraded bag is one of today, and says what the old one did."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bags_at_hand import REFERENCE

from sal_height.bag.check import check_bag
from sal_height.bag.copies import upgrade
from sal_height.bag.files import ACCOUNT
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import COMPRESSIONS, BagWriter, Packing
from sal_height.commands import main
from sal_height.messages.definition import known_definition

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
