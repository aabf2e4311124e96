"""The compiled loops of the image formers against their formulas in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.imaging.formers._kernels import _add_one, add_pulses, fill_turns, read_profiles, row_is_reached
from sal_height.imaging.weighting import Processing
from sal_height.numeric import OVERSAMPLING, TAPS, dense_profiles, tap_polynomials, tap_weights

COUNT, WINDOW, WAVENUMBER, SPACING = 32, 4.0, 80.0, 0.02
ANGLE = 0.02
"""Of 1 m of track 20 m away, the middle 0.4 m."""


def scene(pulses: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Track (x, y, z, reference, place along x, weight) past points, some of them beyond the range window."""
    rng = np.random.default_rng(111)
    places = SPACING * (np.arange(pulses) - (pulses - 1) / 2)
    track = np.zeros((pulses, 6))
    track[:, 0] = track[:, 4] = places
    track[:, 3], track[:, 5] = 20.0, rng.uniform(0.5, 1.5, pulses)
    spots = np.stack([rng.uniform(-0.2, 0.2, points), rng.uniform(17.5, 22.5, points), rng.uniform(-1, 1, points)])
    return track, spots


def geometry(track: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Delay (m) and sine of the angle to abeam of each point in each pulse, (pulses, points)."""
    distance = np.linalg.norm(points[None] - track[:, :3, None], axis=1)
    return distance - track[:, 3, None], (track[:, 4, None] - points[0]) / distance


@pytest.mark.parametrize("runs", [2, 30, 300], ids=["one change", "runs of 10", "hardly any run"])
def test_pixels_that_read_the_same_samples_are_read_as_others(runs: int) -> None:
    rng, pixels = np.random.default_rng(115), 301
    sample = np.sort(rng.integers(0, runs, pixels)).astype(np.int32)
    tap, cosine, sine = (rng.uniform(-1, 1, shape).astype(np.float32) for shape in ((TAPS, pixels), pixels, pixels))
    profile = circular(rng, (runs + TAPS,)).astype(np.complex64)
    image = np.ones((pixels, 2, 1), np.float32)
    _add_one(sample, tap, cosine, sine, profile.view(np.float32).reshape(-1, 2, 1), image)
    read = np.sum(tap * profile[sample + np.arange(TAPS)[:, None]], axis=0)
    expected = 1 + 1j + read * (cosine + 1j * sine)
    np.testing.assert_allclose(image[:, 0, 0] + 1j * image[:, 1, 0], expected, atol=1e-5)


@pytest.mark.parametrize("detectors", [1, 3])
@pytest.mark.parametrize("angle", [0.0, ANGLE], ids=["spotlight", "stripmap"])
def test_pulses_are_added_as_the_formula_of_backprojection_says(detectors: int, angle: float) -> None:
    """sum of a(p) profile(delay) exp(j k delay), with the profile read by the kernel's taps."""
    pulses, points = 50, 300
    track, spots = scene(pulses, points)
    rng = np.random.default_rng(112)
    spectra = circular(rng, (detectors, pulses, COUNT)).astype(np.complex64)
    dense, polynomials = dense_profiles(spectra, np.ones(COUNT)), tap_polynomials()
    profiles = np.stack([dense.real, dense.imag], axis=2)
    processing = Processing(azimuth_window="hamming", angle=angle)
    per_metre, middle = OVERSAMPLING * COUNT / WINDOW, OVERSAMPLING * COUNT // 2
    scales = np.array([per_metre, middle, WAVENUMBER / (2 * np.pi), WINDOW / 2, angle, SPACING])
    image = np.zeros((points, 2, detectors), np.float32)
    weight, valid = np.zeros(points), np.ones(points, bool)
    add_pulses(spots, spots[0].copy(), track, profiles, polynomials, processing.taper(), scales, image, weight, valid)

    delay, sine = geometry(track, spots)
    distance = delay + track[:, 3, None]
    gain = processing.angle_weights(sine, SPACING / distance) if angle else np.broadcast_to(track[:, 5:], delay.shape)
    inside = np.abs(delay) <= WINDOW / 2
    position = np.clip(delay, -WINDOW / 2, WINDOW / 2) * per_metre + middle
    before = np.minimum(np.floor(position), 2 * middle - 1).astype(int)
    taps = tap_weights((position - before).astype(np.float32).ravel(), polynomials).reshape(TAPS, pulses, points)
    read = (before + 1)[..., None] + np.arange(TAPS)
    samples = dense[np.arange(pulses)[:, None, None], read]
    expected = np.einsum("px,jpx,pxjd->xd", gain * np.exp(1j * WAVENUMBER * delay), taps, samples)
    np.testing.assert_allclose(image[:, 0] + 1j * image[:, 1], expected, atol=2e-6 * np.abs(expected).max() * pulses)
    np.testing.assert_allclose(weight, gain.sum(axis=0), rtol=1e-5)
    np.testing.assert_array_equal(valid, np.all(inside | (gain == 0), axis=0))
    assert 0.1 < np.mean(valid) < 0.95

    values = np.empty((pulses, points, detectors), np.complex64)
    read_profiles(delay, dense.view(np.float32), polynomials, per_metre, middle, WINDOW / 2, values.view(np.float32))
    expected = np.einsum("jpx,pxjd->pxd", taps, samples)
    np.testing.assert_allclose(values, expected, atol=2e-6 * np.abs(expected).max())

    # Every spot is the second pixel of a row of its own.
    step, turns = np.array([0.03, 0.1, -0.2]), np.empty((points, 2, pulses), np.complex64)
    starts = spots.T - step
    fill_turns(starts, step, track.T[[0, 1, 2, 3, 5]], WAVENUMBER / (2 * np.pi), turns.view(np.float32))
    np.testing.assert_allclose(turns[:, 1], (track[:, 5:] * np.exp(1j * WAVENUMBER * delay)).T, atol=2e-6)

    reached, along = np.ones((points, 2), bool), np.array([1.0, 0.0, 0.0])
    for start, row in zip(starts, reached, strict=True):
        whole = row_is_reached(start, step, along, track[:, :5].copy(), WINDOW / 2, angle, SPACING, row)
        assert whole == row.all()
    np.testing.assert_array_equal(reached[:, 1], valid)


def test_a_row_whose_ends_are_reached_and_whose_middle_is_too_near_is_not_taken_for_reached() -> None:
    """Of 6 m past an antenna 20 m away, of which a window of 0.2 m around 20.15 m holds the outer parts."""
    step, along = np.array([0.1, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    start, reached = np.array([-3.0, 20.0, 0.0]), np.ones(61, bool)
    track = np.array([[0.0, 0.0, 0.0, 20.15, 0.0]])
    assert not row_is_reached(start, step, along, track, 0.1, 0.0, SPACING, reached)
    distance = np.hypot(-3.0 + 0.1 * np.arange(61), 20.0)
    np.testing.assert_array_equal(reached, np.abs(distance - 20.15) <= 0.1)
    assert reached[0]
    assert reached[-1]
    assert not reached[30]
