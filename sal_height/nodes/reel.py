"""The messages of a bag in the order in which they are played, and the group of dwells that is played at once."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator

from sal_height.errors import UserError
from sal_height.nodes.cues import DwellKey
from sal_height.nodes.played import Content, Played

LONGEST_GROUP = 4
"""A group of dwells ends after the frames of this many dwells, even if some dwells lack a frame."""


class Reel:
    """Messages one after the other; those that are put back come again.

    Attributes:
        next: the message that is the next one; None: there is no more.
    """

    def __init__(self, recorded: Iterator[Played]) -> None:
        """Begin with the first message.

        Raises:
            UserError: the bag is damaged there.
        """
        self._recorded = recorded
        self._put_back: deque[Played] = deque()
        self.next: Played | None = next(recorded, None)

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

    def put_back(self, recorded: Iterable[Played]) -> None:
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
        self.set_aside: list[Played] = []
        self.last_odometry_ns = last_odometry_ns
        self._last_pulse_ns = 0

    def add(self, content: Content) -> None:
        """Take note of a message that is played."""
        if content.odometry_ns is not None:
            self.last_odometry_ns = content.odometry_ns
        if content.part:
            self.frames[content.part.dwell] += 1
            if content.part.provenance is None:  # from the sensor, so that odometry is needed
                self._last_pulse_ns = max(self._last_pulse_ns, content.part.end_ns)

    def closed(self, detectors: int, dwell: DwellKey) -> bool:
        """Whether a frame of a dwell is not of this group.

        All frames have come, and odometry past the last pulse; or too many for that, and the dwell is another one.
        """
        complete = bool(self.frames) and min(self.frames.values()) >= detectors
        covered = self.last_odometry_ns >= self._last_pulse_ns
        crowded = self.frames.total() + len(self.set_aside) >= LONGEST_GROUP * detectors
        return (complete and covered) or (crowded and dwell not in self.frames)
