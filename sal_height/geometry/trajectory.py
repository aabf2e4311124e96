"""The platform's track: timed poses, interpolated to pulse times."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline, PPoly
from scipy.spatial.transform import Rotation, RotationSpline

from sal_height.errors import UserError
from sal_height.geometry import _kernels as kernels
from sal_height.geometry.accuracy import (
    OdometryAccuracy,
    known_pose,
    known_velocity,
    position_variances,
    shortfall,
)
from sal_height.geometry.earth import EARTH_RADIUS
from sal_height.geometry.frames import AT_BASE_LINK, ApertureState, Mounting, antennas_of
from sal_height.geometry.motion import STEADY, Motion, attitude_between, rotation_matrix
from sal_height.numeric import F64, ShortRepr, arrays_of, in_parallel, joined_bytes


def locate_at_elevation(
    elevation: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> F64:
    """Return the map position (m) of the target at `elevation` (rad) with a pixel's range and Doppler.

    Args:
        elevation: elevation in body axes, rad.
        slant_range: distance from the middle of the aperture, m.
        along: component of that distance along the flight, m.
        aperture: state of the platform, not sliding (`aperture_at`).
        look_side: +1 right, -1 left.

    Returns:
        Positions of the broadcast shape (..., 3); NaN where no such direction exists.
    """
    velocity, rotation = np.ascontiguousarray(aperture.velocity), np.ascontiguousarray(aperture.rotation)

    def fill(numbers: F64, antennas: F64, positions: F64) -> None:
        angles, ranges, ahead = numbers
        kernels.locate_at_elevations(angles, ranges, ahead, antennas, velocity, rotation, look_side, positions)

    return _located(fill, (elevation, slant_range, along), aperture)


def locate_at_height(
    height: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> F64:
    """Return the map position (m) of the target at `height` (m) above the sphere with a pixel's range and Doppler.

    The line of sight s has the length `slant_range` and the component `along` in the direction of flight. With the
    platform at e from the earth's centre, |e + s| = EARTH_RADIUS + height fixes a second component, along the part of e
    perpendicular to the flight. Of the two points that remain, one lies on the look side.

    Arguments and result are those of `locate_at_elevation`, with the height instead of the elevation; NaN where no
    point has that range, Doppler and height.
    """
    velocity = np.ascontiguousarray(aperture.velocity)

    def fill(numbers: F64, antennas: F64, positions: F64) -> None:
        heights, ranges, ahead = numbers
        kernels.locate_at_heights(heights, ranges, ahead, antennas, velocity, look_side, EARTH_RADIUS, positions)

    return _located(fill, (height, slant_range, along), aperture)


def _located(
    fill: Callable[[F64, F64, F64], None],
    each: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike],
    aperture: ApertureState,
) -> F64:
    """Positions of pixels, of the shape (..., 3) to which their numbers and the aperture's positions broadcast.

    Args:
        fill: function that fills the positions (n, 3) of pixels from their numbers (3, n) and `antennas_of`.
        each: three numbers of each pixel.
        aperture: aperture of the image.
    """
    arrays = [np.asarray(numbers) for numbers in each]
    shape = np.broadcast_shapes(*(array.shape for array in arrays), aperture.position.shape[:-1])
    numbers, positions, antennas = np.empty((3, *shape)), np.empty((*shape, 3)), antennas_of(aperture, shape)
    for number, array in enumerate(arrays):
        numbers[number] = array
    rows, found = numbers.reshape(3, -1), positions.reshape(-1, 3)

    def fill_part(part: slice) -> None:
        fill(rows[:, part], antennas[part] if len(antennas) > 1 else antennas, found[part])

    in_parallel(fill_part, len(found), 2**14)  # points for which another thread pays
    return positions


@dataclass(frozen=True, eq=False)
class PlatformState(ShortRepr):
    """One odometry sample.

    Attributes:
        stamp_ns: time, ns since the epoch.
        position: position of base_link in map, shape (3,), m.
        orientation: quaternion x, y, z, w that turns body into map axes, shape (4,).
        velocity: velocity in map axes, shape (3,), m/s.
        covariance: covariance of the pose, as in nav_msgs/Odometry, shape (6, 6).
        velocity_covariance: covariance of the velocity in body axes, shape (3, 3), (m/s)^2; zeros: not stated.
    """

    stamp_ns: int
    position: F64
    orientation: F64
    velocity: F64
    covariance: F64
    velocity_covariance: F64 = field(default_factory=lambda: np.zeros((3, 3)))

    def __reduce__(self) -> tuple[Any, ...]:
        """To be sent to another process, with all numbers as one object."""
        arrays = self.position, self.orientation, self.velocity, self.covariance, self.velocity_covariance
        return _state_of, (self.stamp_ns, joined_bytes(arrays))


def _state_of(stamp_ns: int, numbers: bytes) -> PlatformState:
    return PlatformState(stamp_ns, *arrays_of(numbers, ((3,), (4,), (3,), (6, 6), (3, 3))))


class Assumed(NamedTuple):
    """Variances that nobody states, about all AXES: the greatest at the first, the middle and the last of some pulses.

    Attributes:
        of_samples: those of the nearest samples, in addition to the stated ones.
        in_gaps: those of the motion between samples, in addition to what is stated or samples show.
        gap_s: longest time between the samples around these pulses, s.
    """

    of_samples: F64
    in_gaps: F64
    gap_s: float


NOBODY_KNOWS = OdometryAccuracy()
"""Accuracy of odometry that nothing states but its covariances."""


class Trajectory:
    """Platform states over time: positions by cubic Hermite splines, attitudes by spherical linear interpolation.

    Times are float64 seconds after `epoch_ns`. An absolute time in float64 is only exact to 0.2 us, in which the
    platform travels many optical wavelengths.

    The track is that of a sensor with a given mounting on the platform. The lever arm follows a spline through the
    attitudes, with continuous angular velocity and acceleration, which adds its turning to the antenna's velocity. It
    is exact for a platform that turns at a constant rate, even between two states; 1 m of arm turning at 0.2 rad/s
    leaves its chord over 5 ms by 0.12 um, a twelfth of a wavelength of 1.55 um each way.
    """

    def __init__(
        self,
        states: list[PlatformState],
        mounting: Mounting = AT_BASE_LINK,
        motion: Motion = STEADY,
        accuracy: OdometryAccuracy = NOBODY_KNOWS,
    ) -> None:
        """Interpolate two or more states of strictly increasing time.

        Args:
            states: samples of odometry.
            mounting: mounting of the sensor whose track it is.
            motion: motion by which the covariance grows in gaps between states.
            accuracy: accuracy of states whose covariances do not state it.

        Raises:
            UserError: there are fewer than two states, their times do not increase, or their velocities contradict
                their positions.
        """
        if len(states) < 2:
            raise UserError(f"The odometry has {len(states)} samples; 2 or more are needed to interpolate.")
        self.states = states
        self.mounting, self.motion, self.accuracy = mounting, motion, accuracy
        self.epoch_ns = states[0].stamp_ns
        self._seconds = np.array([(s.stamp_ns - self.epoch_ns) * 1e-9 for s in states])
        if not np.all(np.diff(self._seconds) > 0):
            raise UserError(
                "The odometry's times do not increase; every sample needs a later stamp than the one before."
            )
        _check_velocity(states, self._seconds)

    @cached_property
    def _position(self) -> PPoly:
        """Position of base_link in map over time, m."""
        positions, velocities = (np.array([getattr(s, name) for s in self.states]) for name in ("position", "velocity"))
        return CubicHermiteSpline(self._seconds, positions, velocities)

    @cached_property
    def _turning(self) -> RotationSpline:
        """Attitude of base_link over time, with continuous angular velocity and acceleration."""
        return RotationSpline(self._seconds, Rotation.from_quat(np.array([s.orientation for s in self.states])))

    def _around(self, t: float) -> tuple[int, float]:
        """The state before a time in s after the epoch, and the fraction of the interval to the next, from 0 to 1."""
        first = min(max(0, bisect.bisect_right(self._seconds, t) - 1), len(self.states) - 2)
        return first, (t - self._seconds[first]) / (self._seconds[first + 1] - self._seconds[first])

    def _attitude(self, t: float) -> F64:
        """Matrix that turns the axes of the sensor into those of map, at a time in s after the epoch."""
        first, fraction = self._around(t)
        before, after = self.states[first : first + 2]
        attitude = rotation_matrix(attitude_between(before.orientation, after.orientation, fraction))
        return attitude if self.mounting.is_identity else attitude @ rotation_matrix(self.mounting.rotation)

    def between(self, start_ns: int, end_ns: int) -> Trajectory:
        """The track from the last state at or before `start_ns` to the first at or after `end_ns`, if it has them."""
        stamps = [state.stamp_ns for state in self.states]
        first = max(0, bisect.bisect_right(stamps, start_ns) - 1)
        return self.of_states(self.states[first : bisect.bisect_left(stamps, end_ns) + 1])

    def followed_by(self, later: Trajectory) -> Trajectory:
        """This track up to the first state of `later`, and `later` from there on."""
        before = bisect.bisect_left(self.states, later.epoch_ns, key=lambda state: state.stamp_ns)
        return self.of_states([*self.states[:before], *later.states])

    def mounted(self, mounting: Mounting) -> Trajectory:
        """The track of a sensor on this platform."""
        return self if mounting == self.mounting else Trajectory(self.states, mounting, self.motion, self.accuracy)

    def of_states(self, states: list[PlatformState]) -> Trajectory:
        """The track by other states of the same platform."""
        return Trajectory(states, self.mounting, self.motion, self.accuracy)

    def positions(self, stamp_ns: int, seconds_after: F64) -> F64:
        """Return the positions (m) at `stamp_ns` + `seconds_after` (s, increasing), shape (times, 3).

        Raises:
            UserError: a time lies outside the track.
        """
        t = self._offsets(stamp_ns, seconds_after)
        position = np.asarray(self._position(t))
        return position if self.mounting.is_identity else position + self._turning(t).apply(self.mounting.lever_arm)

    def velocity_covariance(self, stamp_ns: int, pulse_times: F64) -> F64:
        """Covariance of the velocity ((m/s)^2, map axes, (3, 3)) in the middle of the pulses.

        It is the stated one of the nearest sample plus that of a gap around it; zeros where nobody states any.

        Raises:
            UserError: a time lies outside the track.
        """
        middle = self._middle(self._offsets(stamp_ns, pulse_times))
        nearest = self.states[self._nearest(middle)]
        attitude = rotation_matrix(nearest.orientation)
        return attitude @ self._stated(nearest)[1] @ attitude.T + np.diag(self._in_gap(middle, self.motion)[6:])

    def assumed(self, stamp_ns: int, pulse_times: F64) -> Assumed:
        """Variances that are assumed of the track at `stamp_ns` + `pulse_times` (s, increasing).

        Raises:
            UserError: a time lies outside the track.
        """
        t, motion, sigmas = self._offsets(stamp_ns, pulse_times), self.motion, self.accuracy.assumed
        seconds = float(t[0]), self._middle(t), float(t[-1])
        states = [self.states[index] for index in {self._nearest(one) for one in seconds}]
        of_samples = [shortfall(one.covariance, one.velocity_covariance, sigmas) for one in states]
        in_gaps = [self._in_gap(one, motion.with_assumed) - self._in_gap(one, motion) for one in seconds]
        gaps_s = np.diff(self._seconds)[[self._around(one)[0] for one in seconds]]
        return Assumed(np.max(of_samples, axis=0), np.max(in_gaps, axis=0), float(gaps_s.max()))

    def nearest(self, stamp_ns: int, pulse_times: F64) -> PlatformState:
        """The sample nearest to the middle of the pulses at `stamp_ns` + `pulse_times` (s, increasing).

        Raises:
            UserError: a time lies outside the track.
        """
        return self.states[self._nearest(self._middle(self._offsets(stamp_ns, pulse_times)))]

    def aperture(self, stamp_ns: int, pulse_times: F64) -> ApertureState:
        """Return the state in the middle of the pulses at `stamp_ns` + `pulse_times` (s, increasing).

        Its covariance is the stated one of the nearest sample plus that of a gap around it, by the accelerations that
        are stated or that samples show; zeros where nobody states any.

        Raises:
            UserError: a time lies outside the track, or the platform stands still.
        """
        t = self._offsets(stamp_ns, pulse_times)
        middle = self._middle(t)
        position, velocity = self._antenna(middle)
        speed = float(np.linalg.norm(velocity))
        if not speed > 0:
            raise UserError("The odometry's velocity is 0 in the aperture; a synthetic aperture needs motion.")
        nearest = self.states[self._nearest(middle)]
        return ApertureState(
            position=position,
            velocity=velocity,
            rotation=self._attitude(middle),
            length=speed * float(t[-1] - t[0]) * len(t) / (len(t) - 1),
            covariance=antenna_covariance(
                self._stated(nearest)[0] + np.diag(self._in_gap(middle, self.motion)[:6]),
                nearest.orientation,
                self.mounting,
            ),
        )

    def _stated(self, state: PlatformState) -> tuple[F64, F64]:
        """Covariances of pose and velocity of a sample, by itself or, where it states none, by the stated accuracy."""
        more = shortfall(state.covariance, state.velocity_covariance, self.accuracy.stated)
        pose, velocity = known_pose(state.covariance), known_velocity(state.velocity_covariance)
        return pose + np.diag(more[:6]), velocity + np.diag(more[6:])

    def _in_gap(self, t: float, motion: Motion) -> F64:
        """Variances of pose and velocity by a motion between two samples at t s after the epoch, shape (AXES,).

        If the track does not state its acceleration, at least the one that the two samples show counts.
        """
        first, _ = self._around(t)
        if self.motion.acceleration < 0:
            shown = shown_acceleration(*self.states[first : first + 2])
            motion = replace(motion, acceleration=max(motion.acceleration, shown))
        return motion.variances(t - self._seconds[first], self._seconds[first + 1] - t)

    def _middle(self, t: F64) -> float:
        """The middle of times in s after the epoch."""
        return float(np.clip((t[0] + t[-1]) / 2, self._seconds[0], self._seconds[-1]))

    def _nearest(self, t: float) -> int:
        """Index of the state nearest to a time in s after the epoch."""
        first, fraction = self._around(t)
        return first + (fraction > 0.5)

    def _offsets(self, stamp_ns: int, seconds_after: F64) -> F64:
        """Times in s after the epoch; refused if one lies outside the track."""
        t = (stamp_ns - self.epoch_ns) * 1e-9 + seconds_after
        rounding = 1e-9  # s: stamps are rounded to whole nanoseconds, pulse times are not
        if t[0] < self._seconds[0] - rounding or t[-1] > self._seconds[-1] + rounding:
            raise UserError(
                f"The odometry covers {self._seconds[0]:.6f} to {self._seconds[-1]:.6f} s, the aperture "
                f"{t[0]:.6f} to {t[-1]:.6f} s of the same clock; the odometry must cover the whole aperture."
            )
        return t

    def _antenna(self, t: float | F64) -> tuple[F64, F64]:
        """Position (m) and velocity (m/s) of the antenna in map at times in s after the epoch, shape (..., 3)."""
        position, velocity = np.asarray(self._position(t)), np.asarray(self._position(t, 1))
        if self.mounting.is_identity:
            return position, velocity
        turning, arm = self._turning(t), self.mounting.lever_arm
        swept = np.cross(self._turning(t, 1), arm)  # angular velocity x arm, both in the axes of base_link
        return position + turning.apply(arm), velocity + turning.apply(swept)


def shown_acceleration(before: PlatformState, after: PlatformState) -> float:
    """Density of white acceleration by which the positions of two samples contradict their velocities.

    It gives their distance from the mean velocity over the time T between them the variance q T^3 / 12 in each
    direction. Errors of position or velocity show, too. With three components it is a rough estimate: their sum
    stands for each of them, so that it is seldom too small by much.

    Returns:
        The density, m/s^2/sqrt(Hz).
    """
    seconds = (after.stamp_ns - before.stamp_ns) * 1e-9
    off = after.position - before.position - seconds * (before.velocity + after.velocity) / 2
    return float(np.linalg.norm(off) * np.sqrt(12 / seconds**3))


def antenna_covariance(covariance: F64, orientation: F64, mounting: Mounting) -> F64:
    """Covariance of position (m^2) and rotation (rad^2) of the antenna from that of base_link, shape (6, 6).

    An error of the attitude by the small rotation e moves the antenna by e x arm, so that the covariance C becomes
    J C J^T with J = [[I, -[arm]x], [0, I]].
    """
    if mounting.is_identity:
        return covariance
    arm = Rotation.from_quat(orientation).apply(mounting.lever_arm)
    jacobian = np.eye(6)
    jacobian[:3, 3:] = np.cross(np.eye(3), arm).T  # columns are e_k x arm
    return jacobian @ covariance @ jacobian.T


def _check_velocity(states: list[PlatformState], seconds: F64) -> None:
    """Refuse velocities that contradict the positions: those that are zero or given in other axes.

    The mean velocity of two successive samples must be their distance over their time difference, within 10 % of the
    speed and three standard deviations of the positions, along the ground and upwards each: heights whose level is not
    known may be uncertain by much more than positions.
    """
    positions, velocities = np.array([s.position for s in states]), np.array([s.velocity for s in states])
    variances = position_variances(np.array([s.covariance[:3, :3] for s in states]))
    sigma = np.sqrt(np.stack([variances[:, :2].sum(axis=1), variances[:, 2]]))
    steps = np.diff(seconds)
    made = np.diff(positions, axis=0) / steps[:, None]
    stated = (velocities[1:] + velocities[:-1]) / 2
    allowed = 0.1 * np.linalg.norm(made, axis=-1) + 3 * (sigma[:, 1:] + sigma[:, :-1]) / steps
    off = made - stated
    excess = np.max(np.stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])]) - allowed, axis=0)
    if np.any(excess > 0):
        worst = int(np.argmax(excess))
        raise UserError(
            f"The odometry's twist gives a velocity of {np.round(stated[worst], 3).tolist()} m/s in map, its positions "
            f"{np.round(made[worst], 3).tolist()}; twist must be the velocity in base_link axes."
        )
