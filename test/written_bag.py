"""Bags of messages without samples, in a given order: what a flight says of its making."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter
from sal_height.engine.results import DwellKey
from sal_height.messages import serialize
from sal_height.messages.parameters import parameter_of
from sal_height.messages.types import (
    Calibration,
    ChannelFrame,
    ComplexImage,
    DiagnosticArray,
    DiagnosticStatus,
    DwellLoss,
    HeightImage,
    KeyValue,
    NavSatFix,
    ParameterEvent,
    Provenance,
    SensorInfo,
)

TOPICS = {
    ChannelFrame: "/phase_history",
    ComplexImage: "/slc",
    ParameterEvent: "/parameter_events",
    Calibration: "/calibration",
    SensorInfo: "/sensor_info",
    NavSatFix: "/map_origin",
    DwellLoss: "/losses",
    DiagnosticArray: "/diagnostics",
}


def key(dwell: int) -> DwellKey:
    return DwellKey("", dwell, dwell * 1_000_000_000)


def frame(dwell: int, channel: int = 0) -> ChannelFrame:
    message = ChannelFrame(dwell=dwell, channel=channel)
    message.header.stamp = messages.to_stamp(key(dwell).stamp_ns)
    return message


def heights(dwell: int, calibration: str = "", estimator: str = "ml", **stages: Mapping[str, Any]) -> HeightImage:
    """A height image whose provenance states the parameters of these stages."""
    provenance = Provenance(calibration_id=calibration)
    for name, values in stages.items():
        provenance.parameters = messages.with_stage(provenance.parameters, name, values)
    message = HeightImage(dwell=dwell, estimator=estimator, provenance=provenance)
    message.header.stamp = messages.to_stamp(key(dwell).stamp_ns)
    return message


def told(node: str, **values: Any) -> ParameterEvent:
    """What a node answers, or says at its start."""
    parameters = [parameter_of(name, value) for name, value in values.items()]
    return ParameterEvent(node=f"/{node}", new_parameters=parameters)


def changed(node: str, **values: Any) -> ParameterEvent:
    """What a node says when its parameters are set."""
    return ParameterEvent(node=f"/{node}", changed_parameters=told(node, **values).new_parameters)


def lost(node: str, dwell: int, reason: str, count: int = 0) -> DwellLoss:
    """A node left out a dwell."""
    stamp = messages.to_stamp(key(dwell).stamp_ns)
    return DwellLoss(node=node, of_dwell=True, dwell=dwell, dwell_stamp=stamp, messages=count, reason=reason)


def process(node: str, number: int) -> DiagnosticArray:
    """The account of a node in the process of that number."""
    return DiagnosticArray(status=[DiagnosticStatus(name=node, values=[KeyValue(key="pid", value=str(number))])])


def calibration(name: str, sensor: str = "sensor") -> Calibration:
    return Calibration(id=name, config_hash=sensor)


def written(folder: Path, recorded: Iterable[Any], custom_data: Mapping[str, str] | None = None) -> BagReader:
    """A bag with these messages, one after the other."""
    return written_apart(folder, {"": recorded}, custom_data)


def written_apart(
    folder: Path, recorded: Mapping[str, Iterable[Any]], custom_data: Mapping[str, str] | None = None
) -> BagReader:
    """A bag with these messages in namespaces, such as "/lidar", one after the other."""
    listed = [(space, message) for space, messages_there in recorded.items() for message in messages_there]
    with BagWriter(folder, custom_data or {}) as writer:
        for topic, kind in {(f"{space}{_topic_of(message)}", type(message)) for space, message in listed}:
            writer.add_topic(topic, kind.__msgtype__, [qos.FRAMES])
        for time_ns, (space, message) in enumerate(listed, 1):
            writer.write(f"{space}{_topic_of(message)}", serialize(message), time_ns, time_ns)
    return BagReader(folder)


def _topic_of(message: Any) -> str:
    return f"/{message.estimator}/height" if isinstance(message, HeightImage) else TOPICS[type(message)]
