"""The curves of a figure, and their distance from theory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height.numeric import F64

EXACT = 1e-9
"""Greatest difference from its closed form of a value without standard error."""


@dataclass(frozen=True)
class Curve:
    """One curve of a figure; all arrays have the shape (points,).

    Attributes:
        quantity: plotted quantity; curves of one quantity have common axes.
        case: distinction from other curves of its quantity.
        x: abscissa.
        value: ordinate.
        standard_error: standard error of the value; 0 without random numbers.
        closed_form: exact value; NaN without a closed form.
        style: style of its line in matplotlib.
        colour: number of its colour; curves with one number are to be compared.
    """

    quantity: str
    case: str
    x: F64
    value: F64
    standard_error: F64
    closed_form: F64
    style: str = "-"
    colour: int = 0

    @property
    def name(self) -> str:
        """Name of the curve, of its quantity and case."""
        return f"{self.quantity}, {self.case}"


@dataclass(frozen=True)
class Figure:
    """A figure of one of the papers, or one that adds to them.

    Attributes:
        title: title of the picture.
        axes: labels of the horizontal and the vertical axis, by quantity.
        curve_count: number of curves.
        curves: function of the number of Monte Carlo trials at each point and the seed that makes the curves.
    """

    title: str
    axes: Mapping[str, tuple[str, str]]
    curve_count: int
    curves: Callable[[int, int], Iterator[Curve]]


def exact_curve(
    quantity: str, case: str, x: F64, value: F64, closed_form: F64, style: str = "-", colour: int = 0
) -> Curve:
    """A curve without random numbers."""
    return Curve(quantity, case, x, value, np.zeros_like(x), closed_form, style, colour)


def rows_of(figure: str, curve: Curve) -> list[dict[str, Any]]:
    """The points of a curve: figure, curve, x, value, standard_error, closed_form (NaN: absent)."""
    names = ("x", "value", "standard_error", "closed_form")
    return [
        {"figure": figure, "curve": curve.name} | dict(zip(names, numbers, strict=True))
        for numbers in zip(*(getattr(curve, name).tolist() for name in names), strict=True)
    ]


def check_of(row: dict[str, Any]) -> dict[str, Any] | None:
    """A point with its closed form and `z`, their difference in standard errors; None without a closed form.

    A value without standard error has no z, which is then None: it must be within EXACT. A value that should exist
    and does not is None.
    """
    if np.isnan(row["closed_form"]):
        return None
    value, error = row["value"], row["standard_error"]
    names = ("figure", "curve", "x", "closed_form", "value", "standard_error")
    check = {name: row[name] for name in names} | {"z": (value - row["closed_form"]) / error if error > 0 else None}
    return check if np.isfinite(value) else check | {"value": None, "z": None}


def holds(check: dict[str, Any]) -> bool:
    """True if the value is within 3 standard errors of its closed form, or within EXACT if it has no z."""
    if check["value"] is None:
        return False
    if check["z"] is None:
        return bool(abs(check["value"] - check["closed_form"]) <= EXACT)
    return bool(abs(check["z"]) <= 3.0)
