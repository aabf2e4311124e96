"""Exports of a bag, each read by others, hold every height of the bag and no other one."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import rasterio
import xarray
import zarr
from helpers import assert_one_sentence, make_aperture
from PIL import Image
from pyproj import CRS
from rio_cogeo.cogeo import cog_validate

import sal_height
from sal_height import messages
from sal_height.bag.qos import LATCHED
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.elevation import Validity
from sal_height.errors import UserError
from sal_height.exports import RecordedHeights, dataset, write_film, write_las, write_map, write_netcdf, write_zarr
from sal_height.exports import film as film_module
from sal_height.exports.film_frames import frames_of
from sal_height.exports.las import gps_time
from sal_height.geometry import Grid, Origin, sphere_coordinates, sphere_point
from sal_height.messages import serialize
from sal_height.messages.types import ComplexImage, Header, HeightImage, Provenance
from sal_height.relief import HeightField, Surface

BAGS = Path(__file__).parents[2] / "bags"
ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)
DWELLS, SHAPE = 7, (40, 30)
CODES = np.array([Validity.NO_SIGNAL, Validity.OK, Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS], np.uint8)


def height_image(dwell: int) -> HeightImage:
    """Pixels with up to three surfaces around heights of 2, 5 and 9 m, some of them extended."""
    rng = np.random.default_rng(dwell)
    order = rng.integers(0, 4, SHAPE)
    validity = CODES[order]
    validity[(order == 1) & (rng.random(SHAPE) < 0.3)] = Validity.EXTENDED
    north, east = np.indices(SHAPE) * 0.5 + [[[-3500.0]], [[20.0 * dwell]]]
    surfaces = []
    for number, level in enumerate((2.0, 5.0, 9.0)):
        height = np.where(order > number, level + rng.normal(0, 0.1, SHAPE), np.nan)
        positions = sphere_point(east + 0.3 * number, north, height)
        sigma, cnr_db = (np.where(order > number, rng.uniform(*span, SHAPE), np.nan) for span in ((0.01, 1), (0, 30)))
        surfaces.append(Surface.at(positions, height, sigma, cnr_db))
    axes = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    grid = Grid(sphere_point(20.0 * dwell, -3500.0, 0.0), *axes, 0.5, 0.5, *SHAPE)
    field = HeightField(grid, validity, tuple(surfaces), rng.dirichlet(np.ones(5), SHAPE))
    slc = ComplexImage(dwell=dwell, header=Header(frame_id="map", stamp=messages.to_stamp(10**18 + dwell * 10**9)))
    return messages.height_to_message(field, make_aperture(), (2, 2), "ml", slc, Provenance())


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of height images with everything that they may have."""
    path = tmp_path_factory.mktemp("exported") / "bag"
    with BagWriter(path, {}) as writer:
        writer.add_topic("/ml/height", HEIGHT_TYPE, [LATCHED])
        for dwell in range(DWELLS):
            writer.write("/ml/height", serialize(height_image(dwell)), dwell, dwell)
    return path


@pytest.fixture(scope="module")
def heights(bag: Path) -> RecordedHeights:
    """Its heights near Munich."""
    return RecordedHeights.of_bag(bag, origin=ORIGIN)


def fields() -> Iterator[tuple[HeightImage, HeightField]]:
    """What went into the bag."""
    for dwell in range(DWELLS):
        image = height_image(dwell)
        yield image, messages.field_from_message(image)


def test_a_point_cloud_has_every_surface_as_a_return(heights: RecordedHeights, tmp_path: Path) -> None:
    path = tmp_path / "street.laz"
    count = write_las(heights, path)
    cloud = laspy.read(path)
    expected = [
        (image, field, number, surface) for image, field in fields() for number, surface in enumerate(field.surfaces, 1)
    ]
    sizes = [int(np.isfinite(surface.height).sum()) for *_, surface in expected]
    assert len(cloud.points) == count == sum(sizes) > 1000
    assert heights.projection is not None
    for name in ("sigma", "cnr_db", "spread"):
        for dwell in {image.dwell for image, *_ in expected}:
            mine = np.sort(np.asarray(cloud[name])[np.asarray(cloud["dwell"]) == dwell])
            values = [getattr(s, name)[np.isfinite(s.height)] for image, _, _, s in expected if image.dwell == dwell]
            np.testing.assert_array_equal(mine, np.sort(np.concatenate(values).astype(np.float32)))
    image, field, number, surface = expected[0]
    first = (np.asarray(cloud["dwell"]) == image.dwell) & (np.asarray(cloud.return_number) == number)
    there = np.isfinite(surface.height)
    coordinates = heights.projection.coordinates(surface.positions[there])
    np.testing.assert_allclose(cloud.xyz[first], coordinates, rtol=0, atol=0.51e-4)
    surfaces = sum(np.isfinite(one.height).astype(int) for one in field.surfaces)
    np.testing.assert_array_equal(np.asarray(cloud.number_of_returns)[first], surfaces[there])
    np.testing.assert_array_equal(np.asarray(cloud["validity"])[first], field.validity[there])
    assert field.order_probability is not None
    order = np.where(field.validity == Validity.EXTENDED, 4, surfaces)[there]
    known = field.order_probability[there][np.arange(len(order)), order]
    np.testing.assert_allclose(np.asarray(cloud["order_probability"])[first], known, rtol=1e-6)


