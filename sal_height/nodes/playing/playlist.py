"""What a recorded sensor delivers, in memory, in the order and at the times at which it did."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple, Self

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.sensor_topics import FRAMES
from sal_height.bag.stamps import STAMP, STAMP_AT, stamp_ns_of
from sal_height.errors import UserError
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.topics import ODOMETRY, SENSOR_INFO


class Item(NamedTuple):
    """A serialized message, and when the sensor delivered it, ns of its stamps."""

    due_ns: int
    topic: str
    cdr: bytes


class Playlist(NamedTuple):
    """Odometry, air and frames of whole dwells, in the order of their delivery, and the description of their sensor.

    Odometry and air are delivered at their stamps, a frame after its last pulse; what was known of the air before comes
    at the begin, with a stamp from which on it is used for the first dwell. The list can be played again and again: its
    stamps then go on by `period_ns`.

    Attributes:
        sensor_info: the last description, serialized.
        items: what is played.
        period_ns: time from the begin of the list to the begin of its repetition.
        dwells: number of dwells.
        odometry: the messages of the odometry.
    """

    sensor_info: bytes
    items: list[Item]
    period_ns: int
    dwells: int
    odometry: list[Odometry]

    @classmethod
    def of_bag(cls, reader: BagReader, most_bytes: float) -> Self:
        """Read a bag.

        Args:
            reader: of the bag.
            most_bytes: that its messages may take.

        Raises:
            UserError: it has no complete dwell, or its messages take more.
        """
        info, described, size = b"", SensorInfo(), 0
        odometry: dict[int, tuple[bytes, Odometry]] = {}
        air: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in messages.AIR}
        dwells: dict[int, list[tuple[bytes, ChannelFrame]]] = {}
        topics = [name for name in reader.topics if name.lstrip("/") in {SENSOR_INFO, ODOMETRY, FRAMES, *air}]
        for recorded in reader.messages(topics):
            message = reader.decode(recorded.type_name, recorded.cdr)
            size += len(recorded.cdr)
            if size > most_bytes:
                raise UserError(
                    f"Bag {reader.path} contains more than {most_bytes / 1e6:.0f} MB of dwells (max_memory_mb), "
                    f"which are "
                    "played from memory; allow more, or record a shorter bag."
                )
            if isinstance(message, SensorInfo):
                info, described = recorded.cdr, message
            elif isinstance(message, Odometry):
                odometry[messages.to_ns(message.header.stamp)] = recorded.cdr, message
            elif (topic := recorded.topic.lstrip("/")) in air:
                air[topic].append((messages.to_ns(message.header.stamp), recorded.cdr))
            else:
                dwells.setdefault(messages.to_ns(message.header.stamp), []).append((recorded.cdr, message))
        channels = messages.sensor_from_message(described).detector_count if info else 0
        whole = {stamp: frames for stamp, frames in sorted(dwells.items()) if len(frames) == channels}
        around = _odometry_around(sorted(odometry), whole.keys(), {s: _last_pulse(f[0][1]) for s, f in whole.items()})
        if not whole or not around:
            raise UserError(
                f"Bag {reader.path} has no dwell with frames of all channels and odometry around its pulses."
            )
        items = [Item(stamp, ODOMETRY, odometry[stamp][0]) for stamp in around]
        items += [Item(_last_pulse(m), FRAMES, cdr) for frames in whole.values() for cdr, m in frames]
        for topic, samples in air.items():
            items += _air_during(topic, samples, min(whole), around[0], around[-1])
        return cls(
            info,
            sorted(items, key=lambda item: item.due_ns),
            _period(list(whole), around),
            len(whole),
            [odometry[stamp][1] for stamp in around],
        )

    @property
    def size(self) -> int:
        """Bytes of all messages."""
        return sum(len(item.cdr) for item in self.items)

    def frames(self) -> Iterator[list[ChannelFrame]]:
        """The frames of each dwell, in the order of channels."""
        dwells: dict[int, list[bytes]] = {}
        for item in self.items:
            if item.topic == FRAMES:
                dwells.setdefault(stamp_ns_of(item.cdr), []).append(item.cdr)
        for serialized in dwells.values():
            decoded = [messages.deserialize(cdr, ChannelFrame) for cdr in serialized]
            yield sorted(decoded, key=lambda frame: frame.channel)

    @property
    def dwell_rate_hz(self) -> float:
        """Dwells that the sensor delivers in a second."""
        return self.dwells * 1e9 / self.period_ns


def restamped(cdr: bytes, shift_ns: int) -> bytes:
    """A serialized message whose first field is a header, with a later stamp (ns); the rest byte for byte."""
    stamp = STAMP.pack(*divmod(stamp_ns_of(cdr) + shift_ns, 1_000_000_000))
    whole = memoryview(cdr)
    return b"".join((whole[:STAMP_AT], stamp, whole[STAMP_AT + STAMP.size :]))


def _last_pulse(frame: ChannelFrame) -> int:
    return messages.to_ns(frame.header.stamp) + round(frame.pulse_time[-1] * 1e9)


def _odometry_around(stamps: list[int], dwells: Iterable[int], ends: dict[int, int]) -> list[int]:
    """The stamps from the last before the first pulse to the first after the last, where there are such."""
    known, starts = np.array(stamps, dtype=np.int64), list(dwells)
    if not starts:
        return []
    first = int(np.searchsorted(known, min(starts), "right")) - 1
    last = int(np.searchsorted(known, max(ends.values()), "left"))
    return stamps[first : last + 1] if 0 <= first < last < len(stamps) else []


def _air_during(topic: str, samples: list[tuple[int, bytes]], dwell_ns: int, begin_ns: int, end_ns: int) -> list[Item]:
    """What comes on a topic of the air from the begin to the end, first what the first dwell needs.

    Args:
        topic: its name.
        samples: stamp and bytes of its messages.
        dwell_ns: stamp of the first dwell.
        begin_ns: when the first odometry comes.
        end_ns: when the last odometry comes.
    """
    if not samples:
        return []
    in_use_ns = dwell_ns - messages.AIR_LATENCY_NS
    stamp_ns, cdr = max((one for one in samples if one[0] <= in_use_ns), default=min(samples))
    later = [Item(max(begin_ns, stamp), topic, cdr) for stamp, cdr in samples if in_use_ns < stamp <= end_ns]
    return [Item(begin_ns, topic, restamped(cdr, in_use_ns - stamp_ns)), *later]


def _period(dwells: list[int], odometry: list[int]) -> int:
    """Time after which the list may begin anew: a dwell after the last one, and after all odometry.

    That is the longest time between dwells of the bag, as the platform turns between its passes.
    """
    interval = max(np.diff(dwells).tolist(), default=0)
    return max(dwells[-1] - dwells[0] + interval, odometry[-1] - odometry[0] + 1)
