"""A flight somewhere on the earth: its bag says where, and its map lies there, also that of a replay."""

from __future__ import annotations

import dataclasses
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from helpers import assert_one_sentence
from rasterio.transform import Affine
from rosbags.highlevel import AnyReader

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.described import origin_of
from sal_height.bag.namespace import open_bag
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.geometry import Origin, Projection, sphere_point
from sal_height.graph.reporting import RELIEF_MAP
from sal_height.messages import serialize
from sal_height.runs.chain.entry import FROM_HEIGHTS, Part
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.truth.simulate import fly
from sal_height.simulation import Preset, flight_of
from sal_height.simulation.preset import parse_preset

MUNICH = {"latitude_deg": 48.1, "longitude_deg": 11.3, "height_m": 560.0}
ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)


@pytest.fixture(scope="module")
def flown(two_dwells: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a run of two dwells near Munich."""
    out = tmp_path_factory.mktemp("placed") / "run"
    fly(placed(two_dwells), 3, out, {})
    return out


def placed(preset: Preset) -> Preset:
    return parse_preset(dataclasses.asdict(preset) | {"origin": MUNICH}, "test")


def assert_in_utm(path: Path) -> None:
    """The map covers the street, whose middle is the origin, in zone 32, with heights above the ellipsoid."""
    projection = Projection.of("utm", ORIGIN)
    with rasterio.open(path) as file:
        assert "UTM zone 32N" in file.crs.to_wkt()
        easting, northing, height = projection.coordinates(sphere_point(0.0, 0.0, 0.0))
        box = file.bounds
        assert box.left < easting < box.right
        assert box.bottom < northing < box.top
        heights = file.read(1)
        assert np.nanmedian(heights) == pytest.approx(height, abs=0.5), "the street is up to 0.2 m high, with cars"
        assert height == pytest.approx(560.0, abs=1e-6)


def test_the_map_of_a_run_is_in_utm(flown: Path) -> None:
    assert_in_utm(flown / RELIEF_MAP)


def test_the_bag_says_where_the_map_is_to_others(flown: Path) -> None:
    """Read by rosbags."""
    with AnyReader([flown / "bag"]) as reader:
        (one,) = [c for c in reader.connections if c.topic == "/map_origin"]
        assert one.msgtype == "sensor_msgs/msg/NavSatFix"
        ((_, _, cdr),) = reader.messages([one])
        fix = reader.deserialize(cdr, one.msgtype)
    assert (fix.latitude, fix.longitude, fix.altitude) == pytest.approx((48.1, 11.3, 560.0))
    assert fix.header.frame_id == "map"


def test_a_replay_from_heights_makes_the_same_map(flown: Path, tmp_path: Path, replay: Any) -> None:
    replay(flown / "bag", tmp_path / "again", {}, part=Part(entry=FROM_HEIGHTS))
    assert_in_utm(tmp_path / "again" / RELIEF_MAP)
    with rasterio.open(flown / RELIEF_MAP) as one, rasterio.open(tmp_path / "again" / RELIEF_MAP) as other:
        assert one.transform == other.transform
        np.testing.assert_allclose(one.read(1), other.read(1), rtol=0, atol=1e-4)


def test_a_bag_without_parameters_is_placed_by_its_topic(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The first message is that of somebody who has not filled it in."""
    empty = messages.origin_to_message(Origin(0.0, 0.0, 0.0), messages.to_stamp(5), "map")
    good = messages.origin_to_message(ORIGIN, messages.to_stamp(6), "map")
    with BagWriter(tmp_path / "bag", {}) as bag:
        bag.add_topic("/map_origin", "sensor_msgs/msg/NavSatFix", [qos.LATCHED])
        for stamp_ns, message in enumerate((empty, good)):
            bag.write("/map_origin", serialize(message), stamp_ns, stamp_ns)
    reader = open_bag(tmp_path / "bag", None, ["/map_origin"])
    with caplog.at_level(logging.WARNING):
        values = recorded_parameters(reader)
    assert "a message on /map_origin is not used" in caplog.text
    expected = {"origin_latitude_deg": 48.1, "origin_longitude_deg": 11.3, "origin_height_m": 560.0}
    assert values["relief_mapper"] == values["ground_mapper"] == pytest.approx(expected)


def test_a_bag_without_an_origin_is_not_placed(recorded: Path) -> None:
    assert origin_of(open_bag(recorded / "bag", None, ["/sensor_info"])) is None
    assert "origin_latitude_deg" not in recorded_parameters(open_bag(recorded / "bag", None, ["/ml/height"])).get(
        "relief_mapper", {}
    )


def test_an_elevation_model_gives_the_origin_and_contradicts_another(two_dwells: Preset, tmp_path: Path) -> None:
    path = tmp_path / "hill.tif"
    profile = {"driver": "GTiff", "width": 80, "height": 80, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", crs="EPSG:32632", transform=Affine(5, 0, 6.9e5, 0, -5, 5.3e6), **profile) as file:
        file.write(np.full((80, 80), 500.0, np.float32), 1)
    on_hill = dataclasses.replace(two_dwells, scene=str(path))
    origin = flight_of(on_hill, 1).scene.origin
    assert origin is not None
    zone = Projection.of("EPSG:32632", origin)
    np.testing.assert_allclose(zone.coordinates(np.zeros(3)), [6.9e5 + 200, 5.3e6 - 200, 0.0], atol=1e-6)
    with pytest.raises(UserError) as refused:
        flight_of(placed(on_hill), 1)
    assert_one_sentence(str(refused.value), "scene hill has one of its own", "remove the key origin")


@pytest.mark.parametrize(
    ("origin", "words"),
    [
        ({"latitude_deg": 0.0, "longitude_deg": 0.0}, "a position at sea"),
        ({"latitude_deg": 91.0, "longitude_deg": 0.0}, "latitude_deg"),
        ({"latitude_deg": 1.0}, "longitude_deg"),
    ],
)
def test_an_origin_that_is_no_place_is_refused(two_dwells: Preset, origin: dict[str, float], words: str) -> None:
    with pytest.raises(UserError, match=words):
        parse_preset(dataclasses.asdict(two_dwells) | {"origin": origin}, "test")
