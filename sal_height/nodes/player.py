"""Node player: publishes what a bag holds of a sensor, or the images or heights made of it, dwell by dwell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from sal_height_msgs.msg import Calibration as CalibrationMessage

from sal_height.bag.definitions import message_class
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.topics import HEIGHT_TYPE, SENSOR_TYPE
from sal_height.errors import UserError
from sal_height.nodes.account import CALIBRATIONS
from sal_height.nodes.cues import DwellKey, cues_of_text
from sal_height.nodes.managed import INACTIVE
from sal_height.nodes.played import ALL, LATEST_NS, MOST, SENSOR, Content, DwellRange, chosen, content_of, qos_of
from sal_height.nodes.playlist import SENSOR_INFO
from sal_height.nodes.program import run_node
from sal_height.nodes.reel import Group, Reel
from sal_height.nodes.remote_parameters import RemoteParameters
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import (
    LATCHED_QOS,
    RESET,
    SENSOR_TOPICS,
    Stage,
    StageParameters,
)
from sal_height.settings import setting

CALIBRATION_TOPIC = "calibration"


class Parameters(StageParameters):
    """Parameters of the node."""

    bag: str = setting("", "path of the bag: its folder or its .mcap file", read_only=True)
    topics: tuple[str, ...] = setting(
        SENSOR,
        "topics that are played: those of the sensor, or sensor_info and slc, or heights such as ml/height",
        read_only=True,
    )
    namespace: str = setting(
        "", "namespace that the topics have in the bag, which they are played without; empty: none", read_only=True
    )
    first_dwell: int = setting(0, "number of the first dwell that is played", minimum=0, maximum=MOST, read_only=True)
    last_dwell: int = setting(MOST, "number of the last dwell that is played", minimum=0, maximum=MOST, read_only=True)
    start_ns: int = setting(0, "earliest stamp of the dwells that are played", unit="ns", minimum=0, read_only=True)
    end_ns: int = setting(LATEST_NS, "latest stamp of the dwells that are played", unit="ns", minimum=0, read_only=True)
    cues: str = setting(
        "",
        "what happened in flight, as a replay finds it: a list of dwell, parameters and calibrations in JSON",
        read_only=True,
    )


class Player(Stage):
    """Publishes the recorded bytes of one group of dwells at each call of ~/step.

    The first sensor info comes before that, so that the nodes can get ready for the sensor. A dwell before which
    something happened in flight (`cues`) begins a group; a calibration is published at a step of its own.
    """

    parameters = Parameters
    outputs: ClassVar[Topics] = {**SENSOR_TOPICS, CALIBRATION_TOPIC: "calibrations that the parameter cues names"}
    answers: ClassVar[Topics] = {**RESET, "~/step": "publish the next dwell"}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the bag cannot be used or lacks a topic.
        """
        super().__init__("player", **node_arguments)
        self._others = RemoteParameters(self, ())
        self._announced: BagMessage | None = None
        try:
            self._open()
        except UserError:
            self.destroy_node()
            raise
        self.serve("~/step", self._step)

    def _open(self) -> None:
        """Open the bag, offer what is in it, and publish the first sensor info.

        Raises:
            UserError: the bag cannot be used or lacks a topic.
        """
        path = self.current_parameters().bag
        if not path:
            raise UserError("Parameter bag is empty; it must be the path of a bag.")
        parameters = self.current_parameters()
        self._reader = NamespacedReader(Path(path), parameters.namespace)
        recorded = {name.lstrip("/"): topic for name, topic in self._reader.topics.items()}
        if missing := [name for name in parameters.topics if name not in recorded]:
            raise UserError(
                f"Bag {self._reader.path} has no topic {', '.join(missing)}; needed are {', '.join(parameters.topics)}."
            )
        for name in parameters.topics:  # their bytes go out as they are
            self._reader.check_type(recorded[name].type_name)
        self._outlets = {
            recorded[name].name: self.offer(message_class(recorded[name].type_name), name, qos_of(name))
            for name in parameters.topics
        }
        self._detectors = sum(recorded[name].type_name == HEIGHT_TYPE for name in parameters.topics)
        self._cues = cues_of_text(self.current_parameters().cues)
        self._others = RemoteParameters(self, {name for cue in self._cues.values() for name in cue.parameters})
        self._calibrations = self._named_calibrations()
        self._calibration = self.offer(CalibrationMessage, CALIBRATION_TOPIC, LATCHED_QOS)
        dwells = DwellRange(parameters.first_dwell, parameters.last_dwell, parameters.start_ns, parameters.end_ns)
        played = self._reader.messages(list(self._outlets))
        self._reel = Reel(played if dwells == ALL else chosen(played, dwells))
        self._last_odometry_ns = 0
        if SENSOR_INFO in parameters.topics:
            self._announced = next(self._reader.messages([recorded[SENSOR_INFO].name]), None)
            if self._announced and self._content_of(self._announced):
                self._publish(self._announced)

    @property
    def is_ready(self) -> bool:
        """Whether it has a bag, and nodes whose parameters it is to set can be reached."""
        return self._others.are_ready and super().is_ready

    def _named_calibrations(self) -> dict[str, bytes]:
        """The serialized calibrations that the cues name, by identity.

        Raises:
            UserError: the bag does not hold one of them.
        """
        named = {name for cue in self._cues.values() for name in cue.calibrations}
        if not named:
            return {}
        found = {name: cdr for name, cdr in calibrations_of(self._reader) if name in named}
        if missing := sorted(named - found.keys()):
            raise UserError(f"Bag {self._reader.path} has no calibration {missing[0]!r} on topic {CALIBRATION_TOPIC}.")
        return found

    def _step(self) -> tuple[bool, str]:
        if not self.is_active:
            return False, INACTIVE
        if self._reel.next is None:
            return False, "the bag has ended"
        self.tally.receive()
        self.submit(1, self._publish_group)
        return True, "next dwell"

    def _publish_group(self) -> int:
        """Publish up to the first frame that is not of this group; the number of frames.

        What cannot be decoded is counted and left out.
        """
        group = Group(self._last_odometry_ns)
        while (recorded := self._reel.next) is not None:
            if recorded == self._announced:
                self._announced = None  # the next one like it is to be played
            elif content := self._content_of(recorded):
                if content.part:
                    if group.closed(self._detectors) or self._is_held_up(content.part.dwell, group):
                        break
                    if self._comes_later(content.part.dwell, group):
                        group.set_aside.append(recorded)
                        self._reel.advance()
                        continue
                group.add(content)
                self._publish(recorded)
            self._reel.advance()
        self._last_odometry_ns = group.last_odometry_ns if group.set_aside else 0
        self._reel.put_back(group.set_aside)
        return group.frames.total()

    def _comes_later(self, dwell: DwellKey, group: Group) -> bool:
        """Whether frames of a dwell are to wait until a group, which has begun before it, has been played."""
        return dwell not in group.frames and bool(group.set_aside or (group.frames and dwell in self._cues))

    def _is_held_up(self, dwell: DwellKey, group: Group) -> bool:
        """Do what is to happen before a dwell, if it begins a group; whether the step ends with that.

        Raises:
            UserError: a node does not take its parameters.
        """
        if group.frames or dwell not in self._cues:
            return False
        cue = self._cues.pop(dwell)
        if cue.calibrations:
            first, *others = cue.calibrations
            self._cues[dwell] = replace(cue, calibrations=tuple(others))
            self._calibration.publish(self._calibrations[first])
            self.tell(CALIBRATIONS)
            return True
        for name, values in cue.parameters.items():
            self._others.set(name, values, lambda: self.is_ending)
        return False

    def _content_of(self, recorded: BagMessage) -> Content | None:
        """What matters of a message; takes note of detectors of a sensor info. None: it is broken, which is told."""
        try:
            if recorded.type_name != SENSOR_TYPE:
                return content_of(recorded)
            sensor = self._reader.decode(recorded.type_name, recorded.cdr)
        except Exception as error:  # noqa: BLE001 (whatever the deserializer makes of broken bytes)
            self.ignore(f"broken {recorded.topic}", UserError(f"A message cannot be decoded: {error}"))
            return None
        self._detectors = max(1, len(sensor.beams.elevation_boresights))
        return Content()

    def _publish(self, recorded: BagMessage) -> None:
        self._outlets[recorded.topic].publish(recorded.cdr)


def calibrations_of(reader: BagReader) -> Iterator[tuple[str, bytes]]:
    """The calibrations in a bag: identity and serialized message.

    Raises:
        UserError: the bag is damaged.
    """
    for recorded in reader.messages([name for name in reader.topics if name.lstrip("/") == CALIBRATION_TOPIC]):
        yield reader.decode(recorded.type_name, recorded.cdr).id, recorded.cdr


def main() -> int:
    """Console script."""
    return run_node(Player)


if __name__ == "__main__":
    raise SystemExit(main())
