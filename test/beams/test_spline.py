"""Splines on a grid: exact for polynomials of their degree, also complex ones, with all derivatives that are used."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.beams.spline import spline_surface


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("orders", [(0, 0), (1, 0), (0, 1)], ids=str)
@pytest.mark.parametrize("imaginary", [0.0, 0.7], ids=["real", "complex"])
def test_spline_reproduces_polynomials_and_their_derivatives(
    degree: int, orders: tuple[int, int], imaginary: float
) -> None:
    rng = np.random.default_rng(1)
    x, y = (np.cumsum(rng.uniform(0.1, 0.3, count)) - 1 for count in (degree + 5, degree + 1))
    shape = (degree + 1, degree + 1)
    coefficients = rng.normal(size=shape) + 1j * imaginary * rng.normal(size=shape)
    if not imaginary:
        coefficients = coefficients.real
    at_x, at_y = rng.uniform(x[0], x[-1], (4, 30)), rng.uniform(y[0], y[-1], (4, 30))
    values = np.polynomial.polynomial.polygrid2d(x, y, coefficients)
    found = spline_surface(x, y, values, degree)(at_x, at_y, orders)
    expected = coefficients
    for axis, order in enumerate(orders):
        expected = np.polynomial.polynomial.polyder(expected, order, axis=axis)
    assert found.dtype == values.dtype
    np.testing.assert_allclose(found, np.polynomial.polynomial.polyval2d(at_x, at_y, expected), atol=1e-10)
