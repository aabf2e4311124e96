"""Transforms of rows: the definition, by either library."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from helpers import circular

from sal_height.numeric import fft
from sal_height.numeric.fft import Rows

BACKENDS = [
    "scipy",
    pytest.param("pyfftw", marks=pytest.mark.skipif(not find_spec("pyfftw"), reason="pyfftw is not installed")),
]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("length", [1, 30, 49, 64])
def test_rows_are_transformed_by_the_definition_and_not_scaled(
    backend: str, length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fft, "BACKEND", backend)
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


@pytest.mark.parametrize("backend", BACKENDS)
def test_forward_and_back_is_length_times_the_numbers(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fft, "BACKEND", backend)
    numbers = circular(np.random.default_rng(63), (5, 60)).astype(np.complex64)
    rows = Rows(5, 60)
    rows.data[:] = numbers
    rows.forward()
    rows.backward()
    np.testing.assert_allclose(rows.data, 60 * numbers, atol=60 * 1e-6)
