"""Modules whose names have moved to others: for one release the old ones still work, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any


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
