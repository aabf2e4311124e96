"""ROS parameters as messages: their values by type, as rclpy has them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from sal_height.errors import UserError
from sal_height.messages.types import Parameter, ParameterType, ParameterValue

KEPT = 512
"""Number of cached parameters, those used last: nearly all are the same from dwell to dwell."""

FIELDS = {
    ParameterType.PARAMETER_NOT_SET: "",
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
    ParameterType.PARAMETER_STRING: "string_value",
    ParameterType.PARAMETER_BYTE_ARRAY: "byte_array_value",
    ParameterType.PARAMETER_BOOL_ARRAY: "bool_array_value",
    ParameterType.PARAMETER_INTEGER_ARRAY: "integer_array_value",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "double_array_value",
    ParameterType.PARAMETER_STRING_ARRAY: "string_array_value",
}
"""Field of ParameterValue by its type."""

SINGLE: tuple[tuple[type[Any], int], ...] = (
    (bool, ParameterType.PARAMETER_BOOL),
    (int, ParameterType.PARAMETER_INTEGER),
    (float, ParameterType.PARAMETER_DOUBLE),
    (str, ParameterType.PARAMETER_STRING),
)
"""Types of parameters by those of their values; bool is before int, of which it is a subclass."""

LISTS: tuple[tuple[type[Any], int], ...] = (
    (bytes, ParameterType.PARAMETER_BYTE_ARRAY),
    (bool, ParameterType.PARAMETER_BOOL_ARRAY),
    (int, ParameterType.PARAMETER_INTEGER_ARRAY),
    (float, ParameterType.PARAMETER_DOUBLE_ARRAY),
    (str, ParameterType.PARAMETER_STRING_ARRAY),
)
"""Types of list parameters by the type of all their elements; an empty list is of bytes."""


def parameter_of(name: str, value: Any) -> Parameter:
    """The message of a parameter.

    Raises:
        TypeError: no parameter can have that value.
    """
    kind = _kind_of(value)
    if field := FIELDS[kind]:
        stored = b"".join(value) if kind == ParameterType.PARAMETER_BYTE_ARRAY else value
        return Parameter(name=name, value=ParameterValue(type=kind, **{field: stored}))
    return Parameter(name=name)


@lru_cache(KEPT, typed=True)
def _kept_parameter(name: str, value: bool | float | str) -> Parameter:
    return parameter_of(name, value)


def shared_parameter(name: str, value: Any) -> Parameter:
    """The message of a parameter, which must not be changed: that of the same single value is the same object.

    Zeros of floats are not shared, for 0.0 and -0.0 are equal.

    Raises:
        TypeError: no parameter can have that value.
    """
    is_single = isinstance(value, bool | int | float | str) and not (isinstance(value, float) and value == 0)
    return _kept_parameter(name, value) if is_single else parameter_of(name, value)


def value_of(message: ParameterValue) -> Any:
    """The value of a parameter; None: not set.

    Raises:
        UserError: it is of a type that ROS does not have.
    """
    if message.type not in FIELDS:
        raise UserError(f"A parameter is of type {message.type}; 0 to 9 are allowed.")
    field = FIELDS[message.type]
    if not field:
        return None
    value = getattr(message, field)
    if message.type == ParameterType.PARAMETER_BYTE_ARRAY:
        return [bytes([byte]) for byte in value]
    if message.type < ParameterType.PARAMETER_BYTE_ARRAY:
        return value
    return value.tolist() if hasattr(value, "tolist") else list(value)


def _kind_of(value: Any) -> int:
    if value is None:
        return int(ParameterType.PARAMETER_NOT_SET)
    for kind, number in SINGLE:
        if isinstance(value, kind):
            return number
    if isinstance(value, list | tuple):
        for kind, number in LISTS:
            if all(isinstance(one, kind) for one in value):
                return number
    raise TypeError(f"{value!r} is no value of a parameter")
