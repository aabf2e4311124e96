"""Heights whose rows were estimated apart, as from the channels that receive each of them, in one field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from sal_height.elevation import Validity
from sal_height.numeric import F64, Bool
from sal_height.relief.heights import HeightField, Surface


def joined_rows(parts: Sequence[tuple[Bool, HeightField]]) -> HeightField:
    """A field in which each part has the rows of pixels that belong to it, shape (rows,); the rest is MISSING_DATA.

    Surfaces that a part has not searched for, and probabilities that it has not estimated, are NaN in its rows.
    """
    if len(parts) == 1 and parts[0][0].all():
        return parts[0][1]
    rows, parts_fields = [rows for rows, _ in parts], [field for _, field in parts]
    first, most = parts_fields[0], max(len(field.surfaces) for field in parts_fields)
    validity = np.full(first.validity.shape, Validity.MISSING_DATA, np.uint8)
    for some, field in parts:
        validity[some] = field.validity[some]
    surfaces = []
    for number in range(most):
        given = [field.surfaces[number] if number < len(field.surfaces) else None for field in parts_fields]
        values = {f.name: _joined(rows, [getattr(one, f.name, None) for one in given]) for f in fields(Surface)}
        surfaces.append(Surface(**values))
    probability = _joined(rows, [field.order_probability for field in parts_fields])
    return HeightField(first.grid, validity, tuple(surfaces), probability)


def _joined(rows: Sequence[Bool], arrays: Sequence[F64 | None]) -> Any:
    """An array with the rows of each array that exists, and NaN elsewhere; None if no array exists."""
    known = [(some, array) for some, array in zip(rows, arrays, strict=True) if array is not None]
    if not known:
        return None
    whole = np.full(known[0][1].shape, np.nan)
    for some, array in known:
        whole[some] = array[some]
    return whole
