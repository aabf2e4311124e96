"""Provenance: what a product was made from, by which version of the programs and with which parameters."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from sal_height import __version__
from sal_height.engine.provenance import Same
from sal_height.errors import Rejected, UserError
from sal_height.messages.parameters import parameter_of, value_of
from sal_height.messages.types import Parameter, Provenance
from sal_height.settings import Settings

HELD_PARAMETERS = 256
"""Messages of parameters held, the last that were used: nearly all are the same from dwell to dwell."""


HELD_PROVENANCES = 16
"""Provenances for which what follows from them is held: those of the products of a node are the same objects."""


def derived(before: Provenance, stage: str, values: Settings | Mapping[str, Any]) -> Provenance:
    """Return the provenance of what `stage`, with the parameters `values`, made of a product.

    That of the same product and settings is the same object, which is to be left as it is.

    Args:
        before: provenance of that product. Its sensor, calibration and autofocus phase are kept.
        stage: name of the node.
        values: of the parameters, by name.
    """
    if isinstance(values, Settings):
        return _derived(Same(before), stage, Same(values))
    return _newly_derived(before, stage, values)


@lru_cache(HELD_PROVENANCES)
def _derived(before: Same[Provenance], stage: str, values: Same[Settings]) -> Provenance:
    return _newly_derived(before.one, stage, values.one)


def _newly_derived(before: Provenance, stage: str, values: Settings | Mapping[str, Any]) -> Provenance:
    return Provenance(
        code_version=__version__,
        config_hash=before.config_hash,
        calibration_id=before.calibration_id,
        parameters=with_stage(before.parameters, stage, values),
        autofocus_phase=before.autofocus_phase,
    )


def with_stage(before: Sequence[Parameter], stage: str, values: Settings | Mapping[str, Any]) -> list[Parameter]:
    """Return the value of Provenance.parameters with the parameters of one more stage.

    Args:
        before: parameters of the earlier stages; those of `stage` among them are replaced.
        stage: name of the node, which is the part before the first dot in the names of its parameters.
        values: of the parameters, by name. Nested mappings make names with further dots; None is left out.
    """
    flat = _flat(values, f"{stage}.")
    kept = [parameter for parameter in before if not parameter.name.startswith(f"{stage}.")]
    return kept + [_parameter(name, value) for name, value in flat.items()]


def _parameter(name: str, value: Any) -> Parameter:
    """The message of a parameter, to be left as it is."""
    if isinstance(value, Hashable):
        return _held_parameter(name, value)
    return parameter_of(name, value)


@lru_cache(maxsize=HELD_PARAMETERS, typed=True)
def _held_parameter(name: str, value: Hashable) -> Parameter:
    return parameter_of(name, value)


def held_stages(provenance: Provenance) -> Mapping[str, Mapping[str, Any]]:
    """Return `stages_of` the parameters of a provenance that is never changed; to be left as it is."""
    return _stages_of(Same(provenance))


@lru_cache(HELD_PROVENANCES)
def _stages_of(provenance: Same[Provenance]) -> Mapping[str, Mapping[str, Any]]:
    return stages_of(provenance.one.parameters)


def stages_of(parameters: Sequence[Parameter]) -> dict[str, dict[str, Any]]:
    """Return the values in a Provenance.parameters by stage and name of the parameter.

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


def recorded(parameters: Sequence[Parameter], stage: str, name: str) -> Any:
    """Return the value of the parameter `name` of `stage` in a Provenance.parameters, or None if it is not there."""
    return stages_of(parameters).get(stage, {}).get(name)


def _flat(values: Settings | Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """Return values that ROS parameters can have by their names, each of which begins with the prefix."""
    flat: dict[str, Any] = {}
    for name, value in dict(values).items():
        if isinstance(value, Settings | Mapping):
            flat |= _flat(value, f"{prefix}{name}.")
        elif value is not None:
            flat[prefix + name] = value.item() if isinstance(value, np.generic) else value
    return flat
