"""What a run says it has achieved."""

from __future__ import annotations

import pytest

from sal_height.graph.reporting import achieved


@pytest.mark.parametrize(
    ("accuracy", "said"),
    [
        (
            {"ml": {"s68_m": 0.0096, "crb_m": 0.0087}, "monopulse": {"s68_m": 0.02, "crb_m": 0.0087}},
            "Heights of ml are right to 9.6 mm (s68); the Cramér-Rao bound of their looks is 8.7 mm.",
        ),
        (
            {"ml": {"s68_m": 3.217, "crb_m": 0.1}},
            "Heights of ml are right to 3.22 m (s68); the Cramér-Rao bound of their ",
        ),
        ({"ml": {"s68_m": 0.02, "crb_m": 0.01}, "tracked": {"s68_m": 0.001, "crb_m": 0.01}}, "Heights of ml are"),
        ({"ml": {"s68_m": None, "crb_m": None}}, ""),
        ({}, ""),
    ],
    ids=["best", "metres", "tracked has no bound", "no height", "no truth"],
)
def test_the_best_estimator_is_named_beside_its_bound(accuracy: dict[str, dict[str, float]], said: str) -> None:
    found = achieved(accuracy)
    assert found.startswith(said)
    assert bool(found) == bool(said)
