"""Point clouds in pictures: their projection, what hides what, and their shading."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.graph.cloud_picture import COLUMNS, CloudView, point_image, point_size
from sal_height.numeric import F64

SOUTHWARDS = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
"""Line of sight of a sensor in the north that looks down at 45 degrees."""


def plane(height: float = 0.0, spacing: float = 0.2) -> F64:
    """Points of a level square of 20 m."""
    steps = np.arange(-10.0, 10.0, spacing)
    east, north = (axis.ravel() for axis in np.meshgrid(steps, steps))
    return np.stack([east, north, np.full(east.size, height)], axis=-1)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_cloud_is_seen_from_the_sensor(side: float) -> None:
    """A sensor in the north that looks south has the east on its left; what is high is up, what is near is low."""
    view = CloudView(SOUTHWARDS * [1.0, side, 1.0], np.zeros(3), np.ones(3), 1.0)
    across, up, depth = view.projected(np.array([[1.0, 0, 0], [0, side, 0], [0, 0, 1]]))
    assert np.sign(across[0]) == -side
    assert depth[1] < 0
    assert up[1] < 0
    assert up[2] > 0
    np.testing.assert_allclose(across**2 + up**2 + depth**2, 1)


def test_heights_of_flat_ground_are_drawn_larger_by_a_whole_factor() -> None:
    gentle = plane() + np.array([0.0, 0.0, 1.0]) * np.linspace(0.0, 0.4, len(plane()))[:, None]
    view = CloudView.of_points(gentle, SOUTHWARDS)
    assert view.stretch == round(view.stretch) == 3
    assert CloudView.of_points(np.concatenate([plane(), plane(5.0)]), SOUTHWARDS).stretch == 1
    one, other = view.projected(np.array([[0.0, 0, 0], [0, 0, 1]])).T
    taller = CloudView(view.sight, view.lower, view.upper, 1.0).projected(np.array([[0.0, 0, 0], [0, 0, 1]])).T
    np.testing.assert_allclose(other - one, 3 * (taller[1] - taller[0]))


def test_near_points_hide_far_ones_and_a_closed_surface_has_no_holes() -> None:
    """Of a red square below a blue one, the part that shows is the one that nothing stands before."""
    below, above = plane(0.0), plane(4.0)
    view = CloudView.of_points(np.concatenate([below, above]), SOUTHWARDS)
    colours = np.array([[1.0, 0.0, 0.0]] * len(below) + [[0.0, 0.0, 1.0]] * len(above))
    size = point_size(view, below)
    picture = point_image(view, np.concatenate([below, above]), colours, size)
    turned = point_image(view, np.concatenate([above, below]), colours[::-1], size)
    np.testing.assert_array_equal(picture, turned)
    alone = point_image(view, above, colours[len(below) :], size)
    drawn = alone[..., 3] > 0
    assert np.all(picture[drawn, 2] > 0)
    assert np.all(picture[drawn, 0] == 0)
    rows, cols = np.nonzero(drawn)
    inside = np.ptp(cols) * np.ptp(rows) * 0.5
    assert drawn.sum() > inside, "the square is turned by 18 degrees"
    middle = drawn[int(rows.mean()) - 20 : int(rows.mean()) + 20, COLUMNS // 2 - 20 : COLUMNS // 2 + 20]
    assert middle.all()


def test_ground_is_darkest_next_to_what_stands_before_it() -> None:
    """A level square has one brightness; behind a box on it, ground that is farther on the page is darker."""
    ground = plane()
    box = np.array([[east, 0.0, up] for east in np.arange(-2, 2, 0.1) for up in np.arange(0, 3, 0.1)])
    view = CloudView.of_points(np.concatenate([ground, box]), SOUTHWARDS)
    size = point_size(view, ground)
    level = point_image(view, ground, np.ones_like(ground), size)
    inner = level[level[..., 3] > 0][:, 0]
    assert np.median(inner) > 220
    assert np.percentile(inner, 5) > 0.8 * np.median(inner)
    behind = point_image(view, np.concatenate([ground, box]), np.ones((len(ground) + len(box), 3)), size)
    assert behind[behind[..., 3] > 0][:, 0].min() < 0.6 * np.median(inner)


def test_a_single_point_is_drawn() -> None:
    alone = np.array([[3.0, 4.0, 5.0]])
    view = CloudView.of_points(alone, SOUTHWARDS)
    picture = point_image(view, view.inside(alone), np.ones((1, 3)), point_size(view, alone))
    assert np.count_nonzero(picture[..., 3]) == 1
