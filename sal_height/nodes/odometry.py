"""The platform states that the compression node holds, in the order of their stamps."""

from __future__ import annotations

import bisect
from enum import Enum

from sal_height.geometry import PlatformState

REORDERED_NS = 1_000_000_000
"""A sample that is older than the latest one by up to this was overtaken on its way: transport takes milliseconds, and
a clock that starts anew goes back further."""

MOST_STATES = 200_000
"""Samples held at most, 100 s at 2 kHz (0.2 GB), whatever time they span."""


class Arrival(Enum):
    """What became of an odometry sample."""

    IN_ORDER = "in order"
    REORDERED = "reordered"
    REPEATED = "repeated"
    SET_ASIDE = "set aside"
    RESTARTED = "restarted"


class OdometryHistory:
    """Odometry samples of the last seconds.

    A sample that is far from the others in time is set aside. Only if the next one continues it has the clock, or its
    source, started anew; a single wrong stamp costs no other sample.
    """

    def __init__(self, held_s: float) -> None:
        """Hold samples for at least `held_s` seconds, in terms of their stamps."""
        self._held_ns = round(held_s * 1e9)
        self._states: list[PlatformState] = []
        self._apart: PlatformState | None = None

    def __len__(self) -> int:
        """Number of samples held."""
        return len(self._states)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps of the first and the last sample; None if there is none."""
        return (self._states[0].stamp_ns, self._states[-1].stamp_ns) if self._states else None

    def add(self, state: PlatformState) -> Arrival:
        """Take a sample in: in constant time on average if samples come in order."""
        if not self._states or -REORDERED_NS <= state.stamp_ns - self._states[-1].stamp_ns <= self._held_ns:
            self._apart = None
            return self._insert(state)
        apart, self._apart = self._apart, state
        if apart is None or not self._is_continued(apart, state):
            return Arrival.SET_ASIDE
        self._apart = None
        del self._states[bisect.bisect_left(self._states, apart.stamp_ns, key=_stamp) :]
        self._states += [apart, state]
        return Arrival.RESTARTED

    def around(self, start_ns: int, end_ns: int) -> list[PlatformState]:
        """The samples from the last before `start_ns` to the first after `end_ns`; none if these are not covered."""
        first = bisect.bisect_right(self._states, start_ns, key=_stamp) - 1
        last = bisect.bisect_left(self._states, end_ns, key=_stamp)
        return self._states[first : last + 1] if 0 <= first < last < len(self._states) else []

    def _is_continued(self, apart: PlatformState, state: PlatformState) -> bool:
        """Whether a sample comes after the one set aside, and is closer to it than to the latest one."""
        step_ns = state.stamp_ns - apart.stamp_ns
        return 0 < step_ns < abs(state.stamp_ns - self._states[-1].stamp_ns)

    def _insert(self, state: PlatformState) -> Arrival:
        if not self._states or state.stamp_ns > self._states[-1].stamp_ns:
            self._states.append(state)
            self._forget()
            return Arrival.IN_ORDER
        place = bisect.bisect_left(self._states, state.stamp_ns, key=_stamp)
        if self._states[place].stamp_ns == state.stamp_ns:
            self._states[place] = state
            return Arrival.REPEATED
        self._states.insert(place, state)
        return Arrival.REORDERED

    def _forget(self) -> None:
        """Drop what is too old once it is more than half of all, so that each sample is moved once on average."""
        oldest_ns = self._states[-1].stamp_ns - self._held_ns
        half = len(self._states) // 2
        if self._states[half].stamp_ns < oldest_ns:
            del self._states[: bisect.bisect_left(self._states, oldest_ns, key=_stamp)]
        elif len(self._states) > MOST_STATES:
            del self._states[:half]


def _stamp(state: PlatformState) -> int:
    return state.stamp_ns
