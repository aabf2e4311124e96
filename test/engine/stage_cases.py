"""All stages, each with the items of a flight that it takes, and other settings that it may be changed to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from example_stage import CoverageStage
from flown_items import (
    SMALL,
    START_NS,
    STRIP,
    Item,
    at,
    flight_items,
    heights_in,
    image_items,
    noise_strip,
    small_flight,
)
from scipy.spatial.transform import Rotation

from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS
from sal_height.engine.adjuster import HeightAdjuster
from sal_height.engine.air import AirSample
from sal_height.engine.calibrations import StatedCalibration
from sal_height.engine.calibrator import PsfCalibration
from sal_height.engine.compression import Compression
from sal_height.engine.frames import PlacedOrigin, StaticTransform
from sal_height.engine.heights import height_stage
from sal_height.engine.mapper import GroundMapper, ReliefMapper
from sal_height.engine.movers import MoverDetection
from sal_height.engine.navigation import NavigationStage, Pose, Twist
from sal_height.engine.stage import Stage
from sal_height.engine.tracker import Tracker
from sal_height.geometry import Origin, Sample
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset
from sal_height.topics import CALIBRATION, MAP_ORIGIN, ODOMETRY, SENSOR_INFO, TF_STATIC

DWELLS = 4


@dataclass(frozen=True)
class Case:
    """A stage and what arrives on its ports.

    Attributes:
        name: of the test.
        kind: class of the stage.
        given: its settings.
        changed: settings to which it may be changed.
        items: what arrives, in the order of a flight.
        makes: number of products that these give in that order; None: not stated.
        rehearses: whether rehearsals are tried, too.
    """

    name: str
    kind: type[Stage]
    items: Callable[[], Sequence[Item]]
    given: Mapping[str, Any] = field(default_factory=dict)
    changed: Mapping[str, Any] = field(default_factory=lambda: {"max_memory_mb": 1000})
    makes: int | None = DWELLS
    rehearses: bool = True

    @property
    def settings(self) -> Any:
        """The settings at the start."""
        return self.kind.settings(**self.given)

    def make(self, **given: Any) -> Stage:
        """A stage."""
        return self.kind(self.settings.changed(**given))

    def counted(self) -> set[str]:
        """Ports whose messages are counted."""
        return {port.name for port in self.kind.inputs(self.settings) if port.counted}

    def __str__(self) -> str:
        return self.name


def calibration_of(sensor: Sensor, gain: float = 1.1, **values: Any) -> Calibration:
    """A calibration that says that a channel is stronger than described."""
    response = np.ones((sensor.detector_count, sensor.sample_count), np.complex128)
    response[1] *= gain
    sigmas = {f"{what}_sigma": np.zeros(sensor.detector_count) for what in ("response", "gain", "phase")}
    return Calibration(sensor.config_hash, **{"response": response, "dwells": 1, **sigmas, **values})


def stated(calibration: Calibration) -> Item:
    """A calibration on its port."""
    return CALIBRATION, StatedCalibration(calibration, START_NS)


def air_items(stamp_ns: int, kelvin: float = 265.65, pascal: float = 65_000.0) -> list[Item]:
    """Of a lidar at 3.5 km, which needs no humidity."""
    return [("air/pressure", AirSample(stamp_ns, pascal)), ("air/temperature", AirSample(stamp_ns, kelvin))]


def transform(
    parent: str, child: str, shift: Sequence[float] = (0.0, 0.0, 0.0), turn: Rotation | None = None
) -> StaticTransform:
    """Where a frame is in another one."""
    return StaticTransform(parent, child, np.array(shift), (turn or Rotation.identity()).as_quat())


@cache
def spotlight() -> Sequence[Item]:
    return flight_items(small_flight(DWELLS))


@cache
def everything_asked_for() -> Sequence[Item]:
    """A flight with air, a transform and a calibration."""
    flight = small_flight(DWELLS)
    others = [*air_items(START_NS - 2_000_000_000), (TF_STATIC, transform("base_link", "sensor", (0.3, 0.0, 0.1)))]
    return [*others, stated(calibration_of(flight.sensor)), *flight_items(flight)]


@cache
def channel_images() -> Sequence[Item]:
    return [stated(calibration_of(small_flight().sensor)), *image_items(small_flight(DWELLS), whole=False, **SMALL)]


@cache
def whole_images() -> Sequence[Item]:
    return image_items(small_flight(DWELLS), whole=True, **SMALL)


@cache
def wide_images() -> Sequence[Item]:
    return image_items(small_flight(DWELLS), whole=False, rows=20, cols=48)


@cache
def unweighted_images() -> Sequence[Item]:
    return image_items(small_flight(DWELLS), whole=False, range_window="rectangular", **SMALL)


@cache
def heights() -> Sequence[Item]:
    return [("ml/height", one) for one in heights_in(small_flight(DWELLS), **SMALL)]


@cache
def heights_and_origin() -> Sequence[Item]:
    return [(MAP_ORIGIN, PlacedOrigin(Origin(0.84, 0.2, 560.0), START_NS, "map")), *heights()]


@cache
def heights_and_odometry() -> Sequence[Item]:
    flight = small_flight(DWELLS)
    odometry = [(ODOMETRY, at(state, START_NS)) for dwell in range(DWELLS) for state in flight.platform_states(dwell)]
    return [(SENSOR_INFO, flight.sensor), *odometry, *heights()]


@cache
def instruments() -> Sequence[Item]:
    """Poses and twists that the odometry of the flight is made of."""
    items: list[Item] = []
    unknown = np.zeros((3, 3))
    for dwell in range(DWELLS):
        for state in small_flight(DWELLS).platform_states(dwell):
            stamp_ns = START_NS + state.stamp_ns
            velocity = Sample(stamp_ns, state.velocity, unknown)
            pose = Pose(Sample(stamp_ns, state.position, unknown), Sample(stamp_ns, state.orientation, unknown))
            items += [("platform/twist", Twist(velocity, in_body=False)), ("platform/pose", pose)]
    return items


@cache
def few_pixels() -> Sequence[Item]:
    return image_items(small_flight(3), whole=False, rows=4, cols=4)


@cache
def sum_and_difference() -> Sequence[Item]:
    return image_items(flight_of(replace(load_preset("xband_sumdiff"), dwells=2), 1), whole=False, **SMALL)


OTHERWISE = {"canopy_ground": (few_pixels, 3), "sum_difference": (sum_and_difference, 2)}
"""Estimators that take long, or that need another sensor: what arrives, and how many products that gives."""

CASES = (
    Case("spotlight", Compression, spotlight, SMALL, {**SMALL, "range_window": "rectangular"}),
    Case("strip", Compression, lambda: flight_items(noise_strip()), STRIP, {**STRIP, "rows": 12}),
    Case(
        "with air, transform and calibration",
        Compression,
        everything_asked_for,
        {**SMALL, "air": "topics", "mounting_from_tf": True, "calibration": "topic"},
        {**SMALL, "air": "none", "mounting_from_tf": True, "calibration": "topic"},
    ),
    *(
        Case(name, height_stage(name), items, {}, {"range_looks": 1}, makes, rehearses=name != "canopy_ground")
        for name in ESTIMATORS
        for items, makes in (OTHERWISE.get(name, (channel_images, DWELLS)),)
    ),
    Case("ml of whole dwells", height_stage("ml"), whole_images, {}, {"range_looks": 1}),
    Case("tracker", Tracker, heights, {}, {"correlation_length_m": 5.0}),
    Case(
        "relief_mapper",
        ReliefMapper,
        heights_and_origin,
        {"period_s": 1.0},
        {"period_s": 1.0, "max_queued_dwells": 3},
        makes=1,
    ),
    Case(
        "ground_mapper",
        GroundMapper,
        heights_and_origin,
        {"period_s": 1.0},
        {"period_s": 1.0, "max_queued_dwells": 3},
        makes=1,
    ),
    Case(
        "map of a known place", ReliefMapper, heights, {"origin_latitude_deg": 48.1, "crs": "EPSG:32632"}, {}, makes=1
    ),
    Case("adjuster", HeightAdjuster, heights_and_odometry, {}, {"correlation_s": 50.0}, makes=None),
    Case("movers", MoverDetection, wide_images, {}, {"prominence_db": 10.0}),
    Case(
        "calibrator",
        PsfCalibration,
        unweighted_images,
        {"dwells": 2, "dwell_step": 1},
        {"dwells": 3, "dwell_step": 1},
        2,
    ),
    Case("navigation", NavigationStage, instruments, {}, {"max_memory_mb": 1000}, makes=None),
    Case("example", CoverageStage, heights, {}),
)
"""Every stage, some in more than one way."""
