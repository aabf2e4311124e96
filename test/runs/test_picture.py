"""Pictures of heights."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.runs.cloud_picture import projected
from sal_height.runs.comparison import Comparison, PublishedErrors
from sal_height.runs.height_picture import ground_picture, height_limits
from sal_height.runs.surface_report import GroundCoverage, Judged


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


def judgement_of(place: list[list[float]], sigma: list[float], ghost: list[bool]) -> Judged:
    """Four cells of 1 m from west to east: lit, lit, in shadow and silent, and one outside the array."""
    count = len(place)
    errors = PublishedErrors(
        place=np.array(place),
        validity=np.zeros(count, dtype=np.uint8),
        sigma=np.array(sigma),
        nearest=np.where(ghost, np.nan, 0.1),
        own=np.full(count, 0.1),
        ghost=np.array(ghost),
        true_order=np.ones(count, dtype=np.int64),
    )
    comparison = Comparison(errors, 2, 2, 2, 0, 1, 0, np.zeros((5, 7), dtype=np.int64))
    inside = np.array([True, True, True, False])
    ground = GroundCoverage(
        size=1.0,
        tolerance=0.1,
        number=np.array([[5, -2], [5, -1], [5, 0], [5, 1]]),
        terrain=np.array([0.0, 1.0, 2.0, 3.0]),
        inside=inside,
        lit=np.array([True, True, False, False]),
        right=np.array([True, False, False, False]),
        silent=np.array([False, False, True, False]),
    )
    return Judged(comparison, ground)


def test_a_cell_shows_the_surface_nearest_to_its_middle_and_an_empty_one_why_it_is() -> None:
    one = judgement_of([[-1.4, 5.5, 3.0], [-1.9, 5.5, 4.0]], [0.2, 0.3], [False, False])
    picture = ground_picture(one)
    assert picture.extent == (-2, 1, 5, 6)
    np.testing.assert_array_equal(picture.terrain, [[0, 1, 2]])
    np.testing.assert_array_equal(picture.lit, [[0, 1, np.nan]])
    np.testing.assert_array_equal(picture.height, [[3, 3, 3]])
    near = ground_picture(judgement_of([[-1.4, 5.5, 3.0], [-5.0, 5.5, 4.0]], [0.2, 0.3], [True, False]))
    np.testing.assert_array_equal(near.sigma, [[0.2, 0.2, 0.2]])
    np.testing.assert_array_equal(near.ghost, [[1, 1, 1]])
    assert np.isnan(near.error).all()
    empty = ground_picture(judgement_of([[-9.0, 5.5, 3.0]], [0.2], [False]))
    assert np.isnan(empty.height).all()
    np.testing.assert_array_equal(empty.silent, [[0, 0, 1]])


def test_shares_of_the_ground_are_of_the_cells_inside_the_array() -> None:
    shares = judgement_of([[0.0, 0.0, 0.0]], [0.1], [False]).ground.shares
    assert shares == {"lit": pytest.approx(2 / 3), "shadow": pytest.approx(1 / 3), "right": pytest.approx(1 / 2)}


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_cloud_is_seen_from_the_sensor(side: float) -> None:
    """A sensor in the north that looks south has the east on its left; what is high is up, what is near is low."""
    across, up, depth = projected(np.array([[1.0, 0, 0], [0, side, 0], [0, 0, 1]]), side)
    assert np.sign(across[0]) == -side
    assert depth[1] < 0
    assert up[1] < 0
    assert up[2] > 0
    np.testing.assert_allclose(across**2 + up**2 + depth**2, 1)
