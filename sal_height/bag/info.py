"""Contents of a bag by its indexes: no message is read but the first description of each sensor."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.described import sensors_in
from sal_height.bag.files import FileIndex, bag_files, read_log_times
from sal_height.bag.reader import BagReader, Topic
from sal_height.errors import UserError
from sal_height.numeric import I64
from sal_height.tables import ABSENT, aligned


@dataclass(frozen=True)
class TopicInfo:
    """A topic of a bag.

    Attributes:
        name: name of the topic.
        type_name: type of its messages as recorded.
        count: number of its messages.
        rate_hz: mean rate at which they were received; None for less than two messages, or if times are not known.
        longest_gap_s: longest time between two that follow each other; None as above.
    """

    name: str
    type_name: str
    count: int
    rate_hz: float | None
    longest_gap_s: float | None


@dataclass(frozen=True)
class FileInfo:
    """A file of a bag: name, bytes, and how its chunks are compressed: none, lz4, zstd, or several of these."""

    name: str
    size: int
    compression: str


@dataclass(frozen=True)
class FramesInfo:
    """Frames of a topic against the channels of its dwells, by their number.

    Attributes:
        topic: topic of the frames.
        frames: number of frames.
        detectors: number of detectors in the first description of the sensor; None if no description can be read.
    """

    topic: str
    frames: int
    detectors: int | None

    @property
    def lacking(self) -> int | None:
        """Least number of frames missing from whole dwells; None if the number of detectors is not known."""
        return -self.frames % self.detectors if self.detectors else None

    @property
    def dwells(self) -> int | None:
        """Least number of dwells of the frames; None if the number of detectors is not known."""
        return -(-self.frames // self.detectors) if self.detectors else None


@dataclass(frozen=True)
class BagInfo:
    """Contents of a bag.

    Attributes:
        path: path of the bag.
        begin_ns: time at which the first message was received, ns; None without messages.
        end_ns: reception of the last message, ns.
        files: files of the bag, oldest first.
        topics: topics by name.
        frames: frames of each sensor.
    """

    path: Path
    begin_ns: int | None
    end_ns: int | None
    files: Sequence[FileInfo]
    topics: Sequence[TopicInfo]
    frames: Sequence[FramesInfo]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    @property
    def count(self) -> int:
        """Messages of all topics."""
        return sum(topic.count for topic in self.topics)

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last, s; 0 without messages."""
        return 0.0 if self.begin_ns is None or self.end_ns is None else (self.end_ns - self.begin_ns) * 1e-9


def bag_info(path: Path) -> BagInfo:
    """Contents of the bag at `path`, from the indexes of its files and the first description of each sensor.

    Raises:
        UserError: it is not a complete bag.
    """
    bag_files(path)  # refuses a bag that is not stored as MCAP and has no such index
    reader = BagReader(path)
    times = _log_times(reader)
    statistics = [index.statistics for index in reader.indexes if index.statistics.message_count]
    return BagInfo(
        path,
        min((one.message_start_time for one in statistics), default=None),
        max((one.message_end_time for one in statistics), default=None),
        [_file_info(index) for index in reader.indexes],
        [_topic_info(topic, times.get(name)) for name, topic in sorted(reader.topics.items())],
        [
            FramesInfo(sensor.frames, reader.topics[sensor.frames].count, _detectors(reader, sensor.sensor_info))
            for sensor in sensors_in(reader.topics)
            if sensor.frames in reader.topics
        ],
    )


def info_text(info: BagInfo) -> str:
    """Contents of a bag as lines of text: the bag, a table of its topics, and a text on each sensor's dwells."""
    compressions = sorted({file.compression for file in info.files})
    head = [
        ["bag", str(info.path)],
        ["size", f"{info.size / 1e6:.1f} MB in {len(info.files)} {'file' if len(info.files) == 1 else 'files'}"],
        ["compression", ", ".join(compressions)],
        ["begin", ABSENT if info.begin_ns is None else f"{info.begin_ns // 10**9}.{info.begin_ns % 10**9:09d} s"],
        ["duration", f"{info.duration_s:.3f} s"],
        ["messages", str(info.count)],
    ]
    rows = [
        [topic.name, str(topic.count), _number(topic.rate_hz), _number(topic.longest_gap_s), topic.type_name]
        for topic in info.topics
    ]
    table = aligned([["topic", "messages", "rate Hz", "longest gap s", "type"], *rows])
    lines = [f"{name:<12} {text}" for name, text in head]
    return "\n".join([*lines, "", table, *(["", *map(_dwells_sentence, info.frames)] if info.frames else [])])


def info_values(info: BagInfo) -> dict[str, Any]:
    """Contents of a bag as values that JSON has."""
    frames = [{**asdict(one), "dwells": one.dwells, "lacking": one.lacking} for one in info.frames]
    totals = {"size": info.size, "count": info.count, "duration_s": info.duration_s}
    return {**asdict(info), "path": str(info.path), **totals, "frames": frames}


def _dwells_sentence(frames: FramesInfo) -> str:
    if frames.detectors is None:
        return f"{frames.topic}: {frames.frames} frames of a sensor that no message describes."
    whole = f"{frames.topic}: {frames.frames} frames of {frames.detectors} detectors"
    if frames.lacking:
        return f"{whole}, {frames.dwells} dwells or more; {frames.lacking} frames are lacking of whole dwells."
    return f"{whole}, as many as {frames.dwells} whole dwells have."


def _log_times(reader: BagReader) -> Mapping[str, I64]:
    """Reception of messages, ns, in order, by topic; empty if a file does not state it.

    Those at the head of a file that are in the one before, too, are left out.
    """
    parts: dict[str, list[I64]] = defaultdict(list)
    for index, repeated in zip(reader.indexes, reader.repeated, strict=True):
        times = read_log_times(index)
        if times is None:
            return {}
        for topic, one in times.items():
            parts[topic].append(one[repeated.get(topic, 0) :])
    return {topic: np.sort(np.concatenate(found)) for topic, found in parts.items()}


def _topic_info(topic: Topic, times: I64 | None) -> TopicInfo:
    rate = gap = None
    if times is not None and len(times) > 1:
        span_s = float(times[-1] - times[0]) * 1e-9
        rate = (len(times) - 1) / span_s if span_s else None
        gap = float(np.diff(times).max()) * 1e-9
    return TopicInfo(topic.name, topic.recorded_type, topic.count, rate, gap)


def _file_info(index: FileIndex) -> FileInfo:
    compressions = sorted({chunk.compression or "none" for chunk in index.summary.chunk_indexes})
    return FileInfo(index.path.name, index.size, ", ".join(compressions) or "none")


def _detectors(reader: BagReader, topic: str) -> int | None:
    """Number of detectors in the first description of a sensor; None if no description can be read."""
    try:
        first = next(reader.messages([topic]), None)
        described = reader.decode(first.type_name, first.cdr) if first and topic in reader.topics else None
    except UserError:
        return None
    return len(described.beams.elevation_boresights) or None if described else None


def _number(value: float | None) -> str:
    return ABSENT if value is None else f"{value:.4g}"
