"""What a report says of the ground, on an estimate with known errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sal_height.relief import GroundEstimate, GroundKind
from sal_height.runs.truth.pictures import draw_ground
from sal_height.runs.truth.report import TrueGround, ground_statistics, read_accuracy
from sal_height.simulation.flight import flight_of
from sal_height.simulation.preset import Preset

SHAPE = (40, 50)
SEED = 3  # of the recorded flight


def a_ground() -> tuple[GroundEstimate, TrueGround]:
    """Level ground with a step of 1 m at row 20, a tenth of the cells 0.2 m too high, and shadow in the last rows."""
    rng = np.random.default_rng(1)
    terrain = np.where(np.arange(SHAPE[0]) < 20, 1.0, 0.0)[:, None] * np.ones(SHAPE)
    height = terrain + rng.normal(0.0, 0.01, SHAPE)
    height[20] = 1.0  # the edge, one cell off
    height[:, :5] += 0.2
    kind = np.full(SHAPE, GroundKind.MEASURED, np.uint8)
    kind[:, 45:] = GroundKind.INTERPOLATED
    kind[36:] = GroundKind.SHADOW
    height[36:] = np.nan
    sigma = np.where(np.isnan(height), np.nan, 0.01)
    shadow = np.zeros(SHAPE, dtype=bool)
    shadow[36:] = True
    estimate = GroundEstimate(0.0, 0.0, 0.05, height, sigma, kind, np.ones(SHAPE, np.uint32))
    return estimate, TrueGround(terrain, ~shadow, shadow)


def test_errors_are_counted_by_what_heights_rest_on() -> None:
    estimate, truth = a_ground()
    found = ground_statistics(estimate, truth, 0.06)
    assert found["right"] == pytest.approx(0.9 * 35 / 36, abs=0.001)  # an edge that is one cell off is wrong
    assert found["lit"] == {"measured": 0.9, "interpolated": 0.1, "shadow": 0.0, "unseen": 0.0}
    assert found["shadow"]["shadow"] == 1.0
    assert found["measured"]["cells"] == 36 * 45
    assert found["measured"]["beyond_5_sigma"] == pytest.approx(1 - 8 / 9 * 35 / 36, abs=0.005)
    assert found["interpolated"]["within_1_sigma"] == pytest.approx(0.68, abs=0.1)  # 180 cells: standard error 0.035


def test_the_picture_is_written(tmp_path: Path) -> None:
    draw_ground(*a_ground(), tmp_path / "ground.png")
    assert (tmp_path / "ground.png").stat().st_size > 10_000


def test_ground_with_too_many_cells_is_left_out_of_the_report(
    recorded: Path, two_dwells: Preset, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A single height far off may stretch the ground; the rest of the report is made all the same."""
    flight = flight_of(two_dwells, SEED)
    whole = read_accuracy(recorded / "bag", flight, ["ml_height"]).statistics["ml"]
    assert "ground" in whole
    monkeypatch.setattr("sal_height.runs.truth.report.MAX_CELLS", 100)
    without = read_accuracy(recorded / "bag", flight, ["ml_height"]).statistics["ml"]
    assert without == {name: value for name, value in whole.items() if name != "ground"}
    (said,) = caplog.messages
    assert "ml" in said
    assert "100" in said
