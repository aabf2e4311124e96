"""Dense range profiles: a short kernel reads the transform of a spectrum at any delay."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric.range_profiles import OVERSAMPLING, TAPS, dense_profiles, tap_polynomials, tap_weights


def read(spectra: np.ndarray, weights: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Profiles at delays in resolution cells, by the kernel, as the docstrings say: (detectors, pulses, cells)."""
    profiles = dense_profiles(spectra, weights)
    position = cells * OVERSAMPLING + OVERSAMPLING * spectra.shape[2] // 2 + TAPS // 2
    before = np.floor(position).astype(int)
    taps = tap_weights((position - before).astype(np.float32), tap_polynomials())
    index = before + np.arange(TAPS)[:, None] - TAPS // 2 + 1
    complex_profiles = profiles[:, :, 0] + 1j * profiles[:, :, 1]
    return np.einsum("jc,pjcd->dpc", taps, complex_profiles[:, index])


@pytest.mark.parametrize("count", [16, 17, 63, 64])
@pytest.mark.parametrize("detectors", [1, 3])
def test_profile_at_any_delay_is_the_transform_written_out(count: int, detectors: int) -> None:
    """Over the whole range window, for even and odd numbers of frequencies."""
    rng = np.random.default_rng(67)
    spectra = circular(rng, (detectors, 2, count)).astype(np.complex64)
    weights, cells = rng.uniform(0.5, 1.5, count), rng.uniform(-count / 2, count / 2, 300)
    turns = np.outer(np.arange(count) - count // 2, cells) / count
    expected = np.einsum("dpf,f,fc->dpc", spectra, weights, np.exp(2j * np.pi * turns))
    np.testing.assert_allclose(read(spectra, weights, cells), expected, atol=1.2e-5 * np.abs(expected).max())


def test_profile_repeats_itself_at_the_ends_of_the_window() -> None:
    spectra = circular(np.random.default_rng(68), (2, 3, 20)).astype(np.complex64)
    profiles = dense_profiles(spectra, np.ones(20))
    assert profiles.shape == (3, OVERSAMPLING * 20 + TAPS, 2, 2)
    np.testing.assert_array_equal(profiles[:, :TAPS], profiles[:, -TAPS:])


def test_polynomials_are_a_kernel_that_is_even() -> None:
    """A position halfway between two samples weighs both sides alike; one on a sample ends in zero weight ahead."""
    taps = tap_weights(np.array([0.0, 0.5, 1.0], np.float32), tap_polynomials())
    scale = taps.max()
    np.testing.assert_allclose(taps[:, 1], taps[::-1, 1], atol=1e-6 * scale)
    np.testing.assert_allclose(taps[:, 0], taps[::-1, 2], atol=1e-6 * scale)
    assert np.argmax(taps[:, 0]) == TAPS // 2 - 1
