"""Runs to look at, made once."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import Preset, load_preset

SEED = 3


@pytest.fixture(scope="session")
def two_dwells() -> Preset:
    """The small preset, two dwells."""
    return dataclasses.replace(load_preset("small"), dwells=2)


@pytest.fixture(scope="session")
def recorded(two_dwells: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a run of two dwells, without pictures."""
    out = tmp_path_factory.mktemp("runs") / "recorded"
    fly(two_dwells, SEED, out, {})
    return out
