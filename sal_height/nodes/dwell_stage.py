"""A stage that works on whole dwells: gathers the messages of all detectors, and the sensor they belong to."""

from __future__ import annotations

import time
from abc import abstractmethod
from typing import Any

from sal_height_msgs.msg import SensorInfo

from sal_height import convert
from sal_height.dwell import Dwell, DwellAssembler
from sal_height.errors import Rejected, UserError
from sal_height.nodes.parameters import declare_parameters, read_parameters
from sal_height.nodes.stage import LATCHED_QOS, Stage
from sal_height.sensor import Sensor

HELD_DWELLS = 8
"""Unfinished dwells held before the oldest is dropped."""


class DwellStage(Stage):
    """Takes one message per detector and hands over complete dwells.

    Messages that come before their sensor info wait for it. What does not become complete within the timeout is
    dropped and counted; the next dwell is not affected.
    """

    parameters: type[Any]
    """Dataclass of the node's parameters; has at least timeout_s, the longest wait for missing messages."""

    def __init__(self, name: str, message_type: type, topic: str, **node_arguments: Any) -> None:
        """Declare the parameters; subscribe to `topic` and to sensor_info.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(name, **node_arguments)
        declare_parameters(self, self.parameters)
        self._sensor: Sensor | None = None
        self._assembler: DwellAssembler[Any] = DwellAssembler(HELD_DWELLS, self.current_parameters().timeout_s)
        self._early: list[tuple[float, Any]] = []
        self.listen(SensorInfo, "sensor_info", self._on_sensor_info, LATCHED_QOS)
        self.listen(message_type, topic, self._on_message)
        self.create_timer(0.1, self.advance, clock=self.steady_clock)

    def current_parameters(self) -> Any:
        """The parameters as they are now."""
        return read_parameters(self, self.parameters)

    @abstractmethod
    def check(self, message: Any, sensor: Sensor) -> None:
        """Raise Rejected if the message cannot be processed with `sensor`."""

    @abstractmethod
    def process(self, messages: list[Any], sensor: Sensor) -> int:
        """Process the messages of all detectors (on the worker); returns the number of messages published."""

    def belongs(self, message: Any, sensor: Sensor) -> bool:
        """Whether the message was made with `sensor`; if not, it waits for another sensor info."""
        return bool(message.config_hash == sensor.config_hash)

    def missing(self, dwell: Dwell[Any]) -> Rejected | None:  # noqa: ARG002 (subclasses use it)
        """What a dwell of all detectors still waits for, or None."""
        return None

    def advance(self) -> None:
        """Hand over what is complete; drop what has waited too long."""
        now = time.monotonic()
        if self._sensor is not None:
            for dwell in self._assembler.complete(self._sensor.detector_count):
                if self.missing(dwell) is None:
                    self._hand_over(self._assembler.take(dwell), self._sensor)
        for dwell in self._assembler.overdue(now):
            reason = self._incomplete(dwell)
            self.reject(len(self._assembler.take(dwell)), reason)
        overdue = [message for began, message in self._early if now - began > self._assembler.timeout]
        if overdue:
            self._early = self._early[len(overdue) :]
            self.reject(len(overdue), self._unmatched())

    def _hand_over(self, messages: list[Any], sensor: Sensor) -> None:
        self.submit(len(messages), lambda: self.process(messages, sensor))

    def _on_sensor_info(self, message: SensorInfo) -> None:
        try:
            self._sensor = convert.sensor_from_message(message)
        except UserError as error:
            self.ignore("sensor info", error)
            return
        self._assembler.forget_finished()
        waiting, self._early = self._early, []
        for began, early in waiting:
            self._take_in(early, began)

    def _on_message(self, message: Any) -> None:
        self.tally.receive()
        self._take_in(message, time.monotonic())

    def _take_in(self, message: Any, arrived: float) -> None:
        if self._sensor is None or not self.belongs(message, self._sensor):
            self._early.append((arrived, message))
            limit = HELD_DWELLS * (self._sensor.detector_count if self._sensor else 16)
            if len(self._early) > limit:
                del self._early[0]
                self.reject(1, self._unmatched())
            return
        key = (message.dwell, convert.to_ns(message.header.stamp))
        try:
            self.check(message, self._sensor)
            self._assembler.add(key, message.detector, message, arrived)
        except Rejected as error:
            self.reject(1, error)
        self.advance()

    def _incomplete(self, dwell: Dwell[Any]) -> Rejected:
        count = self._sensor.detector_count if self._sensor else 0
        absent = sorted(set(range(count)) - set(dwell.items))
        if absent:
            return Rejected("incomplete dwell", f"Dwell {dwell.key[0]}: detectors {absent} did not come in time.")
        return self.missing(dwell) or Rejected(
            "buffer full", f"Dwell {dwell.key[0]}: {HELD_DWELLS} dwells wait already."
        )

    def _unmatched(self) -> Rejected:
        if self._sensor is None:
            return Rejected("no sensor info", "No usable message on sensor_info; publish one (transient local).")
        return Rejected(
            "contradicts sensor info",
            f"The message's config_hash is not that of the sensor info in force ({self._sensor.config_hash}).",
        )
