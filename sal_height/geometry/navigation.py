"""Platform states from instruments that measure positions, velocities and attitudes separately, at different times.

Each attitude gives a state: attitudes change fastest, and have the highest rate. Positions between two samples follow a
cubic Hermite spline, as between the resulting states (`trajectory`).
"""

from __future__ import annotations

import bisect
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from sal_height.errors import Rejected
from sal_height.geometry.geodesy import Origin
from sal_height.geometry.motion import attitude_between, quaternion_of, rotation_matrix
from sal_height.geometry.trajectory import PlatformState
from sal_height.numeric import F64

REORDERED_NS = 1_000_000_000
"""Greatest age of a sample against the latest one that was overtaken in transit; an older one means that a clock has
started again."""


class Sample(NamedTuple):
    """A measured vector in map axes, or a quaternion x, y, z, w.

    Attributes:
        stamp_ns: time, ns since the epoch.
        value: measured value, shape (3,) or (4,), m, m/s or without unit.
        covariance: covariance of the position (m^2) or the attitude (rad^2), shape (3, 3); zeros: not known.
    """

    stamp_ns: int
    value: F64
    covariance: F64


class Awaited(Exception):  # noqa: N818 (not an error)
    """The sample of an instrument after a time has not arrived yet; its argument is the quantity that it measures."""


