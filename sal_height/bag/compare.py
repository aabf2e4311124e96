"""Compare the messages of two bags field by field: the check that a replay equals the golden run."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import EXACT, Tolerances
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.elevation import Validity
from sal_height.io import or_null
from sal_height.messages import to_ns
from sal_height.messages.plain import fields_of_message
from sal_height.numeric import F64, I64

TIMES = {"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
"""Types of messages that are one value, in nanoseconds."""

NUMBERS_OF_SAMPLES = {"complex_float32": "<f4", "complex_int16": "<i2"}
"""Type of the numbers in `samples`, two of which make a sample, by the name of their encoding."""

EDGES: F64 = np.concatenate([[0.0], 10.0 ** (np.arange(-20 * 20, 20 * 20 + 1) / 20), [np.inf]])
"""Limits of the bins of differences for quantiles, twenty per decade."""

EQUAL, WITHIN, CHANGED = "equal", "within tolerance", "changed"
"""Verdicts, the best first."""

NOT_COMPARED = frozenset({"provenance", "order", "doubts", "fit"})
"""Fields of messages that describe their making, or judge their result: a bag may be older than a test of its data."""

NOTHING: NDArray[Any] = np.zeros(0)


def fields_of(message: Any, without: frozenset[str] = frozenset()) -> dict[str, NDArray[Any]]:
    """All values of a message, as arrays of one dimension by name.

    Args:
        message: message of any type.
        without: fields of the message itself that are left out.

    Returns:
        Numbers and texts by names such as "grid.rows" and "surfaces[0].height"; a time or duration is whole
        nanoseconds, complex samples are complex numbers. An empty list is an empty array.
    """
    names = [name for name in fields_of_message(message) if name not in without]
    return dict(entry for name in names for entry in _entries(name, getattr(message, name), message))


def content_hash(fields: Mapping[str, NDArray[Any]]) -> bytes:
    """SHA-256 of names and values; it does not depend on the padding of a serialized message, nor on a NaN's bits."""
    digest = hashlib.sha256()
    for name, values in fields.items():
        digest.update(f"{name} {values.dtype.str} {values.size}\n".encode())
        digest.update(np.ascontiguousarray(_canonical(values)).tobytes())
    return digest.digest()


def _canonical(values: NDArray[Any]) -> NDArray[Any]:
    """The values with one NaN in place of all others, and without negative zeros."""
    if values.dtype.kind not in "fc":
        return values
    return np.where(np.isnan(values), values.dtype.type(np.nan), values) + values.dtype.type(0)


