"""The straight track nearest to a flight, and pulses at its even steps."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.imaging.formers.straight_track import TAPS, resampling, straight_track

FORWARD = np.array([0.6, 0.8, 0.0])


def test_track_that_is_straight_and_even_is_its_own() -> None:
    steps = 0.25 * (np.arange(40) - 19.5)
    track = straight_track(np.array([5.0, -2.0, 900.0]) + steps[:, None] * FORWARD, FORWARD)
    np.testing.assert_allclose(track.middle, [5, -2, 900], atol=1e-12)
    assert track.spacing == pytest.approx(0.25, rel=1e-12)
    np.testing.assert_allclose(track.places, steps, atol=1e-12)
    np.testing.assert_allclose(track.even, steps, atol=1e-12)


def test_no_other_even_track_is_nearer_to_an_uneven_one() -> None:
    """Least squares: what remains is square to a constant and to a slope."""
    rng = np.random.default_rng(66)
    places = 0.25 * np.arange(41) + 0.05 * rng.standard_normal(41)
    antenna = places[:, None] * FORWARD + rng.standard_normal(41)[:, None] * np.array([-0.8, 0.6, 0.0])
    track = straight_track(antenna, FORWARD)
    slope, constant = np.polyfit(np.arange(41), places, 1)
    assert track.spacing == pytest.approx(slope, rel=1e-9)
    fitted = track.even + track.middle @ FORWARD
    np.testing.assert_allclose(fitted, constant + slope * np.arange(41), atol=1e-12)


def wave(places: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Sinusoids of some turns per metre, one in each column."""
    return np.exp(2j * np.pi * places[:, None] * turns)


@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_frequencies_of_half_the_band_are_resampled_to_60_db(drift: float) -> None:
    """Up to a quarter turn per pulse; from places 0.3 pulses off, or ever further by a speed that changes."""
    index = np.arange(200.0)
    places = 0.5 * (index + drift * index**2 / 400)
    wanted = 0.5 * (np.arange(10.0, 185.0) + 0.3)
    turns = np.linspace(-0.25, 0.25, 21) / 0.5 / (1 + drift)
    samples = wave(places, turns).astype(np.complex64)
    error = resampling(places, wanted) @ samples - wave(wanted, turns)
    assert np.mean(np.abs(error) ** 2, axis=0).max() < 1.5e-6


def test_places_of_pulses_are_taken_as_they_are_and_beyond_them_is_nothing() -> None:
    places = 0.5 * np.arange(20.0)
    samples = wave(places, np.array([0.3, -0.9])).astype(np.complex64)
    wanted = np.concatenate([[-0.5, -0.01], places, [9.51, 30.0]])
    made = resampling(places, wanted) @ samples
    np.testing.assert_allclose(made[2:-2], samples, atol=1e-6)
    np.testing.assert_array_equal(made[[0, 1, -2, -1]], 0)


def test_resampling_reads_only_pulses_that_there_are() -> None:
    """At both ends the first of TAPS pulses is moved inwards."""
    places = np.arange(float(TAPS))
    method = resampling(places, np.linspace(0.0, TAPS - 1.0, 50))
    assert method.shape == (50, TAPS)
    assert method.nnz == 50 * TAPS
    np.testing.assert_allclose(method.toarray()[[0, -1]], np.eye(TAPS)[[0, -1]], atol=1e-6)


def test_fewer_pulses_than_taps_are_all_taken() -> None:
    made = resampling(np.arange(3.0), np.arange(3.0)) @ np.eye(3, dtype=np.float32)
    np.testing.assert_allclose(made, np.eye(3), atol=1e-6)
