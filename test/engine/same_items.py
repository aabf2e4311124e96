"""Equality of items value for value: arrays, dataclasses, tuples and mappings, with NaN equal to itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
from pydantic import BaseModel

from sal_height.geometry import Projection

SIMPLE = str, bytes, int, float, complex, AbstractSet, type(None), type, np.generic
"""Kinds of values that are compared by =="""


def difference(one: Any, other: Any, where: str = "") -> str:
    """Where two items differ first, and how; empty if they are the same."""
    if one is other:
        return ""
    if type(one) is not type(other):
        return f"{where}: {type(one)} and {type(other)}"
    if isinstance(one, np.ndarray):
        return _between_arrays(one, other, where)
    ours, theirs = _parts_of(one), _parts_of(other)
    if ours is None or theirs is None:
        both_nan = one != one and other != other  # noqa: PLR0124 (that is what NaN is)
        return "" if both_nan or one == other else f"{where}: {one!r} and {other!r}"
    if list(ours) != list(theirs):
        return f"{where}: {list(ours)} and {list(theirs)}"
    found = (difference(ours[name], theirs[name], f"{where}.{name}") for name in ours)
    return next(filter(None, found), "")


def are_same(one: Any, other: Any) -> bool:
    """Whether two items have the same values."""
    return not difference(one, other)


def _parts_of(item: Any) -> Mapping[Any, Any] | None:
    """The parts of an item by name or number; None: it has none."""
    if isinstance(item, SIMPLE):
        return None
    if isinstance(item, Projection):
        return {"name": item.name}
    if dataclasses.is_dataclass(item):
        return {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
    if isinstance(item, BaseModel | Mapping):
        return dict(item)
    if isinstance(item, Sequence):
        return dict(enumerate(item))
    raise TypeError(f"{item!r} has no values to compare")


def _between_arrays(one: Any, other: Any, where: str) -> str:
    if (one.dtype, one.shape) != (other.dtype, other.shape):
        return f"{where}: arrays {one.dtype} {one.shape} and {other.dtype} {other.shape}"
    if np.array_equal(one, other, equal_nan=one.dtype.kind in "fc"):
        return ""
    return f"{where}: {np.count_nonzero(one != other)} of {one.size} numbers differ"
