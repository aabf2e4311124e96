"""The relief mapper, as a stage and as a node: the map is right, survives bad input, is written however it ends."""

from __future__ import annotations

import json
import math
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rclpy
from helpers import assert_one_sentence, file_size_limit, make_aperture, publisher_of
from programs import PROCESSING as PROGRAMS
from programs import Program
from pyproj import CRS
from rclpy.node import Node
from rclpy.parameter import Parameter
from stage_graph import StageGraph, with_fields

from sal_height import messages
from sal_height.elevation.array.estimate import Validity
from sal_height.engine.stage import StageSettings
from sal_height.errors import UserError
from sal_height.geometry.earth import sphere_coordinates, sphere_point
from sal_height.geometry.geodesy import Origin
from sal_height.geometry.grid import Grid
from sal_height.geometry.projection import Projection
from sal_height.messages.types import (
    ComplexImage,
    Header,
    HeightImage,
    Image,
    NavSatFix,
    NodeAccount,
    PointCloud2,
    Provenance,
    ReliefMap,
    TransformStamped,
)
from sal_height.nodes.accounts.account import PROGRESS, Account
from sal_height.nodes.host import StageNode
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS
from sal_height.relief.heights import HeightField, Surface

TIMEOUT_S = 120.0
ROWS, COLS = 6, 9
WEST, SOUTH = -4.0, -3503.0


def height_image(dwell: int, shift: int = 0, level: float = 2.0) -> HeightImage:
    """Pixels in the centres of cells of 1 m that rise by 0.1 m per metre east, `shift` metres further east.

    The north-west corner has no height.
    """
    east, north = (
        g.astype(float) for g in np.meshgrid(WEST + shift + 0.5 + np.arange(COLS), SOUTH + 0.5 + np.arange(ROWS))
    )
    height = level + 0.1 * east
    height[-1, 0] = np.nan
    sigma = np.full(height.shape, 0.05)
    validity = np.where(np.isfinite(height), Validity.OK, Validity.LOW_CNR).astype(np.uint8)
    axes = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    grid = Grid(sphere_point(WEST + shift + 0.5, SOUTH + 0.5, 0.0), *axes, 1.0, 1.0, ROWS, COLS)
    field = HeightField(grid, validity, (Surface.at(sphere_point(east, north, height), height, sigma, sigma),))
    slc = ComplexImage(dwell=dwell, header=Header(frame_id="map", stamp=messages.to_stamp(1_000_000_000 * (dwell + 1))))
    provenance = Provenance(config_hash="of the sensor", calibration_id="of the lens")
    provenance.parameters = messages.with_stage([], "ml_height", {"range_looks": 2})
    return messages.height_to_message(field, make_aperture(), (2, 2), "ml", slc, provenance)


class Mapped:
    """A relief mapper with somebody who publishes heights and listens to what comes of them."""

    def __init__(self, graph: Graph, mapper: StageNode | None) -> None:
        self.graph = graph
        self.mapper = mapper
        self.maps: list[ReliefMap] = []
        self.images: list[Image] = []
        self.points: list[PointCloud2] = []
        self.frames: list[TransformStamped] = []
        self.account = Account()
        node = graph.add(Node("feeder", context=graph.context))
        self.publisher = publisher_of(node, HeightImage, "ml/height", FRAMES_QOS)
        subscribe(node, ReliefMap, "map/relief", self.maps.append, LATCHED_QOS)
        subscribe(node, Image, "map/image", self.images.append, LATCHED_QOS)
        subscribe(node, PointCloud2, "map/points", self.points.append, LATCHED_QOS)
        subscribe(node, TransformStamped, "map/frame", self.frames.append, LATCHED_QOS)
        subscribe(node, NodeAccount, PROGRESS, self._watch, 10)
        self.wait(lambda: self.publisher.get_subscription_count() == 1, "the mapper")
        topics = ("map/relief", "map/image", "map/points")
        self.wait(lambda: all(node.count_publishers(topic) == 1 for topic in topics), "its products")

    def feed(self, *images: HeightImage) -> None:
        """Publish, and wait until the mapper has accounted for all."""
        goal = self.account.received + len(images)
        for image in images:
            self.publisher.publish(image)
        self.wait(lambda: (self.account.received, self.account.waiting) == (goal, 0), "the account")

    def map_of(self, images: int) -> ReliefMap:
        """The map of so many height images."""
        self.wait(lambda: bool(self.maps) and self.maps[-1].images == images, f"a map of {images}")
        return self.maps[-1]

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        assert self.graph.spin_until(condition, TIMEOUT_S), f"waited in vain for {what}: {self.account}"

    def _watch(self, message: NodeAccount) -> None:
        if message.node == "relief_mapper":
            self.account = Account.of_message(message)


