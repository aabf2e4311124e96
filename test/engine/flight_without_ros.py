"""A flight, and a strip, through all stages: a program that prints how many products each port has."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from flown_items import STRIP, Item, flight_items, history_in, small_flight

from sal_height.elevation import ESTIMATORS
from sal_height.engine.adjuster import HeightAdjuster
from sal_height.engine.calibrator import PsfCalibration
from sal_height.engine.chain import Chain
from sal_height.engine.compression import Compression
from sal_height.engine.heights import height_stage
from sal_height.engine.mapper import GroundMapper, ReliefMapper
from sal_height.engine.movers import MoverDetection
from sal_height.engine.navigation import NavigationStage, Pose, Twist
from sal_height.engine.results import FileProduct, Loss, Product
from sal_height.engine.stage import Rehearsal, Stage
from sal_height.engine.tracker import Tracker
from sal_height.geometry import PlatformState, Sample
from sal_height.simulation import flight_of, load_preset
from sal_height.topics import ODOMETRY

DWELLS = 3
UNKNOWN = np.zeros((3, 3))


def instruments(state: PlatformState) -> list[Item]:
    """What navigation makes the odometry of."""
    velocity = Sample(state.stamp_ns, state.velocity, UNKNOWN)
    place, attitude = (Sample(state.stamp_ns, value, UNKNOWN) for value in (state.position, state.orientation))
    return [("platform/twist", Twist(velocity, in_body=False)), ("platform/pose", Pose(place, attitude))]


def run(kinds: Sequence[tuple[type[Stage], dict[str, Any]]], items: Iterable[Item]) -> Counter[str]:
    """Products by port, files by path, and losses by stage and reason."""
    settings = [kind.settings(**given) for kind, given in kinds]
    chain, found = Chain([kind(values) for (kind, _), values in zip(kinds, settings, strict=True)], settings), Counter()
    for results in (chain.start(), *(chain.feed(*item) for item in items), chain.finish()):
        for made in results:
            if isinstance(made.result, Product):
                found[made.result.port] += 1
            elif isinstance(made.result, FileProduct):
                found[made.result.path] += 1
            elif isinstance(made.result, Loss):
                found[f"{made.stage.name}: {made.result.reason}"] += made.result.messages
    return found


def estimators(*left_out: str) -> list[tuple[type[Stage], dict[str, Any]]]:
    return [(height_stage(name), {}) for name in ESTIMATORS if name not in left_out]


def fly() -> dict[str, dict[str, int]]:
    """The products of a flight with everything, of a sensor with sum and difference, of few pixels, and of a strip."""
    flight = small_flight(DWELLS)
    items: list[Item] = []
    for port, item in flight_items(flight):
        items += instruments(item) if port == ODOMETRY else [(port, item)]
    image = {"rows": 20, "cols": 48, "air": "none", "range_window": "rectangular", "calibration": "topic"}
    after = [
        (Tracker, {}),
        (HeightAdjuster, {}),
        (ReliefMapper, {"file": "map.tif", "origin_latitude_deg": 48.1}),
        (GroundMapper, {"file": "ground.tif"}),
        (MoverDetection, {}),
    ]
    calibration = (PsfCalibration, {"dwells": 2, "dwell_step": 1, "file": "calibration.npz"})
    place = {"origin_latitude_deg": 48.1}
    everything = [
        (NavigationStage, place),
        (Compression, image),
        *estimators("canopy_ground", "sum_difference"),
        *after,
    ]
    pair = flight_of(replace(load_preset("xband_sumdiff"), dwells=2), 1)
    few = [(Compression, {"rows": 4, "cols": 4, "air": "none"}), (height_stage("canopy_ground"), {})]
    rehearse(few[0][0], flight)
    strip = [(Compression, STRIP), *estimators("canopy_ground", "sum_difference"), *after[:4]]
    return {
        "flight": run([*everything, calibration], items),
        "sum and difference": run(
            [(Compression, {"air": "none"}), (height_stage("sum_difference"), {})], flight_items(pair)
        ),
        "few pixels": run(few, flight_items(flight, dwells=range(2))),
        "strip": run(strip, flight_items(flight_of(replace(load_preset("sal_stripmap"), dwells=4), 9))),
    }


def rehearse(kind: type[Stage], flight: Any) -> None:
    """What a host with a worker does before the first dwell."""
    stage = kind(kind.settings())
    jobs = [
        one for one in stage.accept("sensor_info", flight.sensor) if isinstance(getattr(one, "inputs", 0), Rehearsal)
    ]
    assert [*stage.process(jobs)] == [[]]
    assert history_in(flight, 0).stamp_ns == 0


def main() -> None:
    """Print the products."""
    print(json.dumps(fly()))  # noqa: T201 (a program)
