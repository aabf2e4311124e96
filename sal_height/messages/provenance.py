"""Parameters in the message of a provenance, by stage; everything else is done with the provenance of the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sal_height.engine.provenance import flat_values
from sal_height.errors import Rejected, UserError
from sal_height.messages.parameters import shared_parameter, value_of
from sal_height.messages.types import Parameter
from sal_height.settings import Settings


def with_stage(before: Sequence[Parameter], stage: str, values: Settings | Mapping[str, Any]) -> list[Parameter]:
    """The value of Provenance.parameters with the parameters of one more stage.

    Args:
        before: parameters of the earlier stages; those of `stage` among them are replaced.
        stage: name of the node, which is the part before the first dot in the names of its parameters.
        values: values of the parameters, by name. Nested mappings make names with further dots; None is left out.
    """
    kept = [parameter for parameter in before if not parameter.name.startswith(f"{stage}.")]
    return kept + [shared_parameter(name, value) for name, value in flat_values(values, f"{stage}.").items()]


def stages_of(parameters: Sequence[Parameter]) -> dict[str, dict[str, Any]]:
    """The values in a Provenance.parameters by stage and name of the parameter.

    Raises:
        Rejected: a value is of a type that ROS parameters do not have.
    """
    stages: dict[str, dict[str, Any]] = {}
    for parameter in parameters:
        stage, _, name = parameter.name.partition(".")
        try:
            stages.setdefault(stage, {})[name] = value_of(parameter.value)
        except UserError as error:
            sentence = (
                f"Provenance.parameters has {parameter.name!r} of type {parameter.value.type}; 0 to 9 are allowed."
            )
            raise Rejected("wrong provenance", sentence) from error
    return stages
