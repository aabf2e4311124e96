"""The platform's track: odometry samples in the order of their stamps, and those that cover a dwell."""

from __future__ import annotations

import bisect
import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sal_height.engine.stage import FOREVER_NS
from sal_height.geometry import (
    ASSUMED_ACCELERATION,
    ASSUMED_TURNING,
    NOT_STATED,
    REORDERED_NS,
    Motion,
    OdometryAccuracy,
    PlatformState,
    Trajectory,
    known_pose,
    known_velocity,
)
from sal_height.numeric import F64, I64
from sal_height.settings import Settings, setting

MOST_STATES = 200_000
"""Greatest number of samples that are kept, 100 s at 2 kHz (20 MB), whatever time they span."""

OLD = 4
"""Samples that are too old are dropped once they are the fraction 1 / OLD of all: each is moved three times then."""

NUMBERS = 10
"""Numbers of a sample: position, orientation and velocity."""


ACCURACY: Mapping[str, str] = {
    "odometry_position_sigma_m": "position_m",
    "odometry_velocity_sigma_mps": "velocity_mps",
    "odometry_attitude_sigma_rad": "attitude_rad",
    "odometry_heading_sigma_rad": "heading_rad",
}
"""Numbers of `OdometryAccuracy`, by the parameters that state them."""


class OdometrySettings(Settings):
    """Settings of the odometry: its gaps, and its accuracy where its covariances do not state it."""

    max_odometry_gap_s: float = setting(
        0.5, "longest time between two odometry samples during a dwell", unit="s", minimum=1e-6, maximum=3600.0
    )
    odometry_interval_s: float = setting(
        0.05,
        "longest time between two odometry samples that is no gap; in a gap the covariances of pose and velocity grow "
        "by what the platform may have done meanwhile",
        unit="s",
        minimum=1e-6,
        maximum=3600.0,
    )
    acceleration_noise: float = setting(
        NOT_STATED,
        f"acceleration that odometry does not show, for gaps; -1: not known, {ASSUMED_ACCELERATION:g} or what "
        "positions and velocities of the samples show is assumed, and the heights are doubted",
        unit="m/s^2/sqrt(Hz)",
        minimum=NOT_STATED,
        maximum=1000.0,
    )
    turning_noise: float = setting(
        NOT_STATED,
        f"angular acceleration that odometry does not show, for gaps; -1: not known, {ASSUMED_TURNING:g} is assumed, "
        "and the heights are doubted",
        unit="rad/s^2/sqrt(Hz)",
        minimum=NOT_STATED,
        maximum=1000.0,
    )
    odometry_position_sigma_m: float = setting(
        NOT_STATED,
        "standard deviation of each component of the position where the covariances of the odometry leave it unknown: "
        "a variance is zero, negative or NaN, or all three are one number that is no measurement; 0: exact; -1: not "
        "known, 2 m are assumed and the heights are doubted",
        unit="m",
        minimum=NOT_STATED,
        maximum=1e5,
    )
    odometry_velocity_sigma_mps: float = setting(
        NOT_STATED, "the same of the velocity; -1: 0.05 m/s", unit="m/s", minimum=NOT_STATED, maximum=1e3
    )
    odometry_attitude_sigma_rad: float = setting(
        NOT_STATED, "the same of roll and pitch; -1: 0.002 rad", unit="rad", minimum=NOT_STATED, maximum=math.pi
    )
    odometry_heading_sigma_rad: float = setting(
        NOT_STATED, "the same of the heading; -1: 0.01 rad", unit="rad", minimum=NOT_STATED, maximum=math.pi
    )
    odometry_buffer_s: float = setting(
        100.0,
        "time for which odometry is kept; a dwell must be complete within it",
        unit="s",
        minimum=1.0,
        maximum=86400.0,
        read_only=True,
    )

    @property
    def motion(self) -> Motion:
        """Motion that is possible in gaps of the odometry."""
        return Motion(self.acceleration_noise, self.turning_noise, self.odometry_interval_s)

    @property
    def accuracy(self) -> OdometryAccuracy:
        """Accuracy of odometry whose covariances do not state it."""
        return OdometryAccuracy(**{number: getattr(self, name) for name, number in ACCURACY.items()})

    def assumed_track(self, states: list[PlatformState]) -> Trajectory:
        """The track of samples whose covariances contain what is assumed of them and of the motion between them.

        Raises:
            UserError: the samples make no track.
        """
        return Trajectory(states, motion=self.motion.with_assumed, accuracy=self.accuracy.with_assumed)


