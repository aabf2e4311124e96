"""Maps in a coordinate reference system: places are those of PROJ's own chain, and unsuitable systems are refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import refused
from pyproj import CRS, Transformer

from sal_height.errors import UserError
from sal_height.geometry import Origin, Projection, find_system, sphere_point

ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)


@pytest.mark.parametrize(
    ("latitude", "longitude", "code"),
    [
        (48.1, 11.3, 32632),
        (-33.9, 151.2, 32756),
        (0.5, -179.9, 32601),
        (78.2, 15.6, 32633),  # Svalbard
    ],
)
def test_utm_is_the_zone_of_the_origin(latitude: float, longitude: float, code: int) -> None:
    projection = Projection.of("utm", Origin(math.radians(latitude), math.radians(longitude), 0.0))
    assert projection.name == f"EPSG:{code}"
    assert projection.system.to_2d() == CRS(code)


@pytest.mark.parametrize(
    ("name", "back_m"), [("utm", 1e-5), ("EPSG:25832", 1e-5), ("EPSG:32633", 1e-5), ("EPSG:3035", 1e-3)]
)
def test_coordinates_are_those_of_projs_topocentric_chain(name: str, back_m: float) -> None:
    """Within 35 km to 1 um; 1 mm is promised. PROJ's own way back of an equal-area projection is off by 0.4 mm."""
    rng = np.random.default_rng(2)
    positions = rng.uniform(-35e3, 35e3, (100, 3)) * [1, 1, 0.1]
    projection = Projection.of(name, ORIGIN)
    chain = Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0=48.1 +lon_0=11.3 +h_0=560 "
        "+step +inv +proj=cart +ellps=WGS84"
    )
    longitude, latitude, height = chain.transform(*positions.T)
    system = CRS(projection.name).to_3d()
    expected = Transformer.from_crs("EPSG:4979", system, always_xy=True).transform(longitude, latitude, height)
    found = projection.coordinates(positions)
    np.testing.assert_allclose(found, np.transpose(expected), rtol=0, atol=1e-6)
    np.testing.assert_allclose(projection.positions(found), positions, rtol=0, atol=back_m)
    assert np.isnan(projection.coordinates(np.full((2, 3), np.nan))).all()


@pytest.mark.parametrize(("name", "grid"), [("EPSG:32632+5773", "egm96"), ("EPSG:31468", "BETA2007")])
def test_systems_whose_grids_are_not_installed_are_refused_and_the_grid_is_named(name: str, grid: str) -> None:
    """PROJ would go on without a word: 46 m wrong in height above the geoid, or 3 m to the side of the old datum."""
    with refused(UserError, f"{name} needs a grid that is not installed", grid, "pyproj sync"):
        Projection.of(name, ORIGIN)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("EPSG:99999999", "'EPSG:99999999' is not known to PROJ; give utm or a code"),
        ("nonsense", "is not known to PROJ"),
        ("EPSG:4326", "has angles for coordinates, a map needs metres"),
        ("EPSG:4978", "is not a projection of the earth"),
        ("EPSG:2263", "has coordinates in US survey foot, a map needs metres"),
        ('LOCAL_CS["site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]', "is not a projection of the earth"),
        ("+proj=tmerc +lon_0=9 +R=6371000 +units=m +type=crs", "has no datum"),
    ],
)
def test_systems_that_cannot_hold_a_map_are_refused(name: str, words: str) -> None:
    with refused(UserError, words):
        find_system(name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("EPSG:32756", "was made for another place"),  # the other hemisphere
        ("EPSG:3857", "its metres are not metres on the ground"),  # Web Mercator: 1.5 m for 1 m
        ("EPSG:2193", "was made for another place"),  # New Zealand
    ],
)
def test_systems_that_do_not_suit_the_place_are_refused(name: str, words: str) -> None:
    with refused(UserError, f"{name} does not suit a map at latitude 48.1000", words):
        Projection.of(name, ORIGIN)


def test_the_poles_have_no_zone_of_utm() -> None:
    north = Origin(math.radians(87.0), 0.3, 0.0)
    with refused(UserError, "UTM has no zone at latitude 87.0000", "EPSG:5041"):
        Projection.of("utm", north)
    assert Projection.of("EPSG:5041", north).name == "EPSG:5041"


@pytest.mark.parametrize(("kilometres", "most_m"), [(1, 0.00044), (5, 0.0110), (35, 0.54), (100, 4.41)])
def test_the_sphere_is_wrong_in_height_by_what_the_documentation_says(kilometres: float, most_m: float) -> None:
    """In all directions, most at the equator."""
    azimuth = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    on_sphere = sphere_point(1e3 * kilometres * np.sin(azimuth), 1e3 * kilometres * np.cos(azimuth), 0.0)
    worst = [
        np.abs(Projection.of("utm", Origin(math.radians(latitude), 0.2, 0.0)).coordinates(on_sphere)[:, 2]).max()
        for latitude in (0.01, 30.0, 48.0, 70.0)
    ]
    assert max(worst) == pytest.approx(most_m, rel=0.01)
    assert min(worst) > most_m / 3
