"""Platform states from instruments that measure positions, velocities and attitudes apart, each at times of its own.

There is a state for each attitude: attitudes change fastest, and come most often. Positions between two samples follow
a cubic Hermite spline, as those between the states that result do (`trajectory`).
"""

from __future__ import annotations

import bisect
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from sal_height.errors import Rejected
from sal_height.geometry.geodesy import Origin
from sal_height.geometry.quaternion import attitude_between, quaternion_of, rotation_matrix
from sal_height.geometry.trajectory import PlatformState
from sal_height.numeric import F64

REORDERED_NS = 1_000_000_000
"""A sample that is older than the latest one by up to this was overtaken on its way; further back, a clock has started
anew."""

MOST_HELD = 4
"""Positions and velocities are held for so many times as long as attitudes may wait, which may come later than they."""


class Sample(NamedTuple):
    """A measured vector in map axes, or a quaternion x, y, z, w.

    Attributes:
        stamp_ns: time, ns since the epoch.
        value: what was measured, m, m/s or without unit, shape (3,) or (4,).
        covariance: of the position (m^2) or the attitude (rad^2), shape (3, 3); zeros: not known.
    """

    stamp_ns: int
    value: F64
    covariance: F64


class Awaited(Exception):  # noqa: N818 (not an error)
    """The sample of an instrument after a time has not come yet; its argument is what the instrument measures."""


class Series:
    """Samples of one instrument, in the order of their stamps."""

    def __init__(self, what: str, longest_gap_s: float) -> None:
        """Begin a series of `what`, between whose samples there may be so many seconds."""
        self.what = what
        self.stamps: list[int] = []
        self.samples: list[Sample] = []
        self._longest_gap_ns = round(longest_gap_s * 1e9)

    def add(self, sample: Sample) -> None:
        """Take a sample in.

        Raises:
            Rejected: it is not later than the last one.
        """
        if self.stamps and sample.stamp_ns <= self.stamps[-1]:
            late_s = (self.stamps[-1] - sample.stamp_ns) * 1e-9
            raise Rejected(
                f"late {self.what}",
                f"A sample of the {self.what} is stamped {late_s:.6g} s before the latest one; each must be later than "
                "the one before. Do two sources publish?",
            )
        self.stamps.append(sample.stamp_ns)
        self.samples.append(sample)

    def is_before(self, stamp_ns: int) -> bool:
        """Whether a stamp is so far before the last one that the clock has started anew."""
        return bool(self.stamps) and self.stamps[-1] - stamp_ns > REORDERED_NS

    def around(self, stamp_ns: int) -> tuple[int, float]:
        """Index of the last sample not after a time, and how far that is on the way to the next one, from 0 to 1.

        Raises:
            Awaited: the next one has not come yet.
            Rejected: there was none before, or too much time is between them.
        """
        before = bisect.bisect_right(self.stamps, stamp_ns) - 1
        if before < 0:
            if not self.stamps:
                raise Awaited(self.what)
            sentence = f"No sample of the {self.what} is as old as the state that needs it."
            raise Rejected(f"no {self.what}", sentence)
        if self.stamps[before] == stamp_ns:
            return before, 0.0
        is_last = before == len(self.stamps) - 1
        begin_ns, end_ns = self.stamps[before], stamp_ns if is_last else self.stamps[before + 1]
        if end_ns - begin_ns > self._longest_gap_ns:
            raise Rejected(
                f"{self.what} gap",
                f"Samples of the {self.what} are {(end_ns - begin_ns) * 1e-9:.6g} s apart, or the next one is overdue; "
                f"{self._longest_gap_ns * 1e-9:g} s are allowed (longest_gap_s).",
            )
        if is_last:
            raise Awaited(self.what)
        return before, (stamp_ns - begin_ns) / (end_ns - begin_ns)

    def clear(self) -> None:
        """Forget all."""
        self.forget(len(self.stamps))

    def forget(self, count: int) -> None:
        """Forget the first samples."""
        del self.stamps[:count], self.samples[:count]

    def forget_before(self, stamp_ns: int) -> None:
        """Forget the samples before a time."""
        self.forget(bisect.bisect_left(self.stamps, stamp_ns))


