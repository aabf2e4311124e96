"""`sal-height adjust`: navigation and mounting from dwells that overlap, and a bag with the corrected trajectory."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from tqdm import tqdm

from sal_height import messages
from sal_height.adjustment import (
    UNKNOWN_GROUND,
    Adjustment,
    AdjustmentSettings,
    ObservedDwell,
    Points,
    References,
    Stated,
    adjust,
    corrected_states,
)
from sal_height.bag.copies import kept_packing
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import CALIBRATION_TYPE, FIX_TYPE, FRAME_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.elevation import ESTIMATORS
from sal_height.errors import Rejected, UserError
from sal_height.geometry import PlatformState, Trajectory
from sal_height.imaging import correct_track
from sal_height.io import bag_name, new_folder, writing
from sal_height.pipeline import heights
from sal_height.runs.adjustment_picture import draw_adjustment
from sal_height.runs.adjustment_report import summary_of
from sal_height.runs.campaign import Case, plan
from sal_height.runs.catalogue import NodeParameters
from sal_height.runs.recorded_dwells import (
    COMPRESSION,
    FRAME_TOPIC,
    ODOMETRY_TOPIC,
    Compressed,
    Losses,
    RecordedDwells,
    Work,
)
from sal_height.runs.reporting import PARAMETERS, reporting
from sal_height.sensor import Sensor

ADJUSTED_FROM = "adjusted_from"
"""Name of the bag that was adjusted in the custom data of a new one."""

COPIED = {FRAME_TYPE, SENSOR_TYPE, CALIBRATION_TYPE, FIX_TYPE}

KNOWN = {"boresight_sigma_rad": 0.0, "lever_arm_sigma_m": 0.0, "odometry_delay_sigma_s": 0.0}
"""Parameters of the compression whose errors the covariance of the corrected odometry contains."""

LEAST_POINTS = 20
"""Points of a dwell that can be compared with others."""

MOST_DWELLS = 1_000_000


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What became of a bag.

    Attributes:
        summary: what the report says.
        warnings: sentences on what could not be done.
        bag: the new one.
    """

    summary: dict[str, Any]
    warnings: list[str]
    bag: Path


def adjust_bag(
    bag: Path,
    out: Path,
    estimator: str = "ml",
    given: NodeParameters | None = None,
    wanted: Mapping[str, Any] | None = None,
    references: References = UNKNOWN_GROUND,
) -> Adjusted:
    """Adjust the dwells of a bag to each other; leaves report.json, adjustment.png and a new bag in `out`.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        estimator: whose heights are compared.
        given: parameters of nodes that replace recorded ones.
        wanted: settings of the adjustment by name; of the mounting and the delay those that the bag's compression had.
        references: known ground.

    Raises:
        UserError: the bag cannot be used, or a parameter or a setting is not allowed.
    """
    scheme = plan(Case(bag, out, {}, given or {}, (estimator,)), MOST_DWELLS)
    compression = scheme.parameters.get(COMPRESSION, {})
    stated = {name: compression[name] for name in KNOWN if compression.get(name)}
    settings = AdjustmentSettings(**{**stated, **(wanted or {})})
    folder = new_folder(out)
    with reporting(folder, {"bag": bag.name, "settings": settings.model_dump()}) as report:
        work = scheme.works[0]
        dwells, sensor, losses = _observed(work, estimator)
        report |= {"dwells": len(dwells), "dropped": losses.dropped}
        adjustment = adjust(dwells, sensor.mounting, settings, references)
        summary, warnings = summary_of(adjustment, dwells, sensor.mounting, settings, references)
        warnings = [*scheme.warnings, *losses.sentences.values(), *warnings]
        report |= {**summary, "warnings": warnings}
        with writing(folder / "adjustment.png"):
            draw_adjustment(adjustment, folder / "adjustment.png")
        corrections = _Corrections(adjustment, sensor, settings, work) if adjustment.comparisons else None
        known = {**KNOWN, "map_axes": "enu", "body_axes": "flu"} if corrections else {}
        parameters = {**scheme.parameters, COMPRESSION: {**compression, **known}}
        _write(work, folder / "bag", parameters, corrections)
    return Adjusted(summary, warnings, folder / "bag")


