"""What the tests of the image formers share: dwells and strips of few samples, and how images are compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from helpers import circular, direct_history, make_sensor

from sal_height.geometry.frames import ApertureState, look_direction
from sal_height.geometry.grid import Grid
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.formers.choice import choose_former
from sal_height.imaging.pixels import Processing, slant_plane_grid
from sal_height.sensor.sensor import PhaseHistory, Sensor
from sal_height.simulation.gust import gust_motion

Array = npt.NDArray[np.float64]

LOOK = np.pi / 4

EAST = np.array([1.0, 0.0, 0.0])

TAPERED = Processing("taylor", "taylor")


@dataclass(frozen=True)
class Case:
    """Everything a former takes; `case.image(former)` calls it."""

    history: PhaseHistory
    antenna: Array
    sensor: Sensor
    processing: Processing
    grid: Grid

    def image(self, former: Callable[..., npt.NDArray[np.complex64]] = backproject) -> npt.NDArray[np.complex64]:
        return former(self.history, self.antenna, self.sensor, self.processing, self.grid)

    def with_targets(self, positions: Array, amplitudes: npt.ArrayLike) -> Case:
        """The echoes of targets instead; amplitudes of shape (detectors, targets)."""
        return replace(self, history=echoes(self, positions, amplitudes))


def chosen(case: Case, name: str = "auto", **grid: int) -> Callable[..., npt.NDArray[np.complex64]]:
    """The former that is chosen by its name, perhaps for an image of another size."""
    return choose_former(name, case.antenna, case.sensor, case.processing, replace(case.grid, **grid))


def db(power: float) -> float:
    return float(10 * np.log10(power))


def difference_db(image: npt.NDArray[np.complex64], reference: npt.NDArray[np.complex64]) -> float:
    """Power of the difference over that of the reference, where both are valid."""
    valid = np.isfinite(image) & np.isfinite(reference)
    assert np.mean(valid) > 0.1
    return db(np.sum(np.abs(image - reference)[valid] ** 2) / np.sum(np.abs(reference)[valid] ** 2))


def gusty_track(straight: Array, seconds: Array, gust: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Positions on a straight track in gusts (m/s rms), and the direction of flight in their middle."""
    speed = float(np.linalg.norm(straight[-1] - straight[0]) / (seconds[-1] - seconds[0]))
    motion, middle = gust_motion(gust, speed, rng), (seconds[0] + seconds[-1]) / 2
    velocity = (straight[-1] - straight[0]) / (seconds[-1] - seconds[0]) + motion.velocity(middle)
    moved = straight + motion.displacement(seconds) - motion.displacement(middle)
    return moved, velocity / np.linalg.norm(velocity)


def dwell(
    rng: np.random.Generator,
    *,
    reach: float = 5000.0,
    length: float = 0.08,
    rows: int = 40,
    cols: int = 12,
    gust: float = 0.0,
    jitter: float = 0.0,
    direction: Array = EAST,
    processing: Processing = TAPERED,
    shift: tuple[float, float] = (0.0, 0.0),
    spread: tuple[float, float] = (1.0, 1.0),
    **changes: object,
) -> Case:
    """A spotlight dwell of noise, which fills the image as speckle does, on a slant-plane grid.

    Args:
        rng: of the noise, the gusts and the jitter.
        reach: range of the middle of the image, m.
        length: of the aperture, m.
        rows: of the image.
        cols: of the image.
        gust: m/s rms at a speed of 50 m/s.
        jitter: standard deviation of each antenna coordinate in every pulse, m.
        direction: of flight.
        processing: weights.
        shift: of the image from the middle of the beams, pixels.
        spread: spacing of the pixels over the resolution.
        changes: of the sensor.
    """
    sensor = make_sensor(**{"sample_count": 64, "pulse_count": 48, **changes})
    pulses = sensor.pulse_count
    steps = (np.arange(pulses) - (pulses - 1) / 2) * length / pulses
    direction = direction / np.linalg.norm(direction)
    antenna = np.array([3.0, -2.0, reach * np.cos(LOOK)]) + steps[:, None] * direction
    if gust:
        antenna, direction = gusty_track(antenna, steps / 50.0, gust, rng)
    antenna = antenna + jitter * rng.standard_normal(antenna.shape)
    aperture = ApertureState(antenna.mean(axis=0), 50.0 * direction, _level(direction), length, np.zeros((6, 6)))
    grid = slant_plane_grid(sensor, aperture, reach, rows, cols, 1.0)
    grid = replace(
        grid, row_spacing=grid.row_spacing * spread[0], col_spacing=grid.col_spacing * spread[1],
        origin=grid.points((rows - 1) / 2 * (1 - spread[0]) + shift[0], (cols - 1) / 2 * (1 - spread[1]) + shift[1]),
    )  # fmt: skip
    noise = circular(rng, (sensor.detector_count, pulses, sensor.sample_count)).astype(np.complex64)
    history = PhaseHistory(0, steps / 50.0, np.full(pulses, reach), noise)
    return Case(history, antenna, sensor, processing, grid)


def _level(forward: Array) -> Array:
    """Body axes of a platform whose nose points along `forward` and whose wings are level."""
    left = np.cross([0.0, 0.0, 1.0], forward)
    left /= np.linalg.norm(left)
    return np.stack([forward, left, np.cross(forward, left)], axis=-1)


SAL = {"wavelength": 1.55e-6, "aperture": 0.01, "bandwidth": 2e9, "reach": 5000.0, "spacing": 2.5e-3}
"""Of the stripmap preset: nothing migrates, and a metre of motion is a million turns."""

