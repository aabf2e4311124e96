"""Images of a scene straight from its scatterers, without pulses: wide ones in seconds.

The aperture of a dwell is so short that the spectrum of an image is that of its scatterers at their range and Doppler
(a two-dimensional non-uniform FFT), times the windows: `test_honest.py` holds it against phase history and
backprojection. The beams are stretched along the flight, so that one dwell covers as many columns as wanted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import finufft
import numpy as np

from sal_height.geometry import ApertureState, Grid, look_direction, pixels_at, sphere_point
from sal_height.imaging import Processing, Slc, azimuth_resolution
from sal_height.imaging.pixels import slant_plane_grid, slc_noise_power
from sal_height.numeric import C64, Complex, blocks, broadening, chirp_z, in_parallel
from sal_height.sensor import Sensor
from sal_height.simulation import Preset, Scene, VisibleSurface, load_preset
from sal_height.simulation.scene import visible_surface
from sal_height.simulation.spotlight import cell_power, draw_amplitudes

SLANT_RANGE = 5000.0
PRESET = "sal_spotlight"
MARGIN = 8
"""Columns of ground that are simulated beside the image, at each side."""

BEAM_COLUMNS = 4 / 3
"""Columns in a beamwidth along the flight over those of the image, as in preset sal_spotlight."""


@dataclass(frozen=True, eq=False)
class DirectImages:
    """Images of a scene in unit noise, for any CNR.

    Attributes:
        sensor: that saw it.
        surface: lit scatterers.
        aperture: state of the platform.
        grid: pixels.
        processing: windows over band and aperture.
        echoes: images at a CNR of 0 dB without noise, complex64, shape (detectors, rows, cols).
        noise: noise of the receivers, same shape.
    """

    sensor: Sensor
    surface: VisibleSurface
    aperture: ApertureState
    grid: Grid
    processing: Processing
    echoes: C64
    noise: C64

    @property
    def cell(self) -> tuple[float, float]:
        """Unweighted resolution in range and azimuth, m."""
        return self.sensor.range_resolution, azimuth_resolution(self.sensor, self.aperture, SLANT_RANGE)

    def slc(self, cnr_db: float) -> Slc:
        """The images at a CNR (dB)."""
        images = (np.float32(10 ** (cnr_db / 20)) * self.echoes + self.noise).astype(np.complex64)
        noise_power = slc_noise_power(self.sensor, self.processing, self.sensor.pulse_count)
        clipped = np.zeros(len(images))
        windows = self.processing.azimuth_window, self.processing.range_window
        return Slc(images, self.grid, self.aperture, noise_power, clipped, *windows)


def lidar(
    cols: int,
    pattern: str = "jinc",
    detectors: int = 16,
    detector_size: tuple[float, float] = (0.0, 0.0),
    look_angle: float = np.pi / 4,
    preset_name: str = PRESET,
) -> Sensor:
    """The lidar of a preset with beams that cover `cols` columns in azimuth, and as many pulses.

    Args:
        cols: number of columns.
        pattern: pattern of the beams.
        detectors: number of detectors.
        detector_size: size of a detector along and across the axis of the array, beamwidths.
        look_angle: angle from nadir of the middle of the array, rad.
        preset_name: name of the preset.
    """
    preset = load_preset(preset_name)
    beamwidth = BEAM_COLUMNS * cols * preset.sensor.wavelength_m / (2 * _aperture_length(preset))
    described = replace(
        preset.sensor,
        mode="spotlight",
        pattern=pattern,
        detectors=detectors,
        detector_size_beamwidths=detector_size,
        azimuth_aperture_m=preset.sensor.wavelength_m / beamwidth,
        pulse_count=cols + 2 * MARGIN,
    )
    flight = replace(preset.flight, look_angle_rad=look_angle)
    return replace(preset, sensor=described, flight=flight).make_sensor()


def _aperture_length(preset: Preset) -> float:
    """Length of the synthetic aperture, m: of a dwell, or in stripmap the width of the beam on the ground."""
    sensor, flight = preset.sensor, preset.flight
    if sensor.mode == "stripmap":
        return sensor.wavelength_m / sensor.aperture_m * flight.slant_range_m
    return flight.speed_mps * sensor.pulse_count / sensor.pulse_repetition_frequency_hz


def direct_images(
    scene: Scene,
    sensor: Sensor,
    shape: tuple[int, int],
    processing: Processing,
    rng: np.random.Generator,
    look_angle: float = np.pi / 4,
    preset_name: str = PRESET,
) -> DirectImages:
    """Images of a scene seen from a flight that looks south.

    Args:
        scene: centred on the map origin.
        sensor: sensor that `lidar` makes for that number of columns.
        shape: rows and columns of the images.
        processing: windows.
        rng: random generator of speckle and noise.
        look_angle: look angle of the sensor, rad.
        preset_name: name of the preset of the sensor.
    """
    preset = load_preset(preset_name)
    aim = sphere_point(0.0, 0.0, scene.reference_height)
    aperture = ApertureState(
        position=aim - SLANT_RANGE * look_direction(look_angle, 0.0, sensor.look_side),
        velocity=np.array([preset.flight.speed_mps, 0.0, 0.0]),
        rotation=np.eye(3),
        length=_aperture_length(preset),
        covariance=np.zeros((6, 6)),
        sliding=False,
    )
    broadened = broadening(processing.range_weights(sensor.sample_count))
    grid = slant_plane_grid(sensor, aperture, SLANT_RANGE, *shape, broadened)
    cell = sensor.range_resolution, azimuth_resolution(sensor, aperture, SLANT_RANGE)
    half = (shape[1] / 2 * grid.col_spacing) + (MARGIN - 1) * cell[1]
    reach = sensor.range_window / 2
    ranges = SLANT_RANGE - reach, SLANT_RANGE + reach
    surface = visible_surface(scene, aperture, sensor.look_side, cell, (-half, half), ranges)
    amplitudes = draw_amplitudes(surface, cell_power(1.0, sensor, sensor.pulse_count), rng)
    echoes = image_of(spectrum_of(surface, amplitudes, sensor, aperture, grid), sensor, aperture, grid, processing)
    samples = (sensor.detector_count, sensor.sample_count, sensor.pulse_count, 2)
    noise = np.sqrt(0.5) * rng.standard_normal(samples, dtype=np.float32).view(np.complex64)[..., 0]
    return DirectImages(
        sensor, surface, aperture, grid, processing, echoes, image_of(noise, sensor, aperture, grid, processing)
    )


def spectrum_of(
    surface: VisibleSurface, amplitudes: Complex, sensor: Sensor, aperture: ApertureState, grid: Grid
) -> C64:
    """Sum of the scatterers at every range and azimuth frequency, shape (detectors, frequencies, pulses)."""
    sight = surface.positions - aperture.position
    along = sight @ aperture.direction
    row, col = pixels_at(np.sqrt(np.sum(sight**2, axis=-1) - along**2), along, aperture, grid)
    phases = [
        2 * np.pi * (index - (count - 1) / 2) * spacing / window
        for index, count, spacing, window in zip(
            (row, col), grid.shape, (grid.row_spacing, grid.col_spacing), _windows(sensor, aperture), strict=True
        )
    ]
    weighted = np.empty((sensor.detector_count, len(amplitudes)), np.complex64)

    def weigh(part: slice) -> None:
        for block in blocks(part.stop - part.start, 2**12):  # whose numbers stay in a processor's cache
            there = slice(part.start + block.start, part.start + block.stop)
            beams = sensor.beams.response(surface.elevation[there], surface.squint[there])
            weighted[:, there] = beams.T * amplitudes[there]

    in_parallel(weigh, len(amplitudes))
    size = sensor.sample_count, sensor.pulse_count
    x, y = (phase.astype(np.float32) for phase in phases)
    return finufft.nufft2d1(x, y, weighted, size, isign=-1, eps=1e-5)


def image_of(spectrum: C64, sensor: Sensor, aperture: ApertureState, grid: Grid, processing: Processing) -> C64:
    """Pixels of a spectrum of shape (detectors, frequencies, pulses), weighted by the windows."""
    detectors, samples, pulses = spectrum.shape
    rows, cols = grid.shape
    turns = [
        spacing / window
        for spacing, window in zip((grid.row_spacing, grid.col_spacing), _windows(sensor, aperture), strict=True)
    ]
    range_weights, azimuth_weights = processing.range_weights(samples), processing.azimuth_weights(pulses)
    # Frequencies are counted from their middle, as finufft does.
    down = np.exp(2j * np.pi * turns[0] * np.outer(np.arange(rows) - (rows - 1) / 2, np.arange(samples) - samples // 2))
    lines = ((down * (range_weights / samples)).astype(np.complex64) @ spectrum).reshape(-1, pulses)
    lines *= (azimuth_weights / pulses).astype(np.float32)
    beside = chirp_z(np.array([2 * np.pi * turns[1]]), pulses, pulses // 2, cols, (cols - 1) / 2)
    image = np.empty((len(lines), cols), dtype=np.complex64)

    in_parallel(lambda part: beside.fill_rows(lines[part], image[part]), len(lines))
    return image.reshape(detectors, rows, cols)


def _windows(sensor: Sensor, aperture: ApertureState) -> tuple[float, float]:
    """Extent that the samples cover without ambiguity in range and azimuth, m."""
    return sensor.range_window, azimuth_resolution(sensor, aperture, SLANT_RANGE) * sensor.pulse_count
