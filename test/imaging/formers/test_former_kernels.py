"""The compiled loops of the image formers against their formulas in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.imaging.formers._kernels import (
    _add_all,
    _add_one,
    _add_runs,
    _changes,
    add_pulses,
    fill_turns,
    read_profiles,
    row_is_reached,
)
from sal_height.imaging.pixels import Processing
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


@pytest.mark.parametrize("detectors", [1, 3])
@pytest.mark.parametrize("runs", [1, 2, 30, 300], ids=["no change", "one change", "runs of 10", "hardly any run"])
def test_pixels_that_read_the_same_samples_are_read_as_others(runs: int, detectors: int) -> None:
    rng, pixels = np.random.default_rng(115), 301
    sample = np.sort(rng.integers(0, runs, pixels)).astype(np.int32)
    fraction, cosine, sine = (rng.uniform(low, 1, pixels).astype(np.float32) for low in (0, -1, -1))
    profile = circular(rng, (runs + TAPS, detectors)).astype(np.complex64)
    apart = np.stack([profile.real, profile.imag], axis=1)
    tap = tap_weights(fraction, tap_polynomials())
    read = np.einsum("jp,jpd->dp", tap, profile[sample + np.arange(TAPS)[:, None]])
    expected = 1 + 1j + read * (cosine + 1j * sine)
    at_once, one_by_one = np.ones((2, detectors, 2, pixels), np.float32)
    _add_runs(sample, _changes(sample), fraction, cosine, sine, apart, tap_polynomials(), at_once)
    if detectors == 1:
        _add_one(sample, tap, cosine, sine, apart, one_by_one)
    else:
        by_pixel = np.ones((pixels, 2, detectors), np.float32)
        _add_all(sample, tap, cosine, sine, apart, by_pixel)
        one_by_one = by_pixel.T  # (detectors, 2, pixels)
    for image in (at_once, one_by_one):
        np.testing.assert_allclose(image[:, 0] + 1j * image[:, 1], expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.parametrize("detectors", [1, 3])
def test_pixels_in_a_row_have_the_values_that_they_have_among_others(detectors: int) -> None:
    """1500 pixels at ranges that grow by 13 dense samples; shuffled, hardly two in a row read the same samples."""
    rng, points = np.random.default_rng(116), 1500
    track, _ = scene(7, 1)
    spots = np.stack([np.full(points, 0.1), np.linspace(19.6, 20.4, points), np.zeros(points)])
    dense = dense_profiles(circular(rng, (detectors, 7, COUNT)).astype(np.complex64), np.ones(COUNT))
    profiles = np.stack([dense.real, dense.imag], axis=2)
    scales = np.array([OVERSAMPLING * COUNT / WINDOW, COUNT, WAVENUMBER / (2 * np.pi), WINDOW / 2, 0.0, SPACING])
    images = np.zeros((2, detectors, 2, points), np.float32)
    shuffled = rng.permutation(points)
    for image, order in zip(images, (np.arange(points), shuffled), strict=True):
        add_pulses(
            spots[:, order].copy(), np.zeros(points), track, profiles, tap_polynomials(), np.ones(2, np.float32),
            scales, image, np.zeros(points), np.ones(points, bool),
        )  # fmt: skip
    np.testing.assert_allclose(images[0][:, :, shuffled], images[1], atol=2e-6 * np.abs(images).max())


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
    image = np.zeros((detectors, 2, points), np.float32)
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
    expected = np.einsum("px,jpx,pxjd->dx", gain * np.exp(1j * WAVENUMBER * delay), taps, samples)
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
