"""Messages of a bag with the content that playing needs, and the choice of dwells."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from sal_height import messages
from sal_height.bag.topics import FRAME_TYPE, HEIGHT_TYPE, IMAGE_TYPE, ODOMETRY_TYPE, BagMessage
from sal_height.engine.frame_items import Frame
from sal_height.engine.results import DwellKey
from sal_height.messages.types import Provenance

MARGIN_NS = 1_000_000_000
"""Odometry and the air are played from this time before the first pulse of a chosen dwell to that after its last,
in addition to the last sample before and the first one after, ns."""

MOST, LATEST_NS = 2**32 - 1, 2**63 - 1
"""Greatest number of a dwell, and latest stamp, ns."""


LOCKSTEP, PACED, BURST = CLOCKS = "lockstep", "paced", "burst"
"""Times at which a bag is played: dwell by dwell on request, at the times of its stamps, or all at once."""


class DwellPart(NamedTuple):
    """The dwell of a message.

    Attributes:
        dwell: key of the dwell.
        end_ns: stamp of the dwell's last pulse, as far as the message states it, ns.
        provenance: provenance of the message, which must not be changed; None: the sensor delivered it.
    """

    dwell: DwellKey
    end_ns: int
    provenance: Provenance | None = None


def part_of(recorded: BagMessage) -> DwellPart | None:
    """The dwell of a frame, image or height image; None: the message is another one.

    Raises:
        RuntimeError: the message is broken.
    """
    if recorded.type_name == FRAME_TYPE:
        return part_of_frame(messages.received_frame(recorded.cdr))
    if recorded.type_name in {IMAGE_TYPE, HEIGHT_TYPE}:
        product = messages.deserialize(recorded.cdr, recorded.type_name, shared=True)
        stamp_ns = messages.to_ns(product.header.stamp)
        dwell = DwellKey(product.provenance.config_hash, product.dwell, stamp_ns)
        return DwellPart(dwell, stamp_ns, product.provenance)
    return None


def part_of_frame(frame: Frame) -> DwellPart:
    """The dwell of a frame."""
    times = frame.pulse_time
    duration_s = float(times.max(where=(times > 0) & (times <= messages.LONGEST_DWELL), initial=0.0))
    return DwellPart(frame.key, frame.key.stamp_ns + round(duration_s * 1e9))


class Content(NamedTuple):
    """Content of a message, as far as a player needs it.

    Attributes:
        part: dwell of the message; None: it belongs to no dwell.
        odometry_ns: stamp of odometry, ns; None: another message.
        air_ns: stamp of a message on the air, ns; None: another message.
        fault: reason why it cannot be decoded; empty: it can.
    """

    part: DwellPart | None = None
    odometry_ns: int | None = None
    air_ns: int | None = None
    fault: str = ""

    @property
    def sample_ns(self) -> int | None:
        """Stamp of odometry or air, ns; None: another message."""
        return self.odometry_ns if self.air_ns is None else self.air_ns

    @property
    def delivered_ns(self) -> int | None:
        """Time at which the sensor delivered it, by its stamp, ns; None: not stated."""
        return self.part.end_ns if self.part else self.odometry_ns


class Played(NamedTuple):
    """A message that is played, and its content, which is read once."""

    recorded: BagMessage
    content: Content


def read_contents(recorded: Iterator[BagMessage]) -> Iterator[Played]:
    """Messages with their content; broken ones are among them."""
    return (Played(one, _content_of(one)) for one in recorded)


def _content_of(recorded: BagMessage) -> Content:
    try:
        if recorded.type_name == ODOMETRY_TYPE:
            return Content(odometry_ns=_stamp_ns(recorded))
        if recorded.type_name in messages.AIR_TYPES:
            return Content(air_ns=_stamp_ns(recorded))
        return Content(part_of(recorded))
    except Exception as error:  # noqa: BLE001 (broken bytes may raise anything)
        return Content(fault=str(error))


def _stamp_ns(recorded: BagMessage) -> int:
    return messages.to_ns(messages.deserialize(recorded.cdr, recorded.type_name).header.stamp)


@dataclass(frozen=True)
class DwellRange:
    """The dwells that are chosen of a bag, by number and by time.

    Attributes:
        first: number of the first one.
        last: number of the last one.
        start_ns: earliest stamp, ns.
        end_ns: latest stamp, ns.
    """

    first: int = 0
    last: int = MOST
    start_ns: int = 0
    end_ns: int = LATEST_NS

    def __contains__(self, dwell: DwellKey) -> bool:
        """True if a dwell is chosen."""
        return self.first <= dwell.number <= self.last and self.start_ns <= dwell.stamp_ns <= self.end_ns


ALL = DwellRange()


def chosen(items: Iterator[Played], dwells: DwellRange) -> Iterator[Played]:
    """The messages of chosen dwells, and odometry and air around them; descriptions of the sensor are never left out.

    Broken messages are passed on.
    """
    if dwells == ALL:
        yield from items
        return
    kept: dict[str, deque[tuple[int, Played]]] = {}
    covered_ns: dict[str, int] = {}
    needed_ns, passed_ns = -math.inf, -math.inf
    for one in items:
        part, stamp_ns, topic = one.content.part, one.content.sample_ns, one.recorded.topic
        if stamp_ns is not None:
            if covered_ns.get(topic, -math.inf) < needed_ns or stamp_ns <= needed_ns + MARGIN_NS:
                covered_ns[topic] = stamp_ns
                yield one
            else:
                samples = kept.setdefault(topic, deque())
                samples.append((stamp_ns, one))
                _forget(samples, passed_ns)
        elif part is None:
            yield one
        elif part.dwell in dwells:
            needed_ns = max(needed_ns, part.end_ns)
            for name, samples in kept.items():
                _forget(samples, part.dwell.stamp_ns)
                while samples:
                    covered_ns[name], sample = samples.popleft()
                    yield sample
            yield one
        else:
            passed_ns = part.dwell.stamp_ns


def _forget(samples: deque[tuple[int, Played]], time_ns: float) -> None:
    """Drop samples of more than the margin before a time, but for the last sample before it."""
    while len(samples) > 1 and samples[1][0] < time_ns - MARGIN_NS:
        samples.popleft()
