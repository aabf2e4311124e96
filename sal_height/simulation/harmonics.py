"""Random motion as a sum of harmonics of random phases: its derivatives and integral are known exactly at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.numeric import F64


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Velocities in one or more axes, their derivative and their integral.

    Attributes:
        omega: angular frequencies of the harmonics, rad/s, shape (harmonics,).
        amplitude: amplitude of the velocity in each axis, shape (harmonics, axes).
        phase: phase in each axis, rad, shape (harmonics, axes).
    """

    omega: F64
    amplitude: F64
    phase: F64

    def displacement(self, seconds: npt.ArrayLike) -> F64:
        """Integral of `velocity`, without a mean, at times in s, shape (..., axes)."""
        return self._sum(seconds, -1, -np.pi / 2)

    def velocity(self, seconds: npt.ArrayLike) -> F64:
        """Velocity in each axis, at times in s, shape (..., axes)."""
        return self._sum(seconds, 0, 0.0)

    def acceleration(self, seconds: npt.ArrayLike) -> F64:
        """Derivative of `velocity`, per s."""
        return self._sum(seconds, 1, np.pi / 2)

    def _sum(self, seconds: npt.ArrayLike, power: int, lead: float) -> F64:
        """Sum of harmonics whose amplitudes are multiplied by a power of omega, `lead` rad ahead of the velocity's."""
        if not np.any(self.amplitude):  # the sum takes a millisecond for the pulses of a dwell
            return np.zeros((*np.shape(seconds), self.amplitude.shape[1]))
        turn = np.asarray(seconds, dtype=np.float64)[..., None] * self.omega
        wave = np.cos(turn[..., None] + self.phase + lead)
        return np.einsum("...ha,ha->...a", wave, self.amplitude * self.omega[:, None] ** float(power))
