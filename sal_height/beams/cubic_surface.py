"""The cubic spline through values on a grid of unequal steps, and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from sal_height.numeric import F64, compiled, in_parallel

Amplitudes = npt.NDArray[np.float64 | np.complex128]

LEAST = 1 << 14
"""Values that are worth a thread."""


@dataclass(frozen=True, eq=False)
class CubicSurface:
    """A piecewise bicubic function of x and y.

    Attributes:
        x: nodes, increasing, shape (n,).
        y: nodes, increasing, shape (m,).
        coefficients: in every cell, of the powers of x and of y past its corner, rising: shape (n - 1, m - 1, 4, 4).
    """

    x: F64
    y: F64
    coefficients: Amplitudes

    @classmethod
    def through(cls, x: F64, y: F64, values: Amplitudes) -> CubicSurface:
        """The not-a-knot spline through `values`, shape (n, m), real or complex."""
        in_x = CubicSpline(x, values).c  # falling powers, intervals, y
        in_both = CubicSpline(y, in_x, axis=-1).c  # falling powers and intervals of y, then those of x
        return cls(x, y, np.ascontiguousarray(in_both[::-1, :, ::-1].transpose(3, 1, 2, 0)))

    def at(self, x: F64, y: F64, orders: tuple[int, int]) -> Amplitudes:
        """The derivative of `orders` in x and y, each 0 or 1, at places within the grid: the shape of both."""
        places = np.ravel(x), np.ravel(y)
        values = np.empty(x.size, dtype=self.coefficients.dtype)

        def work(part: slice) -> None:
            _evaluate(self.x, self.y, self.coefficients, places[0][part], places[1][part], *orders, values[part])

        in_parallel(work, x.size, LEAST)
        return values.reshape(x.shape)


@compiled
def _evaluate(
    x_nodes: F64,
    y_nodes: F64,
    coefficients: Amplitudes,
    x: F64,
    y: F64,
    x_order: int,
    y_order: int,
    values: Amplitudes,
) -> None:
    x_powers, y_powers = np.empty(4), np.empty(4)
    for i in range(len(x)):
        cell = coefficients[_powers(x_nodes, x[i], x_order, x_powers), _powers(y_nodes, y[i], y_order, y_powers)]
        total = 0 * cell[0, 0]
        for j in range(4):
            line = 0 * total
            for k in range(4):
                line += y_powers[k] * cell[j, k]
            total += x_powers[j] * line
        values[i] = total


@compiled
def _powers(nodes: F64, place: float, order: int, powers: F64) -> int:
    """Powers 0 to 3 of the distance past the node before a place, or their derivatives; and that node's number."""
    before = 0
    beyond = len(nodes) - 1
    while beyond - before > 1:
        middle = (before + beyond) // 2
        if nodes[middle] <= place:
            before = middle
        else:
            beyond = middle
    distance = place - nodes[before]
    powers[0] = 1.0 - order
    for power in range(1, 4):
        powers[power] = powers[power - 1] * distance
    if order:
        powers[1], powers[2], powers[3] = 1.0, 2 * distance, 3 * distance * distance
    return before
