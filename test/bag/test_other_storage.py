"""Bags of rosbag2 in other storages, as rosbags writes them, hold the same messages."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from bags_at_hand import REFERENCE
from helpers import assert_one_sentence, refused
from rosbags.convert.cli import main as rosbags_convert

from sal_height.bag.check import check_bag
from sal_height.bag.copies import Range, cut, upgrade
from sal_height.bag.info import bag_info
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.errors import UserError

STORAGES = {
    "sqlite3": ["--dst-storage", "sqlite3"],
    "sqlite3 files": ["--dst-storage", "sqlite3", "--compress", "zstd", "--compress-mode", "file"],
    "sqlite3 messages": ["--dst-storage", "sqlite3", "--compress", "zstd", "--compress-mode", "message"],
    "mcap files": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "file"],
    "mcap messages": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "message"],
}


@pytest.fixture(scope="module")
def conversions(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """Makes the reference bag of a version in another storage, once."""
    folder = tmp_path_factory.mktemp("conversions")

    @cache
    def convert(storage: str, version: int) -> Path:
        out = folder / f"{storage} {version}"
        paths = ["--src", str(REFERENCE.parent / f"version_{version}"), "--dst", str(out)]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["rosbags-convert", *STORAGES[storage], *paths])
            with pytest.raises(SystemExit) as ended:
                rosbags_convert()
        assert not ended.value.code
        return out

    return convert


@pytest.fixture
def converted(conversions: Callable[[str, int], Path], tmp_path: Path) -> Callable[..., Path]:
    """Copies a bag in another storage."""

    def copied(storage: str, version: int = 3) -> Path:
        bag = tmp_path / "bag"
        shutil.copytree(conversions(storage, version), bag)
        return bag

    return copied


@pytest.mark.parametrize("storage", STORAGES)
def test_messages_topics_and_profiles_are_the_same(storage: str, converted: Callable[..., Path]) -> None:
    source, reader = BagReader(REFERENCE), BagReader(converted(storage))
    assert [m._replace(publish_time_ns=0) for m in reader.messages()] == [
        m._replace(publish_time_ns=0) for m in source.messages()
    ]
    assert reader.begin_ns == source.begin_ns == next(source.messages()).log_time_ns
    assert reader.topics.keys() == source.topics.keys()
    for name, topic in reader.topics.items():
        known = source.topics[name]
        assert (topic.type_name, topic.count, topic.offered_qos) == (known.type_name, known.count, known.offered_qos)
        assert topic.definition.same_layout(known.definition)
        assert topic.definition.type_hash == known.definition.type_hash
    heights = list(reader.messages(["/ml/height"]))
    assert [reader.decode(m.type_name, m.cdr).dwell for m in heights] == [0, 1]
    assert list(reader.messages([])) == []


@pytest.mark.parametrize("version", [0, 1, 2])
def test_messages_of_older_versions_are_read(version: int, converted: Callable[..., Path]) -> None:
    reader = BagReader(converted("sqlite3", version))
    source = BagReader(REFERENCE.parent / f"version_{version}")
    assert [m.cdr for m in reader.messages()] == [m.cdr for m in source.messages()]
    assert {name for name, topic in reader.topics.items() if topic.is_old} == {
        name for name, topic in source.topics.items() if topic.is_old
    }


def test_a_file_alone_is_read(converted: Callable[..., Path]) -> None:
    bag = converted("sqlite3")
    (file,) = bag.glob("*.db3")
    assert [m.cdr for m in BagReader(file).messages()] == [m.cdr for m in BagReader(REFERENCE).messages()]


def test_custom_data_are_read(converted: Callable[..., Path]) -> None:
    bag = converted("sqlite3")
    text = (bag / "metadata.yaml").read_text()
    assert "custom_data: null" in text
    (bag / "metadata.yaml").write_text(text.replace("custom_data: null", "custom_data: {flight: '7'}"))
    assert BagReader(bag).custom_data == {"flight": "7"}


def test_an_upgrade_or_a_cut_makes_mcap(converted: Callable[..., Path], tmp_path: Path) -> None:
    bag = converted("sqlite3 messages")
    upgrade(bag, tmp_path / "mcap")
    assert check_bag(tmp_path / "mcap", lambda *_: None) == []
    assert [m.cdr for m in BagReader(tmp_path / "mcap").messages()] == [m.cdr for m in BagReader(bag).messages()]
    assert cut(bag, tmp_path / "cut", Range(dwells=(0, 0))).counts["/phase_history"] == 8


def test_what_needs_mcap_says_how_to_make_it(
    converted: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = converted("sqlite3")
    with refused(UserError, "storage 'sqlite3'", f"'sal-height bag upgrade {bag} --out DIR'"):
        bag_info(bag)
    for command in ("check", "recover"):
        words = ["--out", str(tmp_path / "out")] if command == "recover" else []
        assert main(["bag", command, str(bag), *words]) == 2
        assert "bag upgrade" in capsys.readouterr().err


@pytest.mark.parametrize("storage", ["sqlite3", "sqlite3 files", "sqlite3 messages"])
def test_damage_is_said_in_one_sentence(storage: str, converted: Callable[..., Path]) -> None:
    """Wherever a file is cut: what is read of it is whole, or it is refused."""
    bag = converted(storage)
    whole = {m.cdr for m in BagReader(REFERENCE).messages()}
    (file,) = (path for path in bag.iterdir() if path.name != "metadata.yaml")
    data = file.read_bytes()
    refused = 0
    for size in range(0, len(data), len(data) // 8):
        file.write_bytes(data[:size])
        try:
            assert {m.cdr for m in BagReader(bag).messages()} <= whole
        except UserError as refusal:
            refused += 1
            assert_one_sentence(str(refusal), str(bag), "cannot be read")
    assert refused >= 7