def start(graph: Graph, **parameters: Any) -> StageNode:
    values = {"period_s": 0.1, **parameters}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return graph.add(PROCESSING["relief_mapper"](context=graph.context, parameter_overrides=overrides))


@pytest.fixture
def mapped_node(graph: Graph, tmp_path: Path) -> Mapped:
    """The node of a mapper of cells of 1 m that writes map.tif."""
    return Mapped(graph, start(graph, cell_size_m=1.0, file=str(tmp_path / "map.tif")))


class MapStage:
    """A relief mapper that is fed with messages, and the maps that it publishes."""

    def __init__(self, **parameters: Any) -> None:
        self.graph = StageGraph()
        self.mapper = self.graph.add("relief_mapper", **{"period_s": 0.1, **parameters})
        self.maps = self.graph.heard["map/relief"]

    def feed(self, *images: HeightImage) -> None:
        self.graph.publish("ml/height", *images)

    def set_origin(self, origin: NavSatFix) -> None:
        self.graph.publish("map_origin", origin)

    def map_of(self, images: int) -> ReliefMap:
        """The map of N height images."""
        self.graph.wait(lambda: bool(self.maps) and self.maps[-1].images == images, f"a map of {images}")
        return self.maps[-1]


@pytest.fixture
def mapped(tmp_path: Path) -> MapStage:
    """A mapper of cells of 1 m that writes map.tif."""
    return MapStage(cell_size_m=1.0, file=str(tmp_path / "map.tif"))


def layer(message: ReliefMap, name: str) -> np.ndarray:
    return np.asarray(getattr(message.layers[0], name)).reshape(message.rows, message.cols)


def expected_height(first: int, last: int) -> np.ndarray:
    """Heights of `height_image` shifted by `first` to `last` together."""
    row = 2.0 + 0.1 * (WEST + 0.5 + np.arange(first, COLS + last))
    return np.tile(row, (ROWS, 1))


def test_dwells_become_one_map(mapped: MapStage) -> None:
    mapped.feed(*(height_image(dwell, shift=dwell) for dwell in range(3)))
    message = mapped.map_of(3)
    assert (message.rows, message.cols, message.cell_size) == (ROWS, COLS + 2, 1.0)
    assert (message.origin_east, message.origin_north) == (WEST + 0.5, SOUTH + 0.5)
    assert (message.header.frame_id, message.crs, [one.name for one in message.layers]) == ("map", "", ["mean"])
    assert (message.header.stamp.sec, message.dwell, message.estimator) == (3, 2, "ml")
    count = np.tile([1, 2, *[3] * (COLS - 2), 2, 1], (ROWS, 1))
    count[-1] = [0, 0, 0, *[3] * (COLS - 3), 2, 1] + (np.arange(COLS + 2) == 1) + 2 * (np.arange(COLS + 2) == 2)
    np.testing.assert_array_equal(layer(message, "count"), count)
    seen = count > 0
    np.testing.assert_allclose(layer(message, "height")[seen], expected_height(0, 2)[seen], rtol=1e-5)
    np.testing.assert_allclose(layer(message, "sigma")[seen], 0.05 / np.sqrt(count[seen]), rtol=2e-3)
    assert np.isnan(layer(message, "height")[~seen]).all()
    assert np.isnan(layer(message, "sigma")[~seen]).all()
    assert np.array_equal(np.isfinite(layer(message, "disagreement")), count > 1)


def test_provenance_names_this_stage_after_those_before(mapped: MapStage) -> None:
    mapped.feed(height_image(0))
    provenance = mapped.map_of(1).provenance
    assert (provenance.config_hash, provenance.calibration_id) == ("of the sensor", "of the lens")
    parameters = messages.stages_of(provenance.parameters)
    assert set(parameters) == {"ml_height", "relief_mapper"}
    assert parameters["relief_mapper"]["cell_size_m"] == 1.0


