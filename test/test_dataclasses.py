"""Dataclasses that contain arrays compare by identity, as fields cannot be compared, and have a short text."""

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
from sal_height.numeric import ShortRepr

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


FACES = (*("adjustment", "beams", "calibration", "elevation", "geometry", "imaging", "movers", "passes", "pipeline"),)
FACES += ("relief", "response", "sensor", "simulation")
"""Packages of the core whose public dataclasses users of Python see."""


def contains_arrays(kind: type) -> bool:
    """Whether a dataclass has an array, or a dataclass that has one."""
    hints = typing.get_type_hints(kind)
    fields = [hints[one.name] for one in dataclasses.fields(kind)]
    return any(holds_arrays(one) or any(map(contains_arrays, dataclasses_in(one))) for one in fields)


def dataclasses_in(annotation: object) -> list[type]:
    """The dataclasses that an annotation names; a function has none."""
    if typing.get_origin(annotation) is Callable:
        return []
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        return [annotation]
    return [one for part in typing.get_args(annotation) for one in dataclasses_in(part)]


@pytest.mark.parametrize("package", FACES)
def test_public_dataclasses_that_contain_arrays_have_a_text_of_one_screen(package: str) -> None:
    face = importlib.import_module(f"{sal_height.__name__}.{package}")
    public = [getattr(face, name) for name in face.__all__]
    kinds = [one for one in public if isinstance(one, type) and dataclasses.is_dataclass(one) and contains_arrays(one)]
    assert [kind for kind in kinds if not issubclass(kind, ShortRepr)] == []
    assert kinds or package == "pipeline"


def test_beams_can_be_compared_and_hashed() -> None:
    beams, others = make_beams(count=3), make_beams(count=3)
    assert beams != others
    assert [others, beams].index(beams) == 1
    assert len({beams, others, beams}) == 2
