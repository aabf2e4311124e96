"""Spline through complex or real values on a grid."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from sal_height.numeric import F64

Values = npt.NDArray[Any]
"""Float64 or complex128."""

Surface = Callable[[F64, F64, tuple[int, int]], Values]
"""Derivative of the given orders in x and y, at places x and y of one shape, in that shape."""


def spline_surface(x: F64, y: F64, values: Values, degree: int) -> Surface:
    """Interpolate values on a grid by a tensor-product spline.

    Args:
        x: nodes, increasing, shape (n,), n > degree.
        y: nodes, increasing, shape (m,), m > degree.
        values: real or complex, shape (n, m).
        degree: of the piecewise polynomials along either axis, odd.

    Returns:
        A function that evaluates the spline or a derivative within the grid; real if `values` are.
    """
    if np.iscomplexobj(values):
        real, imaginary = (spline_surface(x, y, part, degree) for part in (values.real, values.imag))
        return lambda at_x, at_y, orders: real(at_x, at_y, orders) + 1j * imaginary(at_x, at_y, orders)
    spline = RectBivariateSpline(x, y, values, kx=degree, ky=degree)
    return lambda at_x, at_y, orders: spline.ev(at_x, at_y, *orders)
