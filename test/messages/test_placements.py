"""Where an image was put comes through provenance as it was."""

from __future__ import annotations

import pytest

from sal_height import messages
from sal_height.errors import Rejected
from sal_height.imaging import Centroid, Placement

PLACED = [
    Placement(0.001, -2e-5, 0.0005, Centroid(0.0023, 1e-4, 3e-4)),
    Placement(0.0, 0.0, 0.01, by_beams=True),
]


def through_messages(placement: Placement) -> Placement:
    parameters = messages.with_stage([], "sar_compression", {"rows": 3, **messages.placement_values(placement)})
    return messages.placement_of(messages.stages_of(parameters)["sar_compression"])


@pytest.mark.parametrize("placement", PLACED)
def test_a_placement_by_data_comes_back(placement: Placement) -> None:
    assert through_messages(placement) == placement


def test_a_placement_by_navigation_is_not_told() -> None:
    assert messages.placement_values(Placement(0.0, 0.0, 0.01)) == {}
    assert messages.placement_of({"rows": 3}) == Placement(0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speed", float("nan")),
        ("pointing", float("inf")),
        ("speed_error", -1.0),
        ("centroid.error", -1e-9),
        ("centroid.vibration", "much"),
    ],
)
def test_numbers_that_are_none_are_refused(name: str, value: object) -> None:
    with pytest.raises(Rejected, match=f"sar_compression.placement.{name}"):
        messages.placement_of({f"placement.{name}": value})
