r"""Model of the errors of a navigation: velocity and attitude as Gauss-Markov processes, position as it follows.

Over a time t = x T the errors of position p, velocity v and attitude e become, with f = exp(-x),

    p' = p + T (1 - f) v + n_p,    v' = f v + n_v,    e' = f e + n_e,

    cov(n_p, n_v) = [[T^2 (2 x - 3 + 4 f - f^2), T (1 - f)^2], [., 1 - f^2]] C_v,    cov(n_e) = (1 - f^2) C_e

(Farrell, Aided Navigation, chapter 4). C_v and C_e are what odometry states; a velocity whose error it does not state
is assumed to move the position in T by the stated error of position. Where the stated position is better than these
predict, as with satellites, the difference is processed as a fix; where worse, as a step.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from sal_height.adjustment.equations import Equation
from sal_height.geometry import ApertureState, Mounting, Trajectory
from sal_height.numeric import F64, Index, ShortRepr

STATE = 9
"""Numbers of a knot: errors of position (m), velocity (m/s) and attitude (rad), each about or along east, north, up."""

EXACT_M, EXACT_MPS, EXACT_RAD = 1e-4, 1e-6, 1e-9
"""Standard deviations of values that odometry states to be exact, or does not state."""


@dataclass(frozen=True, eq=False)
class Stated(ShortRepr):
    """Errors that odometry states at a time.

    Attributes:
        seconds: time, s.
        pose: covariance of position (m^2) and rotation (rad^2), axes of map, shape (6, 6).
        velocity: covariance of the velocity, axes of map, shape (3, 3), (m/s)^2.
    """

    seconds: float
    pose: F64
    velocity: F64


@dataclass(frozen=True, eq=False)
class PulseTrack(ShortRepr):
    """Times of the pulses of a dwell, or of a block of a strip, and the track of the platform by odometry.

    Attributes:
        track: track of base_link.
        begin_ns: start of the dwell, ns.
        times: times of the pulses from there, two or more, s.
        epoch_ns: epoch from which seconds count, ns.
    """

    track: Trajectory
    begin_ns: int
    times: F64
    epoch_ns: int = 0

    @property
    def stated(self) -> Stated:
        """The errors that odometry states in the middle of the pulses."""
        begin_ns, times = self.begin_ns, self.times
        return Stated(
            (begin_ns - self.epoch_ns) * 1e-9 + float(times.mean()),
            self.track.aperture(begin_ns, times).covariance,
            self.track.velocity_covariance(begin_ns, times),
        )

    def stated_abeam(self, aperture: ApertureState, mounting: Mounting) -> Stated:
        """The stated errors at the time when the antenna was abeam of the middle of an image that the pulses completed.

        Args:
            aperture: aperture of the image of a strip, at the position of the antenna then.
            mounting: mounting of the sensor.
        """
        last = self.times[-1:]
        (antenna,) = self.track.mounted(mounting).positions(self.begin_ns, last)
        since = float((antenna - aperture.position) @ aperture.direction) / float(np.linalg.norm(aperture.velocity))
        return replace(self.stated, seconds=(self.begin_ns - self.epoch_ns) * 1e-9 + float(last[0]) - since)


@dataclass(frozen=True, eq=False)
class Knot:
    """A time at which the errors are unknowns.

    Attributes:
        seconds: time, s.
        columns: numbers of the unknowns, shape (STATE,).
    """

    seconds: float
    columns: Index


class Drift:
    """Consecutive knots in time, between which the errors change smoothly."""

    def __init__(self, correlation: float) -> None:
        """Starts without knots; `correlation`: T, s."""
        self.correlation = correlation
        self.knots: list[Knot] = []
        # Variance of the position at the last knot, and its covariance with the velocity.
        self._variance = self._mixed = 0.0

    def needs_knot(self, seconds: float) -> bool:
        """True if there is no knot yet, or the last one is older than T / 1000."""
        return not self.knots or seconds - self.knots[-1].seconds >= self.correlation / 1000

    def add_knot(self, stated: Stated, columns: Index) -> list[Equation]:
        """Adds a knot at the time of stated errors, later than all others, whose unknowns have these numbers.

        Returns:
            The prior of these unknowns.
        """
        knot, before = Knot(stated.seconds, columns), self.knots[-1] if self.knots else None
        self.knots.append(knot)
        # No images could be compared with worse errors than 1 km, 0.1 rad and 10 m/s.
        position = _bounded(stated.pose[:3, :3], EXACT_M, 1e3)
        attitude = _bounded(stated.pose[3:, 3:], EXACT_RAD, 0.1)
        moved = stated.velocity if stated.velocity.any() else position / self.correlation**2
        velocity = _bounded(moved, EXACT_MPS, 10.0)
        variance = _mean_variance(position)
        if before is None:
            self._variance = variance
            prior = _inverse(block_diag(position, velocity, attitude))
            return [Equation(columns, np.eye(STATE), np.zeros(STATE), prior)]
        # Predicted variance of the position, and its covariance with the velocity.
        step = (knot.seconds - before.seconds) / self.correlation
        fade, speed = np.exp(-step), _mean_variance(velocity)
        noise, carried = _position_noise(step, self.correlation) * speed, self.correlation * (1 - fade)
        predicted = self._variance + 2 * carried * self._mixed + carried**2 * speed + float(noise[0, 0])
        self._mixed = fade * (self._mixed + carried * speed) + float(noise[0, 1])
        self._variance = variance
        equations = [self._transition(before, knot, velocity, attitude, max(0.0, variance - predicted))]
        if variance < 0.99 * predicted:
            fix = np.eye(3) * (1 / variance - 1 / predicted)
            equations.append(Equation(columns[:3], np.eye(3), np.zeros(3), fix))
            self._mixed *= variance / predicted
        return equations

    def knot_before(self, seconds: float) -> Knot:
        """The last knot that is not later; the first one if all are."""
        return self.knots[max(0, bisect.bisect_right(self.knots, seconds, key=_time_of) - 1)]

    def nearest_knot(self, seconds: float) -> Knot:
        """The nearest knot in time."""
        after = bisect.bisect_right(self.knots, seconds, key=_time_of)
        return min(self.knots[max(0, after - 1) : after + 1], key=lambda knot: abs(knot.seconds - seconds))

    def forget_before(self, knot: Knot) -> list[Knot]:
        """Forgets the knots before this one, and returns them."""
        first = self.knots.index(knot)
        gone, self.knots = self.knots[:first], self.knots[first:]
        return gone

    def _transition(self, before: Knot, knot: Knot, velocity: F64, attitude: F64, worse: float) -> Equation:
        """The transition from one knot to the next, whose position has an additional variance `worse`, m^2."""
        t = self.correlation
        step = (knot.seconds - before.seconds) / t
        fade = np.exp(-step)
        carried = np.eye(STATE)
        carried[3:, 3:] *= fade
        carried[:3, 3:6] = t * (1 - fade) * np.eye(3)
        noise = np.zeros((STATE, STATE))
        noise[:6, :6] = np.kron(_position_noise(step, t), velocity)
        noise[6:, 6:] = (1 - fade**2) * attitude
        noise[:3, :3] += np.eye(3) * (worse + (0.01 * EXACT_M) ** 2)
        noise[3:6, 3:6] += np.eye(3) * EXACT_MPS**2
        noise[6:, 6:] += np.eye(3) * EXACT_RAD**2
        columns = np.concatenate([before.columns, knot.columns])
        return Equation(columns, np.hstack([-carried, np.eye(STATE)]), np.zeros(STATE), _inverse(noise))


def _time_of(knot: Knot) -> float:
    return knot.seconds


def _position_noise(step: float, correlation: float) -> F64:
    """Covariance of n_p and n_v over that of the velocity, after `step` correlation times."""
    fade = np.exp(-step)
    position = 2 * step - 3 + 4 * fade - fade**2
    if step < 1e-2:  # where these terms cancel
        position = 2 * step**3 / 3 - step**4 / 2
    mixed = correlation * (1 - fade) ** 2
    return np.array([[correlation**2 * position, mixed], [mixed, 1 - fade**2]])


def _inverse(matrix: F64) -> F64:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _mean_variance(covariance: F64) -> float:
    return float(np.trace(covariance)) / 3


def _bounded(covariance: F64, least: float, most: float) -> F64:
    """A covariance with standard deviations from `least` to `most`."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return (vectors * np.clip(values, least**2, most**2)) @ vectors.T
