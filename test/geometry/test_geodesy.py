"""Places on the ellipsoid, and the axes there."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.warp import transform

from sal_height.geometry import Origin
from sal_height.geometry.geodesy import FLATTENING, SEMI_MAJOR_AXIS, geocentric, local_axes

PLACES_DEG = [(0.0, 0.0, 0.0), (48.1, 11.3, 600.0), (-33.9, 151.2, 12_000.0), (89.9, -170.0, -50.0), (-90.0, 0.0, 3.0)]


@pytest.mark.parametrize("place", PLACES_DEG)
def test_geocentric_coordinates_are_those_of_proj(place: tuple[float, float, float]) -> None:
    """PROJ as rasterio has it, from EPSG:4979 to EPSG:4978: both in float64, so 10 nm of 6400 km are allowed."""
    latitude, longitude, height = place
    expected = np.ravel(transform("EPSG:4979", "EPSG:4978", [longitude], [latitude], [height]))
    found = geocentric(np.radians(latitude), np.radians(longitude), height)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("place", PLACES_DEG[:4])
def test_map_axes_are_the_directions_in_which_coordinates_grow(place: tuple[float, float, float]) -> None:
    """A step of latitude is as long as the meridian's radius says, one of longitude as the parallel's."""
    latitude, longitude, height = np.radians(place[0]), np.radians(place[1]), place[2]
    origin, step = Origin(latitude, longitude, height), 1e-6
    squared = FLATTENING * (2 - FLATTENING)
    bend = np.sqrt(1 - squared * np.sin(latitude) ** 2)
    meridian, prime_vertical = SEMI_MAJOR_AXIS * (1 - squared) / bend**3, SEMI_MAJOR_AXIS / bend
    east = (prime_vertical + height) * np.cos(latitude)
    np.testing.assert_allclose(origin.to_map(latitude, longitude, height), 0, atol=1e-8)
    np.testing.assert_allclose(origin.to_map(latitude, longitude, height + 1), [0, 0, 1], atol=1e-8)
    np.testing.assert_allclose(
        origin.to_map(latitude + step, longitude, height)[1] / step, meridian + height, rtol=1e-6
    )
    np.testing.assert_allclose(origin.to_map(latitude, longitude + step, height)[0] / step, east, rtol=1e-6)


def test_distances_in_map_are_those_in_space() -> None:
    origin = Origin(0.84, 0.2, 400.0)
    places = (0.841, 0.203, 6000.0), (0.838, 0.199, -10.0)
    (first, second), (one, other) = ([f(*p) for p in places] for f in (origin.to_map, geocentric))
    assert np.linalg.norm(first - second) == pytest.approx(np.linalg.norm(one - other), abs=1e-8)
    assert 10e3 < np.linalg.norm(first) < 50e3


@pytest.mark.parametrize("place", [(0.84, 0.2, 400.0), (0.842, 0.21, 8000.0), (0.83, 0.15, 12_000.0)])
def test_local_axes_at_a_place_in_map_are_those_of_its_coordinates(place: tuple[float, float, float]) -> None:
    """Up to 400 km from the origin, where up differs by 70 mrad, to 1e-10 rad; 1e-6 rad are 3.5 mm of height."""
    origin = Origin(0.84, 0.2, 400.0)
    turn = origin.turn_at(origin.to_map(*place))
    expected = local_axes(0.84, 0.2) @ local_axes(*place[:2]).T
    np.testing.assert_allclose(turn, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-14)
