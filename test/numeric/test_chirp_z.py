"""The chirp z-transform is the sum that its docstring writes out."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric.chirp_z import SMALL_MATRIX, chirp_z


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
    np.testing.assert_allclose(transform.apply(numbers, slice(None)), expected, atol=1e-6 * inputs)
    some = slice(1, 3)
    np.testing.assert_allclose(transform.apply(numbers[some], some), expected[some], atol=1e-6 * inputs)


@pytest.mark.parametrize(("count", "by_matrix"), [(48, True), (90, True), (91, False)])
def test_a_step_of_one_turn_over_the_numbers_is_the_fourier_transform(count: int, by_matrix: bool) -> None:
    """One step serves any number of lines; small transforms are products with a matrix."""
    numbers = circular(np.random.default_rng(61), (5, count)).astype(np.complex64)
    transform = chirp_z(np.array([-2 * np.pi / count]), count, 0.0, count, 0.0)
    made = transform.apply(numbers, slice(10, 15))
    assert (count**2 <= SMALL_MATRIX) == by_matrix
    np.testing.assert_allclose(made, np.fft.fft(numbers), atol=2e-5)
    assert made.dtype == np.complex64