def test_a_point_cloud_says_its_time_and_place_in_the_header(heights: RecordedHeights, tmp_path: Path) -> None:
    """Bytes of the header as LAS 1.4 R15 has them, and the system as PROJ reads it."""
    path = tmp_path / "street.las"
    write_las(heights, path)
    content = path.read_bytes()
    assert content[:4] == b"LASF"
    (encoding,) = struct.unpack_from("<H", content, 6)
    assert encoding & 0b10001 == 0b10001, "GPS time is adjusted standard time, and the system is well-known text"
    assert tuple(content[24:26]) == (1, 4)
    assert content[104] == 6
    (count,) = struct.unpack_from("<Q", content, 247)
    by_return = struct.unpack_from("<15Q", content, 255)
    assert count == sum(by_return)
    cloud = laspy.read(path)
    system = cloud.header.parse_crs()
    assert system.to_2d().to_epsg() == 32632
    assert len(system.axis_info) == 3
    image, _ = next(fields())
    assert cloud.gps_time[0] == pytest.approx(gps_time(messages.to_ns(image.header.stamp)), abs=1e-6)


@pytest.mark.parametrize(
    ("utc", "seconds"),
    [
        (datetime(1980, 1, 6, tzinfo=UTC), 0),
        (datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), 1167264016),
        (datetime(2017, 1, 1, tzinfo=UTC), 1167264018),
        (datetime(2011, 9, 14, 1, 46, 25, tzinfo=UTC), 1_000_000_000),
    ],
)
def test_gps_time_counts_leap_seconds(utc: datetime, seconds: int) -> None:
    """GPS time 1e9 s was on 14 September 2011 at 01:46:25 UTC; at the end of 2016 a second was inserted."""
    assert gps_time(round(utc.timestamp()) * 10**9) + 1e9 == pytest.approx(seconds, abs=1e-6)


def test_interpolated_heights_are_flagged_as_synthetic(tmp_path: Path) -> None:
    tracked = RecordedHeights.of_bag(BAGS / "xband_sumdiff", "/tracked/height")
    write_las(tracked, tmp_path / "tracked.las")
    cloud = laspy.read(tmp_path / "tracked.las")
    synthetic = np.asarray(cloud.synthetic).astype(bool)
    np.testing.assert_array_equal(synthetic, np.asarray(cloud["validity"]) == Validity.INTERPOLATED)
    assert synthetic.sum() > 300
    assert cloud.header.parse_crs() is None


def test_without_an_origin_points_are_as_in_a_local_map(bag: Path, tmp_path: Path) -> None:
    write_las(RecordedHeights.of_bag(bag), tmp_path / "local.las")
    cloud = laspy.read(tmp_path / "local.las")
    image, field = next(fields())
    there = np.isfinite(field.first.height)
    first = (np.asarray(cloud["dwell"]) == image.dwell) & (np.asarray(cloud.return_number) == 1)
    expected = np.stack(sphere_coordinates(field.first.positions[there]), axis=-1)
    np.testing.assert_allclose(cloud.xyz[first], expected, rtol=0, atol=0.51e-4)


def assert_same_heights(found: Any, heights: RecordedHeights) -> None:
    """A dataset has all numbers of the bag."""
    assert heights.projection is not None
    images = list(fields())
    np.testing.assert_array_equal(found["dwell"], [image.dwell for image, _ in images])
    for number, (image, field) in enumerate(images):
        here = found.isel(dwell=number)
        np.testing.assert_array_equal(here["validity"], field.validity)
        np.testing.assert_array_equal(here["order_probability"], np.float32(field.order_probability))
        assert here["time"].values == np.datetime64(messages.to_ns(image.header.stamp), "ns")
        for surface, mine in zip(field.surfaces, here.transpose("surface", ...)["sigma"].values, strict=True):
            np.testing.assert_array_equal(mine, surface.sigma.astype(np.float32))
    image, field = images[-1]
    there = np.isfinite(field.first.height)
    east, north, up = heights.projection.coordinates(field.first.positions[there]).T
    here = found.isel(dwell=-1, surface=0)
    for name, expected, tolerance in (("x", east, 1e-6), ("y", north, 1e-6), ("height", up, 1e-4)):
        np.testing.assert_allclose(here[name].values[there], expected, rtol=0, atol=tolerance)
    assert np.isnan(here["height"].values[~there]).all()


def test_a_bag_is_a_dataset(bag: Path, heights: RecordedHeights) -> None:
    found = sal_height.open_heights(bag, origin=ORIGIN)
    assert_same_heights(found, heights)
    assert found.height.dims == ("dwell", "surface", "row", "col")


