"""Findings of a check, and the check of one sensor: descriptions, whole dwells, and odometry around their pulses."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from sal_height import messages
from sal_height.bag.copies import kept_custom_data
from sal_height.bag.described import DwellFault, DwellFrames, DwellList, SensorTopics, faults_of
from sal_height.bag.files import PARAMETERS
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.topics import ODOMETRY_TYPE
from sal_height.engine.frame_items import check_frame
from sal_height.errors import Rejected, UserError
from sal_height.geometry import REORDERED_NS
from sal_height.numeric import I64
from sal_height.renamed import with_new_names
from sal_height.sensor import Sensor
from sal_height.tables import counted

GAPLESS_NS = 50_000_000
"""Longest interval of odometry that nodes do not treat as a gap, ns (odometry_interval_s)."""

RECORD_ALL = "Record it, too; the chain cannot work without."


@dataclass(frozen=True)
class Finding:
    """A fault of a bag.

    Attributes:
        severity: error (messages are lost to readers, or cannot be processed) or warning (less than that).
        sentence: description of the fault, and its position.
        fix: remedy of the fault.
    """

    severity: Literal["error", "warning"]
    sentence: str
    fix: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.sentence} {self.fix}"


def error(sentence: str, fix: str) -> Finding:
    """A finding because of which messages are lost, or cannot be processed."""
    return Finding("error", sentence, fix)


def warning(sentence: str, fix: str) -> Finding:
    """A finding that is less severe than lost messages."""
    return Finding("warning", sentence, fix)


def of_refusal(refusal: UserError, fix: str) -> Finding:
    """An error that readers refuse the bag for, with another fix than they name after the last semicolon."""
    sentence, found, _ = str(refusal).rpartition("; ")
    return error(f"{sentence}." if found else str(refusal), fix)


def recovery(path: Path) -> str:
    """The fix of damage."""
    return f"Recover what is whole with 'sal-height bag recover {path} --out DIR'."


def some(cases: Sequence[object]) -> str:
    """The first few of several cases."""
    most = 3  # are named
    named = "; ".join(map(str, cases[:most]))
    return f"{named}; and {len(cases) - most} more" if len(cases) > most else named


class SensorCheck:
    """Looks at the messages of a sensor, in any order."""

    def __init__(self, reader: BagReader, topics: SensorTopics) -> None:
        """Check the sensor with these topics, and read its descriptions."""
        self.topics = topics
        self._reader = reader
        self._dwells = DwellList()
        self._poses: list[tuple[int, int]] = []
        """Log time and stamp of the odometry, ns."""
        self._first_info_ns: int | None = None
        self._sensors: dict[str, Sensor] = {}
        self._faults: dict[tuple[str, str], str] = {}
        """Faults of messages: the first text by topic and reason."""
        self._faulty: Counter[tuple[str, str]] = Counter()
        self._read_descriptions()

    def add(self, message: BagMessage) -> None:
        """Look at a message of one of the sensor's topics."""
        try:
            if message.topic == self.topics.frames:
                self._add_frame(message)
            elif message.topic == self.topics.odometry:
                stamp = messages.deserialize(message.cdr, ODOMETRY_TYPE).header.stamp
                self._poses.append((message.log_time_ns, messages.to_ns(stamp)))
        except Rejected as fault:
            self._note(message.topic, fault.reason, str(fault))
        except (UserError, RuntimeError) as fault:
            self._note(message.topic, "cannot be decoded", f"{str(fault).rstrip('.')}.")

    def findings(self) -> Iterator[Finding]:
        """The faults, once all messages have been read."""
        absent = [name for name in self.topics.names if not self._count(name)]
        if self.topics.frames in absent and self._count(self.topics.images):
            absent = [name for name in absent if name == self.topics.sensor_info]
            yield warning(
                f"Bag {self._reader.path} has images on {self.topics.images} and no messages on {self.topics.frames}.",
                "Replay it with --from slc; record the frames, too, if it should be focused again.",
            )
        for name in absent:
            yield error(f"Bag {self._reader.path} has no messages on {name}.", RECORD_ALL)
        for (topic, reason), count in self._faulty.items():
            yield error(
                f"Nodes refuse {counted(count, 'message')} on {topic} ({reason}), the first: "
                f"{self._faults[topic, reason]}",
                "The program that publishes them must be put right.",
            )
        yield from self._check_air()
        yield from self._check_dwells()
        if self.topics.odometry not in absent:
            yield from self._check_odometry()

    def _check_air(self) -> Iterator[Finding]:
        """Check that the bag has the air messages that the compression needs."""
        if not _uses_air_topics(self._reader):
            return
        needed = {topic for sensor in self._sensors.values() for topic in messages.needed_air(sensor.wavelength)}
        names = [self.topics.namespace + topic for topic in messages.AIR if topic in needed]
        if absent := [name for name in names if not self._count(name)]:
            yield error(
                f"Bag {self._reader.path} has no messages on {', '.join(absent)}, which sar_compression is to take the "
                "air from (its parameter air is topics).",
                "Record them, too, or replay it with --param sar_compression.air=standard.",
            )

    def _count(self, topic: str) -> int:
        """Messages on a topic of the bag."""
        return self._reader.topics[topic].count if topic in self._reader.topics else 0

    def _read_descriptions(self) -> None:
        name = self.topics.sensor_info
        if name not in self._reader.topics:
            return
        try:
            for message in self._reader.messages([name]):
                if self._first_info_ns is None:
                    self._first_info_ns = message.log_time_ns
                self._add_description(message)
        except UserError as fault:  # of a damaged chunk, which is found again
            self._note(name, "cannot be read", str(fault))

    def _add_description(self, message: BagMessage) -> None:
        try:
            sensor = messages.sensor_from_message(self._reader.decode(message.type_name, message.cdr))
        except UserError as fault:
            self._note(message.topic, "sensor info", str(fault))
            return
        known = self._sensors.setdefault(sensor.config_hash, sensor)
        if known.digest != sensor.digest:
            self._note(
                message.topic,
                "contradiction",
                f"two descriptions of config_hash {sensor.config_hash!r} differ, of which the first stays in force.",
            )

    def _add_frame(self, message: BagMessage) -> None:
        frame = self._dwells.add(message.cdr, message.log_time_ns)
        if sensor := self._sensors.get(frame.key.sensor):
            check_frame(frame, sensor)

    def _note(self, topic: str, reason: str, sentence: str) -> None:
        self._faults.setdefault((topic, reason), sentence)
        self._faulty[topic, reason] += 1

    def _check_dwells(self) -> Iterator[Finding]:
        dwells, frames = sorted(self._dwells, key=lambda dwell: dwell.first_log_ns), self.topics.frames
        if not dwells:
            return
        if self._first_info_ns is not None and dwells[0].first_log_ns < self._first_info_ns:
            early = sum(dwell.first_log_ns < self._first_info_ns for dwell in dwells)
            yield warning(
                f"Frames of {early} dwells on {frames} come before the first message on {self.topics.sensor_info}, by "
                f"{(self._first_info_ns - dwells[0].first_log_ns) * 1e-9:.3f} s.",
                "Have the sensor publish its description first, latched (transient local); nodes do not wait for long.",
            )
        yield from self._check_channels(dwells)
        back = [b for a, b in pairwise(dwells) if b.stamp_ns < a.stamp_ns]
        if back:
            yield warning(
                f"Stamps on {frames} run back, at {some([_name(dwell) for dwell in back])}.",
                "Have the sensor stamp its frames by one steady clock.",
            )

    def _check_channels(self, dwells: list[DwellFrames]) -> Iterator[Finding]:
        frames, fix = self.topics.frames, "A replay refuses them; 'sal-height bag cut --dwells' leaves them out."
        faults = faults_of(dwells, {name: sensor.detector_count for name, sensor in self._sensors.items()})
        unknown = [fault for fault in faults if not fault.described]
        lacking = [fault for fault in faults if fault.absent]
        doubled = [fault for fault in faults if fault.doubled]
        if unknown:
            yield error(f"On {frames}, {_share(unknown, dwells)} cannot be used: {some(unknown)}.", RECORD_ALL)
        if lacking:
            yield warning(f"On {frames}, {_share(lacking, dwells)} lack channels: {some(lacking)}.", fix)
        if doubled:
            yield warning(
                f"On {frames}, {_share(doubled, dwells)} have channels twice: {some(doubled)}.",
                "Nodes take the first and drop the others; see that the sensor is recorded once.",
            )

    def _check_odometry(self) -> Iterator[Finding]:
        name = self.topics.odometry
        if not self._poses:
            return
        in_order = np.array([stamp for _, stamp in sorted(self._poses)], dtype=np.int64)
        stamps = np.unique(in_order)
        step_ns = int((in_order - np.maximum.accumulate(in_order)).min())
        if step_ns < -REORDERED_NS:
            yield warning(
                f"Stamps on {name} run back by up to {-step_ns * 1e-9:.3f} s.",
                f"Stamp odometry by one steady clock; nodes put up with {REORDERED_NS * 1e-9:g} s.",
            )
        bare = [dwell for dwell in self._dwells if not _is_covered(dwell, stamps)]
        if bare:
            yield warning(
                f"Messages on {name} do not reach from the first pulse to the last of {len(bare)} of "
                f"{len(self._dwells)} dwells: {some([_name(dwell) for dwell in bare])}.",
                "They cannot be focused; record odometry from before the first dwell to after the last.",
            )
        longest_ns = max((dwell.last_pulse_ns - dwell.stamp_ns for dwell in self._dwells), default=0)
        # Between passes, where no dwell is, odometry may pause.
        in_dwells = np.zeros(len(stamps) - 1, np.bool_)
        for dwell in self._dwells:
            in_dwells[slice(*_around(dwell, stamps))] |= _is_covered(dwell, stamps)
        gaps = np.diff(stamps)[in_dwells]
        long = gaps > max(longest_ns, GAPLESS_NS)
        if long.any():
            yield warning(
                f"Messages on {name} have {np.count_nonzero(long)} gaps in dwells that are longer than a dwell "
                f"({longest_ns * 1e-9:.3g} s) and {GAPLESS_NS * 1e-9:g} s, the longest of {gaps.max() * 1e-9:.3g} s.",
                "Publish odometry more often; in long gaps sigma grows, or dwells are refused (max_odometry_gap_s).",
            )