class Samples(NamedTuple):
    """Odometry samples in the order of their arrival, as arrays.

    Attributes:
        stamps_ns: times, ns since the epoch, shape (n,).
        numbers: position, orientation and velocity as in `PlatformState`, shape (n, NUMBERS).
        covariances: covariances of the poses, shape (n, 6, 6).
        velocity_covariances: covariances of the velocities, shape (n, 3, 3).
    """

    stamps_ns: I64
    numbers: F64
    covariances: F64
    velocity_covariances: F64

    def states(self) -> list[PlatformState]:
        """The samples one by one."""
        return [
            PlatformState(stamp_ns, numbers[:3], numbers[3:7], numbers[7:], *covariances)
            for stamp_ns, numbers, *covariances in zip(
                self.stamps_ns.tolist(), self.numbers, self.covariances, self.velocity_covariances, strict=True
            )
        ]


class Arrival(Enum):
    """Outcome of an odometry sample."""

    IN_ORDER = "in order"
    REORDERED = "reordered"
    REPEATED = "repeated"
    SET_ASIDE = "set aside"
    RESTARTED = "restarted"


class OdometryHistory:
    """Odometry samples of the last seconds.

    A sample that is far from the others in time is set aside. Only if the next one continues it has the clock, or its
    source, started again; a single wrong stamp costs no other sample.

    A clock that steps back by less than REORDERED_NS is taken for samples that arrive out of order: they are sorted
    among those of before the step. Known fault: dwells around such a step are processed with a track that mixes both.
    """

    def __init__(self, held_s: float) -> None:
        """Keep samples for at least `held_s` seconds, in terms of their stamps."""
        self._held_ns = round(held_s * 1e9)
        self._stamps = array("q")
        self._numbers = array("d")  # as plain numbers: objects would take ten times as much memory
        self._covariances: list[tuple[F64, F64]] = []  # of pose and velocity; equal ones are one
        self._apart: PlatformState | None = None

    def __len__(self) -> int:
        """Number of samples that are kept."""
        return len(self._stamps)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps of the first and the last sample, ns; None without samples."""
        return (self._stamps[0], self._stamps[-1]) if self._stamps else None

    def add(self, state: PlatformState) -> Arrival:
        """Insert a sample: in constant time on average if samples arrive in order."""
        if not self._stamps or -REORDERED_NS <= state.stamp_ns - self._stamps[-1] <= self._held_ns:
            self._apart = None
            return self._insert(state)
        apart, self._apart = self._apart, state
        if apart is None or not self._is_continued(apart, state):
            return Arrival.SET_ASIDE
        self._apart = None
        self._drop(bisect.bisect_left(self._stamps, apart.stamp_ns), len(self))
        self._put(len(self), apart)
        self._put(len(self), state)
        return Arrival.RESTARTED

    def extend(self, samples: Samples) -> bool:
        """Append samples, each of which is in order after the one before; False: one is not, and none is appended."""
        if not self._stamps:
            return False
        steps_ns = np.diff(samples.stamps_ns, prepend=self._stamps[-1])
        if not (steps_ns.min() > 0 and steps_ns.max() <= self._held_ns):
            return False
        self._apart = None
        self._stamps.frombytes(samples.stamps_ns.tobytes())
        self._numbers.frombytes(samples.numbers.tobytes())
        self._extend_covariances(samples.covariances, samples.velocity_covariances)
        self._forget()
        return True

    def around(self, start_ns: int, end_ns: int) -> list[PlatformState]:
        """The samples from the last before `start_ns` to the first after `end_ns`; none if these are not covered."""
        first = bisect.bisect_right(self._stamps, start_ns) - 1
        last = bisect.bisect_left(self._stamps, end_ns)
        return [self._at(place) for place in range(first, last + 1)] if 0 <= first < last < len(self) else []

    def may_cover(self, start_ns: int, end_ns: int, none_before_ns: int, gap_s: float = math.inf) -> bool:
        """True if samples that arrive later can make these cover a time that they do not cover yet.

        Args:
            start_ns: start of the time, ns.
            end_ns: end of the time, ns.
            none_before_ns: earliest stamp that samples which arrive later can have, ns.
            gap_s: longest time between two samples that is allowed, s.
        """
        if none_before_ns <= start_ns:
            return True
        first = bisect.bisect_right(self._stamps, start_ns) - 1
        known = self._stamps[max(0, first) : bisect.bisect_left(self._stamps, none_before_ns)]
        reaches_end = bool(known) and known[-1] >= end_ns
        if first < 0 or reaches_end or none_before_ns == FOREVER_NS:
            return False
        return all((later - earlier) * 1e-9 <= gap_s for earlier, later in pairwise([*known, none_before_ns]))

    def _is_continued(self, apart: PlatformState, state: PlatformState) -> bool:
        """True if a sample follows the one set aside, and is closer to it than to the latest one."""
        step_ns = state.stamp_ns - apart.stamp_ns
        return 0 < step_ns < abs(state.stamp_ns - self._stamps[-1])

    def _insert(self, state: PlatformState) -> Arrival:
        if not self._stamps or state.stamp_ns > self._stamps[-1]:
            self._put(len(self), state)
            self._forget()
            return Arrival.IN_ORDER
        place = bisect.bisect_left(self._stamps, state.stamp_ns)
        if self._stamps[place] == state.stamp_ns:
            self._drop(place, place + 1)
            self._put(place, state)
            return Arrival.REPEATED
        self._put(place, state)
        return Arrival.REORDERED

    def _forget(self) -> None:
        """Drop what is too old once it is a good part of all, so that each sample is moved a few times on average."""
        oldest_ns = self._stamps[-1] - self._held_ns
        if self._stamps[len(self) // OLD] < oldest_ns:
            self._drop(0, bisect.bisect_left(self._stamps, oldest_ns))
        elif len(self) > MOST_STATES:
            self._drop(0, len(self) // OLD)

    def _at(self, place: int) -> PlatformState:
        numbers = np.array(self._numbers[NUMBERS * place : NUMBERS * (place + 1)])
        return PlatformState(self._stamps[place], numbers[:3], numbers[3:7], numbers[7:], *self._covariances[place])

    def _put(self, place: int, state: PlatformState) -> None:
        """Insert a sample before the one at `place`."""
        covariances = state.covariance, state.velocity_covariance
        if place and all(map(_have_same_bytes, covariances, self._covariances[place - 1])):
            covariances = self._covariances[place - 1]
        self._stamps.insert(place, state.stamp_ns)
        numbers = array("d", (*state.position, *state.orientation, *state.velocity))
        self._numbers[NUMBERS * place : NUMBERS * place] = numbers
        self._covariances.insert(place, covariances)

    def _extend_covariances(self, pose: F64, velocity: F64) -> None:
        """Append the covariances of samples, shapes (n, 6, 6) and (n, 3, 3); equal ones are one."""
        rows = [np.ascontiguousarray(each.reshape(len(each), -1)).view(np.int64) for each in (pose, velocity)]
        changes = np.logical_or(*((row[1:] != row[:-1]).any(axis=1) for row in rows)).tolist()
        latest = self._covariances[-1]
        is_new = not all(map(_have_same_bytes, latest, (pose[0], velocity[0])))
        for place, is_other in enumerate([is_new, *changes]):
            if is_other:
                latest = pose[place].copy(), velocity[place].copy()
            self._covariances.append(latest)

    def _drop(self, first: int, end: int) -> None:
        del self._stamps[first:end], self._covariances[first:end], self._numbers[NUMBERS * first : NUMBERS * end]


def _have_same_bytes(one: F64, other: F64) -> bool:
    return one.tobytes() == other.tobytes()


def longest_gap_s(states: Sequence[PlatformState]) -> float:
    """The longest time between two samples of odometry, s; infinity without samples."""
    return max(((later.stamp_ns - earlier.stamp_ns) * 1e-9 for earlier, later in pairwise(states)), default=math.inf)


def without_delay(state: PlatformState, delay_ns: int) -> PlatformState:
    """A state without the delay of its stamp (ns), whose covariances can be calculated with."""
    return replace(
        state,
        stamp_ns=state.stamp_ns - delay_ns,
        covariance=known_pose(state.covariance),
        velocity_covariance=known_velocity(state.velocity_covariance),
    )