def _entries(name: str, value: Any, holder: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if getattr(value, "__msgtype__", "") in TIMES:
        yield name, np.array([value.sec * 10**9 + value.nanosec], np.int64)
    elif fields_of_message(value):
        for inner, values in fields_of(value).items():
            yield f"{name}.{inner}", values
    elif isinstance(value, list) and value and fields_of_message(value[0]):
        for number, element in enumerate(value):
            yield from _entries(f"{name}[{number}]", element, holder)
    elif name == "samples":
        yield name, _samples(value, NUMBERS_OF_SAMPLES.get(getattr(holder, "encoding", "")))
    elif isinstance(value, np.ndarray | list):
        yield name, np.asarray(value)
    else:
        yield name, np.array([value])


def _samples(data: Any, numbers: str | None) -> NDArray[Any]:
    """Samples as complex numbers; the numbers as they are where there are not whole samples."""
    values = np.asarray(data)
    if numbers and values.nbytes % np.dtype(numbers).itemsize == 0:
        values = np.frombuffer(data, numbers)
    if values.dtype.kind == "u" or values.size % 2:
        return values
    real, imaginary = values.astype(np.float32).reshape(-1, 2).T
    return (real + 1j * imaginary).astype(np.complex64)


class WorstValue(NamedTuple):
    """A value and the golden one: the dwell (or number) of their message, and their position in the field."""

    dwell: int
    position: int
    golden: str
    made: str


@dataclass
class FieldDifference:
    """Differences of the values of a field from the golden ones.

    Attributes:
        values: number of values compared.
        different: number of values that are not the same; NaN is the same as NaN.
        outside: number of values beyond the tolerance.
        nan_changes: number of values that are NaN on one side only.
        unmatched: number of values without a counterpart, since a field has another number of values.
        greatest: greatest difference of two finite numbers; NaN if none were compared.
        worst: value that is farthest beyond its tolerance, or nearest to it.
    """

    values: int = 0
    different: int = 0
    outside: int = 0
    nan_changes: int = 0
    unmatched: int = 0
    greatest: float = float("nan")
    worst: WorstValue | None = None
    _farthest: float = -np.inf
    _squares: float = 0.0
    _classes: I64 = field(default_factory=lambda: np.zeros(len(EDGES), np.int64))

    @property
    def rms(self) -> float:
        """Root mean square of the differences of finite numbers; NaN if there are none."""
        count = self._classes.sum()
        return float(np.sqrt(self._squares / count)) if count else float("nan")

    def quantile(self, share: float) -> float:
        """Difference that a fraction `share` of the values does not exceed, up to 12 % too great; NaN if empty."""
        counts = np.cumsum(self._classes)
        if not counts[-1]:
            return float("nan")
        limit = EDGES[int(np.searchsorted(counts, share * counts[-1]))]
        return float(min(limit, self.greatest))

    def add(self, golden: NDArray[Any], made: NDArray[Any], allowed: F64, dwell: int) -> int:
        """Add the values of a message.

        Args:
            golden: expected values, shape (n,).
            made: values to judge, shape (m,).
            allowed: greatest differences that are within the tolerance, shape (n,).
            dwell: dwell of the message, or its number.

        Returns:
            The number of values beyond the tolerance.
        """
        self.values += max(golden.size, made.size)
        if golden.size != made.size or (golden.dtype.kind == "U") != (made.dtype.kind == "U"):
            return self._add_unmatched(golden, made, dwell)
        same = np.asarray(golden == made)
        if golden.dtype.kind == "U":
            excess = np.where(same, -np.inf, np.inf)
        else:
            nan = np.isnan(golden), np.isnan(made)
            self.nan_changes += int(np.count_nonzero(nan[0] != nan[1]))
            same |= nan[0] & nan[1]
            excess = np.where(same, -allowed, self._measure(golden, made) - allowed)
            excess[np.isnan(excess)] = np.inf
            excess[nan[0] & nan[1]] = -np.inf
        outside = int(np.count_nonzero(~same & ~(excess <= 0)))
        self.different += int(np.count_nonzero(~same))
        self.outside += outside
        if not same.all():
            changed = np.where(same, -np.inf, excess)
            self._note(float(changed.max()), int(changed.argmax()), golden, made, dwell)
        return outside

    def as_json(self) -> dict[str, Any]:
        """Entry of a report."""
        return {
            "values": self.values,
            "different": self.different,
            "outside": self.outside,
            "nan_changes": self.nan_changes,
            "unmatched": self.unmatched,
            "greatest": or_null(self.greatest),
            "rms": or_null(self.rms),
            **{f"p{round(100 * share)}": or_null(self.quantile(share)) for share in (0.5, 0.95, 0.99)},
            "worst": self.worst and self.worst._asdict(),
        }

    def _add_unmatched(self, golden: NDArray[Any], made: NDArray[Any], dwell: int) -> int:
        count = max(golden.size, made.size)
        self.unmatched += count
        self.different += count
        self.outside += count
        self._note(np.inf, 0, np.array([f"{golden.size} values"]), np.array([f"{made.size} values"]), dwell)
        return count

    def _measure(self, golden: NDArray[Any], made: NDArray[Any]) -> F64:
        """Differences of numbers, entered where both are finite; NaN or infinite where one is not."""
        if golden.dtype.kind in "iub" and made.dtype.kind in "iub":  # beyond 2**53 float64 would lose digits
            difference = np.abs(golden.astype(np.int64) - made.astype(np.int64)).astype(np.float64)
        else:
            wide = np.complex128 if "c" in (golden.dtype.kind, made.dtype.kind) else np.float64
            with np.errstate(invalid="ignore"):
                difference = np.abs(golden.astype(wide) - made.astype(wide))
        finite = difference[np.isfinite(difference)]
        if finite.size:
            self.greatest = float(np.fmax(self.greatest, finite.max()))
            self._squares += float(np.sum(finite**2))
            self._classes += np.bincount(np.searchsorted(EDGES, finite), minlength=len(EDGES))
        return difference

    def _note(self, excess: float, index: int, golden: NDArray[Any], made: NDArray[Any], dwell: int) -> None:
        if excess > self._farthest:
            self._farthest = excess
            self.worst = WorstValue(dwell, index, str(golden[index]), str(made[index]))


class Key(NamedTuple):
    """Key by which a message of one bag is the counterpart of one in the other.

    Attributes:
        topic: name of the topic.
        dwell: number of its dwell; without one, number of earlier messages on the topic.
        channel: number of its channel; 0 without one.
        stamp_ns: its stamp, ns; 0 where messages are matched by numbers alone.
        repetition: number of earlier messages with the same key: a simulator may have been restarted.
    """

    topic: str
    dwell: int
    channel: int = 0
    stamp_ns: int = 0
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
    *,
    by_stamp: bool = False,
) -> dict[str, TopicComparison]:
    """Match the messages of two bags by topic and dwell, and compare their fields.

    Provenance, the order of processing, doubts and tests of the data are not compared.

    Args:
        golden: bag with the expected messages.
        other: bag to judge.
        tolerances: greatest allowed differences from the golden values.
        topics: topics to compare; None: all with height images.
        counts: predicate of golden messages that count; None: all do.
        counts_too: predicate of messages of the other bag that count; None: all do.
        by_stamp: True if messages of dwells are matched by their stamps, too: dwells of a sensor that counts again from
            0 have the same numbers. False: the bags may be of flights at different times.

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
    sides = (_messages(bag, read, one, by_stamp) for bag, one in zip(bags, (counts, counts_too), strict=True))
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
    bag: BagReader, topics: Collection[str], counts: Callable[[Any], bool] | None, by_stamp: bool
) -> Iterator[tuple[Key, Any]]:
    seen: Counter[Key] = Counter()
    for recorded in bag.messages(topics) if topics else ():
        message = bag.decode(recorded.type_name, recorded.cdr)
        if counts and not counts(message):
            continue
        numbered = hasattr(message, "dwell")
        key = Key(recorded.topic, 0)
        if numbered:
            stamp_ns = to_ns(message.header.stamp) if by_stamp else 0
            key = Key(recorded.topic, message.dwell, getattr(message, "channel", 0), stamp_ns)
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


def _confusion(golden: NDArray[Any], made: NDArray[Any]) -> Counter[tuple[str, str]]:
    """Number of pixels by pair of validities; empty if the images have different numbers of pixels."""
    if golden.size != made.size:
        return Counter()
    pairs, counts = np.unique(np.stack([golden, made]), axis=1, return_counts=True)
    return Counter({(_name(one), _name(other)): int(n) for (one, other), n in zip(pairs.T, counts, strict=True)})


def _name(code: int) -> str:
    """Name of a validity; its number where it has none."""
    return Validity(code).name if code in list(Validity) else str(code)
