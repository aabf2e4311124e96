"""Dwells to measure on: geometry, sensor and pixels of a straight flight, and samples to fill them with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.geometry import Grid, look_direction
from sal_height.imaging import FormImages, Processing
from sal_height.numeric import C64, F64
from sal_height.sensor import PhaseHistory, Sensor, aperture_length, processed_angle
from sal_height.simulation import VisibleSurface, load_preset, simulate_block

SLANT_RANGE = 5000.0
"""Of the middle of the image, m."""

LOOK_ANGLE = np.pi / 4
"""Of the middle of the beams, rad from nadir."""


@dataclass(frozen=True)
class Case:
    """Arguments of an image former."""

    history: PhaseHistory
    antenna: F64
    sensor: Sensor
    processing: Processing
    grid: Grid

    def form(self, former: FormImages) -> C64:
        """Images of all detectors by `former`."""
        return former(self.history, self.antenna, self.sensor, self.processing, self.grid)

    def detector(self, index: int) -> Case:
        """The case with one detector only."""
        only = slice(index, index + 1)
        sensor = replace(
            self.sensor,
            elevation_boresights=self.sensor.elevation_boresights[only],
            noise_power=self.sensor.noise_power[only],
        )
        return replace(self, sensor=sensor, history=replace(self.history, samples=self.history.samples[only]))


def spotlight(detectors: int, pulses: int, frequencies: int, rows: int, cols: int) -> Case:
    """The lidar of preset sal_spotlight at 2.5 GHz, one pulse every 1.25 mm; samples are noise."""
    sensor = replace(_sensor("sal_spotlight", detectors, pulses, frequencies), bandwidth=2.5e9, config_hash="")
    antenna = _track(pulses, 1.25e-3)
    col_spacing = sensor.wavelength * SLANT_RANGE / (2 * pulses * 1.25e-3)
    grid = _slant_plane(sensor, rows, cols, col_spacing)
    return Case(_noise(sensor), antenna, sensor, Processing("taylor"), grid)


def stripmap(detectors: int, pulses: int, frequencies: int, rows: int) -> Case:
    """The lidar of preset sal_stripmap, one pulse every 4.8 mm, all columns whose apertures are full; noise."""
    sensor = _sensor("sal_stripmap", detectors, pulses, frequencies)
    spacing, angle = 4.8e-3, processed_angle(sensor)
    cols = int(pulses - aperture_length(sensor, SLANT_RANGE) / spacing) - 4
    grid = _slant_plane(sensor, rows, cols, spacing)
    return Case(_noise(sensor), _track(pulses, spacing), sensor, Processing("taylor", "taylor", angle), grid)


def with_targets(case: Case, count: int = 50) -> Case:
    """A stripmap case with echoes of point targets instead of noise: their Doppler is bounded by the beam."""
    rng = np.random.default_rng(2)
    rows, cols = (rng.uniform(0, size - 1, count) for size in case.grid.shape)
    amplitudes = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    unused, sure = np.full(count, np.nan), np.ones(count, dtype=np.bool_)
    positions = case.grid.points(rows, cols)
    still = np.zeros_like(positions)
    surface = VisibleSurface(positions, unused, np.ones(count), unused, unused, unused, sure, still)
    rotation = np.broadcast_to(np.eye(3), (len(case.antenna), 3, 3))
    reference = case.history.reference_range
    samples = simulate_block(case.sensor, surface, amplitudes, case.antenna, rotation, reference)
    return replace(case, history=replace(case.history, samples=samples))


def _sensor(preset: str, detectors: int, pulses: int, frequencies: int) -> Sensor:
    sensor = load_preset(preset).make_sensor()
    boresights = LOOK_ANGLE + (np.arange(detectors) - (detectors - 1) / 2) * sensor.beamwidth / 2
    return replace(
        sensor,
        pulse_count=pulses,
        sample_count=frequencies,
        elevation_boresights=tuple(boresights),
        noise_power=(1.0,) * detectors,
        config_hash="",
    )


def _track(pulses: int, spacing: float) -> F64:
    """Antenna on a level flight eastwards over the origin, m, (pulses, 3)."""
    east = (np.arange(pulses) - (pulses - 1) / 2) * spacing
    return np.stack([east, np.zeros(pulses), np.full(pulses, SLANT_RANGE * np.cos(LOOK_ANGLE))], axis=-1)


def _slant_plane(sensor: Sensor, rows: int, cols: int, col_spacing: float) -> Grid:
    """Pixels around the aim point, as far apart in range as the resolution."""
    sight, along = look_direction(LOOK_ANGLE, 0.0, sensor.look_side), np.array([1.0, 0.0, 0.0])
    sensor_at = np.array([0.0, 0.0, SLANT_RANGE * np.cos(LOOK_ANGLE)])
    spacing = sensor.range_resolution
    origin = sensor_at + (SLANT_RANGE - (rows - 1) / 2 * spacing) * sight - (cols - 1) / 2 * col_spacing * along
    return Grid(origin, sight, along, spacing, col_spacing, rows, cols)


def _noise(sensor: Sensor) -> PhaseHistory:
    pulses = sensor.pulse_count
    shape = sensor.detector_count, pulses, 2 * sensor.sample_count
    samples = np.random.default_rng(1).standard_normal(shape, dtype=np.float32).view(np.complex64)
    times = np.arange(pulses) / sensor.pulse_repetition_frequency
    return PhaseHistory(0, times, np.full(pulses, SLANT_RANGE), samples)
