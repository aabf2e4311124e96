"""A made-up dwell of a sensor: after it a node finds all tables made, and all code compiled, for the first real one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace
from threading import Lock

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.adjustment import AdjustmentSettings, AdjustmentWindow, ObservedDwell, Stated, corrected_heights
from sal_height.elevation import ElevationEstimator, HeightSettings, Validity
from sal_height.geometry import ApertureState, Grid, PlatformState, Trajectory, look_direction
from sal_height.imaging import ImageSettings, Placement, Slc, focus_cells, image_beams, is_for_speckle
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField, Surface
from sal_height.sensor import PhaseHistory, Sensor, lit_angle, spectrum_sensor

SHARES = (0.1, 0.3, 0.3, 0.3)
"""Fractions of the rows of made-up images with no, one, two and three scatterers."""

MOST_REMEMBERED = 16
"""Number of rehearsals that a process remembers: tables of older ones may have been dropped."""

_LATEST: dict[Hashable, None] = {}
_LOCK = Lock()


def once(rehearsal: Hashable, rehearse: Callable[[], object]) -> None:
    """Rehearse, unless this process has done it lately, as where a run follows another one in a notebook.

    Args:
        rehearsal: key of the rehearsal: all that it depends on.
        rehearse: function that does it; if it raises an error, the rehearsal is not remembered.
    """
    with _LOCK:
        if rehearsal in _LATEST:
            return
    rehearse()
    with _LOCK:
        _LATEST[rehearsal] = None
        if len(_LATEST) > MOST_REMEMBERED:
            del _LATEST[next(iter(_LATEST))]


def rehearsed_slc(
    sensor: Sensor, settings: ImageSettings, compressor: Compressor, rng: np.random.Generator
) -> Slc | None:
    """Images of noise, compressed from a level flight past a scene that fills the range window.

    Args:
        sensor: sensor whose dwells will arrive.
        settings: settings of the images.
        compressor: compressor that will process the dwells, or a new one.
        rng: random generator of the noise.

    Returns:
        The images; None if a strip of 16 blocks has none.

    Raises:
        UserError: images cannot be made with these settings.
    """
    spectrum, beams = spectrum_sensor(sensor), sensor.beams
    span = float(np.ptp(beams.boresights)) + beams.beamwidth
    slant_range = spectrum.range_window / span
    angle, length = float(np.mean(beams.boresights)), sensor.wavelength / beams.track_beamwidth
    speed = sensor.pulse_repetition_frequency * length * beams.track_beamwidth / (5 * lit_angle(beams))
    abeam = -slant_range * look_direction(angle, 0.0, sensor.look_side)
    times = np.arange(sensor.pulse_count) / sensor.pulse_repetition_frequency
    shape = sensor.detector_count, sensor.pulse_count, sensor.sample_count
    block_s = sensor.pulse_count / sensor.pulse_repetition_frequency
    if settings.autofocus != "never":
        _rehearse_autofocus(spectrum, times[:, None] * np.array([speed, 0.0, 0.0]), rng.spawn(1)[0])
    slc = None
    most_blocks = 16  # blocks of a strip after which it has an image, or is given up
    for block in range(1 if sensor.mode == "spotlight" else most_blocks):
        start_s = (block + 1) * block_s
        samples = _normal(rng, shape).astype(np.complex64)
        history = PhaseHistory(round(start_s * 1e9), times, np.full(len(times), slant_range), samples)
        stamps = round(block_s * 1e9) * np.arange(block, block + 4)
        states = [_level(int(stamp), abeam, speed) for stamp in stamps]
        slc = compressor.add(history, Trajectory(states), sensor, settings)
        if slc is not None:
            return slc
    return slc


def _rehearse_autofocus(sensor: Sensor, antenna: F64, rng: np.random.Generator) -> None:
    """Focus on made-up speckle of 20 dB, if dwells of the sensor along `antenna` (m, (pulses, 3)) are for speckle."""
    if is_for_speckle(sensor, antenna):
        shape = sensor.detector_count, len(antenna), sensor.sample_count
        power = 100 * sensor.sample_count * max(sensor.noise_power)
        cells = np.sqrt(power) * _normal(rng, shape)
        focus_cells(cells.astype(np.complex64).swapaxes(1, 2), antenna, sensor)


def with_scatterers(slc: Slc, sensor: Sensor, rng: np.random.Generator) -> Slc:
    """Images whose rows contain no, one, two or three scatterers, at random elevations and with speckle, in noise.

    Args:
        slc: images, of any content.
        sensor: sensor of the images.
        rng: random generator of the scatterers and the noise.
    """
    beams, shape = image_beams(sensor, slc.azimuth_window), slc.grid.shape
    count = rng.choice(len(SHARES), (shape[0], 1), p=SHARES)
    noise = np.sqrt(slc.noise_power)[:, None, None]
    images = noise * _normal(rng, slc.images.shape)
    power = 1000.0  # power of each scatterer over the noise
    for number in range(1, len(SHARES)):
        elevation = rng.uniform(beams.boresights.min(), beams.boresights.max(), (shape[0], 1))
        amplitude = np.sqrt(power * np.mean(slc.noise_power)) * _normal(rng, shape) * (count >= number)
        images += np.moveaxis(beams.response(elevation, 0.0) * amplitude[..., None], -1, 0)
    return replace(slc, images=images.astype(np.complex64))


def rehearse_heights(
    sensor: Sensor,
    images: ImageSettings,
    estimators: Iterable[tuple[ElevationEstimator, HeightSettings]],
    rng: np.random.Generator,
) -> None:
    """Compress a made-up dwell, and estimate the heights of scatterers in its images.

    Args:
        sensor: sensor whose dwells will arrive.
        images: settings of the images.
        estimators: estimators in use, and their settings.
        rng: random generator of noise and scatterers.

    Raises:
        UserError: images or heights cannot be made with these settings.
    """
    slc = rehearsed_slc(sensor, images, Compressor(), rng)
    if slc is not None:
        lit = with_scatterers(slc, sensor, rng)
        for estimator, settings in estimators:
            heights(lit, sensor, estimator, settings)


def rehearse_adjustment(sensor: Sensor, rng: np.random.Generator) -> None:
    """Adjust a made-up dwell to one before it of the same ground, and correct its heights.

    Args:
        sensor: sensor whose dwells will arrive.
        rng: random generator of errors of the heights.
    """
    settings = AdjustmentSettings(boresight_sigma_rad=0.0, lever_arm_sigma_m=0.0)  # so that little has to be searched
    window, known = AdjustmentWindow(sensor.mounting, settings, 1), 1e-10 * np.eye(6)
    for passage in range(2):
        field, aperture = made_up_heights(rng)
        stated = Stated(2 * passage * settings.strip_s, known, known[:3, :3])
        dwell = ObservedDwell.seen_from(aperture, field, Placement(0.0, 0.0, 0.0), stated, sensor)
        corrected_heights(field, dwell, window.add(dwell))


def made_up_heights(rng: np.random.Generator) -> tuple[HeightField, ApertureState]:
    """A height image of level ground and the state of the platform that has seen it.

    Args:
        rng: random generator of the errors.
    """
    height, sigma, angle = 3000.0, 0.1, np.pi / 4
    sight, along = look_direction(angle, 0.0, 1), np.array([1.0, 0.0, 0.0])
    abeam = np.array([0.0, 0.0, height])
    aperture = ApertureState(abeam, 50.0 * along, np.eye(3), 0.1, np.zeros((6, 6)), sliding=False)
    grid = Grid(abeam + height / np.cos(angle) * sight, sight, along, 0.05, 0.1, 60, 6)
    rows, cols = np.arange(grid.rows)[:, None], np.arange(grid.cols)
    errors = sigma * rng.standard_normal(grid.shape)
    positions = grid.points(rows, cols) + errors[..., None] * np.array([0.0, 0.0, 1.0])
    own = np.broadcast_to(sigma**2 * np.eye(3), (*grid.shape, 3, 3))
    surface = Surface.seen_from(aperture, positions, own, np.full(grid.shape, 20.0))
    return HeightField(grid, np.full(grid.shape, Validity.OK, np.uint8), (surface,)), aperture


def _normal(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
    """Complex normal numbers of unit power."""
    return rng.standard_normal((*shape, 2)).view(np.complex128)[..., 0] * np.sqrt(0.5)


def _level(stamp_ns: int, abeam: np.ndarray[tuple[int], np.dtype[np.float64]], speed: float) -> PlatformState:
    """The platform on a level flight eastwards, past the origin at 1 s."""
    position = abeam + np.array([speed * (stamp_ns * 1e-9), 0.0, 0.0])
    return PlatformState(
        stamp_ns, position, Rotation.identity().as_quat(), np.array([speed, 0.0, 0.0]), np.zeros((6, 6))
    )
