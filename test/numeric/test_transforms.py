"""Lengths of FFTs, blocks of rows, exp(j phase), chirp z-transforms and centred sums."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric._kernels import cosine_and_sine
from sal_height.numeric.transforms import (
    BUFFER,
    PRODUCT,
    SMALL,
    CentredSums,
    blocks,
    chirp_z,
    fast_length,
    outer_phasors,
    rows_at_once,
    unit_phasors,
)


@pytest.mark.parametrize("least", [1, 16, 17, 1000, 4097])
def test_fast_lengths_are_long_enough_and_have_small_factors(least: int) -> None:
    """At most a fifth longer than asked for, from a few vectors on."""
    length = rest = fast_length(least)
    assert least <= length <= max(32, 1.2 * least)
    assert length % 16 == 0
    for factor in (2, 3, 5):
        while rest % factor == 0:
            rest //= factor
    assert rest == 1


def test_blocks_cover_all_rows_once_and_fit_into_the_buffer() -> None:
    rows = rows_at_once(1000)
    assert rows == BUFFER // 1000
    assert rows_at_once(10 * BUFFER) == 1
    covered = [row for block in blocks(10, 4) for row in range(10)[block]]
    assert covered == list(range(10))
    assert blocks(0, 4) == []


@pytest.mark.parametrize("largest", [np.pi, 1e3, 1e7])
def test_phasors_of_large_phases_keep_the_digits_of_small_ones(largest: float) -> None:
    """At 1e7 rad, a million turns of a lidar's light, the float64 phase itself is good to 2e-9."""
    phase = np.random.default_rng(64).uniform(-largest, largest, 20000)
    made = unit_phasors(phase)
    assert made.dtype == np.complex64
    assert np.abs(made - np.exp(1j * phase)).max() < 1e-6


def test_phasors_of_whole_quarter_turns() -> None:
    phase = np.pi / 2 * np.arange(-8, 9)
    np.testing.assert_allclose(unit_phasors(phase), 1j ** np.arange(-8, 9), atol=2e-7)


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 5), (2, SMALL - 1), (3, SMALL), (7, 1, 2)])
def test_phasors_of_any_shape_however_they_are_shared_among_threads(shape: tuple[int, ...]) -> None:
    phase = np.random.default_rng(65).uniform(-9, 9, shape[::-1]).T  # not contiguous
    made = unit_phasors(phase)
    assert made.shape == shape
    np.testing.assert_allclose(made, np.exp(1j * phase), atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (4, SMALL), (0, 3)])
def test_phasors_of_products_are_those_of_all_pairs(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(66)
    first, second = rng.uniform(-1e3, 1e3, shape[0]), rng.uniform(-1e4, 1e4, shape[1])
    made = outer_phasors(first, second)
    assert made.dtype == np.complex64
    np.testing.assert_allclose(made, np.exp(1j * np.outer(first, second)), atol=1e-6)


def test_cosine_and_sine_count_turns() -> None:
    for turns in (0.0, 0.125, -0.25, 0.5, 1e6 + 0.375):
        cosine, sine = cosine_and_sine(turns)
        assert cosine == pytest.approx(np.cos(2 * np.pi * turns), abs=1e-6)
        assert sine == pytest.approx(np.sin(2 * np.pi * turns), abs=1e-6)


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
