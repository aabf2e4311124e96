"""Which cells of the ground an image sees: shadows of known length, and the span of the array."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import make_aperture, make_beams, make_sensor

from sal_height.geometry.earth import sphere_point
from sal_height.imaging.pixels import azimuth_resolution, slant_plane_grid
from sal_height.simulation.lit_surfaces import GroundCells, ground_cells
from sal_height.simulation.scene import Scene, visible_surface

SENSOR, APERTURE, BEAMS = make_sensor(), make_aperture(), make_beams("jinc", count=16)
CELL = SENSOR.range_resolution, azimuth_resolution(SENSOR, make_aperture(), 5000.0)
AIM = -5000 * np.sqrt(0.5)
SIZE = 0.05


def cells_of(north: list[float], height: list[float]) -> tuple[GroundCells, np.ndarray]:
    """Cells of a terrain along north (m, from AIM), and how far south of AIM each is, m."""
    values = np.repeat(np.array(height)[:, None], 2, axis=1)
    scene = Scene("profile", np.array([-10.0, 10.0]), AIM + np.array(north), values, np.ones(values.shape))
    half = 9 * CELL[1]
    surface = visible_surface(scene, APERTURE, 1, CELL, (-half, half), (4994.0, 5006.0))
    grid = slant_plane_grid(SENSOR, APERTURE, 5000.0, 90, 12, 1.2)
    cells = ground_cells(scene, surface, APERTURE, grid, BEAMS, 1, SIZE)
    return cells, AIM - (cells.number[:, 0] + 0.5) * SIZE


@pytest.mark.parametrize("height", [0.5, 1.5])
def test_shadow_is_as_long_as_height_times_the_tangent_of_the_look_angle(height: float) -> None:
    cells, south = cells_of([-40.0, -0.002, -0.001, 0.0, 0.001, 40.0], [0.0, 0.0, height, height, 0.0, 0.0])
    down = APERTURE.position[2] - sphere_point(0.0, AIM, 0.0)[2]
    length = height * (-AIM) / (down - height)
    dark = south[~cells.lit]
    assert dark.min() == pytest.approx(0, abs=SIZE)
    assert dark.max() == pytest.approx(length, abs=SIZE)
    np.testing.assert_array_equal(cells.lit, (south <= dark.min() - 1e-9) | (south >= dark.max() + 1e-9))


def test_cells_are_in_the_pixels_of_their_range_and_inside_if_between_the_outermost_boresights() -> None:
    cells, south = cells_of([-40.0, 40.0], [0.0, 0.0])
    assert cells.lit.all()
    places = sphere_point(np.zeros(len(south)), AIM - south, np.zeros(len(south)))
    sight = places - APERTURE.position
    elevation = np.arctan2(-sight[:, 1], -sight[:, 2])
    np.testing.assert_array_equal(cells.inside, (elevation >= BEAMS.span[0]) & (elevation <= BEAMS.span[1]))
    assert 0.2 < cells.inside.mean() < 1
    pixel = (np.linalg.norm(sight, axis=-1) - 5000) / (1.2 * CELL[0]) + 44.5
    np.testing.assert_allclose(cells.pixel[:, 0], pixel, atol=0.51)
