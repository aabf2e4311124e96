"""A dwell as it flies: a few hundred pixels must not cost more than their share of a large image, nor their node.

All rows compare with the core at a large size, measured in the same run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from rclpy.parameter import Parameter

from benchmarks.row import REPEATS, Row, load, medians, sized
from benchmarks.sizes import APERTURE, COLS, PRESET, ROWS, heights_of_street, lidar, made_up_dwell, tiled
from benchmarks.stage_jobs import job_of, read_items
from sal_height import messages
from sal_height.elevation import ESTIMATORS, ElevationEstimator, HeightSettings
from sal_height.imaging import ImageSettings, Slc
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, Header, Provenance
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.pipeline import Compressor, heights
from sal_height.relief import PriorEstimate, ReliefMap, track
from sal_height.relief.map import fitting_cell_size
from sal_height.sensor import Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

CASES = ((PRESET, "ml"), (PRESET, "monopulse"), ("xband_sumdiff", "sum_difference"))
"""Presets and estimators."""

PIXELS = sized(1_000_000, 2000)
"""Height pixels of a large image, about."""

LARGER = sized(8, 2)
"""The large phase history has this many times the pulses, samples, rows and columns of a dwell."""

LARGE_REPEATS = sized(3, 1)
"""Number of times that what is large is timed."""

MARGIN, REST = 1.5, 1e-3
"""Factor on its fraction of a large image that a dwell may take, and additional time, s."""

FRAME = ChannelFrame(header=Header(stamp=messages.to_stamp(0), frame_id=messages.MAP_FRAME))


@dataclass(frozen=True)
class Large:
    """Time of the core for something large.

    Attributes:
        what: name in the results.
        per_pixel_s: time for a pixel, s.
    """

    what: str
    per_pixel_s: float

    def row(self, name: str, seconds: float, pixels: float, note: str = "") -> Row:
        """Time (s) of a dwell of that number of pixels over what is allowed by that of a large one."""
        allowed = MARGIN * self.per_pixel_s * pixels + REST
        return Row(
            name,
            seconds / allowed,
            "1",
            "<= 1",
            f"{seconds * 1e3:.2f} ms{note}; {MARGIN:g} times its share of {self.what} and {REST * 1e3:g} ms are "
            f"{allowed * 1e3:.2f} ms; {load()}",
        )


def against_large_images() -> Iterator[Row]:
    """Time of one dwell, in its node and in the core, over what is allowed by the core's time for a large one."""
    flights = {name: flight_of(replace(load_preset(name), dwells=1), seed=1) for name in {name for name, _ in CASES}}
    with Graph() as graph:
        for name, estimator in CASES:
            yield from _heights(graph, flights[name], estimator)
        yield _compression(graph, flights[PRESET])
        yield from _tracker_and_mapper(graph)


def _heights(graph: Graph, flight: SimulatedFlight, name: str) -> Iterator[Row]:
    estimator, preset = ESTIMATORS[name], load_preset(flight.sensor.name)
    looks = dict(zip(("range_looks", "azimuth_looks"), preset.looks, strict=True))
    settings = estimator.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
    slc = _images(flight)
    pixels = slc.images[0].size // (preset.looks[0] * preset.looks[1])
    allowed = _large_heights(slc, flight.sensor, estimator, settings, pixels)
    node = graph.add(PROCESSING[estimator.node](context=graph.context, parameter_overrides=_overrides(looks)))
    provenance = Provenance(config_hash=flight.sensor.config_hash)
    sent = [serialize(image) for image in messages.slc_to_messages(slc, FRAME, provenance)]
    job = job_of(node, [("sensor_info", _described(flight.sensor)), *(("slc", cdr) for cdr in sent)])
    worked, alone, taken = medians(
        lambda: node._process_job(job),
        lambda: heights(slc, flight.sensor, estimator, settings),
        lambda: read_items(node, "slc", sent),
    )
    yield allowed.row(f"node {estimator.node}, {flight.sensor.name} dwell", worked + taken, pixels, _with(taken))
    yield allowed.row(f"{name}, one dwell of {flight.sensor.name}", alone, pixels)


