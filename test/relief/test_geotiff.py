"""The GeoTIFF of a map: a valid COG that says where it lies and above what its heights are, or that it knows not."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers import refused
from pyproj import CRS
from rasterio.warp import transform
from rio_cogeo.cogeo import cog_validate

from sal_height.errors import UserError
from sal_height.geometry import Origin, Projection
from sal_height.relief.cell_map import Relief
from sal_height.relief.geotiff import check_geotiff, write_geotiff

CELL_M = 2.0
STAMP_NS = 1_000_000_000 * round(datetime(2026, 10, 3, 14, 45, 9, tzinfo=UTC).timestamp())
LATITUDE, LONGITUDE = 48.1, 11.3
ORIGIN = Origin(math.radians(LATITUDE), math.radians(LONGITUDE), 560.0)
ZONE_32 = Projection.of("utm", ORIGIN)
VERTICAL_KEY = 4096


def relief_at(east: float, north: float, rows: int = 3, cols: int = 2) -> Relief:
    """A map whose cells, of which (0, 0) has its centre there, count up from 0 in the order of rows."""
    layer = np.arange(rows * cols, dtype=np.float32).reshape(rows, cols)
    return Relief(east, north, CELL_M, layer, layer, layer, layer.astype(np.uint32))


def written(tmp_path: Path, relief: Relief, projection: Projection | None) -> Path:
    path = tmp_path / "map.tif"
    write_geotiff(path, relief, projection, STAMP_NS, {"estimator": "ml"})
    return path


def test_no_map_has_a_height_without_a_finite_sigma() -> None:
    relief = relief_at(0.0, 0.0)
    for sigma in (np.nan, np.inf):
        unknown = np.where(relief.count == 3, np.float32(sigma), relief.sigma)
        with pytest.raises(ValueError, match="1 heights of a map have no finite sigma"):
            replace(relief, sigma=unknown)


@pytest.mark.parametrize("projection", [ZONE_32, None], ids=["utm", "local"])
def test_a_large_map_is_a_valid_cog_whose_first_level_is_the_map(tmp_path: Path, projection: Projection | None) -> None:
    relief = relief_at(650_001.0, 5_300_001.0, 1500, 1100)
    relief.height[100:200, 50:90] = np.nan
    path = written(tmp_path, relief, projection)
    is_valid, errors, warnings = cog_validate(path, strict=True)
    assert (is_valid, errors, warnings) == (True, [], [])
    with rasterio.open(path) as file:
        assert file.profile["tiled"]
        assert file.overviews(1) == [2, 4]
        np.testing.assert_array_equal(file.read(1)[::-1], relief.height)
        np.testing.assert_array_equal(file.read(4)[::-1], relief.count)


def test_a_cell_is_where_it_is_on_the_earth(tmp_path: Path) -> None:
    """Cell (0, 0) is put on the map's origin; a reader of its own finds the origin's latitude and longitude there."""
    east, north, _ = ZONE_32.coordinates(np.zeros(3))
    path = written(tmp_path, relief_at(east, north), ZONE_32)
    with rasterio.open(path) as file:
        easting, northing = file.xy(file.height - 1, 0)  # it is the southernmost, in the last row of the file
        assert file.read(1)[-1, 0] == 0.0
        assert CRS(file.crs.to_wkt()).to_2d().to_epsg() == 32632
        (longitude,), (latitude,) = transform("EPSG:32632", "EPSG:4326", [easting], [northing])
    assert (latitude, longitude) == pytest.approx((LATITUDE, LONGITUDE), abs=1e-9)


def test_heights_are_said_to_be_above_the_ellipsoid(tmp_path: Path) -> None:
    """By the code 4979 in the file's own keys, by its description of three axes, and in words."""
    with rasterio.open(written(tmp_path, relief_at(650_001.0, 5_300_001.0), ZONE_32)) as file:
        assert len(CRS(file.crs.to_wkt()).axis_info) == 3
        assert "ellipsoid" in file.tags()["VERTICAL_DATUM"]
        assert "EPSG:4979" in file.tags()["VERTICAL_DATUM"]
    keys = geo_keys(tmp_path / "map.tif")
    assert keys[VERTICAL_KEY] == 4979


def test_heights_above_a_geoid_are_said_to_be_so(tmp_path: Path) -> None:
    geoid = Projection(ORIGIN, CRS("EPSG:32632+5773"), "EPSG:32632+5773")
    with rasterio.open(written(tmp_path, relief_at(650_001.0, 5_300_001.0), geoid)) as file:
        assert CRS(file.crs.to_wkt()).sub_crs_list[1].to_epsg() == 5773
        assert "EGM96" in file.tags()["VERTICAL_DATUM"]
    assert geo_keys(tmp_path / "map.tif")[VERTICAL_KEY] == 5773


def test_another_ellipsoid_is_named_in_words(tmp_path: Path) -> None:
    etrs = Projection.of("EPSG:25832", ORIGIN)
    with rasterio.open(written(tmp_path, relief_at(650_001.0, 5_300_001.0), etrs)) as file:
        assert file.crs.to_epsg() == 25832
        assert "GRS 1980" in file.tags()["VERTICAL_DATUM"]


def test_bands_have_names_units_and_descriptions_and_the_file_a_date(tmp_path: Path) -> None:
    with rasterio.open(written(tmp_path, relief_at(5.0, 3.0), ZONE_32)) as file:
        assert file.descriptions == ("height", "sigma", "disagreement", "count")
        assert file.units[:2] == ("m", "m")
        assert "ellipsoid" in file.tags(1)["description"]
        assert math.isnan(file.nodata)
        assert file.tags()["TIFFTAG_DATETIME"] == "2026:10:03 14:45:09"
        assert file.tags()["estimator"] == "ml"


def test_without_an_origin_the_file_claims_no_place_on_the_earth(tmp_path: Path) -> None:
    with rasterio.open(written(tmp_path, relief_at(5.0, 3.0), None)) as file:
        assert not file.crs.is_geographic
        assert not file.crs.is_projected
        assert "origin unknown" in file.crs.to_wkt()
        assert "sphere" in file.tags()["VERTICAL_DATUM"]
        assert file.xy(2, 0) == (5.0, 3.0)


def test_a_file_that_cannot_be_written_is_told_before_the_flight(tmp_path: Path) -> None:
    for path, words in ((tmp_path, "it is a folder"), (tmp_path / "no" / "map.tif", "does not exist")):
        with refused(UserError, f"File {path} cannot be written", words):
            check_geotiff(path)


def geo_keys(path: Path) -> dict[int, int]:
    """The keys of the GeoKeyDirectory (tag 34735) of the first image that have their value with them."""
    content = path.read_bytes()
    assert content[:4] == b"II*\0"
    directory = int.from_bytes(content[4:8], "little")
    for entry in range(int.from_bytes(content[directory : directory + 2], "little")):
        tag = np.frombuffer(content, "<u2", 2, directory + 2 + 12 * entry)
        if tag[0] == 34735:
            count, offset = np.frombuffer(content, "<u4", 2, directory + 6 + 12 * entry)
            numbers = np.frombuffer(content, "<u2", count, offset).reshape(-1, 4)[1:]
            return {int(key): int(value) for key, location, _, value in numbers if location == 0}
    raise AssertionError("The file has no GeoKeyDirectory.")