def _uses_air_topics(reader: BagReader) -> bool:
    """True if the compression used the air of messages, by the parameters with which a bag was made."""
    try:
        values = json.loads(kept_custom_data(reader).get(PARAMETERS, "{}"))
        return bool(with_new_names(values["sar_compression"])["air"] == messages.AIR_OF_TOPICS)
    except (ValueError, TypeError, LookupError, AttributeError):  # they are absent, or a replay refuses them
        return False


def _is_covered(dwell: DwellFrames, stamps: I64) -> bool:
    """True if a sample lies before the first pulse of a dwell or at it, and one after the last or at it."""
    first, last = _around(dwell, stamps)
    return 0 <= first < last < len(stamps)


def _around(dwell: DwellFrames, stamps: I64) -> tuple[int, int]:
    """Numbers of the last sample that is not after the first pulse of a dwell, and of the first not before its last."""
    first = int(np.searchsorted(stamps, dwell.stamp_ns, "right")) - 1
    return first, int(np.searchsorted(stamps, dwell.last_pulse_ns, "left"))


def _name(dwell: DwellFrames) -> str:
    return f"dwell {dwell.number} at {dwell.stamp_ns * 1e-9:.3f} s"


def _share(faults: list[DwellFault], dwells: list[DwellFrames]) -> str:
    return f"{len(faults)} of {len(dwells)} dwells"
