"""Placement of the image of a dwell along the flight, by navigation and the Doppler centroid.

The middle of the beams returns the Doppler frequency 2 (v u + V e) / wavelength off that of navigation: v u is the
error of the velocity along the line of sight u, V the speed, and e the pointing error ahead relative to the attitude.
Both move the lit ground alike in the image, by R / V times the sum. An error of the velocity moves the image itself,
one of the attitude does not. Data give only the sum, modulo wavelength PRF / 2; navigation states the standard
deviations a and V b of both parts, and so divides it (Gauss-Markov estimate)

    v u = (sum) a^2 / (a^2 + V^2 b^2 + n^2),    V e = (sum) V^2 b^2 / (a^2 + V^2 b^2 + n^2)

where n is the error of the centroid. The image is located by the first, and the beams by the second. The residual of
the first is a common error of all pixels of the dwell along the flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import spherical_jn

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, shift_along
from sal_height.imaging.autofocus.gradient import Focus
from sal_height.numeric import F64


@dataclass(frozen=True)
class NavigationPrior:
    """Uncertainty of the Doppler frequency of the beams' middle by navigation, as standard deviations.

    Attributes:
        speed: standard deviation of the antenna's velocity along the line of sight, m/s.
        pointing: standard deviation of the pointing of the beams along the flight, rad.
        flight_speed: speed of the flight, m/s.
    """

    speed: float
    pointing: float
    flight_speed: float

    @classmethod
    def of(cls, aperture: ApertureState, velocity_covariance: F64, sight: F64) -> Self:
        """Derive the prior from the covariances that odometry states; unstated ones are left out.

        Args:
            aperture: state of the platform with the covariance of its pose.
            velocity_covariance: covariance of the velocity, map axes, shape (3, 3), (m/s)^2.
            sight: unit vector in the middle of the beams, map axes.
        """
        turn = np.cross(sight, aperture.direction)
        speed = _deviation_along(sight, velocity_covariance)
        pointing = _deviation_along(turn, aperture.covariance[3:, 3:])
        return cls(speed, pointing, float(np.linalg.norm(aperture.velocity)))

    @property
    def spread(self) -> float:
        """Standard deviation of the sum of both as a velocity along the line of sight, m/s."""
        return float(np.hypot(self.speed, self.flight_speed * self.pointing))

    def with_vibration(self, vibration: float) -> NavigationPrior:
        """With a vibration of this standard deviation (m/s) that odometry does not contain."""
        return replace(self, speed=float(np.hypot(self.speed, vibration)))

    def allows(self, found: float, error: float) -> bool:
        """True if a centroid (m/s) of this standard error is within five sigma; always if nothing is stated."""
        return not self.spread or abs(found) <= 5.0 * float(np.hypot(self.spread, error))


def _deviation_along(direction: F64, covariance: F64) -> float:
    """Standard deviation along a unit vector."""
    return float(np.sqrt(np.maximum(0.0, direction @ covariance @ direction)))


@dataclass(frozen=True)
class Centroid:
    """Measured Doppler frequency of the beams' middle, as a velocity along the line of sight.

    Attributes:
        speed: velocity relative to that of navigation, v u + V e, m/s.
        error: standard error of the velocity, m/s.
        vibration: standard deviation of the part of v u that odometry does not contain, m/s.
    """

    speed: float
    error: float
    vibration: float = 0.0


@dataclass(frozen=True)
class Placement:
    """Placement of an image relative to navigation.

    Attributes:
        speed: velocity of the antenna along the line of sight relative to the odometry, m/s.
        pointing: pointing of the beams ahead relative to the attitude, as the change of the cosine of the angle to the
            flight, which abeam is that of the angle, rad.
        speed_error: standard deviation of the residual of `speed`, m/s.
        centroid: centroid from which these follow; None: it was not measured.
        by_beams: True if the image is in the middle of the beams, whatever its Doppler frequency: the residual is an
            error of the attitude, not of the velocity.
        beams_error: standard error of the beams' middle in the image, of a strip in each of its images, as a velocity
            along the line of sight, m/s; 0: it was not measured.
        own_error: part of `speed_error` that is independent in each dwell, m/s: errors of the odometry last longer.
    """

    speed: float
    pointing: float
    speed_error: float
    centroid: Centroid | None = None
    by_beams: bool = False
    beams_error: float = 0.0
    own_error: float = 0.0

    def residual_speed(self, speed: float, pointing: float) -> float:
        """Standard deviation of the residual of `speed` by errors that navigation does not state, m/s.

        What was taken for an error of the velocity may be one of a pointing that nobody states.

        Args:
            speed: standard deviation of the velocity of the antenna along the line of sight, m/s.
            pointing: standard deviation of the pointing of the beams along the flight times the speed of flight, m/s.
        """
        if self.by_beams:
            return pointing
        return float(np.hypot(speed, self.speed)) if pointing else speed

    def moved(self, antenna: F64, seconds: F64, sight: F64) -> F64:
        """Positions of the antenna (m), shape (pulses, 3), at times in s from the middle of the dwell."""
        return antenna + (self.speed * seconds)[:, None] * sight

    def pointed(self, aperture: ApertureState, sight: F64) -> ApertureState:
        """The aperture as it looked."""
        axis = np.cross(sight, aperture.direction)
        turn = Rotation.from_rotvec(self.pointing * axis / (axis @ axis))
        return replace(aperture, rotation=turn.as_matrix() @ aperture.rotation)

    def seen_from(self, aperture: ApertureState, sight: F64, slant_range: float) -> ApertureState:
        """The corrected aperture, with the residual error along the flight in its covariance."""
        covariance = np.array(aperture.covariance, dtype=np.float64)
        along = self.speed_error * slant_range / np.linalg.norm(aperture.velocity) * shift_along(aperture, sight)
        covariance[:3, :3] += np.outer(along, along)
        velocity = aperture.velocity + self.speed * sight
        return replace(self.pointed(aperture, sight), velocity=velocity, covariance=covariance)


AS_NAVIGATED = Placement(0.0, 0.0, 0.0)
"""An image where an exact navigation puts it."""


def placed_by_navigation(prior: NavigationPrior) -> Placement:
    """Placement of an image by navigation alone."""
    return Placement(0.0, 0.0, prior.speed)


def placed_by_centroid(centroid: Centroid, prior: NavigationPrior, ambiguity: float) -> Placement:
    """Placement of an image by the Doppler centroid and navigation together.

    Args:
        centroid: measured centroid.
        prior: uncertainty of navigation. If it states nothing, all is assumed to be an error of the attitude, and
            the image stays.
        ambiguity: wavelength PRF / 2, m/s. Other multiples of it are weighed by the prior.
    """
    found, error = centroid.speed, centroid.error
    if not prior.spread:
        return Placement(0.0, found / prior.flight_speed, 0.0, centroid)
    prior = prior.with_vibration(centroid.vibration)
    variance = prior.spread**2 + error**2
    of_speed, of_pointing = prior.speed**2 / variance, (prior.flight_speed * prior.pointing) ** 2 / variance
    # Multiples of the ambiguity within six standard deviations of navigation are weighed against each other.
    most = int(min(np.ceil(6.0 * np.sqrt(variance) / ambiguity), 10_000))
    wraps = ambiguity * np.arange(-most, most + 1)
    exponent = -((found + wraps) ** 2) / (2 * variance)
    weights = np.exp(exponent - exponent.max())
    wrapped = np.sum(weights * wraps**2) / weights.sum()
    # A further wrap moves image and beams together, and so the image off the beams' middle by the part of the beams.
    left = prior.speed**2 * (1 - of_speed) + (1 - of_speed) ** 2 * wrapped
    own = (1 - of_speed) ** 2 * (centroid.vibration**2 + wrapped) + (of_speed * error) ** 2
    pointing, errors = of_pointing * found / prior.flight_speed, np.sqrt([left, own])
    return Placement(of_speed * found, pointing, float(errors[0]), centroid, own_error=float(errors[1]))


def placed_by_beams(prior: NavigationPrior, error: float) -> Placement:
    """Placement of an image in the middle of the beams, which only their angle determines.

    Args:
        prior: uncertainty of navigation.
        error: standard error of the beams' middle in the image, as a velocity along the line of sight, m/s.
    """
    whole = float(np.hypot(prior.flight_speed * prior.pointing, error))
    return Placement(0.0, 0.0, whole, by_beams=True, own_error=error)


def vibration_speed(phase: F64, seconds: F64, wavelength: float) -> float:
    """Standard deviation (m/s) of the mean velocity by a vibration, from the rest of its phase over a dwell.

    A vibration of unknown frequency is assumed to have the same power of velocity in every octave from 10 Hz to 2 kHz,
    as by rotors, propellers and engines; below, navigation follows. The parts that are a curvature of the phase, of the
    second or third order, and the trend, which cannot be separated from an error of navigation, follow from the length
    of the dwell; the curvature gives its power.

    Args:
        phase: phase without mean and linear trend, rad, shape (pulses,).
        seconds: times of the pulses, s.
        wavelength: wavelength, m.
    """
    duration = float(seconds[-1] - seconds[0])
    of_trend, *of_curvature = _powers_of_vibration(duration)
    shapes = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(phase)), 3)
    curvature = np.linalg.lstsq(shapes, phase)[0][2:] ** 2 / np.array(of_curvature)
    trend = np.sqrt(of_trend * curvature.mean())  # at the ends of the dwell, rad
    return float(trend * 2 / duration * wavelength / (4 * np.pi))


@lru_cache(maxsize=4)
def _powers_of_vibration(duration: float) -> tuple[float, ...]:
    """Powers of Legendre's polynomials of orders 1 to 3 in the displacement of a vibration over a dwell, per velocity.

    A displacement exp(j omega t) / omega, whose velocity has the amplitude 1, has the parts
    (2 k + 1) j^k j_k(omega T / 2) (Abramowitz & Stegun, 10.1.47).
    """
    omega, order = 2 * np.pi * np.geomspace(10.0, 2000.0, 200), np.arange(1, 4)
    waves = (2 * order + 1)[:, None] * spherical_jn(order[:, None], omega * duration / 2) / omega
    return tuple(np.mean(waves**2, axis=1).tolist())


def place_image(focus: Focus, pulse_times: F64, wavelength: float, prior: NavigationPrior) -> tuple[Focus, Placement]:
    """The phase to remove from a dwell, and the placement of its image then.

    If the phase steps at random from pulse to pulse, its trend has no meaning: it is removed as well, so that the image
    is in the middle of the beams, which only their angle determines.

    Args:
        focus: result of autofocus that is trusted.
        pulse_times: times of the pulses, s, shape (pulses,).
        wavelength: wavelength of the carrier, m.
        prior: prior from navigation.

    Raises:
        Rejected: the Doppler centroid contradicts navigation.
    """
    if not focus.finds_beams:
        return focus, placed_by_navigation(prior)
    pulses = len(pulse_times)
    of_a_radian = speed_of_a_radian(pulse_times, wavelength)
    beams_error = of_a_radian * focus.trend_error
    if focus.is_smooth:
        centroid = centroid_of(focus, pulse_times, wavelength, prior)
        placement = placed_by_centroid(centroid, prior, 2 * np.pi * of_a_radian)
    else:
        centred = focus.phase + focus.trend * (np.arange(pulses) - (pulses - 1) / 2)
        focus, placement = replace(focus, phase=centred, trend=0.0), placed_by_beams(prior, beams_error)
    return focus, replace(placement, beams_error=beams_error)


def centroid_of(focus: Focus, pulse_times: F64, wavelength: float, prior: NavigationPrior) -> Centroid:
    """The Doppler centroid by the trend of a phase that is smooth.

    Args:
        focus: result of autofocus that is trusted.
        pulse_times: times of the pulses, s, shape (pulses,).
        wavelength: wavelength of the carrier, m.
        prior: prior from navigation.

    Raises:
        Rejected: the Doppler centroid contradicts navigation.
    """
    of_a_radian = speed_of_a_radian(pulse_times, wavelength)
    found, error = of_a_radian * focus.trend, of_a_radian * focus.trend_error
    vibration = vibration_speed(focus.phase, pulse_times, wavelength) if prior.spread else 0.0
    known = prior.with_vibration(vibration)
    if not known.allows(found, error):
        raise Rejected(
            "Doppler centroid contradicts navigation",
            f"The beams' middle is at a Doppler that is {found:.3g} m/s of velocity along the line of sight off that "
            f"of the odometry, which states {known.spread:.2g} m/s for velocity and pointing together; attitude, "
            "boresights or the stated covariances must be wrong.",
        )
    return Centroid(found, error, vibration)


def speed_of_a_radian(pulse_times: F64, wavelength: float) -> float:
    """Velocity along the line of sight (m/s) by which the phase turns by 1 rad from pulse to pulse."""
    interval = float(pulse_times[-1] - pulse_times[0]) / (len(pulse_times) - 1)
    return wavelength / (4 * np.pi * interval)
