"""Pictures of heights."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.runs.picture import height_limits


@pytest.mark.parametrize(
    ("terrain", "limits"),
    [
        (np.full((4, 5), 2.0), (1.7, 2.3)),
        (np.linspace(0.0, 10.0, 201), (0.05, 9.95)),
        (np.array([0.0, np.nan]), (-0.3, 0.3)),
    ],
)
def test_colours_span_the_terrain_and_on_flat_ground_the_errors(
    terrain: np.ndarray, limits: tuple[float, float]
) -> None:
    assert height_limits(terrain, 0.3) == pytest.approx(limits)
