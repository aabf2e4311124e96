"""Parameters and values that had other names: what is recorded or written with the old ones is read with the new.

`with_new_names` serves custom data of bags, parameters.yaml, provenance, parameter events, presets, `--param` and
campaigns. A node declares the new names only; its refusal of an old one, as from a launch file, names the new one.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

PARAMETERS: Mapping[str, str] = MappingProxyType(
    {
        "air_held_s": "air_max_age_s",
        "first_misfit_share": "first_misfit_fraction",
        "max_saturated_share": "max_saturated_fraction",
        "misfit_share": "misfit_fraction",
        "odometry_held_s": "odometry_buffer_s",
        "outlier_share": "outlier_fraction",
    }
)
"""New names of parameters by the old ones, which no parameter of any node has today."""

VALUES: Mapping[str, Mapping[Any, str]] = MappingProxyType(
    {"air": {"heard": "topics"}, "autofocus": {True: "always", False: "never"}}
)
"""New values by the old ones, by the new name of the parameter."""


ENDED: Mapping[str, Any] = MappingProxyType({"prior_strength": 0.0})
"""Parameters that have ended, with the value that changed nothing."""


def with_new_names(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of one node with new names and values; where both names are given, the new one counts.

    Parameters that have ended are left out where they changed nothing.
    """
    values = {name: value for name, value in values.items() if name not in ENDED or value != ENDED[name]}
    found = {PARAMETERS.get(name, name): value for name, value in values.items() if name in PARAMETERS}
    found |= {name: value for name, value in values.items() if name not in PARAMETERS}
    return {name: new_value(name, value) for name, value in found.items()}


def new_value(name: str, value: Any) -> Any:
    """The new value of a parameter for an old one; any other as it is."""
    olds = VALUES.get(name, {})
    return olds[value] if isinstance(value, (bool, str)) and value in olds else value
