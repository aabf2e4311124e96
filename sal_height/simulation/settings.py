"""Types of the values that settings read from YAML may have."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from pydantic import BeforeValidator, ConfigDict
from pydantic_core import PydanticCustomError


class StrictKeys:
    """Base of the settings classes: unknown keys, infinities and NaN are refused."""

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


def _not_boolean(value: Any) -> Any:
    if isinstance(value, bool):
        raise PydanticCustomError("boolean", "it must be a number, not true or false")
    return value


Float = Annotated[float, BeforeValidator(_not_boolean)]
Int = Annotated[int, BeforeValidator(_not_boolean)]
Decibels = Annotated[Float, Ge(-60), Le(60)]
Angle = Annotated[Float, Ge(-np.pi), Le(np.pi)]
