"""Modules whose names have moved to others: for one release the old ones still work, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any


def names_of(old: str, new: str) -> Callable[[str], Any]:
    """The `__getattr__` of a module that has moved.

    Args:
        old: dotted name of the module as it was.
        new: dotted name of the module that has its names now.
    """

    def find(name: str) -> Any:
        if name.startswith("__") or not hasattr(module := import_module(new), name):
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        warnings.warn(
            f"{old}.{name} has moved to {new}; import it from there, the old name ends with the next release.",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(module, name)

    return find