def _large_heights(
    slc: Slc, sensor: Sensor, estimator: ElevationEstimator, settings: HeightSettings, pixels: int
) -> Large:
    """Time of the heights of an image that consists of many of `pixels` height pixels, side by side."""
    tiles = max(1, round(np.sqrt(PIXELS / pixels)))
    large, wide = tiled(slc, sensor, tiles, tiles)
    (seconds,) = medians(lambda: heights(large, wide, estimator, settings), repeats=LARGE_REPEATS)
    return Large(f"an image of {pixels * tiles**2:.2g} pixels", seconds / (pixels * tiles**2))


def _compression(graph: Graph, flight: SimulatedFlight) -> Row:
    preset = load_preset(flight.sensor.name)
    image = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
    sensor = lidar(
        flight.sensor.detector_count, LARGER * preset.sensor.pulse_count, LARGER * preset.sensor.sample_count
    )
    large = made_up_dwell(sensor, LARGER * image.rows, LARGER * image.cols)
    (large_time,) = medians(large.compress, repeats=LARGE_REPEATS)
    pixels = image.rows * image.cols
    what = f"{LARGER**2 * pixels:.2g} pixels of {LARGER} times the pulses and samples"
    allowed = Large(what, large_time / (LARGER**2 * pixels))
    node = graph.add(PROCESSING["sar_compression"](context=graph.context, parameter_overrides=_overrides(_size(image))))
    states, history = flight.platform_states(0), flight.phase_history(0)
    frames = messages.history_to_messages(history, flight.sensor, 0, messages.to_stamp(history.stamp_ns))
    sent = [serialize(frame) for frame in frames]
    flown = [serialize(messages.state_to_message(state, messages.to_stamp(state.stamp_ns))) for state in states]
    job = job_of(
        node,
        [
            ("sensor_info", _described(flight.sensor)),
            *(("platform/odometry", cdr) for cdr in flown),
            *(("phase_history", cdr) for cdr in sent),
        ],
    )
    worked, taken = medians(lambda: node._process_job(job), lambda: read_items(node, "phase_history", sent))
    return allowed.row(f"node sar_compression, {preset.name} dwell", worked + taken, pixels, _with(taken))


def _tracker_and_mapper(graph: Graph) -> Iterator[Row]:
    rng, side = np.random.default_rng(1), round(np.sqrt(PIXELS))
    field, large = heights_of_street(ROWS // 2, COLS // 2, 0, rng), heights_of_street(side, side, 0, rng)
    relief_map = ReliefMap(fitting_cell_size(large.grid, APERTURE), 10**7)
    track_time, map_time = medians(
        lambda: track(large, APERTURE, PriorEstimate()), lambda: relief_map.add(large), repeats=LARGE_REPEATS
    )
    what, pixels = f"an image of {side * side:.2g} pixels", field.validity.size
    sent = serialize(messages.height_to_message(field, APERTURE, (2, 2), "ml", FRAME, Provenance()))
    for name, large_time in (("relief_tracker", track_time), ("relief_mapper", map_time)):
        node = graph.add(PROCESSING[name](context=graph.context))
        job = job_of(node, [("ml/height", sent)])
        worked, taken = medians(
            partial(node._process_job, job), partial(read_items, node, "ml/height", [sent]), repeats=REPEATS
        )
        allowed = Large(what, large_time / side**2)
        yield allowed.row(f"node {name}, {PRESET} dwell", worked + taken, pixels, _with(taken))


def _images(flight: SimulatedFlight) -> Slc:
    preset = load_preset(flight.sensor.name)
    image = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
    slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, image)
    if slc is None:
        raise RuntimeError(f"Preset {preset.name} makes no image of one dwell.")
    return slc


def _size(image: ImageSettings) -> dict[str, int]:
    return {"rows": image.rows, "cols": image.cols}


def _overrides(values: dict[str, int]) -> list[Any]:
    return [Parameter(key, value=value) for key, value in values.items()]


def _described(sensor: Sensor) -> bytes:
    return serialize(messages.sensor_to_message(sensor, messages.to_stamp(0)))


def _with(seconds: float) -> str:
    return f" from the bytes of its messages to published ones, {seconds * 1e3:.2f} ms of it to decode these"
