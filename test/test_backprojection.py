"""Backprojection: points focus where they are with the amplitude they have; the image is the matched filter's."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular, direct_history, make_aperture, make_sensor, sample_frequencies
from scipy.constants import speed_of_light

from sal_height.backprojection import backproject_points
from sal_height.compression import slant_plane_grid
from sal_height.geometry import Grid, look_direction
from sal_height.phase_history import PhaseHistory
from sal_height.processing import Processing
from sal_height.sensor import Sensor
from sal_height.windows import window

SENSOR = make_sensor()
REFERENCE = np.full(SENSOR.pulse_count, 5000.0)
ALONG = (np.arange(SENSOR.pulse_count) - (SENSOR.pulse_count - 1) / 2) * 50 / SENSOR.pulse_repetition_frequency
ANTENNA = make_aperture().position + ALONG[:, None] * np.array([1.0, 0.0, 0.0])


def history_of(samples: np.ndarray, reference: np.ndarray = REFERENCE) -> PhaseHistory:
    samples = samples if samples.ndim == 3 else samples[None]
    return PhaseHistory(0, np.zeros(samples.shape[1]), reference, samples.astype(np.complex64))


def grid_with(rows: int = 41, cols: int = 31) -> Grid:
    return slant_plane_grid(SENSOR, make_aperture(), 5000.0, rows, cols, 1.0)


def image_at(history: PhaseHistory, antenna: np.ndarray, sensor: Sensor, window: str, pixels: np.ndarray) -> np.ndarray:
    """Images at `pixels` of shape (..., 3): (detectors, ...)."""
    image = backproject_points(
        history, antenna, sensor, Processing(window), pixels.reshape(-1, 3), np.array([1.0, 0, 0])
    )
    return image.reshape(-1, *pixels.shape[:-1])


def pixel_of(point: np.ndarray, grid: Grid) -> tuple[float, float]:
    """Fractional row and column with the point's distance from the track and place along it."""
    sight, start = point - ANTENNA.mean(axis=0), grid.origin - ANTENNA.mean(axis=0)
    across = np.hypot(sight[1], sight[2]) - np.hypot(start[1], start[2])
    return across / grid.row_spacing, (sight[0] - start[0]) / grid.col_spacing


def point_at(offset: float, slant_range: float, along: float) -> np.ndarray:
    return make_aperture().position + slant_range * look_direction(np.pi / 4 + offset, along / slant_range, 1)


def peak_of(power: np.ndarray, steps: np.ndarray) -> float:
    """Where a finely sampled response peaks: vertex of the parabola through its greatest samples."""
    i = int(np.argmax(power))
    low, top, high = power[i - 1 : i + 2]
    return steps[i] + (steps[1] - steps[0]) * (low - high) / (2 * (low - 2 * top + high))


@pytest.mark.parametrize("offset", [0.0, 3e-4, -5e-4], ids=["in the plane", "above", "below"])
@pytest.mark.parametrize(("slant_range", "along"), [(5000.0, 0.0), (5000.813, 0.371), (4999.04, -0.52)])
def test_point_focuses_at_its_pixel_with_its_amplitude(offset: float, slant_range: float, along: float) -> None:
    """To a 128th of the resolution, whatever its elevation."""
    point, amplitude, grid = point_at(offset, slant_range, along), 1.7 * np.exp(0.6j), grid_with()
    history = history_of(direct_history(SENSOR, point[None], [amplitude], ANTENNA, REFERENCE))
    row, col = pixel_of(point, grid)
    steps = np.arange(-24, 25) / 32
    for pixels, where in (
        (grid.points(row + steps, np.full_like(steps, col)), "range"),
        (grid.points(np.full_like(steps, row), col + steps), "azimuth"),
    ):
        cut = image_at(history, ANTENNA, SENSOR, "rectangular", pixels[None])[0, 0]
        assert abs(peak_of(np.abs(cut) ** 2, steps)) < 1 / 128, where
        assert cut[24] == pytest.approx(amplitude, abs=1e-4)


@pytest.mark.parametrize("name", ["rectangular", "taylor"])
def test_image_is_the_matched_filter_written_out(name: str) -> None:
    weights = window(name, SENSOR.sample_count)
    rng = np.random.default_rng(11)
    reference = REFERENCE + rng.uniform(-0.2, 0.2, len(REFERENCE))
    samples = circular(rng, (2, SENSOR.pulse_count, SENSOR.sample_count)).astype(np.complex64)
    pixels = grid_with().points(rng.uniform(0, 40, (2, 3)), rng.uniform(0, 30, (2, 3)))
    delay = np.linalg.norm(pixels[..., None, :] - ANTENNA, axis=-1) - reference
    phase = 4 * np.pi / speed_of_light * sample_frequencies(SENSOR) * delay[..., None]
    expected = np.einsum("f,mpf,abpf->mab", weights, samples, np.exp(1j * phase)) / samples[0].size
    image = image_at(history_of(samples, reference), ANTENNA, SENSOR, name, pixels)
    assert image.dtype == np.complex64
    np.testing.assert_allclose(image, expected, atol=1e-5 * np.abs(expected).max())


