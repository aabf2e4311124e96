"""Errors of the odometry of a simulated platform, and of the described mounting of the sensor.

Errors of velocity and attitude are Gauss-Markov processes of first order, as the residuals of an inertial navigation
that satellites aid are commonly modelled (Farrell, Aided Navigation, chapter 4); position follows velocity.

A grade gives the rms errors that the maker of such a navigation states for it: Applanix Corporation, POS AV
Specifications, absolute accuracy, post-processed, of the models 310 (tactical), 510 (navigation) and 610 (survey).
docs/presets.md states what is unknown of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from annotated_types import Ge, Gt, Le
from scipy.spatial.transform import Rotation

from sal_height.configuration import Angle, Float, StrictKeys
from sal_height.geometry import Mounting, PlatformState
from sal_height.numeric import F64
from sal_height.simulation.harmonics import Harmonics

Arm = Annotated[Float, Ge(-10), Le(10)]

DEGREE = np.pi / 180
GRADES = {
    "tactical": {"velocity_mps": 0.01, "attitude_rad": 0.013 * DEGREE, "heading_rad": 0.035 * DEGREE},
    "navigation": {"velocity_mps": 0.005, "attitude_rad": 0.005 * DEGREE, "heading_rad": 0.008 * DEGREE},
    "survey": {"velocity_mps": 0.005, "attitude_rad": 0.0025 * DEGREE, "heading_rad": 0.005 * DEGREE},
}
"""Rms errors of each grade."""

BY_GRADE = float("nan")
"""Stands for a number that is not given, until it is filled in."""

NO_ERRORS = {"position_m": 0.0, "velocity_mps": 0.0, "attitude_rad": 0.0}


@dataclass(frozen=True)
class OdometryErrors(StrictKeys):
    """Errors of odometry and mounting; by default none.

    Attributes:
        grade: source of those of the next four numbers that are not given; none: they are 0, and the error of the
            heading is that of the attitude.
        position_m: rms of an error of each coordinate that is constant in a flight, m.
        velocity_mps: rms of the error of each component of velocity, m/s.
        attitude_rad: rms of the error about the two level axes of map, rad.
        heading_rad: rms of the error about the vertical, rad.
        correlation_s: correlation time of errors of velocity and attitude, s.
        delay_s: delay of the stamps of odometry, s.
        undescribed_lever_arm_m: offset of the antenna from its described position, in axes of base_link, m.
        undescribed_boresight_rad: rotation of the sensor from its described attitude, about its own x, y and z, rad.
    """

    position_m: Annotated[Float, Ge(0), Le(1000)] = BY_GRADE
    velocity_mps: Annotated[Float, Ge(0), Le(10)] = BY_GRADE
    attitude_rad: Annotated[Float, Ge(0), Le(0.1)] = BY_GRADE
    heading_rad: Annotated[Float, Ge(0), Le(0.1)] = BY_GRADE
    correlation_s: Annotated[Float, Gt(0), Le(1e6)] = 100.0
    delay_s: Annotated[Float, Ge(-1), Le(1)] = 0.0
    undescribed_lever_arm_m: tuple[Arm, Arm, Arm] = (0.0, 0.0, 0.0)
    undescribed_boresight_rad: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    grade: Literal["tactical", "navigation", "survey"] | None = None

    def __post_init__(self) -> None:
        """Fill in numbers that are not given."""
        # Satellites determine the position alike in every grade; all models state 0.05 to 0.3 m.
        graded = {"position_m": 0.1, **GRADES[self.grade]} if self.grade else NO_ERRORS
        for name, value in graded.items():
            self._fill(name, value)
        self._fill("heading_rad", self.attitude_rad)

    def _fill(self, name: str, value: float) -> None:
        if np.isnan(getattr(self, name)):
            object.__setattr__(self, name, value)

    @property
    def is_wrong(self) -> bool:
        """True if the pose and the velocity that odometry states have errors."""
        return bool(self.position_m or self.velocity_mps or self.turn_rad.any())

    @property
    def turn_rad(self) -> F64:
        """Rms of the error about each axis of map, rad, shape (3,)."""
        return np.array([self.attitude_rad, self.attitude_rad, self.heading_rad])

    @property
    def delay_ns(self) -> int:
        """The delay in whole nanoseconds."""
        return round(1e9 * self.delay_s)

    def built(self, mounting: Mounting) -> Mounting:
        """The true mounting of the sensor, from the described one."""
        if not (any(self.undescribed_lever_arm_m) or any(self.undescribed_boresight_rad)):
            return mounting
        arm = np.add(mounting.lever_arm, self.undescribed_lever_arm_m)
        x, y, z, w = (mounting.axes * Rotation.from_rotvec(self.undescribed_boresight_rad)).as_quat().tolist()
        return replace(mounting, lever_arm=tuple(arm.tolist()), rotation=(x, y, z, w))

    def drawn(self, rng: np.random.Generator) -> PoseErrors:
        """The errors of a flight."""
        place = self.position_m * rng.standard_normal(3)
        motion = _gauss_markov(np.full(3, self.velocity_mps), self.correlation_s, rng)
        return PoseErrors(self, place, motion, _gauss_markov(self.turn_rad, self.correlation_s, rng))


EXACT = OdometryErrors()


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """The errors of the odometry of one flight, over time in s after the start of the first dwell.

    Attributes:
        of: statistics that they were drawn from.
        place: error of position when the flight starts, m, shape (3,).
        motion: errors of velocity, m/s.
        turns: errors of attitude about the axes of map, as the velocity of these harmonics, rad.
    """

    of: OdometryErrors
    place: F64
    motion: Harmonics
    turns: Harmonics

    def added_to(self, true: PlatformState, seconds: float) -> PlatformState:
        """The state that odometry reports instead of the true one at a time, with its covariance."""
        if not self.of.is_wrong:
            return true
        attitude = self.rotation(seconds) * Rotation.from_quat(true.orientation)
        return replace(
            true,
            position=true.position + self.position(seconds),
            orientation=attitude.as_quat(),
            velocity=true.velocity + self.velocity(seconds),
            covariance=self.covariance(seconds),
            velocity_covariance=self.of.velocity_mps**2 * np.eye(3),
        )

    def position(self, seconds: npt.ArrayLike) -> F64:
        """Error of position, m, shape (..., 3)."""
        return self.place + self.motion.displacement(seconds) - self.motion.displacement(0.0)

    def velocity(self, seconds: npt.ArrayLike) -> F64:
        """Error of velocity, m/s, shape (..., 3)."""
        return self.motion.velocity(seconds)

    def rotation(self, seconds: npt.ArrayLike) -> Rotation:
        """Error of attitude."""
        return Rotation.from_rotvec(self.turns.velocity(seconds))

    def covariance(self, seconds: float) -> F64:
        """Covariance of position and rotation at a time, which a well-tuned navigation states, shape (6, 6).

        A Gauss-Markov velocity that is known to err by s moves the position by the variance
        2 s^2 T^2 (t / T - 1 + exp(-t / T)) in the time t.
        """
        errors = self.of
        x = abs(seconds) / errors.correlation_s
        moved = 2 * (errors.velocity_mps * errors.correlation_s) ** 2 * (x + np.expm1(-x))
        return np.diag([errors.position_m**2 + moved] * 3 + [*errors.turn_rad**2])


def _gauss_markov(rms: F64, correlation_s: float, rng: np.random.Generator) -> Harmonics:
    """Three processes whose autocorrelations are rms^2 exp(-|t| / T): spectrum 2 T / pi / (1 + (omega T)^2)."""
    count = 150  # harmonics
    # Correlation times in which the slowest harmonic turns by a radian; the fastest does in the inverse of that.
    span = 100.0
    edges = np.geomspace(1 / (span * correlation_s), span / correlation_s, count + 1)
    power = np.diff(np.arctan(edges * correlation_s))
    return Harmonics(
        omega=np.sqrt(edges[1:] * edges[:-1]),
        amplitude=np.sqrt(2 * power / power.sum())[:, None] * rms,
        phase=rng.uniform(0, 2 * np.pi, (count, 3)),
    )