class Navigation:
    """Merges positions, velocities and attitudes into platform states.

    A stamp more than a second before the latest one says that a clock has started anew: everything is forgotten then.
    """

    def __init__(self, longest_gap_s: float, *, velocity_is_measured: bool, local_to: Origin | None = None) -> None:
        """Begin.

        Args:
            longest_gap_s: longest time between two samples of a kind, s.
            velocity_is_measured: whether velocities will come; if not, they are differences of positions.
            local_to: origin of the map, if attitudes are against east, north and up where the platform is, as an
                inertial unit measures them; None: they are against the axes of map.
        """
        self._local_to = local_to
        self._positions = Series("position", longest_gap_s)
        self._velocities = Series("velocity", longest_gap_s)
        self._attitudes = Series("attitude", longest_gap_s)
        self._done = 0
        """Attitudes at the begin of their series that have been taken."""
        self._velocity_is_measured = velocity_is_measured
        self._in_body = False
        self._held_ns = round(2e9 * longest_gap_s)
        """How long an attitude may wait, and how far before it samples are held."""
        self._declined: list[Rejected] = []

    def add_position(self, sample: Sample) -> None:
        """Take a position of base_link in.

        Raises:
            Rejected: it is late.
        """
        self._add(self._positions, sample)

    def add_velocity(self, sample: Sample, *, in_body: bool) -> None:
        """Take a velocity in, in the axes of the body or of map.

        Raises:
            Rejected: it is late.
        """
        if in_body != self._in_body:
            self._velocities.clear()
            self._in_body = in_body
        self._add(self._velocities, sample)

    def add_attitude(self, sample: Sample) -> None:
        """Take an attitude in.

        Raises:
            Rejected: it is late.
        """
        self._add(self._attitudes, sample)

    def take(self) -> tuple[list[PlatformState], list[Rejected]]:
        """The states that are determined since the last call, and why there is none at other attitudes."""
        states: list[PlatformState] = []
        declined, self._declined = self._declined, []
        while self._done < len(self._attitudes.samples):
            attitude = self._attitudes.samples[self._done]
            try:
                states.append(self._state_at(attitude))
            except Rejected as reason:
                declined.append(reason)
            except Awaited as awaited:
                if self._attitudes.stamps[-1] - attitude.stamp_ns <= self._held_ns:
                    break
                sentence = f"No sample of the {awaited} arrived within {self._held_ns * 1e-9:g} s after an attitude."
                declined.append(Rejected(f"no {awaited}", sentence))
            self._done += 1
        self._forget()
        return states, declined

    def _state_at(self, attitude: Sample) -> PlatformState:
        """The state at the time of an attitude.

        Raises:
            Awaited: what is needed has not come yet.
            Rejected: it will not come.
        """
        before, share = self._positions.around(attitude.stamp_ns)
        position, velocity = self._positions.samples[before].value, self._velocity_at(before)
        if share:
            position, velocity = self._between(before, share, velocity)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = self._positions.samples[before + round(share)].covariance
        covariance[3:, 3:] = attitude.covariance
        return PlatformState(
            attitude.stamp_ns, position, self._against_map(attitude.value, position), velocity, covariance
        )

    def _between(self, before: int, share: float, velocity: F64) -> tuple[F64, F64]:
        """Position and velocity on the cubic Hermite spline between two positions.

        Args:
            before: index of the first of them.
            share: how far on the way from one to the other.
            velocity: at the first one, m/s.
        """
        first, last = self._positions.samples[before : before + 2]
        step_s = (last.stamp_ns - first.stamp_ns) * 1e-9
        velocities = velocity, self._velocity_at(before + 1)
        spline = CubicHermiteSpline([0.0, step_s], np.stack([first.value, last.value]), np.stack(velocities))
        return spline(share * step_s), spline(share * step_s, 1)

    def _velocity_at(self, index: int) -> F64:
        """Velocity in map axes at the time of a position, m/s.

        Raises:
            Awaited: what is needed has not come yet.
            Rejected: it will not come.
        """
        if not self._velocity_is_measured:
            return self._slope_at(index)
        stamp_ns, position, _ = self._positions.samples[index]
        before, share = self._velocities.around(stamp_ns)
        velocity = self._velocities.samples[before].value
        if share:
            velocity = (1 - share) * velocity + share * self._velocities.samples[before + 1].value
        if not self._in_body:
            return velocity
        return rotation_matrix(self._against_map(self._attitude_at(stamp_ns), position)) @ velocity

    def _slope_at(self, index: int) -> F64:
        """Slope of the parabola through a position and its neighbours, m/s."""
        if index == 0:
            raise Rejected("no velocity", "The first position has none before it from which a velocity would follow.")
        if index == len(self._positions.samples) - 1:
            raise Awaited(self._positions.what)
        before, here, after = self._positions.samples[index - 1 : index + 2]
        for stamp_ns in (here.stamp_ns - 1, here.stamp_ns + 1):
            self._positions.around(stamp_ns)  # declines a gap
        first_s, second_s = (here.stamp_ns - before.stamp_ns) * 1e-9, (after.stamp_ns - here.stamp_ns) * 1e-9
        first, second = (here.value - before.value) / first_s, (after.value - here.value) / second_s
        return (second_s * first + first_s * second) / (first_s + second_s)

    def _attitude_at(self, stamp_ns: int) -> F64:
        before, share = self._attitudes.around(stamp_ns)
        first = self._attitudes.samples[before].value
        return attitude_between(first, self._attitudes.samples[before + 1].value, share) if share else first

    def _against_map(self, attitude: F64, position: F64) -> F64:
        """A measured attitude at a position, against the axes of map."""
        if self._local_to is None:
            return attitude
        return np.array(quaternion_of(self._local_to.turn_at(position) @ rotation_matrix(attitude)))

    def _add(self, series: Series, sample: Sample) -> None:
        if series.is_before(sample.stamp_ns):
            sentence = "Stamps have gone back by more than a second: a clock has started again, or two sources publish."
            self._declined.append(Rejected("clock restarted", sentence))
            self._done = 0
            for each in (self._positions, self._velocities, self._attitudes):
                each.clear()
        series.add(sample)
        if series is not self._attitudes:  # those are taken, sooner or later; without any, nothing would be forgotten
            series.forget_before(sample.stamp_ns - MOST_HELD * self._held_ns)

    def _forget(self) -> None:
        """Hold what attitudes that will come, or wait, may need."""
        if not self._attitudes.samples:
            return
        first_ns = self._attitudes.stamps[min(self._done, len(self._attitudes.stamps) - 1)]
        for series in (self._positions, self._velocities):
            series.forget_before(first_ns - self._held_ns)
        held = len(self._attitudes.stamps)
        self._attitudes.forget_before(first_ns - self._held_ns)
        self._done -= held - len(self._attitudes.stamps)
