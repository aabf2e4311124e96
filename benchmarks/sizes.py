"""Inputs of the stages of the pipeline at any size: the lidar of preset sal_spotlight, larger or smaller."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.calibration import Calibration
from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, Grid, Trajectory, sphere_point
from sal_height.imaging import ImageSettings, Slc, image_beams
from sal_height.numeric import C128
from sal_height.pipeline import Compressor
from sal_height.rehearsal import rehearsed_slc
from sal_height.relief import HeightField, Surface, circle_covariance
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import load_preset

PRESET = "sal_spotlight"
ROWS, COLS, PULSES, SAMPLES = 184, 12, 64, 256
"""Of a dwell of the preset: pixels before looks are averaged, pulses, and samples of a pulse."""

SHARES = (0.3, 0.66, 0.03, 0.01)
"""Of the rows of images: those with no, one, two and three scatterers, as found in dwells of the preset."""

POWER = 100.0
"""Of each scatterer over the noise."""

SIGMA = 0.012  # m
SPACINGS = (0.085, 0.097)
"""Of its height pixels on the ground, m."""

APERTURE = ApertureState(np.array([0.0, 3535, 3535]), np.array([50.0, 0, 0]), np.eye(3), 0.08, np.zeros((6, 6)))


@dataclass(frozen=True)
class CompressorInput:
    """Arguments of `Compressor.add`."""

    history: PhaseHistory
    track: Trajectory
    sensor: Sensor
    settings: ImageSettings

    def compress(self) -> Slc | None:
        """The images of this dwell alone."""
        return Compressor().add(self.history, self.track, self.sensor, self.settings)


class _Taking(Compressor):
    """Keeps what it is given."""

    taken: CompressorInput

    def add(
        self,
        history: PhaseHistory,
        track: Trajectory,
        sensor: Sensor,
        settings: ImageSettings,
        calibration: Calibration | None = None,
    ) -> Slc | None:
        self.taken = CompressorInput(history, track, sensor, settings)
        return super().add(history, track, sensor, settings, calibration)


def lidar(detectors: int, pulses: int = PULSES, samples: int = SAMPLES) -> Sensor:
    """The sensor of the preset with another number of detectors, pulses, and samples of a pulse."""
    preset = load_preset(PRESET)
    size = replace(preset.sensor, detectors=detectors, pulse_count=pulses, sample_count=samples)
    return replace(preset, sensor=size).make_sensor()


def made_up_dwell(sensor: Sensor, rows: int, cols: int) -> CompressorInput:
    """A dwell of noise, and the size of the images that are wanted of it."""
    compressor = _Taking()
    rehearsed_slc(sensor, ImageSettings(air="none", rows=rows, cols=cols), compressor, np.random.default_rng(1))
    return compressor.taken


def made_up_images(sensor: Sensor, rows: int, cols: int) -> Slc:
    """Images in whose rows lie as many scatterers as in those of a street (SHARES), in noise."""
    rng, slc = np.random.default_rng(2), made_up_dwell(sensor, rows, cols).compress()
    if slc is None:
        raise RuntimeError(f"Sensor {sensor.name} makes no image of one dwell.")
    beams, noise = image_beams(sensor, slc.azimuth_window), np.sqrt(np.mean(slc.noise_power))
    count = rng.permutation(np.repeat(np.arange(len(SHARES)), np.round(rows * np.array(SHARES)).astype(int)))
    images = noise * _normal(rng, slc.images.shape)
    for number in range(1, len(SHARES)):
        elevation = rng.uniform(beams.boresights.min(), beams.boresights.max(), rows)
        amplitude = np.sqrt(POWER) * noise * _normal(rng, (rows, cols)) * (np.resize(count, rows) >= number)[:, None]
        images += np.moveaxis(beams.response(elevation[:, None], 0.0) * amplitude[..., None], -1, 0)
    return replace(slc, images=images.astype(np.complex64))


def tiled(slc: Slc, sensor: Sensor, down: int, across: int) -> tuple[Slc, Sensor]:
    """The images side by side, several times down and across, and a sensor with beams as wide as they are then."""
    grid = slc.grid
    rows, cols = down * grid.rows, across * grid.cols
    origin = grid.points((grid.rows - rows) / 2, (grid.cols - cols) / 2)
    images = np.tile(slc.images, (1, down, across))
    wide = replace(sensor, azimuth_diameter=sensor.azimuth_diameter / across, config_hash="")
    return replace(slc, images=images, grid=replace(grid, origin=origin, rows=rows, cols=cols)), wide


def heights_of_street(rows: int, cols: int, number: int, rng: np.random.Generator) -> HeightField:
    """Level ground with a kerb of 0.12 m and the roof of a car, without shadow.

    Args:
        rows: pixels across the flight.
        cols: pixels along it.
        number: number of the dwell; it is adjacent to those of the numbers before.
        rng: random generator of the errors.
    """
    place = np.arange(rows)[:, None] * SPACINGS[0], (np.arange(cols) + number * cols) * SPACINGS[1]
    north, east = np.broadcast_arrays(*place)
    error = rng.normal(0.0, SIGMA, north.shape)
    height = np.where(north > 6, 0.12, np.where((north > 2) & (north < 4), 1.4, 0.0)) + error
    positions = sphere_point(east, north - error, height)
    own = circle_covariance(np.full(north.shape, SIGMA), positions, APERTURE)
    surface = Surface.seen_from(APERTURE, positions, own, np.full(north.shape, 20.0))
    sight = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    grid = Grid(np.zeros(3), sight, np.array([1.0, 0.0, 0.0]), SPACINGS[0] / np.sqrt(2), SPACINGS[1], rows, cols)
    return HeightField(grid, np.full(north.shape, Validity.OK, np.uint8), (surface,))


def _normal(rng: np.random.Generator, shape: tuple[int, ...]) -> C128:
    """Complex normal numbers of unit power."""
    return rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] * np.sqrt(0.5)
