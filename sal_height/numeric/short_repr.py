"""Text of one screen for dataclasses that contain arrays, as a notebook shows it."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

WIDTH = 100
"""Longest line of the text."""

UNIT = re.compile(r",\s(m\^2|m/s²|m/s|m|rad/s|rad|Hz|dB|s|ns|K|W)(?=[\s.,;:]|$)")
"""Unit of an attribute: the entry of the docstring ends with it, or has it before the rest."""


class ShortRepr:
    """Base of dataclasses whose `repr` has a line for each field: of arrays type, shape, range, NaN and unit."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Keep `dataclass` from making its own `repr`, with all elements of arrays."""
        super().__init_subclass__(**options)
        cls.__repr__ = ShortRepr.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        fields = {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.repr}  # type: ignore[arg-type]
        shown = {name: value for name, value in fields.items() if not _is_empty(value)}
        units, width = _units_of(type(self)), max(map(len, shown), default=0)
        lines = [f"  {name:<{width}}  {_summary(value, units.get(name, ''))}" for name, value in shown.items()]
        return "\n".join([type(self).__name__, *(_cut(line) for line in lines)])


def _is_empty(value: Any) -> bool:
    return value is None or (isinstance(value, tuple | str | Mapping) and not value)


def _summary(value: Any, unit: str) -> str:
    """A value in one line: arrays by their properties, objects by their numbers, tuples of objects by their count."""
    if isinstance(value, np.ndarray):
        return _array_summary(value, unit)
    if dataclasses.is_dataclass(value):
        return _object_summary(value)
    if isinstance(value, tuple | list) and value and not isinstance(value[0], int | float | complex | str):
        return f"{len(value)} of {type(value[0]).__name__}"
    return f"{value!r} {unit}".rstrip() if isinstance(value, int | float) else " ".join(repr(value).split())


def _array_summary(array: np.ndarray[Any, Any], unit: str) -> str:
    """Type, shape and range of an array (of magnitudes if it is complex), and the share of NaN."""
    parts = [f"{array.dtype} {array.shape}"]
    if array.size and array.dtype.kind in "biufc":
        magnitude = np.abs(array) if array.dtype.kind == "c" else array
        finite = magnitude[np.isfinite(magnitude)] if array.dtype.kind in "fc" else magnitude
        if finite.size:
            name = "magnitude " if array.dtype.kind == "c" else ""
            ends = f"{finite.min():.6g} to {finite.max():.6g} {unit}".rstrip()
            parts.append(f"{name}{ends}")
        if missing := np.count_nonzero(np.isnan(magnitude)):
            parts.append(f"{100 * missing / array.size:.3g} % NaN")
    return ", ".join(parts)


def _object_summary(value: Any) -> str:
    """Name of an object and those of its fields that are numbers or texts."""
    fields = ((one.name, getattr(value, one.name)) for one in dataclasses.fields(value))
    plain = (f"{name}={field!r}" for name, field in fields if isinstance(field, int | float | str) and field != "")
    return f"{type(value).__name__}({', '.join(plain)})"


def _units_of(kind: type) -> dict[str, str]:
    """Units of the attributes by name, as the docstring of the class states them."""
    entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", inspect.getdoc(kind) or "", re.MULTILINE)
    found = ((name, UNIT.search(f"{text}")) for name, text in entries)
    return {name: unit[1] for name, unit in found if unit}


def _cut(line: str) -> str:
    return line if len(line) <= WIDTH else f"{line[: WIDTH - 1]}…"
