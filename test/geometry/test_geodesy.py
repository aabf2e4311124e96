"""Places on the ellipsoid, and the axes there."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod, Transformer

from sal_height.geometry import Origin
from sal_height.geometry.geodesy import local_axes
from sal_height.numeric import F64

PLACES_DEG = [(0.0, 0.0, 0.0), (48.1, 11.3, 600.0), (-33.9, 151.2, 12_000.0), (89.9, -170.0, -50.0)]
TO_SPACE = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
"""Longitude, latitude and height to earth-centred, earth-fixed coordinates."""


def in_space(latitude: float, longitude: float, height: float) -> F64:
    """Earth-centred, earth-fixed coordinates (m) of a place in rad."""
    return np.array(TO_SPACE.transform(longitude, latitude, height, radians=True))


@pytest.mark.parametrize("place", PLACES_DEG)
def test_map_coordinates_are_components_along_the_axes_at_the_origin(place: tuple[float, float, float]) -> None:
    """By vectors in space (EPSG method 9837), up to 200 km away; 10 nm are what float64 has of 6400 km.

    Back it is 2 um: PROJ takes one step of Bowring's formula.
    """
    rng = np.random.default_rng(3)
    here = np.radians(place[0]), np.radians(place[1]), place[2]
    origin = Origin(*here)
    others = here + rng.uniform(-0.02, 0.02, (50, 3)) * [1, 1, 1e5]
    others[:, 0] = np.clip(others[:, 0], -np.pi / 2, np.pi / 2)
    expected = [local_axes(*here[:2]) @ (in_space(*other) - in_space(*here)) for other in others]
    positions = origin.to_map(*others.T)
    np.testing.assert_allclose(positions, expected, rtol=0, atol=2e-8)
    latitude, longitude, height = origin.to_geodetic(positions)
    np.testing.assert_allclose(in_space(latitude, longitude, height), in_space(*others.T), rtol=0, atol=5e-6)


@pytest.mark.parametrize("place", PLACES_DEG[:3])
def test_axes_are_the_directions_in_which_coordinates_grow(place: tuple[float, float, float]) -> None:
    """North along the meridian and east along the parallel, by geodesics of 1 m; up along the normal."""
    latitude, longitude = np.radians(place[:2])
    origin, geodesic = Origin(latitude, longitude, 0.0), Geod(ellps="WGS84")
    np.testing.assert_allclose(origin.to_map(latitude, longitude, 1.0), [0, 0, 1], atol=1e-8)
    for azimuth, axis in ((90.0, [1, 0, 0]), (0.0, [0, 1, 0])):
        there_longitude, there_latitude, _ = geodesic.fwd(place[1], place[0], azimuth, 1.0)
        there = origin.to_map(np.radians(there_latitude), np.radians(there_longitude), 0.0)
        np.testing.assert_allclose(there, axis, atol=1e-6)


@pytest.mark.parametrize("place", [(0.84, 0.2, 400.0), (0.842, 0.21, 8000.0), (0.83, 0.15, 12_000.0)])
def test_local_axes_at_a_place_in_map_are_those_of_its_coordinates(place: tuple[float, float, float]) -> None:
    """Up to 400 km from the origin, where up differs by 70 mrad, to 1e-10 rad; 1e-6 rad are 3.5 mm of height."""
    origin = Origin(0.84, 0.2, 400.0)
    turn = origin.turn_at(origin.to_map(*place))
    expected = local_axes(0.84, 0.2) @ local_axes(*place[:2]).T
    np.testing.assert_allclose(turn, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-14)