XBAND = {"wavelength": 0.03, "aperture": 1.0, "bandwidth": 3e8, "reach": 6000.0, "spacing": 0.25}
"""A target comes 1.4 cells nearer within its aperture of 180 m, and 5 within the beam."""


def strip(
    rng: np.random.Generator,
    *,
    wavelength: float,
    aperture: float,
    bandwidth: float,
    reach: float,
    spacing: float,
    pulses: int = 640,
    frequencies: int = 64,
    rows: int = 40,
    fold: float = 2,
    offset: float = 0.3,
    gust: float = 0.0,
    drift: float = 0.0,
    crab: float = 0.0,
    look_side: int = 1,
    processing: Processing = TAPERED,
    row_spacing: float = 1.3,
    margin: float = 1.02,
    targets: int = 60,
    gains: npt.ArrayLike = (1.0, 0.6),
) -> Case:
    """A stripmap flight past targets all over the image and a little beyond, under beams that are sinc in azimuth.

    Args:
        rng: of targets and gusts.
        wavelength: m.
        aperture: of the antenna, m.
        bandwidth: Hz.
        reach: range of the middle of the image, m.
        spacing: way from pulse to pulse, m.
        pulses: number of pulses.
        frequencies: number of fast-time samples.
        rows: of the image.
        fold: column spacing over pulse spacing.
        offset: of the columns from the pulses, in pulses.
        gust: m/s rms at a speed of 50 m/s.
        drift: share by which the speed changes from the first to the last pulse.
        crab: way to the left and half of it up over that along the columns, which are square to the beams.
        look_side: 1 right, -1 left.
        processing: windows; the angle is the beamwidth.
        row_spacing: over the resolution.
        margin: of the image to the ends of the track, half apertures.
        targets: number of targets.
        gains: amplitude in each detector.
    """
    gains = np.asarray(gains)
    boresights = LOOK + 1e-5 * np.arange(len(gains))
    sensor = make_sensor(
        mode="stripmap", wavelength=wavelength, aperture=aperture, bandwidth=bandwidth, sample_count=frequencies,
        pulse_count=pulses, pattern="sinc", look_side=look_side, elevation_boresights=tuple(boresights),
        noise_power=(1.0,) * len(gains), pulse_repetition_frequency=50.0 / spacing,
    )  # fmt: skip
    index = np.arange(pulses) - (pulses - 1) / 2
    steps = spacing * (index + drift * (index**2 / pulses - pulses / 12))
    antenna = np.array([0.0, 0.0, reach * np.cos(LOOK)]) + steps[:, None] * np.array([1.0, crab, crab / 2])
    direction = EAST
    if gust:
        antenna, direction = gusty_track(antenna, index * spacing / 50.0, gust, rng)
    sight = look_direction(LOOK, 0.0, look_side)
    sight = sight - (sight @ direction) * direction
    sight /= np.linalg.norm(sight)
    half, step = margin * sensor.beamwidth * reach / 2, fold * spacing
    cols = int((np.ptp(antenna @ direction) - 2 * half) / step)
    row_step = sensor.range_resolution * row_spacing
    middle = antenna.mean(axis=0) + reach * sight
    origin = middle - (rows - 1) / 2 * row_step * sight + (offset * spacing - (cols - 1) / 2 * step) * direction
    grid = Grid(origin, sight, direction, row_step, step, rows, cols)
    empty = PhaseHistory(
        0, index * spacing / 50.0, np.full(pulses, reach), np.zeros((1, pulses, frequencies), np.complex64)
    )
    case = Case(empty, antenna, sensor, replace(processing, angle=sensor.beamwidth), grid)
    places = grid.points(rng.uniform(0, rows - 1, targets), rng.uniform(-5, cols + 5, targets))
    return case.with_targets(places, gains[:, None] * circular(rng, (targets,)))


def echoes(case: Case, positions: Array, amplitudes: npt.ArrayLike) -> PhaseHistory:
    """Echoes of targets; in stripmap under a beam square to the columns that ends a beamwidth from its middle."""
    amplitudes, reference = np.asarray(amplitudes), case.history.reference_range
    if case.sensor.mode == "spotlight":
        samples = direct_history(case.sensor, positions, amplitudes, case.antenna, reference)
    else:
        samples = np.zeros((len(amplitudes), len(case.antenna), case.sensor.sample_count), np.complex128)
        for position, amplitude in zip(positions, amplitudes.T, strict=True):
            sight = case.antenna - position
            turn = sight @ case.grid.col_direction / np.linalg.norm(sight, axis=-1) / case.sensor.beamwidth
            lit = np.abs(turn) < 1
            clean = direct_history(case.sensor, position[None], [1.0], case.antenna[lit], reference[lit])
            samples[:, lit] += amplitude[:, None, None] * np.sinc(turn[lit, None]) * clean
    return replace(case.history, samples=samples.astype(np.complex64))


def on_the_ground(case: Case, rng: np.random.Generator) -> Case:
    """A strip's pixels and new targets in the horizontal plane through its middle."""
    grid = case.grid
    outwards = np.array([0.0, np.sign(grid.row_direction[1]), 0.0])
    middle, spacing = grid.points((grid.rows - 1) / 2, 0), grid.row_spacing / np.sin(LOOK)
    origin = middle - (grid.rows - 1) / 2 * spacing * outwards
    case = replace(case, grid=replace(grid, origin=origin, row_direction=outwards, row_spacing=spacing))
    targets = case.grid.points(rng.uniform(0, grid.rows - 1, 20), rng.uniform(0, grid.cols - 1, 20))
    return case.with_targets(targets, circular(rng, (len(case.history.samples), 20)))
