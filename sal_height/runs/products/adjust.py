"""`sal-height adjust`: navigation and mounting from dwells that overlap, and a bag with the corrected trajectory."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sal_height import messages
from sal_height.adjustment import (
    AdjustmentSettings,
    ObservedDwell,
    References,
    adjust,
    corrected_states,
)
from sal_height.bag.copies import kept_packing
from sal_height.bag.described import sensors_of
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import CALIBRATION_TYPE, FIX_TYPE, FRAME_TYPE, ODOMETRY_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.elevation import ESTIMATORS
from sal_height.engine.flight_adjuster import SAYS_NOTHING
from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import Images
from sal_height.engine.results import DwellKey, Loss, Product
from sal_height.errors import Rejected, UserError
from sal_height.geometry import PlatformState
from sal_height.graph.catalogue import NodeParameters, check_estimator, parameters_of, suited
from sal_height.graph.reporting import PARAMETERS, reporting
from sal_height.imaging import correct_track
from sal_height.io import bag_name, new_folder, writing
from sal_height.runs.chain.chain_runs import COMPRESSION, BagRun, only_sensor, plan
from sal_height.runs.chain.entry import Part
from sal_height.runs.chain.replay_parameters import ReplayPlan
from sal_height.runs.products.adjustment_report import draw_adjustment, summary_of
from sal_height.topics import ODOMETRY

ADJUSTED_FROM = "adjusted_from"
"""Name of the bag that was adjusted in the custom data of a new one."""

COPIED = {FRAME_TYPE, SENSOR_TYPE, CALIBRATION_TYPE, FIX_TYPE, *messages.AIR_TYPES}

KNOWN = {"boresight_sigma_rad": 0.0, "lever_arm_sigma_m": 0.0, "odometry_delay_sigma_s": 0.0}
"""Parameters of the compression whose errors the covariance of the corrected odometry contains."""


def adjust_bag(
    bag: Path,
    out: Path,
    estimator: str,
    given: NodeParameters,
    wanted: Mapping[str, Any],
    references: References,
    jobs: int,
) -> tuple[dict[str, Any], list[str]]:
    """Adjust the dwells of a bag to each other; leaves report.json, adjustment.png and a new bag in `out`.

    Args:
        bag: folder of the recorded bag, or its .mcap file.
        out: folder; must be new or empty.
        estimator: estimator whose heights are compared.
        given: parameters of nodes that replace recorded ones.
        wanted: settings of the adjustment by name; of the mounting and the delay those that the bag's compression had.
        references: known ground.
        jobs: dwells that are processed side by side.

    Returns:
        The numbers of the report, and warnings on what could not be done.

    Raises:
        UserError: the bag cannot be used, no dwell of it can be adjusted, or a parameter or a setting is not allowed.
    """
    sensors = list(sensors_of(Part().open(bag))[0].values())
    if not any(map(suited, sensors)):
        raise UserError(
            f"Bag {bag} is of a sensor with one detector, whose dwells have no heights to compare; adjust needs two or "
            "more."
        )
    for sensor in sensors:
        check_estimator(estimator, sensor)
    scheme = plan(bag, given, (estimator,))
    compression = scheme.values.get(COMPRESSION, {})
    stated = {name: compression[name] for name in KNOWN if compression.get(name) not in SAYS_NOTHING}
    settings = AdjustmentSettings(**{**stated, **wanted}).described(next(iter(sensors)))
    folder = new_folder(out)
    with reporting(folder, {"bag": bag.name, "settings": settings.model_dump()}) as report:
        reader = scheme.reader
        run = BagRun(scheme, [COMPRESSION, ESTIMATORS[estimator].node], jobs=jobs)
        mounting = only_sensor(run).mounting
        dwells = sorted(_observe(run, estimator), key=lambda dwell: dwell.seconds)
        left_out = run.losses.described(len(scheme.frames))
        report |= {"dwells": len(dwells), **run.losses.counts()}
        if not dwells:
            why = " ".join(left_out or ["No dwell could be compressed."])
            raise UserError(f"Bag {bag} has no dwell that can be adjusted. {why}")
        adjustment = adjust(dwells, mounting, settings, references)
        summary, sentences = summary_of(adjustment, dwells, mounting, settings, references)
        warnings = [*scheme.warnings, *left_out, *sentences]
        report |= {**summary, "warnings": warnings}
        with writing(folder / "adjustment.png"):
            draw_adjustment(adjustment, folder / "adjustment.png")

        def corrected(states: Sequence[PlatformState]) -> list[PlatformState]:
            seconds = [(state.stamp_ns - scheme.epoch_ns) * 1e-9 for state in states]
            return corrected_states(states, seconds, adjustment, mounting, settings)

        if adjustment.comparisons:
            odometry = _corrected_odometry(scheme, reader, corrected)
            known = {**KNOWN, "map_axes": "enu", "body_axes": "flu"}
        else:
            odometry, known = None, {}
        custom = {PARAMETERS: json.dumps({**scheme.values, COMPRESSION: {**compression, **known}})}
        _write(reader, folder / "bag", {**custom, ADJUSTED_FROM: bag_name(bag)}, odometry)
    return summary, warnings


def _observe(run: BagRun, estimator: str) -> Iterator[ObservedDwell]:
    """The dwells of a bag with heights of an estimator."""
    node, images = ESTIMATORS[estimator].node, dict[DwellKey, Images]()
    for made in run.results("dwells"):
        if not isinstance(made.result, Product):
            continue
        item = made.result.item
        if isinstance(item, Images):
            images[item.key] = item
        elif isinstance(item, Heights) and (source := images.pop(item.key).source) is not None:
            settings = source.settings
            track = correct_track(settings.assumed_track(source.states), settings)
            try:
                yield ObservedDwell.of(item.field, source.slc, source.sensor, track, source.pulses, run.scheme.epoch_ns)
            except Rejected as few:
                run.losses.add(node, Loss(item.key, 0, few.reason, str(few)))


def _corrected_odometry(
    scheme: ReplayPlan, reader: BagReader, corrected: Callable[[Sequence[PlatformState]], list[PlatformState]]
) -> Iterator[bytes | None]:
    """The samples of the odometry in the order of the bag, serialized; None: one that cannot be used."""
    frames = parameters_of(COMPRESSION, scheme.values.get(COMPRESSION, {})).frames
    states: list[PlatformState | None] = []
    for recorded in reader.messages([f"/{ODOMETRY}"]):
        try:
            states.append(messages.state_from_message(messages.deserialize(recorded.cdr, ODOMETRY_TYPE), frames))
        except (UserError, RuntimeError):  # the compression leaves it out, too
            states.append(None)
    better = iter(corrected([state for state in states if state is not None]))
    for state in states:
        if state is None:
            yield None
        else:
            yield messages.serialize(messages.state_to_message(next(better), messages.to_stamp(state.stamp_ns), frames))


def _write(
    reader: BagReader, folder: Path, custom_data: Mapping[str, str], odometry: Iterator[bytes | None] | None
) -> None:
    """Write a bag with what the sensor delivered, and another odometry; None: the same.

    Raises:
        UserError: it cannot be written.
    """
    copied = [topic for topic in reader.topics.values() if topic.type_name in COPIED and topic.count]
    with BagWriter(folder, {**reader.custom_data, **custom_data}, kept_packing(reader)) as bag:
        for topic in [*copied, reader.topics[f"/{ODOMETRY}"]]:
            bag.add_topic(topic.name, topic.type_name, topic.offered_qos)
        names = [topic.name for topic in copied]
        for recorded in reader.messages([*names, f"/{ODOMETRY}"]):
            cdr: bytes | None = recorded.cdr
            if recorded.topic == f"/{ODOMETRY}" and odometry:
                cdr = next(odometry)
            if cdr is not None:
                bag.write(recorded.topic, cdr, recorded.log_time_ns, recorded.publish_time_ns)
