"""Sums around the middle, by halves, are the sums written out."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric.transforms import PRODUCT, CentredSums


@pytest.mark.parametrize(
    ("lines", "inputs", "outputs"),
    [(7, 64, 46), (7, 64, 47), (7, 63, 46), (7, 63, 47), (3, 1, 1), (3, 2, 5), (900, 64, 46)],
)
def test_halves_give_the_sums_written_out(lines: int, inputs: int, outputs: int) -> None:
    """Of even and odd numbers in and out, with factors before; columns beyond the lines stay as they are."""
    step = 0.9 * 2 * np.pi / inputs
    numbers = circular(np.random.default_rng(62), (lines, inputs)).astype(np.complex64)
    turns = step * np.outer(np.arange(inputs) - inputs // 2, np.arange(outputs) - (outputs - 1) / 2)
    made = np.full((outputs, lines + 2), 7, np.complex64)
    sums = CentredSums.of(step, inputs, outputs)
    sums.fill_columns(numbers, made)
    assert (2 * lines * sums.cosines.size > PRODUCT) == (lines == 900)
    np.testing.assert_allclose(made[:, :lines], (numbers @ np.exp(1j * turns)).T, atol=1e-6 * inputs)
    assert np.all(made[:, lines:] == 7)
    factors = circular(np.random.default_rng(63), (lines, inputs)).astype(np.complex64)
    sums.times(factors).fill_columns(numbers, made)
    np.testing.assert_allclose(made[:, :lines], (numbers * factors @ np.exp(1j * turns)).T, atol=3e-6 * inputs)
