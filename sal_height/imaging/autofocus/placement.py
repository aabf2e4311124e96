"""Where the image of a dwell lies along the flight: what navigation knows, and what the Doppler centroid adds.

The middle of the beams returns the Doppler frequency 2 (v u + V e) / wavelength off that of navigation: v u is the
error of the velocity along the line of sight u, V the speed, and e the angle by which the beams look farther ahead
than the attitude says. Both move the lit ground alike in the image, by R / V times the sum. An error of the velocity
moves the image itself, one of the attitude does not. Data tell only the sum, modulo wavelength PRF / 2; navigation
states how large each part is, with the standard deviations a and V b, and so divides it (Gauss-Markov estimate)

    v u = (sum) a^2 / (a^2 + V^2 b^2 + n^2),    V e = (sum) V^2 b^2 / (a^2 + V^2 b^2 + n^2)

where n is the error of the centroid. The image is placed by the first, and the beams are looked for where the second
puts them. What is left of the first is an error along the flight, which all pixels of the dwell share.
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

FAR_OFF = 5.0
"""Standard deviations by which a Doppler centroid may differ from that of navigation."""

WRAPS_SIGMAS, MOST_WRAPS = 6.0, 10_000
"""Standard deviations of what navigation states up to which multiples of the ambiguity of velocity are weighed against
each other, and the most of them to each side."""

LOWEST_HZ, HIGHEST_HZ, FREQUENCIES = 10.0, 2000.0, 200
"""Of vibrations: below, navigation follows; rotors, propellers and engines make those between."""


@dataclass(frozen=True)
class NavigationPrior:
    """How well navigation knows the Doppler frequency of the beams' middle, as standard deviations.

    Attributes:
        speed: of the antenna along the line of sight, m/s.
        pointing: of the angle along the flight under which the beams look, rad.
        flight_speed: m/s.
    """

    speed: float
    pointing: float
    flight_speed: float

    @classmethod
    def of(cls, aperture: ApertureState, velocity_covariance: F64, sight: F64) -> Self:
        """From the covariances that odometry states; what is not stated counts as exact.

        Args:
            aperture: state of the platform with the covariance of its pose.
            velocity_covariance: (m/s)^2, map axes, shape (3, 3).
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

    def beside(self, vibration: float) -> NavigationPrior:
        """With a vibration of this standard deviation (m/s) that odometry does not contain."""
        return replace(self, speed=float(np.hypot(self.speed, vibration)))

    def allows(self, found: float, error: float) -> bool:
        """Whether a centroid (m/s) of this standard error may be; any may be if nothing is stated."""
        return not self.spread or abs(found) <= FAR_OFF * float(np.hypot(self.spread, error))


def _deviation_along(direction: F64, covariance: F64) -> float:
    """Standard deviation along a unit vector."""
    return float(np.sqrt(np.maximum(0.0, direction @ covariance @ direction)))


@dataclass(frozen=True)
class Centroid:
    """What the Doppler frequency of the beams' middle tells, as a velocity along the line of sight.

    Attributes:
        speed: beyond that of navigation, v u + V e, m/s.
        error: its standard error, m/s.
        vibration: standard deviation of the part of v u that odometry does not contain, m/s.
    """

    speed: float
    error: float
    vibration: float = 0.0


@dataclass(frozen=True)
class Placement:
    """How an image lies other than navigation says.

    Attributes:
        speed: of the antenna along the line of sight beyond that of the odometry, m/s.
        pointing: by how much farther ahead the beams look than the attitude says: the change of the cosine of the angle
            to the flight, which abeam is that of the angle, rad.
        speed_error: standard deviation of what is left of `speed`, m/s.
        centroid: from which these follow; None: it was not measured.
        by_beams: whether the image is in the middle of the beams, wherever its Doppler frequency is: what is left is an
            error of the attitude, not of the velocity.
        beams_error: standard error of the beams' middle in the image, of a strip in each of its images, as a velocity
            along the line of sight, m/s; 0: it was not measured.
        own_error: the part of `speed_error` that other dwells do not share, m/s: errors of the odometry last longer.
    """

    speed: float
    pointing: float
    speed_error: float
    centroid: Centroid | None = None
    by_beams: bool = False
    beams_error: float = 0.0
    own_error: float = 0.0

    def moved(self, antenna: F64, seconds: F64, sight: F64) -> F64:
        """Positions of the antenna (m), shape (pulses, 3), at times in s from the middle of the dwell."""
        return antenna + (self.speed * seconds)[:, None] * sight

    def pointed(self, aperture: ApertureState, sight: F64) -> ApertureState:
        """The aperture as it looked."""
        axis = np.cross(sight, aperture.direction)
        turn = Rotation.from_rotvec(self.pointing * axis / (axis @ axis))
        return replace(aperture, rotation=turn.as_matrix() @ aperture.rotation)

    def seen_from(self, aperture: ApertureState, sight: F64, slant_range: float) -> ApertureState:
        """The aperture as it flew and looked, with what is left of the error along the flight in its covariance."""
        covariance = np.array(aperture.covariance, dtype=np.float64)
        along = self.speed_error * slant_range / np.linalg.norm(aperture.velocity) * shift_along(aperture, sight)
        covariance[:3, :3] += np.outer(along, along)
        velocity = aperture.velocity + self.speed * sight
        return replace(self.pointed(aperture, sight), velocity=velocity, covariance=covariance)


