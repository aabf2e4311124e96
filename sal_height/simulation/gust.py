"""Motion of the platform about its track by gusts, and the part of it that the antenna's mount transmits.

Gusts have the Dryden spectra of MIL-F-8785C for medium and high altitude, equal in all axes. The aircraft follows
them with a lag, and its autopilot brings it back to the track. The motion is a sum of harmonics of random phases, so
that position, velocity and attitude are known exactly at any time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.constants import g
from scipy.spatial.transform import Rotation

from sal_height.numeric import F64
from sal_height.simulation.harmonics import Harmonics

MOUNT_RESIDUAL = 2e-4  # fraction of the aircraft's turns that the stabilised mount of the antenna transmits
SLOWEST, FASTEST = 0.02, 60.0  # rad/s: below, the autopilot leaves nothing; above, the airframe's inertia


def gust_spectra(omega: F64, speed: float) -> F64:
    """Dryden spectra of a gust of 1 m/s rms along, left and up, (m/s)^2 per rad/s over omega > 0, (..., 3)."""
    scale = 533.4  # m: 1750 ft, scale of the turbulence in all axes above 2000 ft
    x = scale / speed * omega
    along = 2 / (1 + x**2)
    across = (1 + 3 * x**2) / (1 + x**2) ** 2
    return scale / (np.pi * speed) * np.stack([along, across, across], axis=-1)


def response(omega: F64) -> F64:
    """Amplitude of the aircraft's velocity over that of the gust."""
    lag = 1 / np.hypot(1, 0.5 * omega)  # s, with which the aircraft follows the velocity of the air
    bandwidth, damping = 0.3, 0.7  # natural frequency, rad/s, and damping of the autopilot that keeps the track
    corrected = omega**2 / np.hypot(bandwidth**2 - omega**2, 2 * damping * bandwidth * omega)
    return lag * corrected


@dataclass(frozen=True, eq=False)
class GustMotion(Harmonics):
    """Motion about the track, on top of level flight eastwards: along, left and up.

    Attributes:
        speed: speed of the flight, m/s.
    """

    speed: float

    def rotation(self, seconds: npt.ArrayLike) -> Rotation:
        """Attitude of the mount's axes: level and eastwards, except for the fraction of turns that the mount transmits.

        The aircraft banks by the acceleration to its right over g, and pitches and yaws with the direction of flight.
        """
        velocity, sideways = self.velocity(seconds), self.acceleration(seconds)[..., 1]
        yaw, pitch, roll = velocity[..., 1] / self.speed, -velocity[..., 2] / self.speed, -sideways / g
        return Rotation.from_euler("ZYX", MOUNT_RESIDUAL * np.stack([yaw, pitch, roll], axis=-1))


def gust_motion(gust: float, speed: float, rng: np.random.Generator) -> GustMotion:
    """Motion in gusts of `gust` (m/s rms in each axis) at `speed` (m/s)."""
    count = 150  # harmonics
    edges = np.geomspace(SLOWEST, FASTEST, count + 1)
    omega = np.sqrt(edges[1:] * edges[:-1])
    spectra = gust_spectra(omega, speed) * response(omega)[:, None] ** 2
    return GustMotion(
        speed=speed,
        omega=omega,
        amplitude=gust * np.sqrt(2 * spectra * np.diff(edges)[:, None]),
        phase=rng.uniform(0, 2 * np.pi, (count, 3)),
    )