def test_any_viewer_sees_the_map(mapped_node: Mapped) -> None:
    """The image has north up; points lie where the cells do, on the sphere."""
    mapped_node.wait(lambda: mapped_node.account.subscribers.get("map/points") == 1, "the points to be listened to")
    mapped_node.feed(height_image(0))
    height = layer(mapped_node.map_of(1), "height")
    mapped_node.wait(
        lambda: bool(mapped_node.images and mapped_node.points and mapped_node.frames), "image, points and their frame"
    )
    picture, cloud = mapped_node.images[-1], mapped_node.points[-1]
    pixels = np.frombuffer(picture.data, np.float32).reshape(picture.height, picture.width)
    assert picture.encoding == "32FC1"
    np.testing.assert_array_equal(pixels, height[::-1])
    points = np.frombuffer(cloud.data, np.float32).reshape(cloud.width, len(cloud.fields))
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "height", "sigma"]
    assert len(points) == np.isfinite(height).sum()
    frame, shift = mapped_node.frames[-1], mapped_node.frames[-1].transform.translation
    assert (frame.header.frame_id, frame.child_frame_id) == ("map", cloud.header.frame_id)
    east, north, above = sphere_coordinates(points[:, :3].astype(float) + np.array([shift.x, shift.y, shift.z]))
    np.testing.assert_allclose(above, points[:, 3], atol=1e-5)
    cells = {(round(e - WEST - 0.5), round(n - SOUTH - 0.5)): h for e, n, h in zip(east, north, above, strict=True)}
    assert all(abs(height[row, col] - h) < 1e-3 for (col, row), h in cells.items())
    assert len(cells) == len(points)


def test_maps_are_not_published_more_often_than_asked() -> None:
    mapped = MapStage(period_s=3600.0)
    mapped.feed(*(height_image(dwell) for dwell in range(4)))
    assert mapped.maps == []
    mapped.mapper.conclude()
    assert mapped.map_of(4).layers[0].count[0] == 4
    assert len(mapped.maps) == 1


@pytest.mark.parametrize(("given", "size"), [(0.0, 2.0), (5.0, 5.0)])
def test_the_cell_size_follows_from_the_first_image_unless_given(given: float, size: float) -> None:
    """At 45 degrees and in the ground plane a pixel of 1 m stays one; the aim point is a little lower."""
    mapped = MapStage(cell_size_m=given)
    image = height_image(0)
    image.grid.col_spacing = 1.01
    mapped.feed(image)
    assert mapped.map_of(1).cell_size == size


REFUSED: dict[str, tuple[str, Any, str, str]] = {
    "other frame": ("header.frame_id", "odom", "wrong frames", "'odom'"),
    "no surface": ("surfaces", [], "wrong size", "no surface"),
    "too few heights": ("surfaces.0.height", np.ones(1, np.float32), "wrong size", "height has 1 entries"),
    "too few places": ("surfaces.0.east", np.zeros(0, np.float32), "wrong size", "east has 0 entries"),
    "no pixels": ("grid.rows", 0, "wrong size", "0 x 9"),
    "origin nowhere": ("grid.origin.x", float("inf"), "not finite", "grid"),
    "farther than the earth": ("grid.origin.x", 2e7, "not finite", "1e+07 m"),
    "pixels finer than waves": ("grid.row_spacing", 1e-7, "wrong geometry", "1e-06 m"),
    "no motion": ("aperture.velocity.x", 0.0, "wrong geometry", "velocity"),
    "no rotation": ("aperture.pose.orientation.w", 5.0, "wrong geometry", "orientation"),
    "far away": ("grid.origin.x", 1e6, "map full", "max_cells"),
}
"""A field of a height image, what it is set to, and for what reason and with what words it is refused then."""


def test_what_cannot_be_used_is_counted_and_leaves_the_map_as_it_is(mapped: MapStage) -> None:
    mapped.feed(height_image(0))
    before = mapped.map_of(1)
    for name, (field, value, reason, words) in REFUSED.items():
        dropped = mapped.mapper.counted("dropped.").get(reason, 0)
        mapped.feed(with_fields(height_image(9), {field: value}))
        assert mapped.mapper.counted("dropped.")[reason] == dropped + 1, name
        assert_one_sentence(mapped.mapper.last_rejection.removeprefix(f"{reason}: "), words)
    mapped.feed(height_image(1))
    after = mapped.map_of(2)
    np.testing.assert_array_equal(after.layers[0].height, before.layers[0].height)
    assert (mapped.mapper.summary()["in"], mapped.mapper.summary()["processed"]) == (len(REFUSED) + 2, 2)


