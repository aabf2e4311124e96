"""Nodes player and paced_player: publish the messages of a bag, dwell by dwell or at the times of their delivery."""

from __future__ import annotations

import bisect
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, ClassVar

from rclpy.qos import QoSProfile

from sal_height import messages
from sal_height.bag.described import FRAMES
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.played import (
    CLOCKS,
    LATEST_NS,
    LOCKSTEP,
    MOST,
    PACED,
    Content,
    DwellRange,
    Played,
    chosen,
    read_contents,
)
from sal_height.bag.reader import BagMessage, BagReader, LogTimes
from sal_height.bag.topics import HEIGHT_TYPE, SENSOR_TYPE, Topic
from sal_height.engine.air import AIR_PORTS
from sal_height.engine.compression import SENSOR
from sal_height.engine.results import DwellKey
from sal_height.engine.stage import FOREVER_NS
from sal_height.errors import UserError
from sal_height.messages.codec import SHIPPED
from sal_height.messages.definition import shipped_definition
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.nodes.accounts.account import CALIBRATIONS, DWELLS
from sal_height.nodes.managed import INACTIVE, SENSOR_TOPICS, Topics
from sal_height.nodes.platform_frames import FRAME_TOPICS, PlatformFrames, SourceSettings
from sal_height.nodes.playing.playlist import CLOCK, PacedClock, Playlist, SimulatedClock, delivered
from sal_height.nodes.program import run_node
from sal_height.nodes.scripts import node_of_script
from sal_height.nodes.transport.endpoints import Outlet
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.nodes.worker import RESET, WorkerNode
from sal_height.settings import setting
from sal_height.topics import CALIBRATION, ODOMETRY, SENSOR_INFO


class PacedPlayerSettings(SourceSettings):
    """Parameters of the node paced_player."""

    bag: str = setting("", "path of the bag: its folder or its .mcap file", read_only=True)
    rate: float = setting(
        1.0, "seconds of the sensor that are played in a second if paced", minimum=1e-6, maximum=1e6, read_only=True
    )


class PlayerSettings(PacedPlayerSettings):
    """Parameters of the node player."""

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
        "stamps, with /clock; burst, all as fast as they can be published",
        choices=CLOCKS,
        read_only=True,
    )
    loops: int = setting(
        1,
        "how often the bag is played if paced or burst; stamps go on, dwells keep their numbers",
        minimum=1,
        maximum=1_000_000_000,
        read_only=True,
    )


def qos_of(topic: str) -> QoSProfile:
    """The quality of service of a topic that is played."""
    return {SENSOR_INFO: LATCHED_QOS, **dict.fromkeys((ODOMETRY, *messages.AIR), ODOMETRY_QOS)}.get(topic, FRAMES_QOS)