def peak_sidelobe_db(power: np.ndarray) -> float:
    """Greatest power beyond the first minima to both sides of the peak, relative to it."""
    peak = int(np.argmax(power))
    rising = np.diff(power) > 0
    right = peak + int(np.argmax(rising[peak:]))
    left = peak - int(np.argmax(~rising[:peak][::-1]))
    return float(10 * np.log10(max(power[:left].max(), power[right:].max()) / power[peak]))


@pytest.mark.parametrize(("name", "level"), [("rectangular", -13.26), ("taylor", -35.0)])
def test_peak_sidelobe_in_range(name: str, level: float) -> None:
    point, grid = point_at(0.0, 5000.0, 0.0), grid_with()
    history = history_of(direct_history(SENSOR, point[None], [1.0], ANTENNA, REFERENCE))
    row, col = pixel_of(point, grid)
    steps = np.arange(-12, 12, 1 / 32)
    cut = image_at(history, ANTENNA, SENSOR, name, grid.points(row + steps, np.full_like(steps, col))[None])
    assert peak_sidelobe_db(np.abs(cut[0, 0]) ** 2) == pytest.approx(level, abs=0.3)


def test_peak_sidelobe_in_azimuth_is_that_of_an_unweighted_aperture() -> None:
    point, grid = point_at(0.0, 5000.0, 0.0), grid_with()
    history = history_of(direct_history(SENSOR, point[None], [1.0], ANTENNA, REFERENCE))
    row, col = pixel_of(point, grid)
    steps = np.arange(-12, 12, 1 / 32)
    cut = image_at(history, ANTENNA, SENSOR, "rectangular", grid.points(np.full_like(steps, row), col + steps)[None])
    assert peak_sidelobe_db(np.abs(cut[0, 0]) ** 2) == pytest.approx(-13.26, abs=0.1)


def test_amplitude_ratios_between_detectors_survive() -> None:
    """Every detector gets the same filter, so that the discriminant of the samples is that of the image."""
    point, gains = point_at(2e-4, 5000.4, 0.2), np.array([0.9, -0.31, 0.05 + 0.4j])
    samples = direct_history(SENSOR, point[None], gains[:, None], ANTENNA, REFERENCE)
    row, col = pixel_of(point, grid_with())
    near = grid_with().points(row + np.array([[0.0], [0.4]]), col + np.array([[0.0, -0.3]]))
    image = image_at(history_of(samples), ANTENNA, SENSOR, "taylor", near)
    np.testing.assert_allclose(
        image / image[0], np.broadcast_to((gains / gains[0])[:, None, None], (3, 2, 2)), rtol=1e-6
    )


def test_curved_track_focuses_as_well_as_a_straight_one() -> None:
    """X-band on an arc whose middle is 20 wavelengths off the chord, climbing and sinking by as much."""
    sensor = make_sensor(wavelength=0.03, bandwidth=3e8, aperture=1.9, pulse_count=128)
    turn = np.linspace(-0.035, 0.035, sensor.pulse_count)
    climb = 0.6 * np.cos(np.pi / 2 * turn / turn[-1])
    tracks = {
        "straight": np.stack([1000 * turn, np.full_like(turn, -1000.0), np.full_like(turn, 1000.0)], axis=-1),
        "curved": np.stack([1000 * np.sin(turn), -1000 * np.cos(turn), 1000 + climb], axis=-1),
    }
    point = np.array([2.0, 3.0, 1.0])
    resolution = 0.03 * np.linalg.norm(point - [0, -1000, 1000]) / (2 * 70 * 128 / 127)
    steps = np.linspace(-1, 1, 401)
    for name, antenna in tracks.items():
        reference = np.linalg.norm(antenna, axis=-1)
        history = history_of(direct_history(sensor, point[None], [1.0], antenna, reference), reference)
        cut = point + resolution * steps[:, None] * np.array([1.0, 0, 0])
        image = image_at(history, antenna, sensor, "rectangular", cut[None])[0, 0]
        assert image[200] == pytest.approx(1.0, abs=1e-4), name
        width = np.count_nonzero(np.abs(image) ** 2 > 0.5) * (steps[1] - steps[0])
        assert width == pytest.approx(0.886, rel=0.01), name


def test_pixels_beyond_the_range_window_are_nan_in_every_detector() -> None:
    rows = SENSOR.sample_count + 8
    grid = grid_with(rows=rows, cols=3)
    samples = np.ones((2, SENSOR.pulse_count, SENSOR.sample_count))
    image = image_at(history_of(samples), ANTENNA, SENSOR, "rectangular", grid.pixels())
    slant_range = np.linalg.norm(grid.pixels() - make_aperture().position, axis=-1)
    beyond = np.abs(slant_range - 5000.0) > SENSOR.range_window / 2
    assert np.count_nonzero(beyond[:, 1]) == 8
    np.testing.assert_array_equal(np.isnan(image), np.broadcast_to(beyond, image.shape))


def test_one_pulse_that_does_not_reach_a_pixel_is_enough_for_nan() -> None:
    reference = REFERENCE.copy()
    reference[7] += SENSOR.range_window / 4
    grid = grid_with(rows=63, cols=1)
    samples = np.ones((1, SENSOR.pulse_count, SENSOR.sample_count))
    image = image_at(history_of(samples, reference), ANTENNA, SENSOR, "rectangular", grid.pixels())
    assert np.isnan(image[0, :15, 0]).all()
    assert np.isfinite(image[0, 16:, 0]).all()