def test_dwells_that_contradict_the_stated_course_of_their_error_are_said_once() -> None:
    """Twenty dwells of equal heights, where offsets of 10 m that change from dwell to dwell are stated."""
    mapped = MapStage(varying_offset_m=10.0, offset_correlation_s=0.1)
    mapped.feed(*(height_image(dwell) for dwell in range(20)))
    assert mapped.map_of(20).layers[0].count.max() == 20
    assert mapped.mapper.counted("ignored.") == {"offsets of dwells": 1}
    silent = MapStage()
    silent.feed(*(height_image(dwell) for dwell in range(20)))
    assert silent.mapper.counted("ignored.") == {}


def test_single_bad_pixels_do_not_enter_and_are_counted(mapped: MapStage) -> None:
    image = height_image(0)
    image.surfaces[0].sigma[0], image.surfaces[0].east[1] = float("inf"), float("nan")
    mapped.feed(image)
    np.testing.assert_array_equal(mapped.map_of(1).layers[0].count[:4], [0, 0, 1, 1])
    assert mapped.mapper.counted("ignored.")["bad pixels"] == 1


def test_a_first_image_that_is_refused_does_not_choose_the_cells() -> None:
    mapped = MapStage(max_cells=ROWS * (COLS + 1))
    large = height_image(0)
    large.grid.row_spacing, large.surfaces[0].east[0] = 0.01, 1e5
    mapped.feed(large, height_image(1))
    assert mapped.map_of(1).cell_size == 1.0
    assert mapped.mapper.counted("dropped.")["map full"] == 1


def test_pixels_that_validity_rules_out_do_not_enter(mapped: MapStage) -> None:
    image = height_image(0)
    image.validity[0] = Validity.NOT_ONE_SCATTERER
    image.validity[1] = Validity.TWO_SCATTERERS
    image.validity[2] = Validity.THREE_SCATTERERS
    image.surfaces = 2 * image.surfaces
    mapped.feed(image)
    np.testing.assert_array_equal(mapped.map_of(1).layers[0].count[:4], [0, 1, 0, 1])


def test_the_file_is_what_was_published(mapped: MapStage, tmp_path: Path) -> None:
    mapped.feed(*(height_image(dwell, shift=dwell) for dwell in range(3)))
    message = mapped.map_of(3)
    assert list(tmp_path.iterdir()) == []
    mapped.mapper.conclude()
    assert [path.name for path in tmp_path.iterdir()] == ["map.tif"]
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.descriptions == ("height", "sigma", "disagreement", "count")
        for band, name in enumerate(file.descriptions, start=1):
            np.testing.assert_array_equal(file.read(band)[::-1], layer(message, name).astype(np.float32))
        assert np.isnan(file.nodata)
        assert file.transform.e == -1.0, "north up"
        tags = file.tags()
        assert (tags["estimator"], tags["images"], tags["config_hash"]) == ("ml", "3", "of the sensor")
        assert set(json.loads(tags["parameters"])) == {"ml_height", "relief_mapper"}


@pytest.mark.parametrize(
    ("origin", "is_placed"),
    [
        ({"origin_latitude_deg": 47.5, "origin_longitude_deg": -8.25}, True),
        ({"origin_longitude_deg": 7.0}, True),
        ({}, False),
    ],
    ids=["both", "equator", "none"],
)
def test_the_file_is_placed_on_the_earth_where_the_origin_is_known(
    tmp_path: Path, origin: dict[str, float], is_placed: bool
) -> None:
    path = tmp_path / "map.tif"
    mapped = MapStage(cell_size_m=1.0, file=str(path), **origin)
    mapped.feed(height_image(0))
    mapped.mapper.conclude()
    with rasterio.open(path) as file:
        assert file.crs.is_projected == is_placed
        if is_placed:
            latitude = math.radians(origin.get("origin_latitude_deg", 0.0))
            place = Origin(latitude, math.radians(origin["origin_longitude_deg"]), 0.0)
            projection = Projection.of("utm", place)
            cell = sphere_point(WEST + 4.5, SOUTH + 2.5, 2.05)  # in the middle of the image
            easting, northing, height = projection.coordinates(cell)
            assert CRS(file.crs.to_wkt()).to_2d() == projection.system.to_2d()
            ((found,),) = file.sample([(easting, northing)], indexes=1)
            assert found == pytest.approx(height, abs=0.1), "a metre of cell on ground that rises by 0.1"


