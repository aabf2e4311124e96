"""The ground mapper: it publishes the ground with its kinds, and writes it when it ends."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from chained import Hosted
from helpers import make_aperture
from stage_graph import StageGraph

from sal_height import messages
from sal_height.elevation.array.estimate import Validity
from sal_height.geometry.earth import sphere_point
from sal_height.geometry.geodesy import Origin
from sal_height.geometry.grid import Grid
from sal_height.geometry.projection import Projection
from sal_height.messages.types import ComplexImage, Header, HeightImage, Provenance, ReliefLayer, ReliefMap
from sal_height.relief.heights import HeightField, Surface

WEST, SOUTH, SPACING, ROWS, COLS = -4.0, -3503.0, 0.09, 30, 20


def height_image() -> HeightImage:
    """Level ground at 2 m with a hole of nine pixels."""
    east, north = np.meshgrid(WEST + SPACING * np.arange(COLS), SOUTH + SPACING * np.arange(ROWS))
    height, sigma = np.full(east.shape, 2.0), np.full(east.shape, 0.01)
    height[14:17, 9:12] = np.nan
    validity = np.where(np.isfinite(height), Validity.OK, Validity.NO_SIGNAL).astype(np.uint8)
    axes = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    grid = Grid(sphere_point(WEST, SOUTH, 0.0), *axes, SPACING, SPACING, ROWS, COLS)
    field = HeightField(grid, validity, (Surface.at(sphere_point(east, north, height), height, sigma, sigma),))
    slc = ComplexImage(dwell=0, header=Header(frame_id="map", stamp=messages.to_stamp(1_000_000_000)))
    return messages.height_to_message(field, make_aperture(), (2, 2), "ml", slc, Provenance())


def first_map(**parameters: Any) -> tuple[Hosted, ReliefMap]:
    """A ground mapper, and what it makes of the image."""
    graph = StageGraph()
    mapper = graph.add("ground_mapper", period_s=0.1, **parameters)
    graph.publish("ml/height", height_image())
    graph.wait(lambda: graph.heard["ground/relief"], "a map")
    return mapper, graph.heard["ground/relief"][-1]


def test_the_ground_is_published_with_its_kinds_and_written(tmp_path: Path) -> None:
    mapper, found = first_map(file=str(tmp_path / "ground.tif"))
    height, kind = (
        np.asarray(values).reshape(found.rows, found.cols) for values in (found.layers[0].height, found.layers[0].kind)
    )
    assert np.isclose(found.cell_size, 0.05)
    assert np.mean(kind == ReliefLayer.MEASURED) > 0.85
    assert kind[round(15 * SPACING / 0.05), round(10 * SPACING / 0.05)] == ReliefLayer.INTERPOLATED
    assert np.nanmax(np.abs(height - 2.0)) < 1e-3
    mapper.conclude()
    with rasterio.open(tmp_path / "ground.tif") as file:
        assert (file.height, file.width) == kind.shape
        assert np.isclose(np.nanmedian(file.read(1)), 2.0)
        assert np.array_equal(file.read(file.descriptions.index("kind") + 1)[::-1], kind)


def test_the_ground_near_a_known_origin_is_in_utm() -> None:
    """Its kinds are the same, and heights are above the ellipsoid."""
    place = {"origin_latitude_deg": 48.1, "origin_longitude_deg": 11.3, "origin_height_m": 560.0}
    _, found = first_map(**place)
    height, kind = (
        np.asarray(values).reshape(found.rows, found.cols) for values in (found.layers[0].height, found.layers[0].kind)
    )
    assert (found.crs, found.header.frame_id, found.layers[0].name) == ("EPSG:32632", "map", "ground")
    origin = Origin(math.radians(48.1), math.radians(11.3), 560.0)
    hole = sphere_point(WEST + 10 * SPACING, SOUTH + 15 * SPACING, 2.0)
    easting, northing, expected = Projection.of("utm", origin).coordinates(hole)
    row, col = round((northing - found.origin_north) / 0.05), round((easting - found.origin_east) / 0.05)
    assert kind[row, col] == ReliefLayer.INTERPOLATED
    assert np.nanmax(np.abs(height - expected)) < 1e-3