AS_NAVIGATED = Placement(0.0, 0.0, 0.0)
"""An image where an exact navigation puts it."""


def placed_by_navigation(prior: NavigationPrior) -> Placement:
    """Where navigation alone puts an image."""
    return Placement(0.0, 0.0, prior.speed)


def placed_by_centroid(centroid: Centroid, prior: NavigationPrior, ambiguity: float) -> Placement:
    """Where the Doppler centroid and navigation together put an image.

    Args:
        centroid: that was found.
        prior: what navigation knows. If it states nothing, all is taken for an error of the attitude, and the
            image stays.
        ambiguity: wavelength PRF / 2, m/s. Other multiples of it are weighed by the prior.
    """
    found, error = centroid.speed, centroid.error
    if not prior.spread:
        return Placement(0.0, found / prior.flight_speed, 0.0, centroid)
    prior = prior.beside(centroid.vibration)
    variance = prior.spread**2 + error**2
    of_speed, of_pointing = prior.speed**2 / variance, (prior.flight_speed * prior.pointing) ** 2 / variance
    most = int(min(np.ceil(WRAPS_SIGMAS * np.sqrt(variance) / ambiguity), MOST_WRAPS))
    wraps = ambiguity * np.arange(-most, most + 1)
    exponent = -((found + wraps) ** 2) / (2 * variance)
    weights = np.exp(exponent - exponent.max())
    wrapped = np.sum(weights * wraps**2) / weights.sum()
    # A wrap more moves image and beams together, and so the image off the beams' middle by what is not its part.
    left = prior.speed**2 * (1 - of_speed) + (1 - of_speed) ** 2 * wrapped
    own = (1 - of_speed) ** 2 * (centroid.vibration**2 + wrapped) + (of_speed * error) ** 2
    pointing, errors = of_pointing * found / prior.flight_speed, np.sqrt([left, own])
    return Placement(of_speed * found, pointing, float(errors[0]), centroid, own_error=float(errors[1]))


def placed_by_beams(prior: NavigationPrior, error: float) -> Placement:
    """An image in the middle of the beams, whose angle alone says where that is.

    Args:
        prior: what navigation knows.
        error: standard error of the beams' middle in the image, as a velocity along the line of sight, m/s.
    """
    whole = float(np.hypot(prior.flight_speed * prior.pointing, error))
    return Placement(0.0, 0.0, whole, by_beams=True, own_error=error)


def vibration_speed(phase: F64, seconds: F64, wavelength: float) -> float:
    """Standard deviation (m/s) of the mean velocity by a vibration, from the rest of its phase over a dwell.

    A vibration of unknown frequency is taken to have the same power of velocity in every octave from LOWEST_HZ to
    HIGHEST_HZ. How much of it is a curvature of the phase, of the second or third order, and how much the trend that
    cannot be told from an error of navigation, follows from the length of the dwell; the curvature tells its power.

    Args:
        phase: without mean and linear trend, rad, shape (pulses,).
        seconds: times of the pulses, s.
        wavelength: m.
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
    omega, order = 2 * np.pi * np.geomspace(LOWEST_HZ, HIGHEST_HZ, FREQUENCIES), np.arange(1, 4)
    waves = (2 * order + 1)[:, None] * spherical_jn(order[:, None], omega * duration / 2) / omega
    return tuple(np.mean(waves**2, axis=1).tolist())


def place_image(focus: Focus, pulse_times: F64, wavelength: float, prior: NavigationPrior) -> tuple[Focus, Placement]:
    """The phase to remove from a dwell, and where its image then lies.

    Where the phase steps at random from pulse to pulse, its trend is that of nothing: it is removed as well, so that
    the image is in the middle of the beams, whose angle alone says where that is.

    Args:
        focus: what autofocus has found, to be trusted.
        pulse_times: s, shape (pulses,).
        wavelength: m.
        prior: what navigation knows.

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
        focus: what autofocus has found, to be trusted.
        pulse_times: s, shape (pulses,).
        wavelength: m.
        prior: what navigation knows.

    Raises:
        Rejected: the Doppler centroid contradicts navigation.
    """
    of_a_radian = speed_of_a_radian(pulse_times, wavelength)
    found, error = of_a_radian * focus.trend, of_a_radian * focus.trend_error
    vibration = vibration_speed(focus.phase, pulse_times, wavelength) if prior.spread else 0.0
    known = prior.beside(vibration)
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
