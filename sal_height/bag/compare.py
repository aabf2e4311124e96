"""Compare the messages of two bags field by field: the check that a replay equals the golden run."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sal_height.bag.field_difference import FieldDifference
from sal_height.bag.fields import content_hash, fields_of
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import EXACT, Tolerances
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.elevation import Validity

EQUAL, WITHIN, CHANGED = "equal", "within tolerance", "changed"
"""Verdicts, the best first."""

NOT_COMPARED = frozenset({"provenance", "order"})
"""Fields of messages that describe their making, not their result."""


class Key(NamedTuple):
    """Key by which a message of one bag is the counterpart of one in the other.

    Attributes:
        topic: name of the topic.
        dwell: number of its dwell; without one, number of earlier messages on the topic.
        channel: number of its channel; 0 without one.
        repetition: number of earlier messages with the same key: a simulator may have been restarted.
    """

    topic: str
    dwell: int
    channel: int = 0
    repetition: int = 0


@dataclass
class TopicComparison:
    """Comparison of one topic of a bag with that of the golden one.

    Attributes:
        matched: number of messages that are on both sides.
        missing: number of golden messages without a counterpart.
        extra: number of messages without a golden counterpart.
        lone: dwells (or numbers) of the first of these.
        fields: differences in each field.
        validity: number of pixels by their golden validity and that of the other bag.
        outside: number of values beyond the tolerance by dwell (or number).
        digests: content hashes of the messages, golden and of the other bag.
    """

    matched: int = 0
    missing: int = 0
    extra: int = 0
    lone: list[int] = field(default_factory=list)
    fields: dict[str, FieldDifference] = field(default_factory=dict)
    validity: Counter[tuple[str, str]] = field(default_factory=Counter)
    outside: Counter[int] = field(default_factory=Counter)
    digests: tuple[list[bytes], list[bytes]] = field(default_factory=lambda: ([], []))

    @property
    def verdict(self) -> str:
        """EQUAL, WITHIN or CHANGED."""
        if not self.matched or self.missing or self.extra or self.outside:
            return CHANGED
        return WITHIN if any(one.different for one in self.fields.values()) else EQUAL

    @property
    def worst(self) -> int | None:
        """Dwell (or number) with most values beyond the tolerance; None: none has any."""
        return self.outside.most_common(1)[0][0] if self.outside else None

    @property
    def hashes(self) -> tuple[str, str]:
        """Hash of the content of all messages of the topic, golden and of the other bag, in any order.

        Padding and fields that are not compared do not count. A topic that only one bag has is not read: "".
        """
        golden, other = (
            hashlib.sha256(b"".join(sorted(digests))).hexdigest() if digests else "" for digests in self.digests
        )
        return golden, other

    def as_json(self) -> dict[str, Any]:
        """Entry of a report."""
        confusion: dict[str, dict[str, int]] = {}
        for (golden, made), count in sorted(self.validity.items()):
            confusion.setdefault(golden, {})[made] = count
        return {
            "verdict": self.verdict,
            "matched": self.matched,
            "missing": self.missing,
            "extra": self.extra,
            "first_missing_or_extra": self.lone,
            "sha256": dict(zip(("golden", "made"), self.hashes, strict=True)),
            "equal_fields": sum(not one.different for one in self.fields.values()),
            "fields": {name: one.as_json() for name, one in self.fields.items() if one.different},
            "validity": confusion,
            "worst_dwell": self.worst,
        }


def compare_bags(
    golden: BagReader,
    other: BagReader,
    tolerances: Tolerances = EXACT,
    topics: Collection[str] | None = None,
    counts: Callable[[Any], bool] | None = None,
    counts_too: Callable[[Any], bool] | None = None,
) -> dict[str, TopicComparison]:
    """Match the messages of two bags by topic and dwell, and compare their fields.

    Provenance and the order of processing are not compared.

    Args:
        golden: bag with the expected messages.
        other: bag to judge.
        tolerances: greatest allowed differences from the golden values.
        topics: topics to compare; None: all with height images.
        counts: predicate of golden messages that count; None: all do.
        counts_too: predicate of messages of the other bag that count; None: all do.

    Returns:
        Comparisons by topic, of all that either bag has messages on.

    Raises:
        UserError: a bag cannot be read.
    """
    bags = golden, other
    numbers = [_numbers(bag, topics) for bag in bags]
    found = {topic: TopicComparison() for topic in dict.fromkeys([*numbers[0], *numbers[1]])}
    read = found.keys() if counts or counts_too else numbers[0].keys() & numbers[1].keys()
    for topic in found.keys() - read:
        found[topic].missing, found[topic].extra = (side.get(topic, 0) for side in numbers)
    waiting: tuple[dict[Key, Any], dict[Key, Any]] = ({}, {})
    # Both sides advance together, so that only messages without a counterpart yet are kept in memory.
    sides = _messages(bags[0], read, counts), _messages(bags[1], read, counts_too)
    for pair in itertools.zip_longest(*sides):
        for side, entry in enumerate(pair):
            if entry is not None:
                key, message = entry
                waiting[side][key] = message
                if key in waiting[1 - side]:
                    _compare(waiting[0].pop(key), waiting[1].pop(key), tolerances, key.dwell, found[key.topic])
    for side, lone in enumerate(waiting):
        for key, message in lone.items():
            result = found[key.topic]
            result.missing += side == 0
            result.extra += side == 1
            if len(result.lone) < 5:  # at most five are named
                result.lone.append(key.dwell)
            result.digests[side].append(content_hash(fields_of(message, NOT_COMPARED)))
    return found


def _numbers(bag: BagReader, topics: Collection[str] | None) -> dict[str, int]:
    """Number of messages of each topic to compare that has any."""
    return {
        topic.name: topic.count
        for topic in bag.topics.values()
        if topic.count and (topic.type_name == HEIGHT_TYPE if topics is None else topic.name in topics)
    }


def _messages(
    bag: BagReader, topics: Collection[str], counts: Callable[[Any], bool] | None = None
) -> Iterator[tuple[Key, Any]]:
    seen: Counter[Key] = Counter()
    for recorded in bag.messages(topics) if topics else ():
        message = bag.decode(recorded.type_name, recorded.cdr)
        if counts and not counts(message):
            continue
        numbered = hasattr(message, "dwell")
        key = Key(recorded.topic, message.dwell if numbered else 0, getattr(message, "channel", 0) if numbered else 0)
        seen[key] += 1
        number = seen[key] - 1
        yield key._replace(repetition=number) if numbered else key._replace(dwell=number), message


def _compare(golden: Any, made: Any, tolerances: Tolerances, dwell: int, result: TopicComparison) -> None:
    """Add what a message has in common with its golden counterpart."""
    ours, theirs = fields_of(golden, NOT_COMPARED), fields_of(made, NOT_COMPARED)
    for side, fields in zip(result.digests, (ours, theirs), strict=True):
        side.append(content_hash(fields))
    result.matched += 1
    if golden.__msgtype__ == HEIGHT_TYPE:
        result.validity.update(_confusion(ours["validity"], theirs["validity"]))
    for name in dict.fromkeys([*ours, *theirs]):
        one, other = ours.get(name, NOTHING), theirs.get(name, NOTHING)
        sigma = ours.get(f"{name.rpartition('.')[0]}.sigma".removeprefix("."))
        allowed = tolerances.of(name, one).allowed(one, sigma)
        known = result.fields.setdefault(name, FieldDifference())
        if outside := known.add(one, other, allowed, dwell):
            result.outside[dwell] += outside


NOTHING: NDArray[Any] = np.zeros(0)


def _confusion(golden: NDArray[Any], made: NDArray[Any]) -> Counter[tuple[str, str]]:
    """Number of pixels by pair of validities; empty if the images have different numbers of pixels."""
    if golden.size != made.size:
        return Counter()
    pairs, counts = np.unique(np.stack([golden, made]), axis=1, return_counts=True)
    return Counter({(_name(one), _name(other)): int(n) for (one, other), n in zip(pairs.T, counts, strict=True)})


def _name(code: int) -> str:
    """Name of a validity; its number where it has none."""
    return Validity(code).name if code in list(Validity) else str(code)