def test_shutting_the_context_down_writes_the_file(graph: Graph, mapped_node: Mapped, tmp_path: Path) -> None:
    mapped_node.feed(height_image(0))
    rclpy.shutdown(context=graph.context)
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.read(4).sum() == ROWS * COLS - 1
    graph.close()


def test_a_file_that_was_there_is_replaced_as_a_whole(mapped: MapStage, tmp_path: Path) -> None:
    (tmp_path / "map.tif").write_text("an older one")
    mapped.feed(height_image(0))
    assert (tmp_path / "map.tif").read_text() == "an older one"
    mapped.mapper.conclude()
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.shape == (ROWS, COLS)


def test_without_a_height_there_is_no_file(mapped: MapStage, tmp_path: Path) -> None:
    image = height_image(0)
    image.validity = bytes([Validity.LOW_CNR]) * len(image.validity)
    mapped.feed(image)
    mapped.mapper.conclude()
    assert list(tmp_path.iterdir()) == []
    assert mapped.graph.failure == ""


def test_a_disk_that_is_full_leaves_the_older_file_and_nothing_half_written(mapped: MapStage, tmp_path: Path) -> None:
    (tmp_path / "map.tif").write_text("an older one")
    mapped.feed(height_image(0))
    mapped.map_of(1)
    with file_size_limit(100):
        mapped.mapper.conclude()
    assert_one_sentence(mapped.graph.failure, str(tmp_path / "map.tif"), "File too large")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["an older one"]
    assert mapped.maps[-1].images == 1


def test_heights_that_wait_for_the_worker_are_in_the_map(graph: Graph, tmp_path: Path) -> None:
    mapped, held = Mapped(graph, start(graph, cell_size_m=1.0, file=str(tmp_path / "map.tif"))), threading.Event()
    mapped.mapper.submit(0, lambda: int(not held.wait(TIMEOUT_S)))
    for dwell in range(StageSettings().max_queued_dwells):
        mapped.publisher.publish(height_image(dwell))
    mapped.wait(lambda: len(mapped.mapper.waiting()) == StageSettings().max_queued_dwells, "heights that wait")
    held.set()
    mapped.mapper.conclude()
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.read(4).max() == StageSettings().max_queued_dwells


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"cell_size_m": -1.0}, "cell_size_m is -1.0"),
        ({"max_cells": 0}, "max_cells is 0"),
        ({"varying_offset_m": 0.1}, "varying_offset_m is stated without offset_correlation_s"),
        ({"period_s": 0.0}, "period_s is 0.0"),
        ({"origin_latitude_deg": 91.0}, "origin_latitude_deg is 91.0"),
        ({"crs": "EPSG:1"}, "'EPSG:1' is not known to PROJ"),
        ({"crs": "EPSG:4326"}, "has angles for coordinates"),
        ({"crs": "EPSG:32756", "origin_latitude_deg": 48.1}, "EPSG:32756 does not suit"),
        ({"estimator": "no topic"}, "estimator is 'no topic'"),
        ({"file": "/tmp"}, "it is a folder"),  # noqa: S108 (nothing is written)
        ({"file": "/nowhere/at/all/map.tif"}, "folder /nowhere/at/all does not exist"),
    ],
)
def test_parameters_that_cannot_be_used_are_refused(parameters: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError) as refused:
        MapStage(**parameters)
    assert_one_sentence(str(refused.value), words)


