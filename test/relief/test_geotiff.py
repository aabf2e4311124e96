"""The GeoTIFF of a map lies where the map lies on the WGS-84 ellipsoid, or says that it does not know where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from rasterio.warp import transform

from sal_height.geometry import sphere_coordinates
from sal_height.relief.geotiff import write_geotiff
from sal_height.relief.map import Relief

GEOCENTRIC, GEOGRAPHIC = "EPSG:4978", "EPSG:4326"
CELL_M = 2.0


def relief_at(east: float, north: float) -> Relief:
    """A map of 3 by 2 cells whose cell (0, 0) has its centre at these arc distances from the origin."""
    layer = np.arange(6, dtype=np.float32).reshape(3, 2)
    return Relief(east, north, CELL_M, layer, layer, layer, layer.astype(np.uint32))


def geographic_of(enu: npt.NDArray[np.float64], latitude: float, longitude: float) -> tuple[float, float]:
    """Latitude and longitude (deg) of a point in local ENU axes on the ellipsoid, as a GNSS/INS states it."""
    origin = np.array(transform(GEOGRAPHIC, GEOCENTRIC, [longitude], [latitude], [0.0]))[:, 0]
    lat, lon = np.radians([latitude, longitude])
    east = np.array([-np.sin(lon), np.cos(lon), 0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    point = origin + enu @ np.stack([east, np.cross(up, east), up])
    (lon_there,), (lat_there,), _ = transform(GEOCENTRIC, GEOGRAPHIC, *point[:, None].tolist())
    return lat_there, lon_there


@pytest.mark.parametrize("latitude", [0.0, 36.5, -47.5, 70.0])
@pytest.mark.parametrize("place", [(10_000.0, 0.0), (0.0, 10_000.0), (-7_000.0, 7_000.0), (1_000.0, -20.0)], ids=str)
def test_a_cell_lies_within_a_centimetre_of_its_place_on_the_ellipsoid(
    tmp_path: Path, latitude: float, place: tuple[float, float]
) -> None:
    """Ten kilometres from the origin, 100 m above it; on a sphere it was off by 23 to 56 m."""
    enu = np.array([*place, 100.0])
    east, north, _ = (float(value) for value in sphere_coordinates(enu))
    path = tmp_path / "map.tif"
    write_geotiff(path, relief_at(east, north), (latitude, -8.25), {})
    with rasterio.open(path) as file:
        easting, northing = file.xy(file.height - 1, 0)  # cell (0, 0) is the southernmost, the last row of the file
        (longitude,), (there,) = transform(file.crs, GEOGRAPHIC, [easting], [northing])
        assert file.read(1)[-1, 0] == 0.0
    expected_latitude, expected_longitude = geographic_of(enu, latitude, -8.25)
    metres = np.radians([there - expected_latitude, longitude - expected_longitude]) * 6.4e6
    assert np.hypot(metres[0], metres[1] * np.cos(np.radians(latitude))) < 0.01


def test_without_an_origin_the_file_claims_no_place_on_the_earth(tmp_path: Path) -> None:
    path = tmp_path / "map.tif"
    write_geotiff(path, relief_at(5.0, 3.0), None, {"estimator": "ml"})
    with rasterio.open(path) as file:
        assert not file.crs.is_geographic
        assert not file.crs.is_projected
        assert "origin unknown" in file.crs.to_wkt()
        assert file.xy(2, 0) == (5.0, 3.0)
        assert file.tags()["estimator"] == "ml"
