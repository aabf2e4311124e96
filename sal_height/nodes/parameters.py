"""Node parameters as one frozen dataclass: declaration, description, range check and typed values from one table."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height.errors import UserError

Table = TypeVar("Table")

KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
"""How messages call the types a parameter may have."""


def parameter(
    default: Any,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    read_only: bool = False,
) -> Any:
    """A field of a parameter dataclass: default, description with unit, and what is allowed."""
    metadata = {
        "description": description,
        "range": None if minimum is None else (minimum, maximum),
        "choices": tuple(choices),
        "read_only": read_only,
    }
    return dataclasses.field(default=default, metadata=metadata)


def declare_parameters(node: Node, table: type[Table]) -> None:
    """Declare every field of the dataclass `table` on `node`, and refuse values that it does not allow from now on.

    A whole number is taken where the field is a float.

    Raises:
        UserError: an override has the wrong type, is out of range or is not one of the choices.
    """
    fields = {field.name: field for field in dataclasses.fields(table)}  # type: ignore[arg-type]
    for name, field in fields.items():
        # Declared twice: rclpy shows an override of any type only to a parameter of any type.
        override = node.declare_parameter(name, field.default, ParameterDescriptor(dynamic_typing=True)).value
        node.undeclare_parameter(name)
        node.declare_parameter(name, accepted(field, override), _descriptor(field), ignore_override=True)

    def convert(parameters: list[Parameter]) -> list[Parameter]:
        return [
            Parameter(p.name, value=_converted(fields[p.name], p.value)) if p.name in fields else p for p in parameters
        ]

    def check(parameters: list[Parameter]) -> SetParametersResult:
        refusals = [_refusal(fields[p.name], p.value) for p in parameters if p.name in fields]
        reason = next((refusal for refusal in refusals if refusal), "")
        return SetParametersResult(successful=not reason, reason=reason)

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(check)


def read_parameters(node: Node, table: type[Table]) -> Table:
    """Current values of the parameters that `declare_parameters` declared."""
    return table(**{field.name: node.get_parameter(field.name).value for field in dataclasses.fields(table)})  # type: ignore[arg-type]


def _descriptor(field: dataclasses.Field[Any]) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=field.metadata["description"], read_only=field.metadata["read_only"])
    descriptor.additional_constraints = _allowed(field)
    if field.metadata["range"]:
        low, high = field.metadata["range"]
        if isinstance(field.default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        else:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor


def _allowed(field: dataclasses.Field[Any]) -> str:
    if field.metadata["choices"]:
        return f"allowed are {', '.join(field.metadata['choices'])}"
    kind = KINDS[type(field.default)]
    if field.metadata["range"]:
        low, high = field.metadata["range"]
        return f"it must be {kind} from {low:.10g} to {high:.10g}"
    return f"it must be {kind}"


def accepted(field: dataclasses.Field[Any], value: Any) -> Any:
    """A value for a field of a parameter dataclass in the field's type: a whole number is taken for a float, too.

    Raises:
        UserError: it is not allowed.
    """
    value = _converted(field, value)
    if refusal := _refusal(field, value):
        raise UserError(refusal)
    return value


def _type_name(value: Any) -> str:
    """What ROS calls the type of a value; Python's name if it is none of ROS."""
    try:
        return str(Parameter.Type.from_parameter_value(value).name).lower()
    except TypeError:
        return type(value).__name__


def _converted(field: dataclasses.Field[Any], value: Any) -> Any:
    """The value, as a float if it is a whole number and the field a float."""
    return float(value) if type(value) is int and isinstance(field.default, float) else value


def _refusal(field: dataclasses.Field[Any], value: Any) -> str:
    """Why the field does not allow the value, as a sentence; empty if it does."""
    if value is None:
        return f"Parameter {field.name} has no value; {_allowed(field)}."
    given, wanted = _type_name(value), _type_name(field.default)
    if given != wanted:
        return f"Parameter {field.name} is {value!r} ({given}, not {wanted}); {_allowed(field)}."
    low, high = field.metadata["range"] or (value, value)
    if low <= value <= high and value in (field.metadata["choices"] or (value,)):
        return ""
    return f"Parameter {field.name} is {value!r}; {_allowed(field)}."
