"""Node paced_player: delivers a recorded sensor's dwells from memory, again and again, at the pace of the sensor."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any, ClassVar

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.sensor_topics import FRAMES
from sal_height.engine.air import AIR_PORTS
from sal_height.engine.stage import StageSettings
from sal_height.errors import UserError
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.nodes.managed import INACTIVE
from sal_height.nodes.playing.pace import Pace
from sal_height.nodes.playing.playlist import Playlist, restamped
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.transport.quality import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.nodes.worker import RESET, SENSOR_TOPICS, WorkerNode
from sal_height.settings import setting
from sal_height.topics import ODOMETRY, SENSOR_INFO

LEAD_S = 0.05
"""From the call that starts the sensor to its first message."""


class Parameters(StageSettings):
    """Parameters of the node."""

    bag: str = setting("", "path of the bag: its folder or its .mcap file", read_only=True)
    rate: float = setting(
        1.0, "seconds of the sensor that are played in a second", minimum=1e-6, maximum=1e6, read_only=True
    )


class PacedPlayer(WorkerNode):
    """Publishes odometry, air and frames when the sensor would, from the call of ~/start until it ends.

    The bag is played from memory and begins anew after its end. Stamps go on: they begin with the time of the call,
    which is answered by the first of them (ns), and all else in the messages is as recorded. Further calls are answered
    alike, for an answer may be lost. While the node is inactive, time goes on and nothing is published. Dwells that
    come late, for the machine is busy, come as fast as they can.
    """

    parameters = Parameters
    outputs: ClassVar[Topics] = {**SENSOR_TOPICS, **{port.name: port.about for port in AIR_PORTS}}
    answers: ClassVar[Topics] = {**RESET, "~/start": "begin to deliver"}
    begin_service = "start"

    def __init__(self, **node_arguments: Any) -> None:
        """Read the bag; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the bag cannot be used, has no whole dwell, or takes more memory than max_memory_mb.
        """
        super().__init__("paced_player", **node_arguments)
        parameters = self.current_parameters()
        self._stopping = threading.Event()
        if not parameters.bag:
            raise UserError("Parameter bag is empty; it must be the path of a bag.")
        self.playlist = Playlist.of_bag(BagReader(Path(parameters.bag)), parameters.max_memory_bytes)
        self._outlets = {
            ODOMETRY: self.offer(Odometry, ODOMETRY, ODOMETRY_QOS),
            FRAMES: self.offer(ChannelFrame, FRAMES, FRAMES_QOS),
            **{topic: self.offer(one.message_type, topic, ODOMETRY_QOS) for topic, one in messages.AIR.items()},
        }
        self.offer(SensorInfo, SENSOR_INFO, LATCHED_QOS).publish(self.playlist.sensor_info)
        self._starting, self._first_stamp_ns = threading.Lock(), 0
        self.serve("~/start", self._start)

    def destroy_node(self) -> None:
        """Stop playing, and end the node."""
        self._stopping.set()
        super().destroy_node()

    def _start(self) -> tuple[bool, str]:
        if not self.is_active:
            return False, INACTIVE
        with self._starting:
            if not self._first_stamp_ns:
                self._first_stamp_ns = self.get_clock().now().nanoseconds + round(LEAD_S * 1e9)
                began = time.monotonic() + LEAD_S
                self.submit(0, lambda: self._play(self._first_stamp_ns, began))
        return True, f"{self._first_stamp_ns}"

    def _play(self, first_stamp_ns: int, began: float) -> int:
        """Publish until the node ends (on the worker thread).

        Args:
            first_stamp_ns: the stamp of the first message.
            began: when it is published, s of the monotonic clock.
        """
        items, played = self.playlist.items, 0
        pace = Pace(items[0].due_ns, began, self.current_parameters().rate)
        shift_ns = first_stamp_ns - items[0].due_ns
        while True:
            for item in items:
                wait_s = pace.wait_s(played + item.due_ns)
                if self._stopping.wait(wait_s) if wait_s > 0 else self._stopping.is_set():
                    return 0
                if self.is_active:
                    self._outlets[item.topic].publish(restamped(item.cdr, shift_ns + played))
            played += self.playlist.period_ns


def main() -> int:
    """Console script."""
    return run_node(PacedPlayer)


if __name__ == "__main__":
    raise SystemExit(main())
