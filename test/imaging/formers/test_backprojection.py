"""Backprojection: points focus where they are with the amplitude they have; the image is the matched filter's."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, direct_history, make_aperture, make_sensor, sample_frequencies
from scipy.constants import speed_of_light

from sal_height.geometry.frames import look_direction
from sal_height.geometry.grid import Grid
from sal_height.imaging.formers import _kernels, backprojection
from sal_height.imaging.formers.backprojection import backproject, backproject_points, valid_pixels
from sal_height.imaging.pixels import Processing, slant_plane_grid, slc_noise_power
from sal_height.numeric.range_profiles import TAPS, dense_profiles
from sal_height.numeric.windows import window
from sal_height.sensor.sensor import PhaseHistory, Sensor

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


@pytest.mark.parametrize(("pulses", "frequencies"), [(48, 64), (33, 51)])
@pytest.mark.parametrize("detectors", [1, 2, 3, 16])
def test_detectors_together_are_each_alone(detectors: int, pulses: int, frequencies: int) -> None:
    """One detector has a loop of its own; the pulses are no multiple of what is added at once."""
    rng = np.random.default_rng(12)
    sensor = make_sensor(sample_count=frequencies, pulse_count=pulses)
    samples = circular(rng, (detectors, pulses, frequencies))
    antenna = ANTENNA[:pulses]
    pixels = grid_with().points(rng.uniform(5, 35, 130), rng.uniform(0, 30, 130))
    together = image_at(history_of(samples, REFERENCE[:pulses]), antenna, sensor, "taylor", pixels)
    for detector in range(detectors):
        alone = image_at(history_of(samples[detector], REFERENCE[:pulses]), antenna, sensor, "taylor", pixels)
        np.testing.assert_allclose(alone[0], together[detector], atol=1e-6 * np.abs(together).max())


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_image_does_not_depend_on_how_many_work_on_it(workers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(13)
    history = history_of(circular(rng, (2, SENSOR.pulse_count, SENSOR.sample_count)))
    images = []
    for pieces in (workers, 3):
        monkeypatch.setattr(backprojection, "WORKERS", pieces)
        images.append(backproject(history, ANTENNA, SENSOR, Processing(), grid_with(rows=39, cols=31)))
    # The remainder of a piece, which is not vectorised, is rounded a little differently.
    np.testing.assert_allclose(images[0], images[1], atol=1e-6 * np.nanmax(np.abs(images[1])))


@pytest.mark.parametrize(("name", "level"), [("taylor", -35.0), ("rectangular", -13.26)])
def test_peak_sidelobe_in_azimuth_is_that_of_the_azimuth_window(name: str, level: float) -> None:
    point, grid = point_at(0.0, 5000.0, 0.0), grid_with()
    history = history_of(direct_history(SENSOR, point[None], [1.0], ANTENNA, REFERENCE))
    row, col = pixel_of(point, grid)
    steps = np.arange(-12, 12, 1 / 32)
    pixels = grid.points(np.full_like(steps, row), col + steps)
    cut = backproject_points(history, ANTENNA, SENSOR, Processing("hamming", name), pixels, np.array([1.0, 0, 0]))
    assert peak_sidelobe_db(np.abs(cut[0]) ** 2) == pytest.approx(level, abs=0.3)


@pytest.mark.parametrize("range_window", ["rectangular", "taylor", "hamming"])
@pytest.mark.parametrize("azimuth_window", ["rectangular", "taylor", "hamming"])
def test_noise_has_the_power_that_is_stated_for_both_windows(range_window: str, azimuth_window: str) -> None:
    """Monte Carlo: pixels a resolution apart, of which windows make 1.36 times fewer independent in each direction."""
    rng, processing = np.random.default_rng(14), Processing(range_window, azimuth_window)
    detectors, power = 12, 2.5
    sensor = make_sensor(
        elevation_boresights=tuple(0.78 + 1e-4 * np.arange(detectors)), noise_power=(power,) * detectors
    )
    samples = np.sqrt(power) * circular(rng, (detectors, SENSOR.pulse_count, SENSOR.sample_count))
    image = backproject(history_of(samples), ANTENNA, sensor, processing, grid_with(rows=60, cols=40))
    standard_error = np.sqrt(1.36**2 / image.size)  # 0.8 %
    expected = slc_noise_power(sensor, processing, SENSOR.pulse_count)[0]
    assert np.mean(np.abs(image) ** 2) / expected == pytest.approx(1, abs=3.5 * standard_error)


STRIP = make_sensor(mode="stripmap", sample_count=24, pulse_count=401, pattern="sinc", pulse_repetition_frequency=20e3)
EVEN = (np.arange(401) - 200) * 2.5e-3


def strip_antenna(rng: np.random.Generator) -> np.ndarray:
    """A metre of track, a little uneven and bent."""
    return make_aperture().position + EVEN[:, None] * np.array([1.0, 0, 0]) + 2e-4 * rng.standard_normal((401, 3))


@pytest.mark.parametrize("name", ["rectangular", "taylor"])
@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [1.0, 2e-5, -1e-5]])
def test_strip_is_the_matched_filter_written_out(name: str, direction: list[float]) -> None:
    """Float64: the window over the sine of the angle, and of a pulse at the edge the share that lies within."""
    rng, angle = np.random.default_rng(15), 0.6 * BEAMWIDTH
    unit = np.array(direction) / np.linalg.norm(direction)
    antenna, reference = strip_antenna(rng), 5000 + rng.uniform(-0.1, 0.1, 401)
    samples = circular(rng, (2, 401, 24)).astype(np.complex64)
    places = rng.uniform(-0.2, 0.2, 40)
    points = np.array([point_at(rng.uniform(-1, 1) * BEAMWIDTH, 5000 + rng.uniform(-0.5, 0.5), x) for x in places])
    sight = antenna - points[:, None]
    distance = np.linalg.norm(sight, axis=-1)
    sine = sight @ unit / distance
    pulse_width = abs((antenna[-1] - antenna[0]) @ unit) / 400 / distance
    left = np.clip(sine - pulse_width / 2, -angle / 2, angle / 2)
    share = (np.clip(sine + pulse_width / 2, -angle / 2, angle / 2) - left) / pulse_width
    assert np.any((share > 0.01) & (share < 0.99))
    taper = np.interp(sine / angle, np.linspace(-0.5, 0.5, 1025), window(name, 1025))
    phase = 4 * np.pi / speed_of_light * sample_frequencies(STRIP) * (distance - reference)[..., None]
    total = np.einsum("f,np,mpf,npf->mn", window("taylor", 24), share * taper, samples, np.exp(1j * phase))
    expected = total / (24 * np.sum(share * taper, axis=-1))
    filled = (sine[:, 0] <= -angle / 2) & (sine[:, -1] >= angle / 2)
    assert np.all(filled)
    history = PhaseHistory(0, np.zeros(401), reference, samples)
    image = backproject_points(history, antenna, STRIP, Processing("taylor", name, angle), points, unit)
    np.testing.assert_allclose(image, expected, atol=1.5e-5 * np.abs(expected).max())


def test_strip_is_nan_where_the_aperture_is_not_filled_or_a_pulse_of_it_does_not_reach() -> None:
    """Along the track half an aperture from its ends; in range half a window from the reference, that of its pulses."""
    angle, rng = 0.6 * BEAMWIDTH, np.random.default_rng(16)
    antenna = make_aperture().position + EVEN[:, None] * np.array([1.0, 0, 0])
    reference = np.full(401, 5000.0)
    reference[:101] += 3 * STRIP.range_resolution
    history = PhaseHistory(0, np.zeros(401), reference, circular(rng, (1, 401, 24)).astype(np.complex64))
    grid = Grid(
        point_at(0, 5000 - 15.3 * STRIP.range_resolution, -0.498), grid_with().row_direction, grid_with().col_direction,
        STRIP.range_resolution, 0.004, 31, 250,
    )  # fmt: skip
    processing = Processing(angle=angle)
    image = backproject(history, antenna, STRIP, processing, grid)[0]
    x, cells = -0.498 + 0.004 * np.arange(250), np.arange(31) - 15.3
    half = angle * (5000 + cells * STRIP.range_resolution) / 2
    filled = np.abs(x) <= 0.5 - half[:, None]
    late = x - half[:, None] - 0.00125 < EVEN[100]
    early = x + half[:, None] + 0.00125 > EVEN[101]
    reached = (~late | (np.abs(cells - 3) <= 12)[:, None]) & (~early | (np.abs(cells) <= 12)[:, None])
    assert 0.2 < np.mean(filled & reached) < 0.6
    np.testing.assert_array_equal(np.isfinite(image), filled & reached)
    np.testing.assert_array_equal(valid_pixels(history, antenna, STRIP, angle, grid), filled & reached)


def test_point_at_the_very_end_of_the_window_reads_no_sample_beyond_it() -> None:
    """A pulse that does not reach a point is read at the end of its profile, which must not be past the array."""
    delay = np.array([-9.0, -2.0, 0.1, 2.0, 9.0])
    sample, fraction = np.empty(5, np.int32), np.empty(5, np.float32)
    _kernels._samples(delay, 16.0, 32.0, 2.0, sample, fraction)
    np.testing.assert_array_equal(sample, [1, 1, 34, 64, 64])
    np.testing.assert_allclose(fraction, [0, 0, 0.6, 1, 1], atol=1e-6)
    profile = dense_profiles(np.ones((1, 1, 32), np.complex64), np.ones(32))
    assert sample.max() + TAPS - 1 < profile.shape[1]