def test_netcdf_has_the_heights_by_the_conventions(heights: RecordedHeights, tmp_path: Path) -> None:
    path = tmp_path / "heights.nc"
    assert write_netcdf(heights, path) == DWELLS
    with xarray.open_dataset(path, engine="h5netcdf") as found:
        assert_same_heights(found, heights)
        assert found.attrs["Conventions"] == "CF-1.11"
        assert found.height.attrs["standard_name"] == "height_above_reference_ellipsoid"
        assert found.height.attrs["units"] == "m"
        assert CRS.from_cf(found.crs.attrs).to_2d().to_epsg() == 32632
        flags = dict(
            zip(found.validity.attrs["flag_meanings"].split(), found.validity.attrs["flag_values"], strict=True)
        )
        assert flags["two_scatterers"] == Validity.TWO_SCATTERERS
    assert [one.name for one in tmp_path.iterdir()] == ["heights.nc"]


def test_zarr_has_the_heights_in_whatever_pieces_it_was_written(
    heights: RecordedHeights, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset, "BATCH", 3)
    path = tmp_path / "heights.zarr"
    assert write_zarr(heights, path) == DWELLS
    assert_same_heights(xarray.open_zarr(path, consolidated=False), heights)
    assert zarr.open_group(path, mode="r")["sigma"].shape[0] == DWELLS
    assert [one.name for one in tmp_path.iterdir()] == ["heights.zarr"]


def test_a_map_is_a_valid_cog(heights: RecordedHeights, tmp_path: Path) -> None:
    path = tmp_path / "map.tif"
    shape = write_map(heights, path, cell_size=0.5)
    assert cog_validate(path, strict=True)[0]
    with rasterio.open(path) as file:
        assert file.shape == shape
        assert file.transform.a == 0.5
        low, high = np.nanpercentile(file.read(1), [1, 99])
    assert 560 < low < high < 572, "surfaces of 2 to 9 m, 1 m above the sphere 3.5 km away"


def test_a_film_has_a_frame_for_each_dwell(
    heights: RecordedHeights, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read by Pillow; frames differ, and of many dwells some are shown."""
    assert write_film(heights, tmp_path / "film.gif") == DWELLS
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == DWELLS
        frames, shown_ms = [], 0
        for number in range(DWELLS):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")))
            shown_ms += film.info["duration"]
    assert all(np.any(one != other) for one, other in pairwise(frames))
    assert 2000 < shown_ms <= 10_000
    assert [one.name for one in tmp_path.iterdir()] == ["film.gif"]
    monkeypatch.setattr(film_module, "MOST_FRAMES", 2)
    assert write_film(heights, tmp_path / "short.gif") == 2


def test_a_film_of_a_simulated_flight_shows_the_truth_below() -> None:
    """The cloud grows above it, and the truth is there from the first frame on."""
    rng = np.random.default_rng(2)
    clouds = [rng.uniform((west, 0.0, 0.0), (west + 5.0, 10.0, 1.0), (500, 3)) for west in (0.0, 5.0, 10.0)]
    sight = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    alone = list(frames_of(clouds, None, sight, "measured", 10))
    first, second, third = frames_of(clouds, np.concatenate(clouds), sight, "measured", 10)
    half = len(first) // 2
    assert len(first) == pytest.approx(2 * len(alone[0]), rel=0.1)
    np.testing.assert_array_equal(first[half:], third[half:])
    grown = [np.count_nonzero(np.any(one[:half] != third[:half], axis=-1)) for one in (first, second)]
    assert grown[0] > grown[1] > 1000
    assert len(list(frames_of(clouds, None, sight, "measured", 2))) == 2


def test_films_of_another_kind_are_refused(heights: RecordedHeights, tmp_path: Path) -> None:
    with pytest.raises(UserError) as refused:
        write_film(heights, tmp_path / "film.avi")
    assert_one_sentence(str(refused.value), "a film is written as .gif")


def test_what_is_no_place_or_not_there_is_refused(bag: Path, tmp_path: Path) -> None:
    for arguments, words in (
        ({"topic": "/nothing"}, "has no heights on topic '/nothing'; there are /ml/height"),
        ({"origin": ORIGIN, "crs": "EPSG:32756"}, "does not suit a map at latitude 48.1"),
    ):
        with pytest.raises(UserError) as refused:
            RecordedHeights.of_bag(bag, **arguments)
        assert_one_sentence(str(refused.value), words)
    with pytest.raises(UserError) as refused:
        write_las(RecordedHeights.of_bag(bag), tmp_path / "cloud.txt")
    assert_one_sentence(str(refused.value), "is written as .las or .laz")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(UserError) as refused:
        write_zarr(RecordedHeights.of_bag(bag), tmp_path / "full")
    assert_one_sentence(str(refused.value), "is not empty")