class Series:
    """Samples of one instrument, in the order of their stamps."""

    def __init__(self, what: str, longest_gap_s: float) -> None:
        """Start a series of the quantity `what`, with at most `longest_gap_s` between samples."""
        self.what = what
        self.stamps: list[int] = []
        self.samples: list[Sample] = []
        self._longest_gap_ns = round(longest_gap_s * 1e9)

    def add(self, sample: Sample) -> None:
        """Append a sample.

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
        """True if a stamp is so far before the last one that the clock has started again."""
        return bool(self.stamps) and self.stamps[-1] - stamp_ns > REORDERED_NS

    def around(self, stamp_ns: int) -> tuple[int, float]:
        """Index of the last sample not after a time, and the fraction of the interval to the next one, from 0 to 1.

        Raises:
            Awaited: the next sample has not arrived yet.
            Rejected: no sample is before, or too much time is between the two.
        """
        before = bisect.bisect_right(self.stamps, stamp_ns) - 1
        if before < 0:
            if not self.stamps:
                raise Awaited(self.what)
            message = f"No sample of the {self.what} is as old as the state that needs it."
            raise Rejected(f"no {self.what}", message)
        if self.stamps[before] == stamp_ns:
            return before, 0.0
        is_last = before == len(self.stamps) - 1
        start_ns, end_ns = self.stamps[before], stamp_ns if is_last else self.stamps[before + 1]
        if end_ns - start_ns > self._longest_gap_ns:
            raise Rejected(
                f"{self.what} gap",
                f"Samples of the {self.what} are {(end_ns - start_ns) * 1e-9:.6g} s apart, or the next one is overdue; "
                f"{self._longest_gap_ns * 1e-9:g} s are allowed (longest_gap_s).",
            )
        if is_last:
            raise Awaited(self.what)
        return before, (stamp_ns - start_ns) / (end_ns - start_ns)

    def clear(self) -> None:
        """Forget all samples."""
        self.forget(len(self.stamps))

    def forget(self, count: int) -> None:
        """Forget the first samples."""
        del self.stamps[:count], self.samples[:count]

    def forget_before(self, stamp_ns: int) -> None:
        """Forget the samples before a time."""
        self.forget(bisect.bisect_left(self.stamps, stamp_ns))


class Navigation:
    """Merges positions, velocities and attitudes into platform states.

    A stamp more than a second before the latest one means that a clock has started again: all samples are dropped then.
    """

    def __init__(self, longest_gap_s: float, *, velocity_is_measured: bool, local_to: Origin | None = None) -> None:
        """Start without samples.

        Args:
            longest_gap_s: longest time between two samples of a kind, s.
            velocity_is_measured: True if velocities will arrive; otherwise they are differences of positions.
            local_to: origin of the map, if attitudes are against east, north and up at the platform, as an inertial
                unit measures them; None: they are against the axes of map.
        """
        self._local_to = local_to
        self._positions = Series("position", longest_gap_s)
        self._velocities = Series("velocity", longest_gap_s)
        self._attitudes = Series("attitude", longest_gap_s)
        self._done = 0
        """Number of attitudes at the start of their series that have been processed."""
        self._velocity_is_measured = velocity_is_measured
        self._in_body = False
        self._kept_ns = round(2e9 * longest_gap_s)
        """Longest time for which an attitude may wait, and for which samples before it are kept."""
        self._declined: list[Rejected] = []

    def add_position(self, sample: Sample) -> None:
        """Add a position of base_link.

        Raises:
            Rejected: it is late.
        """
        self._add(self._positions, sample)

    def add_velocity(self, sample: Sample, *, in_body: bool) -> None:
        """Add a velocity in the axes of the body or of map.

        Raises:
            Rejected: it is late.
        """
        if in_body != self._in_body:
            self._velocities.clear()
            self._in_body = in_body
        self._add(self._velocities, sample)

    def add_attitude(self, sample: Sample) -> None:
        """Add an attitude.

        Raises:
            Rejected: it is late.
        """
        self._add(self._attitudes, sample)

    def take(self) -> tuple[list[PlatformState], list[Rejected]]:
        """The states determined since the last call, and the reasons for attitudes without a state."""
        states: list[PlatformState] = []
        declined, self._declined = self._declined, []
        while self._done < len(self._attitudes.samples):
            attitude = self._attitudes.samples[self._done]
            try:
                states.append(self._state_at(attitude))
            except Rejected as reason:
                declined.append(reason)
            except Awaited as awaited:
                if self._attitudes.stamps[-1] - attitude.stamp_ns <= self._kept_ns:
                    break
                message = f"No sample of the {awaited} arrived within {self._kept_ns * 1e-9:g} s after an attitude."
                declined.append(Rejected(f"no {awaited}", message))
            self._done += 1
        self._forget()
        return states, declined

    def _state_at(self, attitude: Sample) -> PlatformState:
        """The state at the time of an attitude.

        Raises:
            Awaited: a sample that is needed has not arrived yet.
            Rejected: it will not arrive.
        """
        before, fraction = self._positions.around(attitude.stamp_ns)
        position, velocity = self._positions.samples[before].value, self._velocity_at(before)
        if fraction:
            position, velocity = self._between(before, fraction, velocity)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = self._positions.samples[before + round(fraction)].covariance
        covariance[3:, 3:] = attitude.covariance
        return PlatformState(
            attitude.stamp_ns, position, self._against_map(attitude.value, position), velocity, covariance
        )

    def _between(self, before: int, fraction: float, velocity: F64) -> tuple[F64, F64]:
        """Position and velocity on the cubic Hermite spline between two positions.

        Args:
            before: index of the first position.
            fraction: fraction of the interval from the first to the second.
            velocity: velocity at the first position, m/s.
        """
        first, last = self._positions.samples[before : before + 2]
        step_s = (last.stamp_ns - first.stamp_ns) * 1e-9
        velocities = velocity, self._velocity_at(before + 1)
        spline = CubicHermiteSpline([0.0, step_s], np.stack([first.value, last.value]), np.stack(velocities))
        return spline(fraction * step_s), spline(fraction * step_s, 1)

    def _velocity_at(self, index: int) -> F64:
        """Velocity in map axes at the time of a position, m/s.

        Raises:
            Awaited: a sample that is needed has not arrived yet.
            Rejected: it will not arrive.
        """
        if not self._velocity_is_measured:
            return self._slope_at(index)
        stamp_ns, position, _ = self._positions.samples[index]
        before, fraction = self._velocities.around(stamp_ns)
        velocity = self._velocities.samples[before].value
        if fraction:
            velocity = (1 - fraction) * velocity + fraction * self._velocities.samples[before + 1].value
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
        before, fraction = self._attitudes.around(stamp_ns)
        first = self._attitudes.samples[before].value
        return attitude_between(first, self._attitudes.samples[before + 1].value, fraction) if fraction else first

    def _against_map(self, attitude: F64, position: F64) -> F64:
        """A measured attitude at a position, against the axes of map."""
        if self._local_to is None:
            return attitude
        return np.array(quaternion_of(self._local_to.turn_at(position) @ rotation_matrix(attitude)))

    def _add(self, series: Series, sample: Sample) -> None:
        if series.is_before(sample.stamp_ns):
            message = "Stamps have gone back by more than a second: a clock has started again, or two sources publish."
            self._declined.append(Rejected("clock restarted", message))
            self._done = 0
            for each in (self._positions, self._velocities, self._attitudes):
                each.clear()
        series.add(sample)
        # `take` drops attitudes; without any, nothing else would be dropped. Attitudes may arrive later than positions
        # and velocities, so that these are kept four times as long as attitudes may wait.
        if series is not self._attitudes:
            series.forget_before(sample.stamp_ns - 4 * self._kept_ns)

    def _forget(self) -> None:
        """Keep only samples that present and future attitudes may need."""
        if not self._attitudes.samples:
            return
        first_ns = self._attitudes.stamps[min(self._done, len(self._attitudes.stamps) - 1)]
        for series in (self._positions, self._velocities):
            series.forget_before(first_ns - self._kept_ns)
        count = len(self._attitudes.stamps)
        self._attitudes.forget_before(first_ns - self._kept_ns)
        self._done -= count - len(self._attitudes.stamps)