def test_without_rasterio_a_file_is_refused_at_the_start(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(UserError) as refused:
        start(graph, file=str(tmp_path / "map.tif"))
    assert "needs rasterio; install it with: pip install 'sal_height[dem]'." in str(refused.value)
    start(graph)


def test_a_signal_ends_the_program_with_a_whole_file(graph: Graph, tmp_path: Path, domain_id: int) -> None:
    path = tmp_path / "map.tif"
    values = f"file:={path}", "cell_size_m:=1.0", "period_s:=0.1", "origin_latitude_deg:=47.5"
    process = run_main(domain_id, *(word for value in values for word in ("-p", value)))
    mapped = Mapped(graph, None)
    mapped.feed(*(height_image(dwell) for dwell in range(5)))
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0
    assert_one_sentence(errors.partition("]: ")[2].strip(), "Waiting for messages on /ml/height")
    with rasterio.open(path) as file:
        assert np.nanmax(file.read(4)) == 5


def test_the_program_ends_with_status_1_and_a_sentence_if_the_folder_is_gone(
    graph: Graph, tmp_path: Path, domain_id: int
) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    process = run_main(domain_id, "-p", f"file:={folder / 'map.tif'}")
    mapped = Mapped(graph, None)
    mapped.feed(height_image(0))
    folder.rmdir()
    process.terminate()
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 1
    assert errors.count("\n") == 2  # the first says what is waited for
    assert f"File {folder / 'map.tif'} cannot be written: No such file or directory." in errors
    assert mapped.map_of(1).rows == ROWS


def run_main(domain_id: int, *arguments: str) -> Program:
    return Program(PROGRAMS, "relief_mapper", "--ros-args", *arguments, domain_id=domain_id)


def placed(origin: NavSatFix, **parameters: Any) -> MapStage:
    """A mapper that an origin was published to."""
    mapped = MapStage(cell_size_m=1.0, **parameters)
    mapped.set_origin(origin)
    return mapped


MUNICH = NavSatFix(header=Header(frame_id="map"), latitude=48.1, longitude=11.3, altitude=560.0)


def test_a_map_with_a_published_origin_is_in_utm() -> None:
    """Coordinates are eastings and northings, and the points are in the map frame where the pixels were."""
    mapped = placed(MUNICH)
    mapped.feed(*(height_image(dwell) for dwell in range(2)))
    message = mapped.map_of(2)
    assert (message.crs, message.header.frame_id) == ("EPSG:32632", "map")
    origin = Origin(math.radians(48.1), math.radians(11.3), 560.0)
    cell = np.array([message.origin_east + 4.0, message.origin_north + 2.0, layer(message, "height")[2, 4]])
    east, north, height = sphere_coordinates(Projection.of("utm", origin).positions(cell))
    assert abs(east - WEST - COLS / 2) < COLS / 2
    assert abs(north - SOUTH - ROWS / 2) < ROWS / 2
    assert height == pytest.approx(2.0 + 0.1 * east, abs=0.06)


def test_an_origin_that_comes_after_the_map_has_begun_places_the_next_one() -> None:
    mapped = MapStage(cell_size_m=1.0)
    mapped.feed(height_image(0))
    mapped.set_origin(MUNICH)
    assert mapped.mapper.counted("ignored.") == {"origin after the begin": 1}
    assert "until service ~/reset starts a new one" in mapped.mapper.last_rejection
    mapped.feed(height_image(1))
    assert mapped.map_of(2).crs == ""
    mapped.mapper.forget()
    mapped.feed(height_image(2))
    assert mapped.map_of(1).crs == "EPSG:32632"


@pytest.mark.parametrize(
    ("changed", "reason", "words"),
    [
        (
            {"latitude": 0.0, "longitude": 0.0},
            "wrong origin",
            "a place at sea that stands for one nobody has filled in",
        ),
        ({"latitude": 91.0}, "wrong origin", "has latitude 91"),
        ({"altitude": -4000.0}, "wrong origin", "is -4000 m above the ellipsoid"),
        ({"longitude": math.nan}, "not finite", "The origin has NaN"),
        ({"header": Header(frame_id="odom")}, "wrong frames", "The origin has frame_id 'odom'"),
    ],
)
def test_an_origin_that_is_no_place_is_told_and_the_next_one_is_used(
    changed: dict[str, Any], reason: str, words: str
) -> None:
    values = {name: getattr(MUNICH, name) for name in ("header", "latitude", "longitude", "altitude")}
    mapped = placed(NavSatFix(**values | changed))
    assert mapped.mapper.counted("ignored.") == {reason: 1}
    assert words in mapped.mapper.last_rejection
    mapped.set_origin(MUNICH)
    assert mapped.mapper.stage._axes is not None


def test_a_system_that_does_not_suit_the_published_origin_is_told() -> None:
    mapped = placed(MUNICH, crs="EPSG:32756")
    assert mapped.mapper.counted("ignored.") == {"origin": 1}
    assert "EPSG:32756 does not suit a map at latitude 48.1000" in mapped.mapper.last_rejection
    mapped.feed(height_image(0))
    assert mapped.map_of(1).crs == ""
