"""Two replays of a bag give the same messages, byte for byte, through nodes and by calls."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest
from helpers import few

from sal_height.bag.reader import BagReader
from sal_height.graph.plan import Execution
from sal_height.runs.replay.bag_replay import replay
from sal_height.topics import SLC

BAGS = Path(__file__).parents[3] / "bags"

ACCOUNTS = ("/diagnostics", "/progress", "/rosout", "/parameter_events")
"""Topics whose messages have the times of a run, and numbers of its processes."""


def raw(bag: Path) -> dict[str, list[bytes]]:
    """The bytes of all messages by topic, in their order."""
    reader, found = BagReader(bag), defaultdict(list)
    for message in reader.messages([topic for topic in reader.topics if topic not in ACCOUNTS]):
        found[message.topic].append(bytes(message.cdr))
    return dict(found)


@pytest.mark.parametrize("name", few(1, ["version_3", "sal_spotlight", "xband_relief", "sal_stripmap"]))
def test_replays_are_equal_byte_for_byte(name: str, tmp_path: Path) -> None:
    """Of all topics but accounts; unknown bytes of padding, or an order that depends on threads, would differ."""
    made = []
    for number, jobs in enumerate((None, None, 1, 1)):
        out = tmp_path / f"{number}"
        replay(BAGS / name, out, {}, Execution(record=[SLC]), jobs=jobs)
        made.append(raw(out / "bag"))
    first, *others = made
    assert {"/slc", "/phase_history", "/platform/odometry", "/tracked/height"} <= first.keys()
    for other in others:
        assert {topic: len(messages) for topic, messages in other.items()} == {
            topic: len(messages) for topic, messages in first.items()
        }
        assert [topic for topic in first if other[topic] != first[topic]] == []
