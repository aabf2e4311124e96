"""Phase of the echoes of a pulse that neither odometry nor sensor description contains: vibration, and laser phase.

Both are the same in all detectors. A vibration moves the antenna along the line of sight by far less than a range cell,
by the same distance for all lit ground, constant within a pulse. The phase of a laser of finite linewidth is a random
walk, and an echo is mixed with the laser when it returns. Within a pulse it is assumed to be constant as well, or else
(`laser_within_pulse`) to drift from sample to sample, as of the middle of the range window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from pydantic_core import PydanticCustomError
from scipy import constants

from sal_height.configuration import Float, StrictKeys
from sal_height.numeric import F64
from sal_height.simulation.harmonics import Harmonics

Frequency = Annotated[Float, Gt(0), Le(1e6)]


@dataclass(frozen=True)
class VibrationLine(StrictKeys):
    """A sinusoidal vibration along the line of sight, as of a rotor or a propeller, of random phase.

    Attributes:
        amplitude_m: amplitude of the displacement, m.
        frequency_hz: frequency, Hz.
    """

    amplitude_m: Annotated[Float, Ge(0), Le(1)]
    frequency_hz: Frequency


@dataclass(frozen=True)
class VibrationBand(StrictKeys):
    """A vibration along the line of sight whose acceleration has one spectral density over a band.

    Attributes:
        density_g2_per_hz: spectral density of the acceleration, squares of standard gravity per Hz, as of vibration
            tests.
        lowest_hz: lowest frequency of the band, Hz.
        highest_hz: highest frequency of the band, Hz.
    """

    density_g2_per_hz: Annotated[Float, Ge(0), Le(100)]
    lowest_hz: Frequency
    highest_hz: Frequency

    def __post_init__(self) -> None:
        if not self.lowest_hz < self.highest_hz:
            raise PydanticCustomError("band", "its lowest_hz must be below its highest_hz")

    @property
    def lines(self) -> list[VibrationLine]:
        """Lines of the same power, evenly spaced in the logarithm of frequency."""
        edges = np.geomspace(self.lowest_hz, self.highest_hz, 201)  # of 200 harmonics
        frequency = np.sqrt(edges[1:] * edges[:-1])
        acceleration = constants.g * np.sqrt(2 * self.density_g2_per_hz * np.diff(edges))
        amplitude = acceleration / (2 * np.pi * frequency) ** 2
        return [VibrationLine(*pair) for pair in zip(amplitude.tolist(), frequency.tolist(), strict=True)]


@dataclass(frozen=True)
class Vibration(StrictKeys):
    """Vibration of the antenna; by default none.

    Attributes:
        lines: sinusoidal vibrations.
        bands: random ones.
    """

    lines: tuple[VibrationLine, ...] = ()
    bands: tuple[VibrationBand, ...] = ()

    @property
    def is_none(self) -> bool:
        """True if nothing vibrates."""
        return not (self.lines or self.bands)

    @property
    def all_lines(self) -> list[VibrationLine]:
        """The lines, and those that the bands are made of."""
        return [*self.lines, *(line for band in self.bands for line in band.lines)]

    def drawn(self, rng: np.random.Generator) -> Harmonics:
        """The vibration of a flight; its displacement (m, away from the scene) has one component."""
        lines = self.all_lines
        omega = 2 * np.pi * np.array([line.frequency_hz for line in lines])
        speed = omega * np.array([line.amplitude_m for line in lines])
        return Harmonics(omega, speed[:, None], rng.uniform(0, 2 * np.pi, (len(lines), 1)))


AT_REST = Vibration()
"""An antenna that does not vibrate."""


def laser_phase(linewidth_hz: float, seconds: F64, slant_range_m: float, rng: np.random.Generator) -> F64:
    """Phase (rad) of echoes of a laser mixed with the laser itself, in the shape of `seconds`.

    The phase of a Lorentzian line is a Wiener process, whose variance grows by 2 pi linewidth in a second. Over a time
    t the phase of the echoes changes with a variance of 4 pi linewidth min(t, 2 R / c). A beat note keeps the fraction
    exp(-4 pi linewidth R / c) of its power, and the rest is spread (Richter, Mandelberg, Kruger and McGrath, IEEE J.
    Quantum Electron. 22, 1986); in pulses shorter than 2 R / c more of it is still in the resolution cell.

    Args:
        linewidth_hz: full width at half maximum, Hz.
        seconds: times at which echoes return, of any shape, s.
        slant_range_m: slant range R of the scene, m.
        rng: generator of the random walk.
    """
    if not linewidth_hz:
        return np.zeros(seconds.shape)
    sent = seconds - 2 * slant_range_m / constants.speed_of_light
    times, place = np.unique(np.stack([seconds, sent]), return_inverse=True)
    steps = rng.standard_normal(len(times) - 1) * np.sqrt(2 * np.pi * linewidth_hz * np.diff(times))
    back, out = np.concatenate([[0.0], np.cumsum(steps)])[place.reshape(2, *seconds.shape)]
    return np.asarray(out - back)


def laser_structure(linewidth_hz: float, slant_range_m: float) -> Callable[[F64], F64]:
    """Mean square of the difference (rad^2) of two values of `laser_phase`, by the time between them (s)."""
    under_way = 2 * slant_range_m / constants.speed_of_light
    return lambda lag: 4 * np.pi * linewidth_hz * np.minimum(lag, under_way)
