"""Dense range profiles: a short kernel reads the transform of a spectrum at any delay."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric._kernels import tap_weights
from sal_height.numeric.range_profiles import (
    OVERSAMPLING,
    TAPS,
    dense_profiles,
    spectra_of_profiles,
    tap_polynomials,
)


def read(spectra: np.ndarray, weights: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Profiles at delays in resolution cells, by the kernel, as the docstrings say: (detectors, pulses, cells)."""
    profiles = dense_profiles(spectra, weights)
    position = cells * OVERSAMPLING + OVERSAMPLING * spectra.shape[2] // 2 + TAPS // 2
    before = np.floor(position).astype(int)
    taps = tap_weights((position - before).astype(np.float32), tap_polynomials())
    index = before + np.arange(TAPS)[:, None] - TAPS // 2 + 1
    return np.einsum("jc,pjcd->dpc", taps, profiles[:, index])


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
    assert profiles.shape == (3, OVERSAMPLING * 20 + TAPS, 2)
    np.testing.assert_array_equal(profiles[:, :TAPS], profiles[:, -TAPS:])


@pytest.mark.parametrize("count", [16, 17, 63])
def test_spectra_of_profiles_are_the_adjoint_of_profiles_of_spectra(count: int) -> None:
    """<profile of s, p> = <s, spectrum of p> for any s and p, also where p reaches over the ends of the window."""
    rng = np.random.default_rng(69)
    spectra = circular(rng, (3, 2, count)).astype(np.complex64)
    profiles = circular(rng, (2, OVERSAMPLING * count + TAPS, 3)).astype(np.complex64)
    dense = dense_profiles(spectra, np.ones(count))
    made = spectra_of_profiles(profiles)
    assert made.shape == spectra.shape
    assert made.dtype == np.complex64
    forward = np.vdot(dense, profiles)
    np.testing.assert_allclose(np.vdot(spectra, made), forward, rtol=3e-6)


def test_spectra_of_long_profiles_take_the_memory_of_the_profiles() -> None:
    """A matrix of 4096 frequencies by 8198 samples would take 269 MB."""
    profiles = np.ones((2, OVERSAMPLING * 4096 + TAPS, 1), np.complex64)
    tracemalloc.start()
    spectra_of_profiles(profiles)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6 * profiles.nbytes


def test_polynomials_are_a_kernel_that_is_even() -> None:
    """A position halfway between two samples weighs both sides alike; one on a sample ends in zero weight ahead."""
    taps = tap_weights(np.array([0.0, 0.5, 1.0], np.float32), tap_polynomials())
    scale = taps.max()
    np.testing.assert_allclose(taps[:, 1], taps[::-1, 1], atol=1e-6 * scale)
    np.testing.assert_allclose(taps[:, 0], taps[::-1, 2], atol=1e-6 * scale)
    assert np.argmax(taps[:, 0]) == TAPS // 2 - 1


def test_weights_of_the_taps_are_the_values_of_their_polynomials() -> None:
    fraction = np.linspace(0, 1, 40, dtype=np.float32)
    expected = np.polynomial.polynomial.polyval(fraction, tap_polynomials().T)
    np.testing.assert_allclose(tap_weights(fraction, tap_polynomials()), expected, atol=1e-6 * expected.max())
