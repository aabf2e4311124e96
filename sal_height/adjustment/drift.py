r"""How the errors of a navigation develop: velocity and attitude as Gauss-Markov processes, position as it follows.

Over a time t = x T the errors of position p, velocity v and attitude e become, with f = exp(-x),

    p' = p + T (1 - f) v + n_p,    v' = f v + n_v,    e' = f e + n_e,

    cov(n_p, n_v) = [[T^2 (2 x - 3 + 4 f - f^2), T (1 - f)^2], [., 1 - f^2]] C_v,    cov(n_e) = (1 - f^2) C_e

(Farrell, Aided Navigation, chapter 4). C_v and C_e are what odometry states; a velocity whose error it does not state
is taken to move the position by as much in T as the error of position that it states. Where it states a position better
than these let it become, as with satellites, the difference is taken as a fix; where worse, as a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from sal_height.adjustment.equations import Equation
from sal_height.numeric import F64

STATE = 9
"""Numbers of a knot: errors of position (m), velocity (m/s) and attitude (rad), each about or along east, north, up."""

EXACT_M, EXACT_MPS, EXACT_RAD = 1e-4, 1e-6, 1e-9
"""Standard deviations of what odometry states to be exact, or does not state."""

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
class Drift:
    """Knots in time between which the errors follow smoothly.

    Attributes:
        seconds: of the knots, s, increasing, shape (knots,).
        correlation: T, s.
    """

    seconds: F64
    correlation: float

    @classmethod
    def over(cls, seconds: F64, correlation: float) -> Drift:
        """Knots at the first of times (s, increasing), and whenever the last one is T / KNOTS_PER_CORRELATION old."""
        knots = [float(seconds[0])]
        for time in seconds.tolist():
            if time - knots[-1] >= correlation / KNOTS_PER_CORRELATION:
                knots.append(time)
        return cls(np.array(knots), correlation)

    def knot_of(self, seconds: float) -> tuple[int, float]:
        """The nearest knot, and the time since it, s."""
        after = int(np.searchsorted(self.seconds, seconds))
        near = [number for number in (after - 1, after) if 0 <= number < len(self.seconds)]
        knot = min(near, key=lambda number: abs(self.seconds[number] - seconds))
        return knot, seconds - float(self.seconds[knot])

    def priors(self, stated: list[Stated]) -> list[Equation]:
        """What is known of the knots beforehand, from what odometry states: in the order of time, at each of them."""
        times = np.array([one.seconds for one in stated])
        nearest = [stated[number] for number in np.searchsorted(times, self.seconds).tolist()]
        places = [_floored(one.pose[:3, :3], EXACT_M) for one in nearest]
        attitudes = [_floored(one.pose[3:, 3:], EXACT_RAD) for one in nearest]
        told = [
            one.velocity if one.velocity.any() else place / self.correlation**2
            for one, place in zip(nearest, places, strict=True)
        ]
        velocities = [_floored(velocity, EXACT_MPS) for velocity in told]
        begin = _inverse(block_diag(places[0], velocities[0], attitudes[0]))
        equations = [Equation(np.arange(STATE), np.eye(STATE), np.zeros(STATE), begin)]
        # Variance of the position, and its covariance with the velocity, as they become from knot to knot.
        variance, mixed, t = _mean_variance(places[0]), 0.0, self.correlation
        for number in range(1, len(self.seconds)):
            step = float(self.seconds[number] - self.seconds[number - 1]) / t
            fade, speed = np.exp(-step), _mean_variance(velocities[number])
            noise, carried = _position_noise(step, t) * speed, t * (1 - fade)
            variance += 2 * carried * mixed + carried**2 * speed + float(noise[0, 0])
            mixed = fade * (mixed + carried * speed) + float(noise[0, 1])
            stated_variance = _mean_variance(places[number])
            worse = max(0.0, stated_variance - variance)
            equations.append(self._transition(number, step, velocities[number], attitudes[number], worse))
            if stated_variance < 0.99 * variance:
                information = np.eye(3) * (1 / stated_variance - 1 / variance)
                equations.append(Equation(STATE * number + np.arange(3), np.eye(3), np.zeros(3), information))
                mixed *= stated_variance / variance
            variance = stated_variance
        return equations

    def _transition(self, number: int, step: float, velocity: F64, attitude: F64, worse: float) -> Equation:
        """How a knot follows from the one before, whose position is `worse` known by so much variance, m^2."""
        fade, t = np.exp(-step), self.correlation
        carried = np.eye(STATE)
        carried[3:, 3:] *= fade
        carried[:3, 3:6] = t * (1 - fade) * np.eye(3)
        noise = np.zeros((STATE, STATE))
        noise[:6, :6] = np.kron(_position_noise(step, t), velocity)
        noise[6:, 6:] = (1 - fade**2) * attitude
        noise[:3, :3] += np.eye(3) * (worse + (0.01 * EXACT_M) ** 2)
        noise[3:6, 3:6] += np.eye(3) * EXACT_MPS**2
        noise[6:, 6:] += np.eye(3) * EXACT_RAD**2
        columns = STATE * (number - 1) + np.arange(2 * STATE)
        return Equation(columns, np.hstack([-carried, np.eye(STATE)]), np.zeros(STATE), _inverse(noise))


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


def _floored(covariance: F64, least: float) -> F64:
    """A covariance with no variance below `least` squared; that of nothing finite is that."""
    if not np.all(np.isfinite(covariance)):
        covariance = np.zeros_like(covariance)
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return (vectors * np.maximum(values, least**2)) @ vectors.T
