"""Double bounce: an echo from the foot of each wall that faces the sensor and is lit, with the square of its height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.errors import UserError
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.canopy import Canopy
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.scene import Scene, VisibleSurface, find_walls


def over(height: np.ndarray, north: np.ndarray, db: float | None = 3.0) -> SimulatedFlight:
    """The small lidar, which looks south, over a dark terrain that is the same everywhere along the flight."""
    flight = flight_of(replace(load_preset("small"), double_bounce_db=db), 1)
    east = np.array([-30.0, 30.0])
    heights = np.tile(height[:, None], 2)
    scene = Scene("walls", east, north, heights, np.zeros_like(heights), double_bounce=flight.scene.double_bounce)
    return replace(flight, scene=scene)


def feet_of(flight: SimulatedFlight) -> VisibleSurface:
    surface = flight.surface(1)
    return surface.where(surface.power > 0)


NORTH = np.arange(-8.0, 8.01, 0.1)


def test_a_wall_echoes_from_its_foot_with_the_square_of_its_height() -> None:
    """Of 0.5 m and 1 m: 2 h^2 in a resolution cell, in the ground's height and at the node before the wall."""
    for top in (0.5, 1.0):
        flight = over(np.where(NORTH < -0.95, top, 0.0), NORTH)
        feet = feet_of(flight)
        np.testing.assert_allclose(feet.heights, 0.0, atol=1e-9)
        np.testing.assert_allclose(feet.positions[:, 1], -0.9, atol=1e-6)
        spread = np.ptp(feet.positions[:, 0]) * (1 + 1 / (len(feet.power) - 1))
        cell = flight.sensor.wavelength * flight.preset.flight.slant_range_m / (2 * flight.aperture(1).length)
        assert feet.power.sum() / (spread / cell) == pytest.approx(10**0.3 * top**2, rel=1e-6)


@pytest.mark.parametrize(
    ("height", "seen"),
    [
        (np.where(NORTH > 0.95, 0.0, 1.0) * (NORTH > -2), 1),  # facing the sensor, and a back side
        (np.where(np.abs(NORTH - 1.0) < 0.55, 1.0, 0.0), 1),  # a block
        (np.where(np.abs(NORTH - 1.0) < 0.55, 2.0, 0.0) + np.where(NORTH < -0.4, 0.2, 0.0), 1),  # a low wall in shadow
        (np.where(np.abs(NORTH - 2.5) < 0.55, 1.0, 0.0) + np.where(NORTH < -0.4, 0.2, 0.0), 2),  # and out of it
        (np.clip(-NORTH, 0, 3), 0),  # a slope of 45 degrees
    ],
)
def test_only_walls_that_face_the_sensor_and_are_lit_echo(height: np.ndarray, seen: int) -> None:
    feet = feet_of(over(height, NORTH))
    assert len(np.unique(np.round(feet.positions[:, 1], 3))) == seen


def test_a_canopy_attenuates_it_and_no_scene_has_less_than_none() -> None:
    """By exp(-2 kappa s) of the path s through the canopy over the ground before the wall: here, less than all."""
    bare = over(np.where(NORTH < -0.95, 1.0, 0.0), NORTH)
    canopy = Canopy(np.full(bare.scene.height.shape, 0.5), 0.0, extinction=1.0, reflectivity=0.0)
    covered = replace(bare, scene=replace(bare.scene, canopy=canopy))
    through = feet_of(covered).power / feet_of(bare).power
    np.testing.assert_allclose(through, np.exp(-2 * 0.5 / np.cos(bare.preset.flight.look_angle_rad)), rtol=1e-2)
    with pytest.raises(UserError, match="double_bounce"):
        replace(bare.scene, double_bounce=-1.0)


def test_a_wall_of_several_nodes_is_one() -> None:
    """Three steep pieces in a row: its foot is at the first, its height that of all three."""
    north = np.arange(6.0)
    height = np.array([[0.0, 0.0, 3.0, 6.0, 9.0, 9.5]])
    feet, rise = find_walls(north, height, np.linspace(0.5, 0.6, 6)[None])
    np.testing.assert_array_equal(np.flatnonzero(feet), [1])
    np.testing.assert_array_equal(rise[0], [0, 9, 0, 0, 0, 0])


def test_it_comes_on_top_of_the_ground() -> None:
    """Of a street with kerbs, cars and walls; and without it no wall has a foot."""
    street = flight_of(load_preset("small"), 1).surface(0)
    bouncing = flight_of(replace(load_preset("small"), double_bounce_db=0.0), 1).surface(0)
    more = len(bouncing.power) - len(street.power)
    targets = int(np.sum(street.deterministic))
    assert more > 0
    ground = len(street.power) - targets
    np.testing.assert_array_equal(bouncing.power[:ground], street.power[:ground])
    np.testing.assert_array_equal(bouncing.power[ground + more :], street.power[ground:])
    assert not feet_of(over(np.where(NORTH < -0.95, 1.0, 0.0), NORTH, None)).power.size
