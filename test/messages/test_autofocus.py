"""Where autofocus has put an image, and what it leaves, come through provenance as they were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sal_height import messages
from sal_height.engine.provenance import Provenance
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging import Centroid, Placement, Slc
from sal_height.messages.products import provenance_of
from sal_height.messages.types import Provenance as ProvenanceMessage

PLACED = [
    Placement(0.001, -2e-5, 0.0005, Centroid(0.0023, 1e-4, 3e-4)),
    Placement(0.0, 0.0, 0.01, by_beams=True, beams_error=2e-4, own_error=1e-4),
]


X, Y = np.eye(3)[:2]
SLC = Slc(
    np.zeros((2, 3, 4), np.complex64),
    Grid(np.zeros(3), X, Y, 1.0, 1.0, 3, 4),
    ApertureState(np.zeros(3), X, np.eye(3), 1.0, np.zeros((6, 6)), sliding=False),
    np.ones(2),
    np.zeros(2),
)


def stated(values: Mapping[str, Any]) -> Provenance:
    """What a message states of the compression."""
    return provenance_of(ProvenanceMessage(parameters=messages.with_stage([], "sar_compression", values)))


def through_messages(slc: Slc) -> tuple[Placement, float]:
    found = stated({"rows": 3, **messages.autofocus_values(slc)})
    return found.placement, found.residual_phase


@pytest.mark.parametrize("placement", PLACED)
def test_what_data_told_comes_back(placement: Placement) -> None:
    assert through_messages(replace(SLC, placement=placement, residual_phase=0.047)) == (placement, 0.047)


def test_what_data_did_not_tell_is_not_told() -> None:
    assert messages.autofocus_values(replace(SLC, placement=Placement(0.0, 0.0, 0.01))) == {}
    assert through_messages(SLC) == (Placement(0.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speed", float("nan")),
        ("pointing", float("inf")),
        ("speed_error", -1.0),
        ("beams_error", -1e-9),
        ("centroid.error", -1e-9),
        ("centroid.vibration", "much"),
    ],
)
def test_numbers_that_are_none_are_refused(name: str, value: object) -> None:
    with pytest.raises(Rejected, match=f"sar_compression.placement.{name}"):
        _ = stated({f"placement.{name}": value}).placement


@pytest.mark.parametrize("value", [float("nan"), -0.1, "much"])
def test_a_phase_that_is_none_is_refused(value: object) -> None:
    with pytest.raises(Rejected, match=r"sar_compression.residual.phase_rad"):
        _ = stated({"residual.phase_rad": value}).residual_phase
