"""Node player: a bag → the sensor_info, platform/odometry and phase_history recorded in it, dwell by dwell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from std_srvs.srv import Trigger

from sal_height.bag.definitions import message_class
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.errors import UserError
from sal_height.nodes.parameters import declare_parameters, parameter, read_parameters
from sal_height.nodes.stage import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS, Stage, run_node

INPUTS = {"sensor_info": LATCHED_QOS, "platform/odometry": ODOMETRY_QOS, "phase_history": FRAMES_QOS}
"""Topics that are played."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    bag: str = parameter("", "path of the bag: its folder or its .mcap file", read_only=True)


class Player(Stage):
    """Publishes the recorded bytes of one dwell at each call of ~/step."""

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the bag cannot be used or has no phase history.
        """
        super().__init__("player", **node_arguments)
        declare_parameters(self, Parameters)
        self._reader = BagReader(Path(read_parameters(self, Parameters).bag))
        recorded = {name.lstrip("/"): topic for name, topic in self._reader.topics.items()}
        if missing := [name for name in INPUTS if name not in recorded]:
            raise UserError(
                f"Bag {self._reader.path} has no topic {', '.join(missing)}; needed are {', '.join(INPUTS)}."
            )
        self._frames_topic = recorded["phase_history"].name
        self._publishers_by_topic = {
            recorded[name].name: self.offer(message_class(recorded[name].type_name), name, qos)
            for name, qos in INPUTS.items()
        }
        self._messages = self._reader.messages([recorded[name].name for name in INPUTS])
        self._next: BagMessage | None = next(self._messages, None)
        self.create_service(Trigger, "~/step", self._on_step)

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._next is not None
        response.message = "next dwell" if response.success else "the bag has ended"
        if response.success:
            self.tally.receive()
            self.submit(1, self._publish_dwell)
        return response

    def _publish_dwell(self) -> int:
        """Publish up to the last frame of the next dwell; the number of frames."""
        frames = 0
        for message in self._until_next_dwell():
            self._publishers_by_topic[message.topic].publish(message.cdr)
            frames += message.topic == self._frames_topic
        return frames

    def _until_next_dwell(self) -> Iterator[BagMessage]:
        """Recorded messages up to the first frame of another dwell."""
        dwell = None
        while self._next is not None:
            if self._next.topic == self._frames_topic:
                frame = self._reader.decode(self._next.type_name, self._next.cdr)
                key = (frame.dwell, frame.header.stamp.sec, frame.header.stamp.nanosec)
                if dwell is not None and key != dwell:
                    return
                dwell = key
            yield self._next
            self._next = next(self._messages, None)


def main() -> int:
    """Console script."""
    return run_node(Player)


if __name__ == "__main__":
    raise SystemExit(main())