class BagSource(WorkerNode):
    """A node that publishes a bag."""

    usual_name: ClassVar[str]
    parameters: type[SourceSettings] = PacedPlayerSettings

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the bag cannot be used, or lacks what is to be played.
        """
        super().__init__(self.usual_name, **node_arguments)
        self._time = PacedClock()
        self._outlets: dict[str, Outlet] = {}
        self._tf = PlatformFrames(self)
        try:
            self._open(_path_of(self.current_parameters().bag))
        except UserError:
            self.destroy_node()
            raise
        self.serve(f"~/{self.begin_service}", self.step)

    def destroy_node(self) -> None:
        """Stop playing, and end the node."""
        self._time.end()
        super().destroy_node()

    def step(self) -> tuple[bool, str]:
        """Publish the next messages, on the worker thread; returns whether there are any, and a message on it."""
        raise NotImplementedError

    def _open(self, bag: Path) -> None:
        """Open the bag, offer its topics, and publish the description of the sensor.

        Raises:
            UserError: the bag cannot be used, or lacks what is to be played.
        """
        raise NotImplementedError


class Player(BagSource):
    """Publishes the recorded bytes of one dwell at each call of ~/step, or of all dwells at one call.

    The first sensor info is published before that, so that the nodes can get ready for the sensor. The first step
    begins with the first message on each topic of the air, which dwells before it have waited for in flight. A
    calibration that was applied from a dwell on is published at a step of its own before that dwell.
    """

    usual_name = "player"
    parameters = PlayerSettings
    outputs: ClassVar[Topics] = {
        **SENSOR_TOPICS,
        CALIBRATION: "calibrations that were applied in the flight, in a replay",
        CLOCK: "time of the sensor, if the parameter clock is paced",
        **FRAME_TOPICS,
    }
    answers: ClassVar[Topics] = {**RESET, "~/step": "publish the next dwell; if paced or burst, all of them"}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; arguments and errors as of `BagSource`."""
        self._by_dwell = False
        self._items: Iterator[Played] = iter(())
        self._next: Played | None = None
        self._applied: dict[DwellKey, list[str]] = {}
        self._calibrations: dict[str, bytes] = {}
        self._ends_ns: list[int] = []
        self._none_before: list[int] = []
        self._begun: set[DwellKey] = set()
        super().__init__(**node_arguments)

    def schedule(self, calibrations: Mapping[DwellKey, Sequence[str]], frames: Mapping[DwellKey, LogTimes]) -> None:
        """State what a replay knows of the bag, before the first step.

        Args:
            calibrations: identities of the calibrations that are published before each dwell.
            frames: times at which the frames of each dwell were recorded.

        Raises:
            UserError: the bag does not have a calibration.
        """
        self._applied = {dwell: list(names) for dwell, names in calibrations.items() if names}
        self._calibrations = self._named_calibrations()
        dwells = sorted(frames.items(), key=lambda item: item[1].last_ns)
        self._ends_ns = [times.last_ns for _, times in dwells]
        self._none_before = list(accumulate((dwell.stamp_ns for dwell, _ in reversed(dwells)), min))[::-1]

    def announced(self) -> dict[str, int]:
        """Stamps by topic, ns, before which nothing more will be published."""
        item = self._next
        if item is None:
            return dict.fromkeys(self._topics, FOREVER_NS)
        done = bisect.bisect_left(self._ends_ns, item.recorded.log_time_ns)
        return {FRAMES: self._none_before[done]} if done < len(self._none_before) else {}

    def step(self) -> tuple[bool, str]:
        """Publish the next messages, on the worker thread; returns whether there are any, and a message on it."""
        if not self.is_active:
            return False, INACTIVE
        if self._next is None:
            return False, "the bag has ended"
        self._note_step(self._next)
        self.tally.receive()
        self.submit(1, self._publish_step)
        return True, "next dwell" if self._by_dwell else "all dwells up to the next calibration"

    def _open(self, bag: Path) -> None:
        """Open the bag, offer its topics, and publish the first sensor info.

        Raises:
            UserError: the bag cannot be used or lacks a topic.
        """
        parameters = self.current_parameters()
        renamed = dict(_names_of(rule) for rule in parameters.renamed)
        self._reader = NamespacedReader(bag, parameters.namespace, renamed)
        recorded = {name.lstrip("/"): topic for name, topic in self._reader.topics.items()}
        if missing := [name for name in parameters.topics if name not in recorded]:
            raise UserError(
                f"Bag {self._reader.path} has no topic {', '.join(missing)}; needed are {', '.join(parameters.topics)}."
            )
        for name in parameters.topics:  # their bytes go out as they are
            self._reader.check_type(recorded[name].type_name)
        self._topics = parameters.topics
        self._names = {recorded[name].name: name for name in parameters.topics}
        self._outlets = {
            topic: self.offer(_class_of(recorded[name]), name, qos_of(name)) for topic, name in self._names.items()
        }
        self._detectors = sum(recorded[name].type_name == HEIGHT_TYPE for name in parameters.topics)
        self._calibration = self.offer(CalibrationMessage, CALIBRATION, LATCHED_QOS)
        info, air = (
            self._first_of([recorded[name].name for name in names if name in parameters.topics])
            for names in ([SENSOR_INFO], messages.AIR)
        )
        self._by_dwell = parameters.clock == LOCKSTEP
        self._items = _brought_forward(air, _without(info, self._played(parameters)))
        self._next = next(self._items, None)
        if parameters.clock == PACED and self._next:
            self._time = SimulatedClock(self, self._next.recorded.log_time_ns, parameters.rate)
        if self._next:
            self._note_step(self._next)
        for announced in info:
            if self._is_usable(Played(announced, Content())):
                self._publish(announced)

    def _note_step(self, first: Played) -> None:
        """Note the time of a step, which is that of its first message."""
        if self._by_dwell:
            self.step_ns = max(1, first.recorded.log_time_ns)  # 0 says nothing

    def _first_of(self, names: Sequence[str]) -> list[BagMessage]:
        """The first message on each of these topics.

        Raises:
            UserError: the bag is damaged.
        """
        found = [next(self._reader.messages([name]), None) for name in names]
        return [message for message in found if message]

    def _played(self, parameters: PlayerSettings) -> Iterator[Played]:
        """The messages to play: in lockstep in the order of the bag, else in that of their delivery.

        Raises:
            UserError: the bag is damaged.
        """
        topics = list(self._outlets)
        dwells = DwellRange(parameters.first_dwell, parameters.last_dwell, parameters.start_ns, parameters.end_ns)
        if self._by_dwell:
            return chosen(read_contents(self._reader.messages(topics)), dwells)
        return delivered(self._reader, topics, dwells, parameters.loops)

    def _named_calibrations(self) -> dict[str, bytes]:
        """The serialized calibrations that are published, by identity.

        Raises:
            UserError: the bag does not have one of them.
        """
        named = {name for names in self._applied.values() for name in names}
        topics = [name for name in self._reader.topics if name.lstrip("/") == CALIBRATION]
        recorded = self._reader.messages(topics) if named and topics else ()
        found = {self._reader.decode(one.type_name, one.cdr).id: one.cdr for one in recorded}
        if missing := sorted(named - found.keys()):
            raise UserError(f"Bag {self._reader.path} has no calibration {missing[0]!r} on topic {CALIBRATION}.")
        return found

    def _advance(self) -> None:
        """Go on to the next message.

        Raises:
            UserError: the bag is damaged; the message at hand was its last, so that none is played twice.
        """
        try:
            self._next = next(self._items, None)
        except UserError:
            self._next = None
            raise

    def _publish_step(self) -> int:
        """Publish messages when they are due, up to the end of the step; returns the number of frames.

        In lockstep a step ends before the first message of another dwell. A message that cannot be decoded is counted
        and left out.
        """
        most_frames, most_others = 128, 2000  # of a step: half or less of what a subscription keeps
        frames, others, dwells = 0, 0, set[DwellKey]()
        while (item := self._next) is not None and self._is_due(item.recorded):
            if self._is_usable(item):
                part = item.content.part
                if part is None:
                    others += 1
                else:
                    if part.dwell in self._applied:
                        if not frames and not others:
                            self._publish_calibration(part.dwell)
                        break
                    if self._by_dwell and frames >= max(1, self._detectors) and part.dwell not in dwells:
                        break
                    frames += 1
                    dwells.add(part.dwell)
                self._play(item)
            self._advance()
            if self._by_dwell and (frames >= most_frames or others >= most_others):
                break
        self._time.stand_still()
        return frames

    def _is_due(self, recorded: BagMessage) -> bool:
        """Wait until a message is due; False if the node ends or becomes inactive before."""
        return self._time.wait_until(recorded.log_time_ns) and self.is_active

    def _publish_calibration(self, dwell: DwellKey) -> None:
        """Publish the next calibration that is applied from a dwell on."""
        names = self._applied[dwell]
        self._calibration.publish(self._calibrations[names.pop(0)])
        if not names:
            del self._applied[dwell]
        self.tell(CALIBRATIONS)

    def _is_usable(self, item: Played) -> bool:
        """True if a message can be decoded, or else it is counted; notes the detectors of a sensor info."""
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

    def _play(self, item: Played) -> None:
        """Publish a message, and count the dwell if it is the first of one."""
        recorded, content = item
        if content.part and content.part.dwell not in self._begun:
            self._begun.add(content.part.dwell)
            self.tally.note(DWELLS)
        self._publish(recorded)

    def _publish(self, recorded: BagMessage) -> None:
        self._outlets[recorded.topic].publish(recorded.cdr)
        self._tf.follow(self._names[recorded.topic], recorded.cdr)


