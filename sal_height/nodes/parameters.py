"""Node parameters as one frozen dataclass: declaration, description, range check and typed values from one table."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height.errors import UserError

Table = TypeVar("Table")


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

    Raises:
        UserError: an override has the wrong type, is out of range or is not one of the choices.
    """
    fields = dataclasses.fields(table)  # type: ignore[arg-type]
    for field in fields:
        try:
            node.declare_parameter(field.name, field.default, _descriptor(field))
        except (InvalidParameterValueException, InvalidParameterTypeException) as error:
            raise UserError(f"{str(error).rstrip('.')}; {_allowed(field)}.") from error
        if refusal := _refusal(field, node.get_parameter(field.name).value):
            raise UserError(refusal)
    by_name = {field.name: field for field in fields}

    def check(parameters: list[Parameter]) -> SetParametersResult:
        refusals = [_refusal(by_name[p.name], p.value) for p in parameters if p.name in by_name]
        reason = next((refusal for refusal in refusals if refusal), "")
        return SetParametersResult(successful=not reason, reason=reason)

    node.add_on_set_parameters_callback(check)


def read_parameters(node: Node, table: type[Table]) -> Table:
    """Current values of the parameters that `declare_parameters` declared."""
    return table(**{field.name: node.get_parameter(field.name).value for field in dataclasses.fields(table)})  # type: ignore[arg-type]


def as_json(stage: str, values: Any, before: str = "{}") -> str:
    """Provenance.parameters: the object `before` with the parameters of `stage` added."""
    return json.dumps(json.loads(before or "{}") | {stage: dataclasses.asdict(values)}, sort_keys=True)


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
    kind = type(field.default).__name__
    if field.metadata["choices"]:
        return f"allowed are {', '.join(field.metadata['choices'])}"
    if field.metadata["range"]:
        low, high = field.metadata["range"]
        return f"it must be a {kind} from {low:g} to {high:g}"
    return f"it must be a {kind}"


def _refusal(field: dataclasses.Field[Any], value: Any) -> str:
    choices = field.metadata["choices"]
    return f"Parameter {field.name} is {value!r}; {_allowed(field)}." if choices and value not in choices else ""
