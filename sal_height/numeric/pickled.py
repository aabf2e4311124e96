"""Objects as few as possible for pickling, whose cost is that of their number: small arrays are joined to bytes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from sal_height.numeric.arrays import F64


def joined_bytes(arrays: Iterable[F64]) -> bytes:
    """The bytes of arrays of float64, one after the other."""
    return b"".join([np.asarray(array, np.float64).tobytes() for array in arrays])


def arrays_of(joined: bytes, shapes: Iterable[tuple[int, ...]]) -> list[F64]:
    """The arrays of these shapes that `joined_bytes` has joined; they cannot be written to."""
    whole, found, at = np.frombuffer(joined, np.float64), [], 0
    for shape in shapes:
        end = at + math.prod(shape)
        found.append(whole[at:end].reshape(shape))
        at = end
    return found


def by_fields(one: Any) -> tuple[type[Any], tuple[Any, ...]]:
    """Class and fields of an object of a dataclass, the result of its `__reduce__`: without what it has cached."""
    kind: Any = type(one)
    return kind, _values_of(kind)(one)


@lru_cache(64)
def _values_of(kind: Any) -> Any:
    return attrgetter(*(field.name for field in fields(kind)))
