"""Node player: publishes what a bag holds of a sensor, or the images or heights made of it.

It does so dwell by dwell, at the pace of the sensor beside /clock, or as fast as it can.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from sal_height import messages
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.topics import HEIGHT_TYPE, SENSOR_TYPE, Topic
from sal_height.errors import UserError
from sal_height.messages.codec import SHIPPED
from sal_height.messages.definition import shipped_definition
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.nodes.account import CALIBRATIONS, DWELLS
from sal_height.nodes.cues import DwellKey, cues_of_text
from sal_height.nodes.delivery import delivered
from sal_height.nodes.managed import INACTIVE
from sal_height.nodes.played import LATEST_NS, MOST, SENSOR, Content, DwellRange, Played, chosen, qos_of, read_contents
from sal_height.nodes.playlist import SENSOR_INFO
from sal_height.nodes.program import run_node
from sal_height.nodes.reel import Group, Reel
from sal_height.nodes.remote_parameters import RemoteParameters
from sal_height.nodes.role import Topics
from sal_height.nodes.simulated_clock import CLOCK, SimulatedClock
from sal_height.nodes.stage import (
    LATCHED_QOS,
    RESET,
    SENSOR_TOPICS,
    Stage,
    StageParameters,
)
from sal_height.settings import setting

CALIBRATION_TOPIC = "calibration"

LOCKSTEP, PACED, BURST = CLOCKS = "lockstep", "paced", "burst"
"""When what a bag holds is played: dwell by dwell as it is asked for, at the times of its stamps, or at once."""


class Parameters(StageParameters):
    """Parameters of the node."""

    bag: str = setting("", "path of the bag: its folder or its .mcap file", read_only=True)
    topics: tuple[str, ...] = setting(
        SENSOR,
        "topics that are played: those of the sensor, with those of the air if any; or sensor_info and slc, or heights "
        "such as ml/height",
        read_only=True,
    )
    namespace: str = setting(
        "", "namespace that the topics have in the bag, which they are played without; empty: none", read_only=True
    )
    renamed: tuple[str, ...] = setting(
        (),
        "topics of the bag that are read under other names, each as OLD:=NEW with leading slashes and namespaces",
        read_only=True,
    )
    first_dwell: int = setting(0, "number of the first dwell that is played", minimum=0, maximum=MOST, read_only=True)
    last_dwell: int = setting(MOST, "number of the last dwell that is played", minimum=0, maximum=MOST, read_only=True)
    start_ns: int = setting(0, "earliest stamp of the dwells that are played", unit="ns", minimum=0, read_only=True)
    end_ns: int = setting(LATEST_NS, "latest stamp of the dwells that are played", unit="ns", minimum=0, read_only=True)
    clock: str = setting(
        LOCKSTEP,
        "when messages are played: lockstep, the next dwell at each call of ~/step; paced, all at the times of their "
        "stamps, beside /clock; burst, all as fast as they can be published",
        choices=CLOCKS,
        read_only=True,
    )
    rate: float = setting(
        1.0, "seconds of the sensor that are played in a second if paced", minimum=1e-6, maximum=1e6, read_only=True
    )
    loops: int = setting(
        1,
        "how often the bag is played if paced or burst; stamps go on, dwells keep their numbers",
        minimum=1,
        maximum=1_000_000_000,
        read_only=True,
    )
    cues: str = setting(
        "",
        "what happened in flight, as a replay finds it: a list of dwell, parameters and calibrations in JSON",
        read_only=True,
    )


class Player(Stage):
    """Publishes the recorded bytes of one group of dwells at each call of ~/step, or of all dwells at one call.

    The first sensor info comes before that, so that the nodes can get ready for the sensor. The first step begins with
    the first message on each topic of the air, which dwells before it have waited for in flight. A dwell before which
    something happened in flight (`cues`) begins a group; a calibration is published at a step of its own. So does a
    step end there that plays all that follows: whoever asks for the next one can wait until the nodes are done before.
    """

    parameters = Parameters
    outputs: ClassVar[Topics] = {
        **SENSOR_TOPICS,
        CALIBRATION_TOPIC: "calibrations that the parameter cues names",
        CLOCK: "time of the sensor, if the parameter clock is paced",
    }
    answers: ClassVar[Topics] = {**RESET, "~/step": "publish the next dwell; if paced or burst, all of them"}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the bag cannot be used or lacks a topic.
        """
        super().__init__("player", **node_arguments)
        self._others = RemoteParameters(self, ())
        self._time: SimulatedClock | None = None
        self._ending = threading.Event()
        try:
            self._open()
        except UserError:
            self.destroy_node()
            raise
        self.serve("~/step", self._step)

    def destroy_node(self) -> None:
        """Stop playing, and end the node."""
        self._ending.set()
        if self._time:
            self._time.end()
        super().destroy_node()

    def _open(self) -> None:
        """Open the bag, offer what is in it, and publish the first sensor info.

        Raises:
            UserError: the bag cannot be used or lacks a topic.
        """
        parameters = self.current_parameters()
        if not parameters.bag:
            raise UserError("Parameter bag is empty; it must be the path of a bag.")
        renamed = dict(_names_of(rule) for rule in parameters.renamed)
        self._reader = NamespacedReader(Path(parameters.bag), parameters.namespace, renamed)
        recorded = {name.lstrip("/"): topic for name, topic in self._reader.topics.items()}
        if missing := [name for name in parameters.topics if name not in recorded]:
            raise UserError(
                f"Bag {self._reader.path} has no topic {', '.join(missing)}; needed are {', '.join(parameters.topics)}."
            )
        for name in parameters.topics:  # their bytes go out as they are
            self._reader.check_type(recorded[name].type_name)
        self._outlets = {
            recorded[name].name: self.offer(_class_of(recorded[name]), name, qos_of(name)) for name in parameters.topics
        }
        self._detectors = sum(recorded[name].type_name == HEIGHT_TYPE for name in parameters.topics)
        self._cues = cues_of_text(parameters.cues)
        self._others = RemoteParameters(self, {name for cue in self._cues.values() for name in cue.parameters})
        self._calibrations = self._named_calibrations()
        self._calibration = self.offer(CalibrationMessage, CALIBRATION_TOPIC, LATCHED_QOS)
        info, air = (
            self._first_of([recorded[name].name for name in names if name in parameters.topics])
            for names in ([SENSOR_INFO], messages.AIR)
        )
        self._reel = Reel(_brought_forward(air, _without(info, self._played(parameters))))
        self._last_odometry_ns = 0
        if parameters.clock == PACED and self._reel.next:
            self._time = SimulatedClock(self, self._reel.next.recorded.log_time_ns, parameters.rate)
        for announced in info:
            if self._is_usable(Played(announced, Content())):
                self._publish(announced)

    def _first_of(self, names: Sequence[str]) -> list[BagMessage]:
        """The first message on each of these topics.

        Raises:
            UserError: the bag is damaged.
        """
        found = [next(self._reader.messages([name]), None) for name in names]
        return [message for message in found if message]

    def _played(self, parameters: Parameters) -> Iterator[Played]:
        """The messages of the bag that are played, in their order; unless in lockstep with the times of their delivery.

        Raises:
            UserError: the bag is damaged.
        """
        topics = list(self._outlets)
        dwells = DwellRange(parameters.first_dwell, parameters.last_dwell, parameters.start_ns, parameters.end_ns)
        if parameters.clock != LOCKSTEP:
            return delivered(self._reader, topics, dwells, parameters.loops)
        return chosen(read_contents(self._reader.messages(topics)), dwells)

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
        in_lockstep = self.current_parameters().clock == LOCKSTEP
        self.submit(1, self._publish_group if in_lockstep else self._deliver)
        return True, "next dwell" if in_lockstep else "all dwells up to the next change in flight"

    def _deliver(self) -> int:
        """Publish what is due when it is, up to a dwell that something is to happen before; the number of frames.

        What cannot be decoded is counted and left out.
        """
        group = Group()
        while (item := self._reel.next) is not None and self._is_due(item.recorded) and self.is_active:
            if self._is_usable(item):
                dwell = item.content.part.dwell if item.content.part else None
                if dwell in self._cues and (group.frames or self._is_held_up(dwell, group)):
                    break
                self._play(item, group)
            self._reel.advance()
        if self._time:
            self._time.stand_still()
        return group.frames.total()

    def _is_due(self, recorded: BagMessage) -> bool:
        """Wait until a message is due, if there is a clock; False if the node ends before."""
        return self._time.wait_until(recorded.log_time_ns) if self._time else not self._ending.is_set()

    def _publish_group(self) -> int:
        """Publish up to the first frame that is not of this group; the number of frames.

        What cannot be decoded is counted and left out.
        """
        group = Group(self._last_odometry_ns)
        while (item := self._reel.next) is not None:
            if self._is_usable(item):
                if part := item.content.part:
                    if group.closed(self._detectors, part.dwell) or self._is_held_up(part.dwell, group):
                        break
                    if self._comes_later(part.dwell, group):
                        group.set_aside.append(item)
                        self._reel.advance()
                        continue
                self._play(item, group)
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

    def _is_usable(self, item: Played) -> bool:
        """Whether a message can be decoded, or else it is told; takes note of the detectors of a sensor info."""
        recorded, fault = item.recorded, item.content.fault
        if recorded.type_name == SENSOR_TYPE:
            try:
                sensor = self._reader.decode(recorded.type_name, recorded.cdr)
                self._detectors = max(1, len(sensor.beams.elevation_boresights))
            except Exception as error:  # noqa: BLE001 (whatever the deserializer makes of broken bytes)
                fault = str(error)
        if fault:
            self.ignore(f"broken {recorded.topic}", UserError(f"A message cannot be decoded: {fault}"))
        return not fault

    def _play(self, item: Played, group: Group) -> None:
        """Publish a message of a group, and count the dwell that it may begin."""
        recorded, content = item
        if content.part and content.part.dwell not in group.frames:
            self.tally.note(DWELLS)
        group.add(content)
        self._publish(recorded)

    def _publish(self, recorded: BagMessage) -> None:
        self._outlets[recorded.topic].publish(recorded.cdr)


