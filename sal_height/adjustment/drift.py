r"""How the errors of a navigation develop: velocity and attitude as Gauss-Markov processes, position as it follows.

Over a time t = x T the errors of position p, velocity v and attitude e become, with f = exp(-x),

    p' = p + T (1 - f) v + n_p,    v' = f v + n_v,    e' = f e + n_e,

    cov(n_p, n_v) = [[T^2 (2 x - 3 + 4 f - f^2), T (1 - f)^2], [., 1 - f^2]] C_v,    cov(n_e) = (1 - f^2) C_e

(Farrell, Aided Navigation, chapter 4). C_v and C_e are what odometry states; a velocity whose error it does not state
is taken to move the position by as much in T as the error of position that it states. Where it states a position better
than these let it become, as with satellites, the difference is taken as a fix; where worse, as a step.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from sal_height.adjustment.equations import Equation
from sal_height.geometry import ApertureState, Mounting, Trajectory
from sal_height.numeric import F64, Index

STATE = 9
"""Numbers of a knot: errors of position (m), velocity (m/s) and attitude (rad), each about or along east, north, up."""

EXACT_M, EXACT_MPS, EXACT_RAD = 1e-4, 1e-6, 1e-9
"""Standard deviations of what odometry states to be exact, or does not state."""

WORST_M, WORST_MPS, WORST_RAD = 1e3, 10.0, 0.1
"""Standard deviations of what it states to be known worse: no images could be compared then."""

KNOTS_PER_CORRELATION = 1000


@dataclass(frozen=True, eq=False)
class Stated:
    """What odometry states of its errors at a time.

    Attributes:
        seconds: s.
        pose: covariance of position (m^2) and rotation (rad^2), axes of map, shape (6, 6).
        velocity: covariance, (m/s)^2, axes of map, shape (3, 3).
    """

    seconds: float
    pose: F64
    velocity: F64


@dataclass(frozen=True, eq=False)
class Pulses:
    """When the pulses of a dwell, or of a block of a strip, were sent, and where odometry had the platform meanwhile.

    Attributes:
        track: of base_link.
        begin_ns: of the dwell.
        times: of the pulses, s from there, two or more.
        epoch_ns: from which seconds count.
    """

    track: Trajectory
    begin_ns: int
    times: F64
    epoch_ns: int = 0

    @property
    def stated(self) -> Stated:
        """What odometry states in their middle."""
        begin_ns, times = self.begin_ns, self.times
        return Stated(
            (begin_ns - self.epoch_ns) * 1e-9 + float(times.mean()),
            self.track.aperture(begin_ns, times).covariance,
            self.track.velocity_covariance(begin_ns, times),
        )

    def stated_abeam(self, aperture: ApertureState, mounting: Mounting) -> Stated:
        """What it states of an image of a strip that they completed, as of when the antenna was abeam of its middle.

        Args:
            aperture: of the image, whose position is that of the antenna then.
            mounting: of the sensor.
        """
        last = self.times[-1:]
        (antenna,) = self.track.mounted(mounting).positions(self.begin_ns, last)
        since = float((antenna - aperture.position) @ aperture.direction) / float(np.linalg.norm(aperture.velocity))
        return replace(self.stated, seconds=(self.begin_ns - self.epoch_ns) * 1e-9 + float(last[0]) - since)


@dataclass(frozen=True, eq=False)
class Knot:
    """A time at which the errors are unknowns.

    Attributes:
        seconds: s.
        columns: numbers of the unknowns, shape (STATE,).
    """

    seconds: float
    columns: Index


class Drift:
    """Knots in time, as time goes on, between which the errors follow smoothly."""

    def __init__(self, correlation: float) -> None:
        """Begin without knots; `correlation`: T, s."""
        self.correlation = correlation
        self.knots: list[Knot] = []
        # Variance of the position at the last knot, and its covariance with the velocity.
        self._variance = self._mixed = 0.0

    def needs_knot(self, seconds: float) -> bool:
        """Whether there is no knot yet, or the last one is older than T / KNOTS_PER_CORRELATION."""
        return not self.knots or seconds - self.knots[-1].seconds >= self.correlation / KNOTS_PER_CORRELATION

    def add_knot(self, stated: Stated, columns: Index) -> list[Equation]:
        """Add a knot at the time of what odometry states, later than all others, whose unknowns have these numbers.

        Returns:
            What is known of them beforehand.
        """
        knot, before = Knot(stated.seconds, columns), self.knots[-1] if self.knots else None
        self.knots.append(knot)
        place, attitude = (
            _bounded(stated.pose[:3, :3], EXACT_M, WORST_M),
            _bounded(stated.pose[3:, 3:], EXACT_RAD, WORST_RAD),
        )
        moved = stated.velocity if stated.velocity.any() else place / self.correlation**2
        velocity = _bounded(moved, EXACT_MPS, WORST_MPS)
        variance = _mean_variance(place)
        if before is None:
            self._variance = variance
            return [Equation(columns, np.eye(STATE), np.zeros(STATE), _inverse(block_diag(place, velocity, attitude)))]
        # Variance of the position, and its covariance with the velocity, as they become.
        step = (knot.seconds - before.seconds) / self.correlation
        fade, speed = np.exp(-step), _mean_variance(velocity)
        noise, carried = _position_noise(step, self.correlation) * speed, self.correlation * (1 - fade)
        become = self._variance + 2 * carried * self._mixed + carried**2 * speed + float(noise[0, 0])
        self._mixed = fade * (self._mixed + carried * speed) + float(noise[0, 1])
        self._variance = variance
        equations = [self._transition(before, knot, velocity, attitude, max(0.0, variance - become))]
        if variance < 0.99 * become:
            fix = np.eye(3) * (1 / variance - 1 / become)
            equations.append(Equation(columns[:3], np.eye(3), np.zeros(3), fix))
            self._mixed *= variance / become
        return equations

    def knot_before(self, seconds: float) -> Knot:
        """The last knot that is not later; the first one if all are."""
        return self.knots[max(0, bisect.bisect_right(self.knots, seconds, key=_time_of) - 1)]

    def nearest_knot(self, seconds: float) -> Knot:
        """The knot that is nearest in time."""
        after = bisect.bisect_right(self.knots, seconds, key=_time_of)
        return min(self.knots[max(0, after - 1) : after + 1], key=lambda knot: abs(knot.seconds - seconds))

    def forget_before(self, knot: Knot) -> list[Knot]:
        """Forget the knots before this one, and return them."""
        first = self.knots.index(knot)
        gone, self.knots = self.knots[:first], self.knots[first:]
        return gone

    def _transition(self, before: Knot, knot: Knot, velocity: F64, attitude: F64, worse: float) -> Equation:
        """How a knot follows from the one before, whose position is `worse` known by so much variance, m^2."""
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
    place = 2 * step - 3 + 4 * fade - fade**2
    if step < 1e-2:  # where these terms cancel
        place = 2 * step**3 / 3 - step**4 / 2
    mixed = correlation * (1 - fade) ** 2
    return np.array([[correlation**2 * place, mixed], [mixed, 1 - fade**2]])


def _inverse(matrix: F64) -> F64:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _mean_variance(covariance: F64) -> float:
    return float(np.trace(covariance)) / 3


def _bounded(covariance: F64, least: float, most: float) -> F64:
    """A covariance with standard deviations from `least` to `most`."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return (vectors * np.clip(values, least**2, most**2)) @ vectors.T
