"""What a run says it has achieved."""

from __future__ import annotations

from typing import Any

import pytest

from sal_height.graph.reporting import achieved


def errors(s68_m: float | None, **others: Any) -> dict[str, Any]:
    """Statistics of an estimator with this scatter."""
    usual = {"valid": 0.96, "bias_m": 0.138, "common_sigma_m": 0.1651, "beyond_5_sigma": 0.002, "crb_m": 0.0087}
    return usual | {"s68_m": s68_m, "kinds": {"OK": {"s68_m": s68_m}}} | others


WITH_BOUND = (
    "Heights of ml: mean error +138 mm (stated common sigma 165 mm), scatter 9.6 mm, 0.20 % beyond 5 sigma, in 96.0 % "
    "of the lit pixels.\nPixels with one surface scatter by 9.6 mm, with shared errors that differ from dwell to dwell;"
    " the Cramér-Rao bound of their looks is 8.7 mm."
)


@pytest.mark.parametrize(
    ("accuracy", "said"),
    [
        ({"ml": errors(0.0096), "monopulse": errors(0.02)}, WITH_BOUND),
        ({"ml": errors(3.217, bias_m=-2.5)}, "Heights of ml: mean error -2.50 m (stated"),
        ({"ml": errors(0.02, common_sigma_m=None)}, "Heights of ml: mean error +138 mm, scatter 20 mm,"),
        ({"ml": errors(0.02), "tracked": errors(0.001)}, "Heights of ml: "),
        ({"ml": errors(None)}, ""),
        ({"ml": errors(0.02, valid=None)}, ""),
        ({}, ""),
    ],
    ids=["best", "metres", "no common error", "tracked has no bound", "no height", "no lit pixel", "no truth"],
)
def test_the_best_estimator_is_named_with_bias_scatter_tails_and_bound(accuracy: dict[str, Any], said: str) -> None:
    found = achieved(accuracy)
    assert found.startswith(said)
    assert bool(found) == bool(said)


@pytest.mark.parametrize(("valid", "compared"), [(0.8, True), (0.79, False)])
def test_what_is_left_of_many_refused_heights_is_not_compared_with_the_bound(valid: float, compared: bool) -> None:
    """The few that pass are chosen by their errors, and may be below the bound of all."""
    assert ("Cramér-Rao" in achieved({"ml": errors(0.005, valid=valid)})) is compared


def test_scatter_contains_shared_errors_only_if_there_are_any() -> None:
    assert "from dwell to dwell" in achieved({"ml": errors(0.0096)})
    assert "from dwell to dwell" not in achieved({"ml": errors(0.0096, common_sigma_m=None)})
