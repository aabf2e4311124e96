"""Elevation models: every height ends up where the file puts it, and files that cannot be used are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers import assert_one_sentence, refused
from matplotlib.cbook import get_sample_data
from pyproj import CRS, Transformer
from rasterio.transform import Affine

from sal_height.errors import UserError
from sal_height.geometry.earth import EARTH_RADIUS, sphere_coordinates
from sal_height.simulation.scene import Scene
from sal_height.simulation.scenes import load_scene

ROWS, COLS = 7, 5
ELEVATION = np.random.default_rng(3).uniform(100, 900, (ROWS, COLS)).astype(np.float32)  # north row first
METRES_PER_DEGREE = np.pi / 180 * EARTH_RADIUS


def write_geotiff(path: Path, crs: str | None, transform: Affine, elevation: np.ndarray = ELEVATION) -> str:
    rows, cols = elevation.shape
    profile = {"driver": "GTiff", "width": cols, "height": rows, "count": 1, "dtype": "float32", "nodata": -9999}
    with rasterio.open(path, "w", crs=crs, transform=transform, **profile) as file:
        file.write(elevation.astype(np.float32), 1)
    return str(path)


def write_npz(path: Path, **arrays: object) -> str:
    np.savez(path, **arrays)
    return str(path)


def assert_heights(scene: Scene, dx: float, dy: float) -> None:
    """Assert that each cell's centre has its height; rows run south, the middle of the file is the map's origin."""
    row, col = np.indices(ELEVATION.shape)
    heights = scene.heights((col - (COLS - 1) / 2) * dx, ((ROWS - 1) / 2 - row) * dy)
    np.testing.assert_allclose(heights, ELEVATION, rtol=1e-6)
    assert np.all(scene.brightness == 1)


SLOPES = np.array([0.2, -0.1])
"""Of a plane in eastings and northings, or their degrees as if a degree were 100 km."""


def plane_of(transform: Affine, rows: int, cols: int, per_unit: float) -> np.ndarray:
    """Elevations that bilinear interpolation has exactly."""
    x, y = transform @ np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)).reshape(2, -1)
    middle = transform @ (cols / 2, rows / 2)
    return (500.0 + per_unit * (SLOPES @ [x - middle[0], y - middle[1]])).reshape(rows, cols)


@pytest.mark.parametrize(
    ("crs", "transform", "per_unit"),
    [
        ("EPSG:32617", Affine(30.0, 0, 5.6e5, 0, -20.0, 4.04e6), 1.0),
        ("EPSG:32617", Affine(300.0, 0, 6.6e5, 0, -400.0, 4.04e6), 1.0),
        ("EPSG:4326", Affine(0.001, 0, -84.4, 0, -0.002, 36.5), 1e5),
        ("EPSG:4258", Affine(0.001, 0, 11.4, 0, -0.0005, 60.5), 1e5),
        ("EPSG:2154", Affine(10.0, 0, 9e5, 0, -10.0, 6.4e6), 1.0),
    ],
    ids=["utm", "wide utm", "degrees", "other degrees", "lambert"],
)
def test_terrain_of_a_geotiff_is_where_proj_has_it(
    tmp_path: Path, crs: str, transform: Affine, per_unit: float
) -> None:
    """Place and height of any point on the plane, to 2 mm: by PROJ's own chain from the system to the map's axes.

    A degree of latitude is up to 0.5 % longer or shorter than on the sphere, and north of UTM is up to 2 degrees beside
    that of the map: 35 m in 1 km.
    """
    rows, cols = 90, 70
    path = write_geotiff(tmp_path / "plane.tif", crs, transform, plane_of(transform, rows, cols, per_unit))
    scene = load_scene(path)
    assert scene.name == "plane"
    assert scene.origin is not None
    assert scene.height.size > 0.7 * rows * cols
    rng = np.random.default_rng(1)
    share = rng.uniform(0.25, 0.75, (2, 500))
    x, y = transform @ (share * [[cols], [rows]])
    middle = np.array(transform @ (cols / 2, rows / 2))
    elevation = 500.0 + per_unit * (SLOPES @ [x - middle[0], y - middle[1]])
    to_earth = Transformer.from_crs(CRS(crs).to_3d(), "EPSG:4979", always_xy=True)
    longitude, latitude, height = to_earth.transform(x, y, elevation)
    at_origin = [float(value) for value in to_earth.transform(*middle, 0.0)]
    assert np.degrees([scene.origin.longitude, scene.origin.latitude]) == pytest.approx(at_origin[:2], abs=1e-9)
    chain = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 +step "
        f"+proj=topocentric +ellps=WGS84 +lat_0={at_origin[1]!r} +lon_0={at_origin[0]!r} +h_0=0"
    )
    east, north, up = sphere_coordinates(np.transpose(chain.transform(longitude, latitude, height)))
    np.testing.assert_allclose(scene.heights(east, north), up, rtol=0, atol=2e-3)


def test_geotiff_in_feet_is_as_large_as_it_is(tmp_path: Path) -> None:
    """Cells of 100 and 50 US survey feet; elevations are in m where nothing says otherwise."""
    path = write_geotiff(tmp_path / "feet.tif", "EPSG:2263", Affine(100, 0, 1e6, 0, -50, 2e5))
    scene = load_scene(path)
    assert np.diff(scene.east) == pytest.approx(100 * 1200 / 3937, rel=1e-4)  # the scale of the projection
    assert np.diff(scene.north) == pytest.approx(50 * 1200 / 3937, rel=1e-4)
    assert scene.heights(0.0, 0.0) == pytest.approx(ELEVATION[ROWS // 2, COLS // 2], abs=0.1)


def test_the_first_row_of_a_geotiff_is_the_northernmost(tmp_path: Path) -> None:
    path = write_geotiff(tmp_path / "utm.tif", "EPSG:32617", Affine(30.0, 0, 5e5, 0, -20.0, 4e6))
    scene = load_scene(path)
    assert scene.height.shape == ELEVATION.shape
    np.testing.assert_allclose(scene.height[::-1], ELEVATION, rtol=0, atol=2.0)
    assert np.all(scene.brightness == 1)


def test_npz_in_metres(tmp_path: Path) -> None:
    assert_heights(load_scene(write_npz(tmp_path / "dem.npz", elevation=ELEVATION, dx=12.0, dy=8.0)), 12.0, 8.0)


def test_npz_in_degrees(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "dem.npz", elevation=ELEVATION, dx=0.001, dy=0.002, ymin=60.0, ymax=60.014)
    dx = 0.001 * METRES_PER_DEGREE * np.cos(np.radians(60.007))
    assert_heights(load_scene(path), dx, 0.002 * METRES_PER_DEGREE)


def test_jacksboro_fault_is_north_up() -> None:
    """The Cumberland Mountains lie north-west of the fault, the valley of Tennessee south-east."""
    scene = load_scene("jacksboro_fault")
    north_west = scene.height[scene.north > 0][:, scene.east < 0]
    south_east = scene.height[scene.north < 0][:, scene.east > 0]
    assert north_west.mean() > south_east.mean() + 100
    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as dem:
        np.testing.assert_array_equal(scene.height[::-1], dem["elevation"])
        edges = float(dem["ymin"]), float(dem["ymax"])
    assert np.ptp(scene.north) == pytest.approx(abs(edges[1] - edges[0]) * METRES_PER_DEGREE, rel=0.005)  # 3" of 0.29°


def test_street_holds_what_it_says() -> None:
    street = load_scene("street")
    assert (street.height.min(), street.height.max()) == (0.0, 2.0)
    assert np.allclose(np.diff(street.north), 0.02)
    assert np.allclose(np.diff(street.east), 0.02)
    names_at = {  # east, north: top
        "road": ((-28.0, 1.0), 0.0),
        "near pavement": ((10.0, 5.0), 0.12),
        "far pavement": ((10.0, -4.0), 0.12),
        "wall": ((10.0, -5.05), 2.0),
        "first step": ((-10.0, -3.2), 0.28),
        "top step": ((-10.0, -7.0), 1.08),
        "car roof": ((-27.0, -1.3), 1.45),
        "bonnet": ((-28.6, -1.3), 0.85),
    }
    for name, (place, top) in names_at.items():
        assert street.heights(*place) == pytest.approx(top, abs=1e-12), name
    assert {(point.north, point.height) for point in street.points} == {(3.0, 1.0)}


def test_name_that_is_no_scene_is_refused_with_those_allowed() -> None:
    with refused(UserError, "'no_such_scene'", "street, woods, village, jacksboro_fault", ".tif or .npz"):
        load_scene("no_such_scene")


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "dem.asc"
    path.write_text("1 2 3")
    with refused(UserError, "'.asc'", ".tif, .tiff and .npz"):
        load_scene(str(path))


HOLE = np.where(np.eye(3) > 0, np.nan, 100.0)
UTM, UTM_GRID = "EPSG:32617", Affine(30, 0, 5e5, 0, -20, 4e6)
NOT_NORTH_UP = ("dem.tif", "north up with a coordinate reference system")
NO_SYSTEM = ("dem.tif", "neither geographic nor projected", "gdalwarp")


def elevations_with(value: float) -> np.ndarray:
    return np.where(np.arange(ELEVATION.size).reshape(ELEVATION.shape) == 13, value, ELEVATION)


@pytest.mark.parametrize(
    ("arrays", "complaint"),
    [
        ({"elevation": ELEVATION, "dx": 1.0}, "lacks dy"),
        ({"height": ELEVATION}, "lacks elevation, dx, dy"),
        ({"elevation": ELEVATION, "dx": 0.0, "dy": 1.0}, "0.0 x 1.0 m; both must be greater than 0"),
        ({"elevation": ELEVATION, "dx": 1.0, "dy": np.nan}, "1.0 x nan m; both must be greater than 0"),
        ({"elevation": ELEVATION, "dx": [1.0, 2.0], "dy": 1.0}, "not a readable .npz file"),
        ({"elevation": np.zeros(9), "dx": 1.0, "dy": 1.0}, "shape (9,); 2 x 2 or more"),
        ({"elevation": HOLE, "dx": 1.0, "dy": 1.0}, "3 cells without elevation"),
        ({"elevation": np.array(["high"] * 4).reshape(2, 2), "dx": 1.0, "dy": 1.0}, "not a readable .npz file"),
        ({"elevation": np.array([[None, 1], [2, 3]]), "dx": 1.0, "dy": 1.0}, "not a readable .npz file"),
        ({}, "lacks elevation, dx, dy"),
        (
            {"elevation": ELEVATION, "dx": np.inf, "dy": 1 / 3},
            "inf x 0.333333 m; both must be greater than 0 and finite",
        ),
        *(
            ({"elevation": elevations_with(value), "dx": 1.0, "dy": 1.0}, said)
            for value, said in (
                (-12001.0, "elevations from -12001 to"),
                (9001.0, "to 9001 m; allowed are -12000 to 9000 m"),
                (-3.4028235e38, "elevations from -3.40282e+38 to"),
                (-9999.0, "1 cells of -9999 m, which looks like undeclared no-data"),
                (-32768.0, "1 cells of -32768 m, which looks like undeclared no-data"),
            )
        ),
    ],
)
def test_useless_npz_is_refused_in_one_sentence(tmp_path: Path, arrays: dict[str, object], complaint: str) -> None:
    path = write_npz(tmp_path / "dem.npz", **arrays)
    with refused(UserError, "Elevation model ", "dem", complaint):
        load_scene(path)


@pytest.mark.parametrize("content", [b"not a zip file", b""], ids=["text", "empty"])
def test_npz_that_is_none_is_refused_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "dem.npz"
    path.write_bytes(content)
    with refused(UserError, "dem.npz", "not a readable .npz file"):
        load_scene(str(path))


def test_damaged_npz_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "dem.npz"
    np.savez_compressed(path, elevation=np.random.default_rng(4).random((50, 50)), dx=1.0, dy=1.0)
    content = bytearray(path.read_bytes())
    content[200:400] = bytes(200)
    path.write_bytes(content)
    with refused(UserError, "dem.npz", "not a readable .npz file"):
        load_scene(str(path))


@pytest.mark.parametrize(
    ("crs", "transform", "parts"),
    [
        ("EPSG:32617", Affine(30, 0, 0, 0, 20, 0), NOT_NORTH_UP),
        ("EPSG:32617", Affine(30, 1, 0, 0, -20, 0), NOT_NORTH_UP),
        ("EPSG:32617", Affine(-30, 0, 0, 0, -20, 0), NOT_NORTH_UP),
        (None, Affine(30, 0, 0, 0, -20, 0), NOT_NORTH_UP),
        ("EPSG:4978", UTM_GRID, NO_SYSTEM),
        ('LOCAL_CS["site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]', UTM_GRID, NO_SYSTEM),
        (
            "EPSG:4326",
            Affine(0.001, 0, 10, 0, -0.001, 95.0),
            ("Elevation model dem", "latitude 94.9965", "between -90 and 90"),
        ),
        (
            "EPSG:4326",
            Affine(0.001, 0, 10, 0, -0.001, -95.0),
            ("Elevation model dem", "latitude -95.0035", "between -90 and 90"),
        ),
        ("EPSG:32617+5773", UTM_GRID, ("needs a grid that is not installed", "egm96")),
    ],
    ids=["south up", "sheared", "mirrored", "nowhere", "geocentric", "local", "north pole", "south pole", "geoid"],
)
def test_geotiff_that_is_not_north_up_on_the_earth_is_refused(
    tmp_path: Path, crs: str | None, transform: Affine, parts: tuple[str, ...]
) -> None:
    with refused(UserError, *parts):
        load_scene(write_geotiff(tmp_path / "dem.tif", crs, transform))


def test_geotiff_with_holes_is_refused(tmp_path: Path) -> None:
    holed = np.where(np.arange(COLS) == 2, -9999, ELEVATION)
    path = write_geotiff(tmp_path / "dem.tif", UTM, UTM_GRID, holed)
    with refused(UserError, f"{ROWS} cells without elevation"):
        load_scene(path)


def test_geotiff_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"
    path.write_bytes(b"II*\0 but no more")
    with refused(UserError, "dem.tif", "not a readable GeoTIFF"):
        load_scene(str(path))


def test_complex_elevations_are_refused(tmp_path: Path) -> None:
    npz = write_npz(tmp_path / "npz.npz", elevation=ELEVATION + 1j, dx=1.0, dy=1.0)
    tif = str(tmp_path / "tif.tif")
    profile = {"driver": "GTiff", "width": COLS, "height": ROWS, "count": 1, "dtype": "complex64"}
    with rasterio.open(tif, "w", crs=UTM, transform=UTM_GRID, **profile) as file:
        file.write((ELEVATION + 1j).astype(np.complex64), 1)
    for path in (npz, tif):
        with refused(UserError, f"Elevation model {Path(path).stem}", "complex elevations; they must be real"):
            load_scene(path)


def test_lowest_and_highest_elevations_are_taken(tmp_path: Path) -> None:
    elevation = np.array([[-12000.0, 9000.0], [-9998.9, 0.0]])
    scene = load_scene(write_npz(tmp_path / "dem.npz", elevation=elevation, dx=1.0, dy=1.0))
    np.testing.assert_array_equal(scene.height[::-1], elevation)


def test_geotiff_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_geotiff(tmp_path / "dem.tif", UTM, UTM_GRID, np.random.default_rng(5).uniform(0, 9, (200, 200)))
    Path(path).write_bytes(Path(path).read_bytes()[:80_000])
    with pytest.raises(UserError) as refusal:
        load_scene(path)
    assert_one_sentence(str(refusal.value), "dem.tif is not a readable GeoTIFF: ")
    assert "See previous" not in str(refusal.value)


@pytest.mark.parametrize("name", ["a" * 5000, "a\0b"], ids=["too long", "zero"])
def test_scene_name_that_no_file_can_have_is_refused(name: str) -> None:
    with pytest.raises(UserError, match="neither a file nor one of"):
        load_scene(name)
