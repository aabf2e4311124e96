"""A canopy over level ground: its profile and what is left of the ground, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import flat_scene, make_aperture, refused

from sal_height.errors import UserError
from sal_height.geometry.earth import sphere_coordinates, sphere_point
from sal_height.simulation.canopy import Canopy
from sal_height.simulation.scene import Scene, VisibleSurface, visible_surface
from sal_height.simulation.scenes import load_scene

PLATFORM_HEIGHT = 5000 * np.sqrt(0.5)
TOP, BASE, EXTINCTION, REFLECTIVITY = 8.0, 2.0, 0.06, 0.1
CELL, EAST, RANGES = (0.25, 0.5), (-5.0, 5.0), (4990.0, 5010.0)
CELLS_PER_METRE = (EAST[1] - EAST[0]) / CELL[1] / CELL[0]
"""Resolution cells in a metre of slant range."""


def level_scene(canopy: Canopy | None = None) -> Scene:
    """Level ground of brightness 1, 45 degrees from nadir."""
    return replace(flat_scene(north=-PLATFORM_HEIGHT), canopy=canopy)


def level_canopy(base: float = BASE) -> Canopy:
    return Canopy(np.full(flat_scene().height.shape, TOP), base, EXTINCTION, REFLECTIVITY)


def see(scene: Scene) -> VisibleSurface:
    return visible_surface(scene, make_aperture(PLATFORM_HEIGHT), 1, CELL, EAST, RANGES)


def on_the_ground(surface: VisibleSurface) -> np.ndarray:
    return np.abs(surface.heights) < 1e-6


@pytest.mark.parametrize("base", [0.0, BASE])
def test_ground_under_a_level_canopy_is_attenuated_twice_along_the_slant_path(base: float) -> None:
    bare, covered = see(level_scene()), see(level_scene(level_canopy(base)))
    ground = covered.where(on_the_ground(covered))
    left = ground.power.sum() / bare.power.sum()
    assert left == pytest.approx(np.exp(-2 * EXTINCTION * (TOP - base) / np.cos(np.pi / 4)), rel=2e-3)


def test_mean_profile_is_that_of_a_random_volume() -> None:
    """Reflectivity per metre, attenuated on the way through what lies above; 3 % for the layers in 1.5 m of height."""
    surface = see(level_scene(level_canopy()))
    edges = np.arange(BASE, TOP + 0.1, 1.5)
    power, _ = np.histogram(surface.heights, edges, weights=surface.power * ~on_the_ground(surface))
    kappa = 2 * EXTINCTION / np.cos(np.pi / 4)
    expected = REFLECTIVITY * np.diff(np.exp(-kappa * (TOP - edges))) / kappa * CELLS_PER_METRE * np.ptp(RANGES)
    np.testing.assert_allclose(power, expected, rtol=0.03)
    assert np.all(surface.heights[~on_the_ground(surface)] > BASE)
    assert surface.heights.max() < TOP


def test_without_extinction_a_canopy_hides_nothing_and_is_as_bright_at_any_slant_range() -> None:
    surface = see(level_scene(replace(level_canopy(), extinction=0.0)))
    volume = surface.where(~on_the_ground(surface))
    per_metre, _ = np.histogram(volume.slant_range, np.arange(4992, 5009), weights=volume.power)
    np.testing.assert_allclose(per_metre, REFLECTIVITY * (TOP - BASE) * CELLS_PER_METRE, rtol=0.03)
    assert surface.where(on_the_ground(surface)).power.sum() == pytest.approx(see(level_scene()).power.sum(), rel=1e-12)


def test_behind_the_edge_of_a_canopy_the_path_leaves_through_its_side() -> None:
    """From a point d behind the edge the line of sight, at 45 degrees, is inside from the height d up to the top."""
    north = -PLATFORM_HEIGHT + np.array([-40.0, 0.0, 0.001, 40.0])  # the canopy stands nearer to the platform
    top = np.repeat(np.array([0.0, 0.0, TOP, TOP])[:, None], 2, axis=1)
    canopy = Canopy(top, 0.0, EXTINCTION, REFLECTIVITY)
    scene = Scene("edge", np.array([-40.0, 40.0]), north, np.zeros_like(top), np.ones_like(top), canopy=canopy)
    behind = np.array([0.5, 2.0, 4.0, 7.0, 9.0])
    points = sphere_point(0.0, -PLATFORM_HEIGHT - behind, 0.0)
    through = scene.transmission(points, np.array([0.0, 0.0, PLATFORM_HEIGHT]))
    inside = np.maximum(TOP - behind, 0.0) / np.cos(np.pi / 4)
    step = TOP / 16 / np.cos(np.pi / 4)  # of the path that is either inside or not
    np.testing.assert_allclose(np.log(through) / (-2 * EXTINCTION), inside, atol=0.5 * step + 0.02)
    assert through[-1] == 1.0


def test_gap_holds_nothing_but_ground() -> None:
    woods = load_scene("woods")
    surface = visible_surface(
        replace(woods, north=woods.north - PLATFORM_HEIGHT), make_aperture(PLATFORM_HEIGHT), 1, CELL, (-10, -8), RANGES
    )
    east, north, height = sphere_coordinates(surface.positions)
    np.testing.assert_allclose(
        height, 0.4 * np.sin(2 * np.pi * east / 80) + 0.03 * (north + PLATFORM_HEIGHT), atol=0.01
    )


def test_woods_hold_what_they_say() -> None:
    woods = load_scene("woods")
    assert woods.canopy is not None
    standing = woods.canopy.top[woods.canopy.top > 0]
    assert (standing.min(), standing.max()) == pytest.approx((6.0, 12.0), abs=0.3)
    assert np.exp(-2 * woods.canopy.extinction * (10 - woods.canopy.base) / np.cos(np.pi / 4)) == pytest.approx(
        0.32, abs=0.01
    )
    assert woods.reference_height == pytest.approx(standing.max() / 2, abs=0.01)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"top": np.zeros((3, 3))}, "canopy's top (3, 3)"),
        ({"top": np.full((161, 161), -1.0)}, "finite and 0 or more"),
        ({"base": np.nan}, "finite and 0 or more"),
        ({"extinction": -0.1}, "finite and 0 or more"),
        ({"reflectivity": np.inf}, "finite and 0 or more"),
    ],
)
def test_impossible_canopy_is_refused(changes: dict[str, object], complaint: str) -> None:
    with refused(UserError, "Scene flat", complaint):
        level_scene(replace(level_canopy(), **changes))
