"""Provenance: what a product was made from, by which programs and with which parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.parameter import Parameter, parameter_value_to_python
from sal_height_msgs.msg import Provenance

from sal_height import __version__
from sal_height.settings import Settings


def derived(before: Provenance, stage: str, values: Settings | Mapping[str, Any]) -> Provenance:
    """Provenance of what `stage` with the parameters `values` made of a product with the provenance `before`.

    All that `before` says of the images stays: sensor, calibration, and the phase that autofocus took off.
    """
    return Provenance(
        code_version=__version__,
        config_hash=before.config_hash,
        calibration_id=before.calibration_id,
        parameters=with_stage(before.parameters, stage, values),
        autofocus_phase=before.autofocus_phase,
    )


def with_stage(
    before: Sequence[ParameterMessage], stage: str, values: Settings | Mapping[str, Any]
) -> list[ParameterMessage]:
    """Provenance.parameters: `before` with those of `stage` added, in place of what it had.

    Args:
        before: parameters of earlier stages.
        stage: name of the node; part of the parameters' names up to the first dot.
        values: by name. A mapping within becomes names with further dots; None is left out.
    """
    flat = _flat(values, f"{stage}.")
    kept = [parameter for parameter in before if not parameter.name.startswith(f"{stage}.")]
    return kept + [Parameter(name, value=value).to_parameter_msg() for name, value in flat.items()]


def stages_of(parameters: Sequence[ParameterMessage]) -> dict[str, dict[str, Any]]:
    """The values in a Provenance.parameters by stage and name of the parameter."""
    stages: dict[str, dict[str, Any]] = {}
    for parameter in parameters:
        stage, _, name = parameter.name.partition(".")
        stages.setdefault(stage, {})[name] = parameter_value_to_python(parameter.value)
    return stages


def recorded(parameters: Sequence[ParameterMessage], stage: str, name: str) -> Any:
    """Value of the parameter `name` of `stage` in a Provenance.parameters; None if it is not there."""
    return stages_of(parameters).get(stage, {}).get(name)


def _flat(values: Settings | Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """Values that a ROS parameter can have, by name behind the prefix."""
    flat: dict[str, Any] = {}
    for name, value in dict(values).items():
        if isinstance(value, Settings | Mapping):
            flat |= _flat(value, f"{prefix}{name}.")
        elif value is not None:
            flat[prefix + name] = value.item() if isinstance(value, np.generic) else value
    return flat
