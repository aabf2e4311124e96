"""The figure of tracked heights: theory holds at every point, and a wrong one does not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sal_height.figures import relief_tracking as figure
from sal_height.figures.curve import Curve, check_of, holds, rows_of
from sal_height.figures.paper_figures import FIGURES
from sal_height.relief.smoothing import ReliefPrior

TRIALS, SEED = 3000, 2


def curves() -> dict[str, Curve]:
    return {curve.name: curve for curve in figure.relief_tracking(TRIALS, SEED)}


def checks_of(made: dict[str, Curve]) -> list[dict[str, Any]]:
    return [check for curve in made.values() for row in rows_of("f", curve) if (check := check_of(row)) is not None]


@pytest.fixture(scope="module")
def made() -> dict[str, Curve]:
    return curves()


def test_theory_holds_at_every_point(made: dict[str, Curve]) -> None:
    """Within 3 standard errors; all points have a closed form."""
    checks = checks_of(made)
    assert len(checks) == 6 * len(figure.LENGTHS) + 3 * len(figure.SNR_DB)
    assert [check for check in checks if not holds(check)] == []
    assert all(abs(check["standard_error"]) > 0 for check in checks)


def test_curves_are_those_of_the_figure(made: dict[str, Curve]) -> None:
    assert len(made) == FIGURES["relief_tracking"].curve_count
    assert {curve.quantity for curve in made.values()} == set(FIGURES["relief_tracking"].axes)


def test_longer_reliefs_gain_more_and_the_smoother_most(made: dict[str, Curve]) -> None:
    """By theory; and who knows each cell's variance is better off than who takes the mean."""
    for name in ("filter", "smoother"):
        assert np.all(np.diff(made[f"gain, {name}"].closed_form) > 0)
    assert np.all(made["gain, smoother"].closed_form > made["gain, filter"].closed_form)
    own, mean = (
        made[f"RMSE with noise that varies, variance taken: {taken}"].closed_form
        for taken in ("each cell's own", "their mean")
    )
    assert np.all(own < mean)


def test_draws_are_repeatable_and_their_blocks_independent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figure, "LENGTHS", np.array([5.0]))
    monkeypatch.setattr(figure, "SNR_DB", np.array([6.0]))
    first, again = curves(), curves()
    for name, curve in first.items():
        np.testing.assert_array_equal(curve.value, again[name].value)
    monkeypatch.setattr(figure, "BLOCK", TRIALS // 2)
    halves = curves()
    assert all(not np.array_equal(curve.value, first[name].value) for name, curve in halves.items())
    assert all(holds(check) for check in checks_of(halves))


def test_the_relief_that_is_drawn_has_its_law() -> None:
    """4000 tracks: standard error of a correlation 1.6 % at most, of the standard deviation 1.1 %."""
    prior = ReliefPrior(5.0, 2.0, 30.0)
    height = figure.draw_relief(np.random.default_rng(3), prior, 0.5, 21, 4000)
    for i in (0, 10, 20):
        assert np.std(height[i]) == pytest.approx(2.0, rel=0.04)
        assert np.mean(height[i]) == pytest.approx(30.0, abs=0.13)
        assert np.corrcoef(height[0], height[i])[0, 1] == pytest.approx(np.exp(-i / 10), abs=0.05)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("steady_sigmas", lambda prior, spacing, measured: (0.45, 0.35)),  # noqa: ARG005
        ("_expected_rmse", lambda prior, sigma, taken: 0.5),  # noqa: ARG005
    ],
)
def test_a_wrong_closed_form_is_noticed(name: str, wrong: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figure, "LENGTHS", np.array([20.0]))
    monkeypatch.setattr(figure, "SNR_DB", np.array([6.0]))
    monkeypatch.setattr(figure, name, wrong)
    assert not all(holds(check) for check in checks_of(curves()))
