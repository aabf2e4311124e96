"""Transforms of rows: the definition, by either library."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import numpy as np
import pytest
import scipy.fft
from helpers import assert_one_sentence, circular

from sal_height.errors import UserError
from sal_height.numeric.fft import CHOICE, Rows

LIBRARIES = [
    "scipy",
    pytest.param("fftw", marks=pytest.mark.skipif(not find_spec("pyfftw"), reason="pyfftw is not installed")),
]


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("length", [1, 30, 49, 64])
def test_rows_are_transformed_by_the_definition_and_not_scaled(
    library: str, length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CHOICE, library)
    numbers = circular(np.random.default_rng(62), (3, length)).astype(np.complex64)
    turns = np.outer(np.arange(length), np.arange(length)) / length
    rows = Rows(3, length)
    assert rows.data.dtype == np.complex64
    assert not rows.data.any()
    ways = ((rows.forward, -1, rows.data, rows.spectrum), (rows.backward, 1, rows.spectrum, rows.data))
    for way, sign, given, made in ways:
        given[:] = numbers
        way()
        assert made is (rows.spectrum if sign < 0 else rows.data)  # whoever holds the buffer sees the result
        np.testing.assert_allclose(made, numbers @ np.exp(sign * 2j * np.pi * turns), atol=1e-5 * length)


@pytest.mark.parametrize("library", LIBRARIES)
def test_forward_and_back_is_length_times_the_numbers(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CHOICE, library)
    numbers = circular(np.random.default_rng(63), (5, 60)).astype(np.complex64)
    rows = Rows(5, 60)
    rows.data[:] = numbers
    rows.forward()
    rows.backward()
    np.testing.assert_allclose(rows.data, 60 * numbers, atol=60 * 1e-6)


def test_fftw_is_used_only_where_it_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """An extra that happens to be installed must not change the last digits of images."""
    monkeypatch.delenv(CHOICE, raising=False)
    numbers = circular(np.random.default_rng(64), (4, 96)).astype(np.complex64)
    rows = Rows(4, 96)
    rows.data[:] = numbers
    rows.forward()
    np.testing.assert_array_equal(rows.spectrum, scipy.fft.fft(numbers))


def test_a_library_that_cannot_be_used_is_refused_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CHOICE, "mkl")
    with pytest.raises(UserError) as refusal:
        Rows(1, 16)
    assert_one_sentence(str(refusal.value), CHOICE, "'mkl'", "'scipy' and 'fftw'")
    monkeypatch.setenv(CHOICE, "fftw")
    monkeypatch.setitem(sys.modules, "pyfftw", None)
    with pytest.raises(UserError) as refusal:
        Rows(1, 16)
    assert_one_sentence(str(refusal.value), CHOICE, "not installed", "sal_height[fast]")
