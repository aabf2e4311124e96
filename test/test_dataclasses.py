"""Dataclasses that hold arrays compare by identity: a comparison of their fields would raise."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import typing
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from helpers import make_beams

import sal_height

PACKAGES = ("beams", "geometry", "sensor", "theory", "elevation.monopulse")
"""Packages that are held to it."""


def dataclasses_of(package: str) -> Iterator[type]:
    """All dataclasses that the modules of a package define."""
    root = importlib.import_module(f"{sal_height.__name__}.{package}")
    for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, type) and dataclasses.is_dataclass(value) and value.__module__ == module.name:
                yield value


def holds_arrays(annotation: object) -> bool:
    """Whether a value of that annotation is, or contains, an array; a function of arrays does not."""
    origin = typing.get_origin(annotation)
    if origin is Callable:
        return False
    return origin is np.ndarray or any(map(holds_arrays, typing.get_args(annotation)))


@pytest.mark.parametrize("package", PACKAGES)
def test_dataclasses_that_hold_arrays_compare_by_identity(package: str) -> None:
    with_arrays = [
        kind for kind in dataclasses_of(package) if any(map(holds_arrays, typing.get_type_hints(kind).values()))
    ]
    assert [kind for kind in with_arrays if kind.__eq__ is not object.__eq__] == []


def test_beams_can_be_compared_and_hashed() -> None:
    beams, others = make_beams(count=3), make_beams(count=3)
    assert beams != others
    assert [others, beams].index(beams) == 1
    assert len({beams, others, beams}) == 2