class _Observing(RecordedDwells):
    """The dwells of a bag as an adjustment takes them."""

    def __init__(self, work: Work, reader: BagReader, estimator: str) -> None:
        """Take the heights of an estimator; raises as its base."""
        super().__init__(work, reader)
        self._estimator = ESTIMATORS[estimator]
        self.dwells: list[ObservedDwell] = []
        self.sensor: Sensor | None = None
        self._epoch_ns = 0

    def made(self, compressed: Compressed) -> None:
        """Make the heights of a dwell, and keep their points."""
        if self.sensor is None:
            self.sensor, self._epoch_ns = compressed.sensor, epoch_of(self.work)
        try:
            self.dwells.append(self._observed(compressed))
        except UserError as error:
            self.losses.drop(self._estimator.node, error)

    def _observed(self, compressed: Compressed) -> ObservedDwell:
        slc, sensor, frames = compressed.slc, compressed.sensor, compressed.frames
        if sensor.mode != "spotlight":
            raise UserError(f"Sensor {sensor.name} is of mode {sensor.mode}; dwells are adjusted in spotlight only.")
        if self.sensor is not None and sensor.config_hash != self.sensor.config_hash:
            raise Rejected("another sensor", f"A dwell is of sensor {sensor.name}; all must be of {self.sensor.name}.")
        parameters = self.in_force.of(self._estimator.node)
        field = heights(slc, sensor, self._estimator, parameters, compressed.calibration)
        points = Points.of(field)
        if len(points.place) < LEAST_POINTS:
            raise Rejected("few heights", f"A dwell has {len(points.place)} heights; {LEAST_POINTS} are needed.")
        settings = self.in_force.of(COMPRESSION)
        track = correct_track(Trajectory(compressed.supplies.states, motion=settings.motion), settings)
        history = messages.history_from_messages(frames)
        middle = history.pulse_times[:1] + np.ptp(history.pulse_times) * np.array([0.49, 0.51])
        stated = Stated(
            (history.stamp_ns - self._epoch_ns) * 1e-9 + float(np.mean(history.pulse_times)),
            track.aperture(history.stamp_ns, middle).covariance,
            track.velocity_covariance(history.stamp_ns, middle),
        )
        ambiguity = sensor.wavelength * sensor.pulse_repetition_frequency / 2
        beams = sensor.beams.axis_middle
        return ObservedDwell(points, slc.aperture, slc.placement, stated, beams, sensor.look_side, ambiguity)


def epoch_of(work: Work) -> int:
    """The time from which the seconds of an adjustment count, ns."""
    return min(dwell.stamp_ns for dwell in work.dwells)


def _observed(work: Work, estimator: str) -> tuple[list[ObservedDwell], Sensor, Losses]:
    """The dwells of a bag in the order of time.

    Raises:
        UserError: there is none.
    """
    reader = NamespacedReader(work.bag, work.namespace)
    observing = _Observing(work, reader, estimator)
    count = sum(reader.topics[topic].count for topic in (ODOMETRY_TOPIC, FRAME_TOPIC) if topic in reader.topics)
    for recorded in tqdm(reader.messages([ODOMETRY_TOPIC, FRAME_TOPIC]), total=count, unit="message", desc="heights"):
        observing.take(recorded)
    observing.end()
    if not observing.dwells or observing.sensor is None:
        why = next(iter(observing.losses.sentences.values()), "No dwell could be compressed.")
        raise UserError(f"Bag {work.bag} has no dwell that can be adjusted. {why}")
    return sorted(observing.dwells, key=lambda dwell: dwell.seconds), observing.sensor, observing.losses


@dataclass(frozen=True, eq=False)
class _Corrections:
    """What makes the corrected odometry of a bag."""

    adjustment: Adjustment
    sensor: Sensor
    settings: AdjustmentSettings
    work: Work

    def applied(self, states: Sequence[PlatformState]) -> list[PlatformState]:
        """The states without their errors."""
        epoch_ns = epoch_of(self.work)
        seconds = [(state.stamp_ns - epoch_ns) * 1e-9 for state in states]
        return corrected_states(states, seconds, self.adjustment, self.sensor.mounting, self.settings)


def _corrected_odometry(work: Work, reader: BagReader, corrections: _Corrections) -> Iterator[bytes | None]:
    """The samples of the odometry in the order of the bag, serialized; None: one that cannot be used."""
    frames = RecordedDwells(work, reader).in_force.of(COMPRESSION).frames
    states: list[PlatformState | None] = []
    for recorded in reader.messages([ODOMETRY_TOPIC]):
        try:
            states.append(messages.state_of_pose(messages.received_pose(recorded.cdr), frames))
        except (UserError, RuntimeError):  # the compression leaves it out, too
            states.append(None)
    usable = sorted((state for state in states if state is not None), key=lambda state: state.stamp_ns)
    better = dict(zip(map(id, usable), corrections.applied(usable), strict=True))
    for state in states:
        if state is None:
            yield None
            continue
        new = better[id(state)]
        yield serialize_message(messages.state_to_message(new, messages.to_stamp(new.stamp_ns), frames))


def _write(work: Work, folder: Path, parameters: NodeParameters, corrections: _Corrections | None) -> None:
    """Write a bag with what the sensor delivered, and the odometry with corrections, if there are any.

    Raises:
        UserError: it cannot be written.
    """
    reader = NamespacedReader(work.bag, work.namespace)
    corrected = _corrected_odometry(work, reader, corrections) if corrections else None
    custom = {**reader.custom_data, PARAMETERS: json.dumps(parameters), ADJUSTED_FROM: bag_name(work.bag)}
    copied = [topic for topic in reader.topics.values() if topic.type_name in COPIED and topic.count]
    with BagWriter(folder, custom, kept_packing(reader)) as bag:
        for topic in [*copied, reader.topics[ODOMETRY_TOPIC]]:
            bag.add_topic(topic.name, topic.type_name, topic.offered_qos)
        names = [topic.name for topic in copied]
        for recorded in reader.messages([*names, ODOMETRY_TOPIC]):
            cdr: bytes | None = recorded.cdr
            if recorded.topic == ODOMETRY_TOPIC and corrected:
                cdr = next(corrected)
            if cdr is not None:
                bag.write(recorded.topic, cdr, recorded.log_time_ns, recorded.publish_time_ns)
