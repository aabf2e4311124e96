"""Splines on a grid against FITPACK's, which has the same knots."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from sal_height.beams import cubic_surface
from sal_height.beams.cubic_surface import CubicSurface

ORDERS = pytest.mark.parametrize("orders", [(0, 0), (1, 0), (0, 1), (1, 1)], ids=str)


def random_grid(rng: np.random.Generator, columns: int = 9) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, y = np.cumsum(rng.uniform(0.5, 1.5, 7)) - 3, np.cumsum(rng.uniform(0.5, 1.5, columns))
    return x, y, rng.normal(size=(7, columns))


@ORDERS
def test_spline_and_its_derivatives(orders: tuple[int, int]) -> None:
    """At the corners, at the nodes, and between."""
    rng = np.random.default_rng(1)
    x, y, values = random_grid(rng)
    places = [np.concatenate([nodes, rng.uniform(nodes[0], nodes[-1], 50)]) for nodes in (x, y)]
    at_x, at_y = (part.copy() for part in np.meshgrid(*places, indexing="ij"))
    result = CubicSurface.through(x, y, values).at(at_x, at_y, orders)
    expected = RectBivariateSpline(x, y, values).ev(at_x, at_y, *orders)
    assert result.dtype == np.float64
    np.testing.assert_allclose(result, expected, atol=1e-12 * np.max(np.abs(expected)) * 10)


@ORDERS
def test_complex_spline_is_that_of_both_parts(orders: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    x, y, values = random_grid(rng, 4)
    places = rng.uniform(x[0], x[-1], 30), rng.uniform(y[0], y[-1], 30)
    result = CubicSurface.through(x, y, values * (1 - 2j)).at(*places, orders)
    assert result.dtype == np.complex128
    np.testing.assert_allclose(result, (1 - 2j) * CubicSurface.through(x, y, values).at(*places, orders), atol=1e-12)


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    x, y, values = random_grid(rng)
    surface = CubicSurface.through(x, y, values)
    places = rng.uniform(x[0], x[-1], (3, 11)), rng.uniform(y[0], y[-1], (3, 11))
    whole = surface.at(*places, (0, 1))
    monkeypatch.setattr(cubic_surface, "LEAST", 4)
    np.testing.assert_array_equal(surface.at(*places, (0, 1)), whole)
