"""Node simulator: publishes what the sensor of a simulated flight would."""

from __future__ import annotations

from typing import Any, ClassVar

from sal_height import messages
from sal_height.engine.stage import FOREVER_NS
from sal_height.messages.flight import dwell_messages, first_messages
from sal_height.messages.types import ChannelFrame, NavSatFix, Odometry, SensorInfo
from sal_height.nodes.accounts.account import DWELLS
from sal_height.nodes.managed import INACTIVE, SENSOR_TOPICS, Topics
from sal_height.nodes.platform_frames import FRAME_TOPICS, PlatformFrames, SourceSettings
from sal_height.nodes.program import run_node
from sal_height.nodes.transport.qos import LATCHED_QOS, ODOMETRY_QOS
from sal_height.nodes.worker import RESET, WorkerNode
from sal_height.settings import setting
from sal_height.simulation import flight_of, load_preset
from sal_height.topics import MAP_ORIGIN, ODOMETRY, PHASE_HISTORY, SENSOR_INFO


class SimulatorSettings(SourceSettings):
    """Parameters of the node."""

    preset: str = setting("sal_spotlight", "name of a preset, or path of its YAML file", read_only=True)
    seed: int = setting(1, "seed of the random numbers", minimum=0, maximum=2**31 - 1, read_only=True)
    period_s: float = setting(
        1.0,
        "time between two dwells; 0: a dwell is made only when the service ~/step is called",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
        read_only=True,
    )
    start_ns: int = setting(
        0, "stamp of the start of the flight; 0: the time when the node starts", unit="ns", minimum=0, read_only=True
    )


class Simulator(WorkerNode):
    """Publishes one dwell after the other, on a timer or at each call of ~/step, until the flight ends.

    Stamps begin at the time of the start; everything else follows from preset and seed alone.
    """

    parameters = SimulatorSettings
    outputs: ClassVar[Topics] = {
        **SENSOR_TOPICS,
        MAP_ORIGIN: "position of the origin of the map frame on the earth, sensor_msgs/NavSatFix, latched",
        **dict.fromkeys(messages.AIR, "what a probe on the platform measures, if the preset has air"),
        **FRAME_TOPICS,
    }
    answers: ClassVar[Topics] = {**RESET, "~/step": "simulate and publish the next dwell"}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a preset or scene that cannot be used.
        """
        super().__init__("simulator", **node_arguments)
        parameters = self.current_parameters()
        self.flight = flight_of(load_preset(parameters.preset), parameters.seed)
        self._next_dwell = 0
        self._published_ns = 0
        self._start_ns = parameters.start_ns or self.get_clock().now().nanoseconds
        self.step_ns = self._start_ns
        self._outlets = {
            SENSOR_INFO: self.offer(SensorInfo, SENSOR_INFO, LATCHED_QOS),
            ODOMETRY: self.offer(Odometry, ODOMETRY, ODOMETRY_QOS),
            PHASE_HISTORY: self.offer(ChannelFrame, PHASE_HISTORY),
            MAP_ORIGIN: self.offer(NavSatFix, MAP_ORIGIN, LATCHED_QOS),
            **{topic: self.offer(one.message_type, topic, ODOMETRY_QOS) for topic, one in messages.AIR.items()},
        }
        self._tf = PlatformFrames(self)
        for topic, message, _ in first_messages(self.flight, self._start_ns):
            self._publish(topic, message)
        self.serve("~/step", self.step)
        if parameters.period_s > 0:
            self.every(parameters.period_s, self._begin_dwell, self.get_clock())

    def announced(self) -> dict[str, int]:
        """Stamps by topic, ns, before which nothing more will be published."""
        after_ns = FOREVER_NS if self._next_dwell >= self.flight.dwells else self._published_ns + 1
        return dict.fromkeys(SENSOR_TOPICS, after_ns)

    def step(self) -> tuple[bool, str]:
        """Simulate and publish the next dwell, on the worker thread; returns whether there is one, and a message."""
        if not self.is_active:
            return False, INACTIVE
        dwell = self._begin_dwell()
        return (False, "the flight has ended") if dwell is None else (True, f"dwell {dwell} of {self.flight.dwells}")

    def _begin_dwell(self) -> int | None:
        """Start to simulate the next dwell; returns its number, or None when the flight has ended."""
        dwell = self._next_dwell
        if dwell >= self.flight.dwells:
            return None
        self._next_dwell += 1
        self.step_ns = self._start_ns + self.flight.dwell_end_ns(dwell)
        self.tally.receive()
        self.submit(1, lambda: self._publish_dwell(dwell))
        return dwell

    def _publish_dwell(self, dwell: int) -> int:
        frames = 0
        for topic, message, stamp_ns in dwell_messages(self.flight, dwell, self._start_ns):
            self._publish(topic, message)
            if topic == PHASE_HISTORY:
                frames, self._published_ns = frames + 1, stamp_ns
        self.tally.note(DWELLS)
        return frames

    def _publish(self, topic: str, message: Any) -> None:
        """Publish a message, and the frames that follow from it."""
        self._outlets[topic].publish(message)
        self._tf.follow(topic, message)


def main() -> int:
    """Console script."""
    return run_node(Simulator)


if __name__ == "__main__":
    raise SystemExit(main())
