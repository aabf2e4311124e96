"""The chirp z-transform is the sum that its docstring writes out."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric.transforms import BUFFER, chirp_z, rows_at_once


@pytest.mark.parametrize(
    ("inputs", "outputs", "n0", "m0"),
    [(100, 77, 50, 38.25), (33, 200, 16.5, 0.0), (1, 5, 0.0, 2.0), (7, 1, -3.0, 0.0), (64, 64, 32, 31.5)],
)
def test_factors_give_the_sum_written_out(inputs: int, outputs: int, n0: float, m0: float) -> None:
    """For steps that turn forwards and backwards, not at all, and by more than a turn per index."""
    steps = np.array([0.9 * 2 * np.pi / 100, -0.1, 0.0, 7.0])
    rng = np.random.default_rng(60)
    numbers = circular(rng, (len(steps), inputs))
    product = (np.arange(inputs) - n0)[:, None] * (np.arange(outputs) - m0)
    expected = np.einsum("ln,lnm->lm", numbers, np.exp(1j * steps[:, None, None] * product))
    transform = chirp_z(steps, inputs, n0, outputs, m0)
    numbers = numbers.astype(np.complex64)
    rows, columns = np.empty(expected.shape, np.complex64), np.full((outputs, len(steps) + 1), 7, np.complex64)
    transform.fill_rows(numbers, rows)
    np.testing.assert_allclose(rows, expected, atol=1e-6 * inputs)
    transform.fill_columns(numbers, columns)
    np.testing.assert_allclose(columns[:, :-1], expected.T, atol=1e-6 * inputs)
    assert np.all(columns[:, -1] == 7)
    transform.times(2j * numbers).fill_rows(np.ones_like(numbers), rows)
    np.testing.assert_allclose(rows, 2j * expected, atol=2e-6 * inputs)


@pytest.mark.parametrize(("lines", "count"), [(5, 48), (2 * BUFFER // 512, 150)], ids=["few lines", "several blocks"])
def test_a_step_of_one_turn_over_the_numbers_is_the_fourier_transform(lines: int, count: int) -> None:
    """One step serves any number of lines."""
    numbers = circular(np.random.default_rng(61), (lines, count)).astype(np.complex64)
    transform = chirp_z(np.array([-2 * np.pi / count]), count, 0.0, count, 0.0)
    assert (lines > rows_at_once(transform.length)) == (lines > 5)
    made = np.empty(numbers.shape, np.complex64)
    transform.fill_rows(numbers, made)
    np.testing.assert_allclose(made, np.fft.fft(numbers), atol=5e-5)
    columns = np.empty((count, lines), np.complex64)
    transform.fill_columns(numbers, columns)
    np.testing.assert_allclose(columns, made.T, atol=1e-5)
