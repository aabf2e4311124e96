"""The messages of a bag in the order in which they are played, and the group of dwells that is played at once."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import Any

from nav_msgs.msg import Odometry
from sal_height_msgs.msg import ChannelFrame, ComplexImage, HeightImage

from sal_height import messages
from sal_height.bag.reader import BagMessage
from sal_height.errors import UserError
from sal_height.nodes.cues import DwellKey

OF_DWELLS = ChannelFrame, ComplexImage, HeightImage
"""Messages that dwells are made of; a bag is played from one kind of them on."""

LONGEST_GROUP = 4
"""A group of dwells ends after the frames of this many dwells, even if some dwells lack a frame."""


class Reel:
    """Messages one after the other; those that are put back come again.

    Attributes:
        next: the message that is the next one; None: there is no more.
    """

    def __init__(self, recorded: Iterator[BagMessage]) -> None:
        """Begin with the first message.

        Raises:
            UserError: the bag is damaged there.
        """
        self._recorded = recorded
        self._put_back: deque[BagMessage] = deque()
        self.next: BagMessage | None = next(recorded, None)

    def advance(self) -> None:
        """Go on to the next message.

        Raises:
            UserError: the bag is damaged; the message at hand was its last, so that none is played twice.
        """
        try:
            self.next = self._put_back.popleft() if self._put_back else next(self._recorded, None)
        except UserError:
            self.next = None
            raise

    def put_back(self, recorded: Iterable[BagMessage]) -> None:
        """Let messages, in this order, be the next ones."""
        if self.next is not None:
            self._put_back.appendleft(self.next)
        self._put_back.extendleft(reversed(list(recorded)))
        self.next = self._put_back.popleft() if self._put_back else None


class Group:
    """Dwells that are played together: one, or several whose frames lie among each other in the bag.

    Attributes:
        frames: number of frames of each dwell.
        set_aside: frames of dwells that lie among these and are to be played after them.
        last_odometry_ns: stamp of the last odometry, ns.
    """

    def __init__(self, last_odometry_ns: int = 0) -> None:
        """Begin without a dwell; odometry has been played up to a time (ns)."""
        self.frames: Counter[DwellKey] = Counter()
        self.set_aside: list[BagMessage] = []
        self.last_odometry_ns = last_odometry_ns
        self._last_pulse_ns = 0

    def add(self, message: Any) -> None:
        """Take note of a message that is played."""
        if isinstance(message, Odometry):
            self.last_odometry_ns = messages.to_ns(message.header.stamp)
        elif isinstance(message, OF_DWELLS):
            key = key_of(message)
            self.frames[key] += 1
        if isinstance(message, ChannelFrame):
            duration = max((t for t in message.pulse_time if 0 < t <= messages.LONGEST_DWELL), default=0.0)
            self._last_pulse_ns = max(self._last_pulse_ns, key.stamp_ns + round(duration * 1e9))

    def closed(self, detectors: int) -> bool:
        """Whether all frames have come, and odometry past the last pulse; or too many frames for that to happen."""
        complete = bool(self.frames) and min(self.frames.values()) >= detectors
        covered = self.last_odometry_ns >= self._last_pulse_ns
        return (complete and covered) or self.frames.total() + len(self.set_aside) >= LONGEST_GROUP * detectors


def key_of(message: Any) -> DwellKey:
    """The dwell of a frame, an image or a height image."""
    return DwellKey(message.dwell, messages.to_ns(message.header.stamp))