class PacedPlayer(BagSource):
    """Publishes odometry, air and frames when the sensor would, from the call of ~/start until it ends.

    The bag is played from memory and starts again after its end. Stamps go on: they start with the time of the call,
    which is answered by the first of them (ns), and all else in the messages is as recorded. Further calls are answered
    alike, for an answer may be lost. While the node is inactive, time goes on and nothing is published. After a delay
    the node catches up.
    """

    usual_name = "paced_player"
    outputs: ClassVar[Topics] = {**SENSOR_TOPICS, **{port.name: port.about for port in AIR_PORTS}, **FRAME_TOPICS}
    answers: ClassVar[Topics] = {**RESET, "~/start": "begin to deliver"}
    begin_service = "start"

    _first_ns = 0
    """Stamp of the first message, ns; 0: the start has not been called."""

    def step(self) -> tuple[bool, str]:
        """Start to play, unless that has been done; returns whether the node plays, and the first stamp, ns."""
        if not self.is_active:
            return False, INACTIVE
        if not self._first_ns:
            lead_s = 0.05  # for the answer, which the caller may need before the first message
            self._first_ns = self.get_clock().now().nanoseconds + round(lead_s * 1e9)
            self._time = PacedClock(self._first_ns, self.current_parameters().rate, time.monotonic() + lead_s)
            self.submit(0, self._publish_passes)
        return True, f"{self._first_ns}"

    def _open(self, bag: Path) -> None:
        """Read the bag, offer the topics of a sensor, and publish its description.

        Raises:
            UserError: the bag cannot be used, has no whole dwell, or takes more memory than max_memory_mb.
        """
        self.playlist = Playlist.of_bag(BagReader(bag), self.current_parameters().max_memory_bytes)
        kinds = {SENSOR_INFO: SensorInfo, ODOMETRY: Odometry, FRAMES: ChannelFrame}
        kinds |= {topic: one.message_type for topic, one in messages.AIR.items()}
        self._outlets = {topic: self.offer(kind, topic, qos_of(topic)) for topic, kind in kinds.items()}
        self._deliver(SENSOR_INFO, self.playlist.sensor_info)

    def _publish_passes(self) -> int:
        """Publish messages when they are due, until the node ends."""
        for message in self.playlist.passes(self._first_ns):
            if not self._time.wait_until(message.log_time_ns):
                break
            if self.is_active:
                self._deliver(message.topic, message.cdr)
        return 0

    def _deliver(self, topic: str, cdr: bytes) -> None:
        """Publish a message, and the frame that it states."""
        self._outlets[topic].publish(cdr)
        self._tf.follow(topic, cdr)


