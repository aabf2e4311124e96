"""A stage that works on whole dwells: gathers the messages of all detectors, and the sensor they belong to."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from contextlib import suppress
from typing import Any, NamedTuple

from sal_height_msgs.msg import SensorInfo

from sal_height import messages
from sal_height.errors import Rejected, UserError
from sal_height.nodes.dwell import Dwell, DwellAssembler
from sal_height.nodes.stage import LATCHED_QOS, Stage
from sal_height.sensor import Sensor

HELD_DWELLS = 8
"""Unfinished dwells held before the oldest is dropped."""

HELD_MESSAGES = 256
"""Messages held that wait for their sensor info."""

HELD_SENSORS = 4
"""Sensor descriptions held: messages made with one may come after the next."""


class _Stream(NamedTuple):
    """A sensor description and the unfinished dwells made with it."""

    sensor: Sensor
    assembler: DwellAssembler[Any]


class DwellStage(Stage):
    """Takes one message per detector and hands over complete dwells.

    Messages that come before their sensor info wait for it. What does not become complete within the timeout is
    dropped and counted; the next dwell is not affected.
    """

    def __init__(self, name: str, message_type: type, topic: str, **node_arguments: Any) -> None:
        """Declare the parameters; subscribe to `topic` and to sensor_info.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(name, **node_arguments)
        self._timeout = self.current_parameters().timeout_s
        self._streams: dict[str, _Stream] = {}
        self._early: list[tuple[float, Any]] = []
        self.listen(SensorInfo, "sensor_info", self._on_sensor_info, LATCHED_QOS)
        self.listen(message_type, topic, self._on_message)
        self.create_timer(0.1, self.advance, clock=self.steady_clock)

    @abstractmethod
    def check(self, message: Any, sensor: Sensor) -> None:
        """Raise Rejected if the message cannot be processed with `sensor`."""

    def supplies(self, dwell: list[Any], sensor: Sensor) -> Any:  # noqa: ARG002 (subclasses use them)
        """What a dwell needs besides its messages, as it is now; it is handed over together with them.

        Raises:
            Rejected: it has not come yet; why the dwell is dropped if it never does.
        """
        return None

    @abstractmethod
    def process(self, dwell: list[Any], sensor: Sensor, supplies: Any) -> int:
        """Process the messages of all channels (on the worker thread).

        Args:
            dwell: one message per channel, in the order of the channels.
            sensor: that they were made with.
            supplies: what `supplies` returned when the dwell was complete.

        Returns:
            The number of messages published.
        """

    def identity(self, message: Any) -> str:
        """The config_hash of the sensor info that a message was made with."""
        return str(message.config_hash)

    def advance(self) -> None:
        """Hand over what is complete; drop what has waited too long."""
        now = time.monotonic()
        for sensor, assembler in self._streams.values():
            for dwell in assembler.complete(sensor.detector_count):
                with suppress(Rejected):
                    supplies = self.supplies(dwell.messages, sensor)
                    self._hand_over(assembler.take(dwell), sensor, supplies)
            for dwell in assembler.overdue(now):
                reason = self._why_unfinished(dwell, sensor, now)
                self.reject(len(assembler.take(dwell)), reason)
        overdue = [message for began, message in self._early if now - began > self._timeout]
        for message in overdue:
            self.reject(1, self._unmatched(message))
        self._early = self._early[len(overdue) :]

    def _hand_over(self, dwell: list[Any], sensor: Sensor, supplies: Any) -> None:
        self.submit(len(dwell), lambda: self.process(dwell, sensor, supplies))

    def _on_sensor_info(self, message: SensorInfo) -> None:
        try:
            sensor = messages.sensor_from_message(message)
        except UserError as error:
            self.ignore("sensor info", error)
            return
        stream = self._streams.pop(sensor.config_hash, _Stream(sensor, DwellAssembler(HELD_DWELLS, self._timeout)))
        stream.assembler.forget_finished()
        self._streams[sensor.config_hash] = stream._replace(sensor=sensor)
        if len(self._streams) > HELD_SENSORS:
            self._give_up(self._streams.pop(next(iter(self._streams))))
        waiting, self._early = self._early, []
        for began, early in waiting:
            self._take_in(early, began)

    def _give_up(self, stream: _Stream) -> None:
        """Drop the unfinished dwells of a sensor that has been replaced."""
        for dwell in stream.assembler.overdue(math.inf):
            reason = self._why_unfinished(dwell, stream.sensor, math.inf)
            self.reject(len(stream.assembler.take(dwell)), reason)

    def _on_message(self, message: Any) -> None:
        self.tally.receive()
        self._take_in(message, time.monotonic())

    def _take_in(self, message: Any, arrived: float) -> None:
        stream = self._streams.get(self.identity(message))
        if stream is None:
            self._early.append((arrived, message))
            if len(self._early) > HELD_MESSAGES:
                self.reject(1, self._unmatched(self._early.pop(0)[1]))
            return
        key = (message.dwell, messages.to_ns(message.header.stamp))
        try:
            self.check(message, stream.sensor)
            stream.assembler.add(key, message.detector, message, arrived)
        except Rejected as error:
            self.reject(1, error)
        self.advance()

    def _why_unfinished(self, dwell: Dwell[Any], sensor: Sensor, now: float) -> Rejected:
        name = f"Dwell {dwell.key[0]}"
        if now - dwell.began <= self._timeout:
            return Rejected("buffer full", f"{name}: more than {HELD_DWELLS} unfinished dwells; the oldest had to go.")
        absent = sorted(set(range(sensor.detector_count)) - set(dwell.items))
        if absent:
            return Rejected("incomplete dwell", f"{name}: detectors {absent} did not come within {self._timeout:g} s.")
        try:
            self.supplies(dwell.messages, sensor)
        except Rejected as missing:
            return missing
        return Rejected("incomplete dwell", f"{name}: completed too late.")

    def _unmatched(self, message: Any) -> Rejected:
        if not self._streams:
            return Rejected("no sensor info", "No usable message on sensor_info; publish one (transient local).")
        known = ", ".join(self._streams)
        return Rejected(
            "contradicts sensor info",
            f"Dwell {message.dwell}, detector {message.detector}: config_hash {self.identity(message)!r} is none of "
            f"those on sensor_info ({known}).",
        )