def _names_of(rule: str) -> tuple[str, str]:
    """The two names of a topic of the bag.

    Raises:
        UserError: the rule has another form.
    """
    old, separator, new = rule.partition(":=")
    if not separator:
        raise UserError(f"Parameter renamed has {rule!r}; each of its texts must be OLD:=NEW.")
    return old, new


def _without(published: Sequence[BagMessage], items: Iterator[Played]) -> Iterator[Played]:
    """What is played, without messages that have been published already."""
    due = {message.topic: message.cdr for message in published}
    for item in items:
        if due.get(item.recorded.topic) == item.recorded.cdr:
            del due[item.recorded.topic]
        else:
            yield item


def _brought_forward(early: Sequence[BagMessage], items: Iterator[Played]) -> Iterator[Played]:
    """What is played, with these messages of it at the begin."""
    others = _without(early, items)
    first = next(others, None)
    if first is None:
        return
    begin_ns = first.recorded.log_time_ns
    yield from read_contents(message._replace(log_time_ns=begin_ns) for message in early)
    yield first
    yield from others


def calibrations_of(reader: BagReader) -> Iterator[tuple[str, bytes]]:
    """The calibrations in a bag: identity and serialized message.

    Raises:
        UserError: the bag is damaged.
    """
    for recorded in reader.messages([name for name in reader.topics if name.lstrip("/") == CALIBRATION_TOPIC]):
        yield reader.decode(recorded.type_name, recorded.cdr).id, recorded.cdr


def _class_of(topic: Topic) -> type[Any]:
    """The class of the messages of a topic.

    Raises:
        UserError: they are of a type that no node of ours takes.
    """
    if shipped_definition(topic.type_name) is None:
        raise UserError(f"Topic {topic.name} has the type {topic.type_name}, which no node takes; play others.")
    return SHIPPED.message_class(topic.type_name)


def main() -> int:
    """Console script."""
    return run_node(Player)


if __name__ == "__main__":
    raise SystemExit(main())
