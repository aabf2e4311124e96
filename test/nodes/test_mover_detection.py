"""Node mover_detection among real publishers: from images to points, counted, and the same when it is done again."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import assert_one_sentence, publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.imaging import ImageSettings
from sal_height.messages.types import ComplexImage, PointCloud2, Provenance, SensorInfo
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS
from sal_height.pipeline import Compressor
from sal_height.sensor import Sensor
from sal_height.simulation.flight import flight_of
from sal_height.simulation.preset import TargetSettings, load_preset

TIMEOUT_S = 120.0
START_NS = 1_700_000_000_123_456_789
RADIAL, EAST, NORTH, HEIGHT = 8.003, 0.1, 0.5, 0.8


@cache
def flown(cols: int = 48) -> tuple[Sensor, tuple[tuple[ComplexImage, ...], ...]]:
    """Five dwells over the street with a car, as sar_compression publishes them."""
    car = TargetSettings(EAST, NORTH, HEIGHT, 30.0, radial_velocity_mps=RADIAL)
    flight = flight_of(replace(load_preset("small"), dwells=5, targets=(car,)), seed=0)
    sensor, dwells = flight.sensor, []
    for number in range(flight.dwells):
        slc = Compressor().add(
            flight.phase_history(number), flight.track(number), sensor, ImageSettings(rows=46, cols=cols)
        )
        assert slc is not None
        frame = ComplexImage(dwell=number)
        frame.header.stamp = messages.to_stamp(START_NS + flight.dwell_start_ns(number))
        values = {**dict(ImageSettings(rows=46, cols=cols)), **messages.autofocus_values(slc)}
        provenance = Provenance(
            config_hash=sensor.config_hash, parameters=messages.with_stage([], "sar_compression", values)
        )
        dwells.append(tuple(messages.slc_to_messages(slc, frame, provenance)))
    return sensor, tuple(dwells)


class Fed:
    """The node, what feeds it, and the clouds that it has published."""

    def __init__(self, graph: Graph, timeout_s: float) -> None:
        """Start the node, which tells the last dwells after so long."""
        overrides = [Parameter("timeout_s", value=timeout_s)]
        self.graph = graph
        self.node = graph.add(PROCESSING["mover_detection"](context=graph.context, parameter_overrides=overrides))
        self.clouds: list[PointCloud2] = []
        feeder = graph.add(Node("feeder", context=graph.context))
        subscribe(feeder, PointCloud2, "movers", self.clouds.append, FRAMES_QOS)
        self._info = publisher_of(feeder, SensorInfo, "sensor_info", LATCHED_QOS)
        self._images = publisher_of(feeder, ComplexImage, "slc", FRAMES_QOS)
        self.wait(lambda: self._images.get_subscription_count() == 1 and feeder.count_publishers("movers") == 1)

    def wait(self, predicate: Callable[[], bool]) -> None:
        assert self.graph.spin_until(predicate, TIMEOUT_S), (len(self.clouds), self.node.tally.summary())

    def publish(self, sensor: Sensor, dwells: Sequence[Sequence[ComplexImage]]) -> None:
        self._info.publish(messages.sensor_to_message(sensor, messages.to_stamp(START_NS)))
        for image in (image for dwell in dwells for image in dwell):
            self._images.publish(image)


def points_of(cloud: PointCloud2) -> list[dict[str, float]]:
    names = [entry.name for entry in cloud.fields]
    values = np.frombuffer(bytes(cloud.data), np.float32).reshape(cloud.width, len(names))
    return [dict(zip(names, map(float, row), strict=True)) for row in values]


def test_a_car_comes_out_with_place_height_and_speed_and_twice_the_same(graph: Graph) -> None:
    """A cloud for each dwell, also for those without movers; the last ones when no more have come for a while."""
    sensor, dwells = flown()
    fed = Fed(graph, timeout_s=1.0)
    fed.publish(sensor, dwells)
    fed.wait(lambda: len(fed.clouds) == 5)
    assert [cloud.width for cloud in fed.clouds] == [0, 0, 1, 0, 0]
    for cloud, dwell in zip(fed.clouds, dwells, strict=True):
        assert (cloud.header.frame_id, cloud.header.stamp) == ("map", dwell[0].header.stamp)
    (one,) = points_of(fed.clouds[2])
    assert (one["x"], one["y"], one["height"]) == pytest.approx((EAST, NORTH, HEIGHT), abs=0.03)
    assert one["z"] == pytest.approx(HEIGHT, abs=0.03)
    assert abs(one["walk_velocity"] - RADIAL) < 4 * one["walk_sigma"] < 1.0
    assert 0 < one["sigma"] < 0.05
    assert one["walks"] == 1.0
    fed.wait(lambda: fed.node.tally.summary()["out"] == 5)
    fed.node.forget()
    fed.publish(sensor, [[shifted(image) for image in dwell] for dwell in dwells])
    fed.wait(lambda: len(fed.clouds) == 10)
    assert [bytes(cloud.data) for cloud in fed.clouds[5:]] == [bytes(cloud.data) for cloud in fed.clouds[:5]]


def test_dwells_that_a_reset_leaves_untold_are_counted(graph: Graph) -> None:
    sensor, dwells = flown()
    fed = Fed(graph, timeout_s=3600.0)
    fed.publish(sensor, dwells)
    fed.wait(lambda: fed.node.tally.summary()["processed"] == 5 * sensor.detector_count)
    untold = len(dwells) - len(fed.clouds)
    assert untold > 0
    fed.node.forget()
    fed.wait(lambda: fed.node.tally.summary().get("ignored.reset") == untold)
    assert_one_sentence(fed.node.last_rejection.partition(": ")[2], "reset before the movers of a dwell were published")


def shifted(image: ComplexImage) -> ComplexImage:
    """The image 1024 s later, so that times of dwells are apart by the very same float64."""
    later = copy.deepcopy(image)
    later.header.stamp.sec += 1024
    later.dwell += 100
    return later


def test_what_tells_no_movers_is_counted_with_a_sentence(graph: Graph) -> None:
    """Images without all Doppler frequencies are dropped; a dwell by itself is ignored."""
    sensor, narrow = flown(cols=12)
    fed = Fed(graph, timeout_s=0.5)
    fed.publish(sensor, narrow[:1])
    fed.wait(lambda: fed.node.tally.summary().get("dropped.Doppler of images") == sensor.detector_count)
    assert_one_sentence(fed.node.last_rejection.partition(": ")[2], "12 columns", "48 columns", "cols")
    fed.publish(sensor, flown()[1][2:3])
    fed.wait(lambda: fed.node.tally.summary().get("ignored.no overlap") == 1)
    assert_one_sentence(fed.node.last_rejection.partition(": ")[2], "Dwell 2", "overlaps with none")
    assert not fed.clouds
