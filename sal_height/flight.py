"""A simulated flight: straight and level eastwards past the middle of the scene, one dwell after the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sal_height.geometry import Aperture, look_direction, sphere_point
from sal_height.phase_history import PhaseHistory
from sal_height.preset import Preset
from sal_height.scene import Scene, VisibleSurface, visible_surface
from sal_height.sensor import Sensor
from sal_height.simulator import draw_amplitudes, receiver_noise, simulate_dwell
from sal_height.trajectory import PlatformState
from sal_height.waveform import echo_sensor, from_spectrum, spectrum_sensor

Array = npt.NDArray[np.float64]

LIT_BEAMWIDTHS = 1.0
"""Ground to each side of the beam's middle, along the flight, that a dwell lights up; in beamwidths."""


@dataclass(frozen=True)
class SimulatedFlight:
    """Everything a simulated run is made of; each dwell follows from it and a seed alone.

    Attributes:
        preset: sensor, flight and CNR.
        sensor: of the preset.
        scene: the ground.
        dwells: number of dwells; they are centred on the scene.
        seed: of all random numbers.
    """

    preset: Preset
    sensor: Sensor
    scene: Scene
    dwells: int
    seed: int

    def position(self, seconds: npt.ArrayLike) -> Array:
        """Platform position (m, map) at times (s) after the start of the first dwell, shape (..., 3)."""
        flight = self.preset.flight
        aim = sphere_point(0.0, 0.0, self.scene.reference_height)
        abeam = aim - flight.slant_range_m * look_direction(flight.look_angle_rad, 0.0, self.sensor.look_side)
        start = -(self.dwells - 1) / 2 * flight.dwell_spacing_m - flight.speed_mps * self._middle_of_dwell
        along = start + flight.speed_mps * np.asarray(seconds, dtype=np.float64)
        return np.asarray(abeam + along[..., None] * np.array([1.0, 0.0, 0.0]))

    @cached_property
    def spectrum(self) -> Sensor:
        """The sensor after range compression: whose range window and resolution the images have."""
        return spectrum_sensor(self.sensor)

    @property
    def pulse_times(self) -> Array:
        """Times of the pulses after the start of their dwell, s."""
        return np.arange(self.sensor.pulse_count) / self.sensor.pulse_repetition_frequency

    @property
    def _middle_of_dwell(self) -> float:
        return float(self.pulse_times[-1]) / 2

    def dwell_start_ns(self, dwell: int) -> int:
        """Start of a dwell after the start of the first, ns."""
        return round(dwell * self.preset.flight.dwell_spacing_m / self.preset.flight.speed_mps * 1e9)

    def platform_states(self, dwell: int) -> list[PlatformState]:
        """Odometry samples that a dwell adds, at the preset's rate, up to one past its end; stamps after the start."""
        period_ns = round(1e9 / self.preset.flight.odometry_rate_hz)
        margin = 2

        def last_sample(number: int) -> int:
            return (self.dwell_start_ns(number) + round(float(self.pulse_times[-1]) * 1e9)) // period_ns + margin

        first = last_sample(dwell - 1) + 1 if dwell else -margin
        stamps = [index * period_ns for index in range(first, last_sample(dwell) + 1)]
        velocity = np.array([self.preset.flight.speed_mps, 0.0, 0.0])
        level = np.array([0.0, 0.0, 0.0, 1.0])
        return [PlatformState(s, self.position(s * 1e-9), level, velocity, np.zeros((6, 6))) for s in stamps]

    def aperture(self, dwell: int) -> Aperture:
        """State in the middle of a dwell's aperture."""
        speed = self.preset.flight.speed_mps
        return Aperture(
            position=self.position(self.dwell_start_ns(dwell) * 1e-9 + self._middle_of_dwell),
            velocity=np.array([speed, 0.0, 0.0]),
            rotation=np.eye(3),
            length=speed * self.sensor.pulse_count / self.sensor.pulse_repetition_frequency,
            covariance=np.zeros((6, 6)),
        )

    def surface(self, dwell: int) -> VisibleSurface:
        """What the dwell illuminates: the range window, and along the flight LIT_BEAMWIDTHS to each side.

        Raises:
            UserError: there is no terrain.
        """
        aperture = self.aperture(dwell)
        reach = self.preset.flight.slant_range_m
        half_width = LIT_BEAMWIDTHS * self.sensor.beamwidth * reach
        half_window = self.spectrum.range_window / 2
        azimuth_cell = self.sensor.wavelength * reach / (2 * aperture.length)
        return visible_surface(
            self.scene,
            aperture,
            self.sensor.look_side,
            (self.spectrum.range_resolution, azimuth_cell),
            (aperture.position[0] - half_width, aperture.position[0] + half_width),
            (reach - half_window, reach + half_window),
        )

    def phase_history(self, dwell: int) -> PhaseHistory:
        """Frames of all detectors in a dwell, in the sensor's waveform, stamped after the start of the first.

        They are reproducible for (seed, dwell).

        Raises:
            UserError: there is no terrain.
        """
        rng = np.random.default_rng([self.seed, dwell])
        surface = self.surface(dwell)
        amplitudes = draw_amplitudes(surface, 10 ** (self.preset.cnr_db / 10), self.spectrum, rng)
        start_ns = self.dwell_start_ns(dwell)
        antenna = self.position(start_ns * 1e-9 + self.pulse_times)
        reference = np.full(self.sensor.pulse_count, self.preset.flight.slant_range_m)
        clean = simulate_dwell(echo_sensor(self.sensor), surface, amplitudes, antenna, reference)
        samples = from_spectrum(clean, self.sensor) + receiver_noise(self.sensor, self.sensor.pulse_count, rng)
        return PhaseHistory(start_ns, self.pulse_times, reference, samples)
