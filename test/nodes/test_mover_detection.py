"""Stage mover_detection: from images to points, counted, and the same when it is done again."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import assert_one_sentence
from stage_graph import StageGraph

from sal_height import messages
from sal_height.imaging import ImageSettings
from sal_height.messages.types import ComplexImage, PointCloud2, Provenance
from sal_height.pipeline import Compressor
from sal_height.sensor import Sensor
from sal_height.simulation.flight import flight_of
from sal_height.simulation.preset import TargetSettings, load_preset

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
            flight.phase_history(number), flight.track(number), sensor, ImageSettings(air="none", rows=46, cols=cols)
        )
        assert slc is not None
        frame = ComplexImage(dwell=number)
        frame.header.stamp = messages.to_stamp(START_NS + flight.dwell_start_ns(number))
        values = {**dict(ImageSettings(air="none", rows=46, cols=cols)), **messages.autofocus_values(slc)}
        provenance = Provenance(
            config_hash=sensor.config_hash, parameters=messages.with_stage([], "sar_compression", values)
        )
        dwells.append(tuple(messages.slc_to_messages(slc, frame, provenance)))
    return sensor, tuple(dwells)


class Fed:
    """The stage, and the clouds that it has published."""

    def __init__(self, timeout_s: float) -> None:
        """Start the stage, which publishes the last dwells after this time."""
        self.graph = StageGraph()
        self.stage = self.graph.add("mover_detection", timeout_s=timeout_s)
        self.clouds: list[PointCloud2] = self.graph.heard["movers"]

    def publish(self, sensor: Sensor, dwells: Sequence[Sequence[ComplexImage]]) -> None:
        self.graph.publish("sensor_info", messages.sensor_to_message(sensor, messages.to_stamp(START_NS)))
        for images in dwells:
            self.graph.publish("slc", *images)


def points_of(cloud: PointCloud2) -> list[dict[str, float]]:
    names = [entry.name for entry in cloud.fields]
    values = np.frombuffer(bytes(cloud.data), np.float32).reshape(cloud.width, len(names))
    return [dict(zip(names, map(float, row), strict=True)) for row in values]


def test_a_car_comes_out_with_place_height_and_speed_and_twice_the_same() -> None:
    """A cloud for each dwell, also for those without movers; the last ones when no more have come for a while."""
    sensor, dwells = flown()
    fed = Fed(timeout_s=1.0)
    fed.publish(sensor, dwells)
    fed.graph.wait(lambda: len(fed.clouds) == 5, "the clouds")
    assert [cloud.width for cloud in fed.clouds] == [0, 0, 1, 0, 0]
    for cloud, dwell in zip(fed.clouds, dwells, strict=True):
        assert (cloud.header.frame_id, cloud.header.stamp) == ("map", dwell[0].header.stamp)
    (one,) = points_of(fed.clouds[2])
    assert (one["x"], one["y"], one["height"]) == pytest.approx((EAST, NORTH, HEIGHT), abs=0.03)
    assert one["z"] == pytest.approx(HEIGHT, abs=0.03)
    assert abs(one["walk_velocity"] - RADIAL) < 4 * one["walk_sigma"] < 1.0
    assert 0 < one["sigma"] < 0.05
    assert one["walks"] == 1.0
    assert fed.stage.summary()["mover candidates"] > 1
    fed.stage.forget()
    fed.publish(sensor, [[shifted(image) for image in dwell] for dwell in dwells])
    fed.graph.wait(lambda: len(fed.clouds) == 10, "the clouds")
    assert [bytes(cloud.data) for cloud in fed.clouds[5:]] == [bytes(cloud.data) for cloud in fed.clouds[:5]]


def test_dwells_that_a_reset_leaves_untold_are_counted() -> None:
    sensor, dwells = flown()
    fed = Fed(timeout_s=3600.0)
    fed.publish(sensor, dwells)
    assert fed.stage.summary()["processed"] == 5 * sensor.detector_count
    untold = len(dwells) - len(fed.clouds)
    assert untold > 0
    fed.stage.forget()
    assert fed.stage.counted("ignored.") == {"reset": untold}
    assert_one_sentence(
        fed.stage.last_rejection.partition(": ")[2], "reset before the movers of a dwell were published"
    )


def shifted(image: ComplexImage) -> ComplexImage:
    """The image 1024 s later, so that times of dwells are apart by the very same float64."""
    later = copy.deepcopy(image)
    later.header.stamp.sec += 1024
    later.dwell += 100
    return later


def test_what_tells_no_movers_is_counted_with_a_sentence() -> None:
    """Images without all Doppler frequencies are dropped; a dwell by itself is ignored."""
    sensor, narrow = flown(cols=12)
    fed = Fed(timeout_s=0.5)
    fed.publish(sensor, narrow[:1])
    assert fed.stage.counted("dropped.") == {"Doppler of images": sensor.detector_count}
    assert_one_sentence(fed.stage.last_rejection.partition(": ")[2], "12 columns", "48 columns", "cols")
    fed.publish(sensor, flown()[1][2:3])
    fed.graph.wait(lambda: fed.stage.counted("ignored.") == {"no overlap": 1}, "the count")
    assert_one_sentence(fed.stage.last_rejection.partition(": ")[2], "Dwell 2", "overlaps with none")
    assert not fed.clouds
