"""Node player: publishes the sensor_info, platform/odometry and phase_history of a bag, dwell by dwell."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, ClassVar

from nav_msgs.msg import Odometry
from sal_height_msgs.msg import ChannelFrame, SensorInfo

from sal_height import messages
from sal_height.bag.definitions import message_class
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.errors import UserError
from sal_height.nodes.managed import INACTIVE
from sal_height.nodes.playlist import FRAMES, ODOMETRY, SENSOR_INFO
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS, RESET, SENSOR_TOPICS, Stage, StageParameters
from sal_height.settings import setting

INPUTS = {SENSOR_INFO: LATCHED_QOS, ODOMETRY: ODOMETRY_QOS, FRAMES: FRAMES_QOS}
"""Topics that are played."""

LONGEST_GROUP = 4
"""A group of dwells ends after the frames of this many dwells, even if some dwells lack a frame."""


class Parameters(StageParameters):
    """Parameters of the node."""

    bag: str = setting("", "path of the bag: its folder or its .mcap file", read_only=True)


class Player(Stage):
    """Publishes the recorded bytes of one group of dwells at each call of ~/step.

    The first sensor info comes before that, so that the nodes can get ready for the sensor.
    """

    parameters = Parameters
    outputs = SENSOR_TOPICS
    answers: ClassVar[Topics] = {**RESET, "~/step": "publish the next dwell"}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the bag cannot be used or lacks a topic.
        """
        super().__init__("player", **node_arguments)
        path = self.current_parameters().bag
        if not path:
            raise UserError("Parameter bag is empty; it must be the path of a bag.")
        self._reader = BagReader(Path(path))
        recorded = {name.lstrip("/"): topic for name, topic in self._reader.topics.items()}
        if missing := [name for name in INPUTS if name not in recorded]:
            raise UserError(
                f"Bag {self._reader.path} has no topic {', '.join(missing)}; needed are {', '.join(INPUTS)}."
            )
        self._outlets = {
            recorded[name].name: self.offer(message_class(recorded[name].type_name), name, qos)
            for name, qos in INPUTS.items()
        }
        self._messages = self._reader.messages(list(self._outlets))
        self._next: BagMessage | None = next(self._messages, None)
        self._detectors = 1
        self._announced = next(self._reader.messages([recorded[SENSOR_INFO].name]), None)
        if self._announced and self._decode(self._announced):
            self._publish(self._announced)
        self.serve("~/step", self._step)

    def _step(self) -> tuple[bool, str]:
        if not self.is_active:
            return False, INACTIVE
        if self._next is None:
            return False, "the bag has ended"
        self.tally.receive()
        self.submit(1, self._publish_group)
        return True, "next dwell"

    def _publish_group(self) -> int:
        """Publish up to the first frame that is not of this group; the number of frames.

        What cannot be decoded is counted and left out.
        """
        group = _Group()
        while self._next is not None:
            recorded = self._next
            if recorded == self._announced:
                self._announced = None  # the next one like it is to be played
            elif message := self._decode(recorded):
                if isinstance(message, ChannelFrame) and group.closed(self._detectors):
                    break
                group.add(message)
                self._publish(recorded)
            self._advance()
        return group.frames.total()

    def _decode(self, recorded: BagMessage) -> Any:
        """The message, whose number of detectors is kept if it is a sensor info; None if it is broken, and counted."""
        try:
            message = self._reader.decode(recorded.type_name, recorded.cdr)
        except Exception as error:  # noqa: BLE001 (whatever the deserializer makes of broken bytes)
            self.ignore(f"broken {recorded.topic}", UserError(f"A message cannot be decoded: {error}"))
            return None
        if isinstance(message, SensorInfo):
            self._detectors = max(1, len(message.beams.elevation_boresights))
        return message

    def _publish(self, recorded: BagMessage) -> None:
        self._outlets[recorded.topic].publish(recorded.cdr)

    def _advance(self) -> None:
        """Read the next message.

        Raises:
            UserError: the bag is damaged; the message at hand was its last, so that none is played twice.
        """
        try:
            self._next = next(self._messages, None)
        except UserError:
            self._next = None
            raise


class _Group:
    """Dwells that are played together: one, or several whose frames lie among each other in the bag."""

    def __init__(self) -> None:
        self.frames: Counter[tuple[int, int]] = Counter()
        self._last_pulse_ns = 0
        self._last_odometry_ns = 0

    def add(self, message: Any) -> None:
        """Take note of a message that is played."""
        if isinstance(message, Odometry):
            self._last_odometry_ns = messages.to_ns(message.header.stamp)
        elif isinstance(message, ChannelFrame):
            start_ns = messages.to_ns(message.header.stamp)
            self.frames[message.dwell, start_ns] += 1
            duration = max((t for t in message.pulse_time if 0 < t <= messages.LONGEST_DWELL), default=0.0)
            self._last_pulse_ns = max(self._last_pulse_ns, start_ns + round(duration * 1e9))

    def closed(self, detectors: int) -> bool:
        """Whether all frames have come, and odometry past the last pulse; or too many frames for that to happen."""
        complete = bool(self.frames) and min(self.frames.values()) >= detectors
        covered = self._last_odometry_ns >= self._last_pulse_ns
        return (complete and covered) or self.frames.total() >= LONGEST_GROUP * detectors


def main() -> int:
    """Console script."""
    return run_node(Player)


if __name__ == "__main__":
    raise SystemExit(main())
