"""Old names: of parameters and values, which are read with the new ones, and of modules, which warn for one release.

`with_new_names` serves custom data of bags, parameters.yaml, provenance, parameter events, presets, `--param` and
campaigns. A node declares the new names only; its refusal of an old one, as from a launch file, names the new one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
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


BEFORE: Mapping[str, Mapping[str, Any]] = MappingProxyType({"sar_compression": {"air": "none"}})
"""Values that did what nodes did before they had these parameters, whose defaults do something else, by node."""


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


def names_of(old: str, new: str, renamed: Mapping[str, str] = MappingProxyType({})) -> Callable[[str], Any]:
    """The `__getattr__` of a module that has moved.

    Args:
        old: dotted name of the module as it was.
        new: dotted name of the module that has its names now.
        renamed: new names of what has another one there, by the old ones.
    """

    def find(name: str) -> Any:
        now = renamed.get(name, name)
        if name.startswith("__") or not hasattr(module := import_module(new), now):
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        place = new if now == name else f"{new} as {now}"
        warnings.warn(
            f"{old}.{name} has moved to {place}; import it from there, the old name ends with the next release.",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(module, now)

    return find
