"""ROS parameters as messages: their values by type, as rclpy has them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

from sal_height.engine.provenance import flat_values
from sal_height.errors import Rejected, UserError
from sal_height.messages.types import Parameter, ParameterType, ParameterValue
from sal_height.settings import Settings

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

SINGLE_TYPES = frozenset(kind for kind, _ in SINGLE)

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


@lru_cache(KEPT)
def _kept_parameter(name: str, value: Any, kind: str) -> Parameter:  # noqa: ARG001 (a part of the key)
    return parameter_of(name, value)


def shared_parameter(name: str, value: Any) -> Parameter:
    """The message of a parameter, which must not be changed: that of the same value is the same object.

    Long texts and lists are not kept.

    Raises:
        TypeError: no parameter can have that value.
    """
    longest = 256  # elements of a value that is kept
    if type(value) in (str, tuple) and len(value) > longest:
        return parameter_of(name, value)
    # Equal values of other types are other parameters, and so are 0.0 and -0.0.
    is_clear = value and type(value) in SINGLE_TYPES
    return _kept_parameter(name, value, type(value).__name__ if is_clear else repr(value))


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
    if type(value) in SINGLE_TYPES:
        return value
    if message.type == ParameterType.PARAMETER_BYTE_ARRAY:
        return [bytes([byte]) for byte in value]
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


def named_values(parameters: Iterable[Parameter]) -> Iterator[tuple[str, Any]]:
    """Names and values in a Provenance.parameters.

    Raises:
        Rejected: a value is of a type that ROS parameters do not have.
    """
    for parameter in parameters:
        try:
            yield parameter.name, value_of(parameter.value)
        except UserError as error:
            raise Rejected(
                "wrong provenance",
                f"Provenance.parameters has {parameter.name!r} of type {parameter.value.type}; 0 to 9 are allowed.",
            ) from error


def stages_of(parameters: Iterable[Parameter]) -> dict[str, dict[str, Any]]:
    """The values in a Provenance.parameters by stage and name of the parameter.

    Raises:
        Rejected: a value is of a type that ROS parameters do not have.
    """
    stages: dict[str, dict[str, Any]] = {}
    for full_name, value in named_values(parameters):
        stage, _, name = full_name.partition(".")
        stages.setdefault(stage, {})[name] = value
    return stages


def with_stage(before: Sequence[Parameter], stage: str, values: Settings | Mapping[str, Any]) -> list[Parameter]:
    """The value of Provenance.parameters with the parameters of one more stage.

    Args:
        before: parameters of the earlier stages; those of `stage` among them are replaced.
        stage: name of the node, which is the part before the first dot in the names of its parameters.
        values: values of the parameters, by name. Nested mappings make names with further dots; None is left out.
    """
    kept = [parameter for parameter in before if not parameter.name.startswith(f"{stage}.")]
    return kept + [shared_parameter(name, value) for name, value in flat_values(values, f"{stage}.").items()]
