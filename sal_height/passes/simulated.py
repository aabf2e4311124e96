"""Passes over point reflectors by a radar on a circle around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light

from sal_height.numeric import C128, F64
from sal_height.passes.flown import Pass
from sal_height.sensor import PhaseHistory, Sensor

GOTCHA_ELEVATIONS = tuple(np.radians([45.66, 44.01, 43.92, 44.18, 44.14, 43.53, 43.01, 43.06]).tolist())
"""Elevation angles of the eight passes of AFRL's Gotcha set over the horizon, rad, as published with it."""


@dataclass(frozen=True)
class Circle:
    """Passes on arcs of circles around the middle of the scene, which is the origin of map.

    Attributes:
        elevations: elevations over the horizon under which each pass is seen from there, rad.
        distance: distance from there, m.
        arc: azimuths of a pass, rad.
        pulses: number of pulses of a pass.
        frequencies: number of frequencies of a pulse.
        frequency: middle of the band, Hz.
        bandwidth: bandwidth, Hz.
        speed: speed of flight, m/s.
    """

    elevations: Sequence[float] = GOTCHA_ELEVATIONS
    distance: float = 10e3
    arc: float = np.radians(3.0)
    pulses: int = 100
    frequencies: int = 192
    frequency: float = 9.6e9
    bandwidth: float = 640e6
    speed: float = 100.0

    def antenna(self, number: int) -> F64:
        """Positions of the antenna on a pass, m, shape (pulses, 3)."""
        azimuth = self.arc * np.linspace(-0.5, 0.5, self.pulses)
        elevation = self.elevations[number]
        level = self.distance * np.cos(elevation)
        height = np.full(self.pulses, self.distance * np.sin(elevation))
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=-1)

    def seconds(self, number: int) -> F64:
        """Times of the pulses of a pass after the first one, s."""
        reach = self.arc * self.distance * np.cos(self.elevations[number])
        return np.linspace(0.0, reach / self.speed, self.pulses)

    def sensor(self, number: int, noise_power: float) -> Sensor:
        """The sensor of a pass: one receiver, whose beam is so wide that pulses sample it."""
        wavelength = speed_of_light / self.frequency
        step = self.arc * self.distance * np.cos(self.elevations[number]) / (self.pulses - 1)
        return Sensor(
            name=f"pass_{number + 1}",
            look_side=-1,
            wavelength=wavelength,
            bandwidth=self.bandwidth,
            sample_count=self.frequencies,
            pulse_count=self.pulses,
            pulse_repetition_frequency=self.speed / step,
            elevation_diameter=2.1 * step,
            azimuth_diameter=2.1 * step,
            pattern="sinc",
            elevation_boresights=(np.pi / 2 - self.elevations[number],),
            noise_power=(noise_power,),
        )


def simulated_passes(
    circle: Circle,
    points: F64,
    amplitudes: C128,
    noise_power: float,
    rng: np.random.Generator,
    phases: F64 | None = None,
    offsets: F64 | None = None,
) -> list[Pass]:
    """Passes over point reflectors in noise.

    Args:
        circle: arcs of the passes.
        points: positions of the reflectors in map, shape (points, 3), m.
        amplitudes: amplitudes of the points in a sample, shape (points,), or (passes, points).
        noise_power: power of the noise of a sample, E|n|^2.
        rng: generator of the noise.
        phases: phases of the passes, (passes,), None: 0, rad.
        offsets: offsets of the antennas from their stated positions, shape (passes, 3), None: 0, m.
    """
    count = len(circle.elevations)
    each = np.broadcast_to(amplitudes, (count, len(points)))
    turns = np.zeros(count) if phases is None else phases
    off = np.zeros((count, 3)) if offsets is None else offsets
    passes = []
    for number in range(count):
        stated = circle.antenna(number)
        sensor = circle.sensor(number, noise_power)
        reference = np.linalg.norm(stated, axis=-1)
        samples = _echoes(sensor, stated + off[number], reference, points, each[number] * np.exp(1j * turns[number]))
        noise = rng.standard_normal((*samples.shape, 2)) @ np.array([1.0, 1j])
        samples = samples + np.sqrt(noise_power / 2) * noise
        history = PhaseHistory(0, circle.seconds(number), reference, samples[None].astype(np.complex64))
        passes.append(Pass(sensor.name, sensor, history, stated))
    return passes


def _echoes(sensor: Sensor, antenna: F64, reference: F64, points: F64, amplitudes: C128) -> C128:
    """Echoes of points, shape (pulses, frequencies)."""
    number = np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2
    echoes = np.zeros((len(antenna), sensor.sample_count), np.complex128)
    middle, step = 4 * np.pi / sensor.wavelength, sensor.wavenumber_step
    for point, amplitude in zip(points, amplitudes, strict=True):
        longer = np.linalg.norm(antenna - point, axis=-1) - reference
        first = np.exp(-1j * (middle + number[0] * step) * longer)
        # The phase grows evenly from frequency to frequency.
        turned = np.exp(-1j * step * np.multiply.outer(longer, np.arange(sensor.sample_count)))
        echoes += amplitude * first[:, None] * turned
    return echoes
