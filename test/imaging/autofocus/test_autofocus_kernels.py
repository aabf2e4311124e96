"""The compiled loops of autofocus, each against its formula in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from helpers import circular
from phase_errors import lower_band

from sal_height.imaging.autofocus._kernels import (
    fill_blocks,
    fill_information,
    fill_periodograms,
    find_eigenvectors,
    invert_toeplitz,
    score_shifts,
    subtract_products,
)

PULSES = 24


def hermitian(rng: np.random.Generator, size: int) -> np.ndarray:
    """A positive definite matrix."""
    samples = circular(rng, (3 * size, size))
    return np.asarray(samples.T @ samples.conj())


def column_of_echoes(rng: np.random.Generator) -> np.ndarray:
    """First column of the covariance of a few waves in noise of power 1."""
    waves = np.exp(1j * np.arange(PULSES)[:, None] * rng.uniform(-1, 1, 5))
    return np.asarray(waves @ rng.uniform(1, 50, 5) + np.eye(PULSES)[0])


def test_blocks_hold_neighbouring_cells() -> None:
    """Of 17 cells the last two are left out."""
    responses, found = circular(np.random.default_rng(7), (3, 4, 17)), np.empty((3, 3, 4, 5), np.complex128)
    fill_blocks(responses, found)
    np.testing.assert_array_equal(found, responses[..., :15].reshape(3, 4, 3, 5).transpose(2, 0, 1, 3))


@pytest.mark.parametrize("lags", [0, 5, PULSES - 1])
def test_the_inverse_of_a_toeplitz_matrix_is_that_of_numpy(lags: int) -> None:
    column, inverse = column_of_echoes(np.random.default_rng(1)), np.zeros((PULSES, lags + 1), np.complex128)
    invert_toeplitz(column, inverse)
    expected = lower_band(np.linalg.inv(scipy.linalg.toeplitz(column)), lags)
    np.testing.assert_allclose(inverse.T, expected, atol=1e-12)


@pytest.mark.parametrize("lags", [5, PULSES - 1])
def test_products_of_the_elements_of_two_matrices_are_subtracted(lags: int) -> None:
    rng = np.random.default_rng(2)
    one, other, before = (hermitian(rng, PULSES) for _ in range(3))
    found, band = (np.ascontiguousarray(lower_band(matrix, lags).T) for matrix in (before, one))
    subtract_products(band, other.astype(np.complex64), found)
    expected = lower_band(before - one * other.astype(np.complex64), lags)
    np.testing.assert_allclose(found.T, expected, atol=1e-9)


def test_information_is_twice_the_product_with_the_inverse() -> None:
    column = column_of_echoes(np.random.default_rng(3))
    matrix = scipy.linalg.toeplitz(column)
    inverse, found = np.linalg.inv(matrix), np.empty((PULSES, 9))
    fill_information(column, np.ascontiguousarray(lower_band(inverse, 8).T), found)
    np.testing.assert_allclose(found.T, lower_band(2 * (matrix * inverse.T).real, 8), atol=1e-12)


def test_periodograms_ascend_in_frequency() -> None:
    spectra = circular(np.random.default_rng(4), (7, 2 * PULSES)).astype(np.complex64)
    found = np.empty(spectra.shape, np.float32)
    fill_periodograms(spectra, found)
    np.testing.assert_allclose(found, np.fft.fftshift(np.abs(spectra) ** 2, axes=-1) / PULSES, rtol=1e-6)


def test_scores_are_those_of_a_shifted_spectrum() -> None:
    rng = np.random.default_rng(5)
    found, snr = rng.exponential(5.0, (9, 2 * PULSES)).astype(np.float32), rng.uniform(1, 50, 9)
    spectrum, bend = rng.uniform(0, 1, 2 * PULSES), rng.standard_normal(2 * PULSES)
    scores, slopes = np.empty(9), np.zeros(2 * PULSES)
    information = score_shifts(found, snr, spectrum, bend, scores, slopes)
    even = 1 + np.outer(snr, spectrum)
    slope = (1 - 1 / even) * bend
    assert information == pytest.approx(np.sum(slope**2))
    np.testing.assert_allclose(scores, np.sum((found / even - 1) * slope, axis=-1), rtol=1e-9)
    np.testing.assert_allclose(slopes, np.sum((1 - 1 / even) * slope, axis=0), rtol=1e-9)


@pytest.mark.parametrize("equal", [False, True])
def test_eigenvectors_are_orthogonal_and_of_their_values(equal: bool) -> None:
    """Two eigenvalues of the same matrix, and of one that has them equal but for rounding."""
    rng = np.random.default_rng(6)
    vectors, values = np.linalg.qr(circular(rng, (3, 16, 16)))[0], np.linspace(1, 8, 16) ** 2
    if equal:
        values[-2] = values[-1]
    matrices = (vectors * values @ vectors.conj().swapaxes(1, 2)).astype(np.complex64)
    block, of_each = np.array([0, 0, 2]), np.linalg.eigvalsh(matrices)[[0, 0, 2], [14, 15, 15]].astype(np.float64)
    found = np.empty((3, 16), np.complex128)
    find_eigenvectors(matrices, block, of_each, found)
    np.testing.assert_allclose(found[:2].conj() @ found[:2].T, np.eye(2), atol=1e-12)
    turned = np.einsum("vmn,vn->vm", matrices[block], found)
    np.testing.assert_allclose(turned, of_each[:, None] * found, atol=1e-5 * values[-1])