def _path_of(bag: str) -> Path:
    """The path of a bag.

    Raises:
        UserError: it is empty.
    """
    if not bag:
        raise UserError("Parameter bag is empty; it must be the path of a bag.")
    return Path(bag)


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
    """The messages to play, without those that have been published already."""
    due = {message.topic: message.cdr for message in published}
    for item in items:
        if due.get(item.recorded.topic) == item.recorded.cdr:
            del due[item.recorded.topic]
        else:
            yield item


def _brought_forward(early: Sequence[BagMessage], items: Iterator[Played]) -> Iterator[Played]:
    """The messages to play, with these of them at the start."""
    others = _without(early, items)
    first = next(others, None)
    if first is None:
        return
    begin_ns = first.recorded.log_time_ns
    yield from read_contents(message._replace(log_time_ns=begin_ns) for message in early)
    yield first
    yield from others


def _class_of(topic: Topic) -> type[Any]:
    """The class of the messages of a topic.

    Raises:
        UserError: they are of a type that no node of ours accepts.
    """
    if shipped_definition(topic.type_name) is None:
        raise UserError(f"Topic {topic.name} has the type {topic.type_name}, which no node takes; play others.")
    return SHIPPED.message_class(topic.type_name)


def main() -> int:
    """Console script of both nodes; the name of the script is that of the node."""
    return run_node(PacedPlayer if node_of_script() == PacedPlayer.usual_name else Player)


if __name__ == "__main__":
    raise SystemExit(main())
