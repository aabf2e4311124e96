"""A stage that works on whole dwells: it gathers their messages, and the sensor that they belong to."""

from __future__ import annotations

import copy
import time
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from sal_height import messages
from sal_height.calibration import Calibration
from sal_height.errors import Rejected, UserError
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import ChannelFrame, ComplexImage, SensorInfo
from sal_height.nodes.dwell import Dwell, DwellAssembler, Key, WaitingClock
from sal_height.nodes.held import Held
from sal_height.nodes.stage import ENDED, LATCHED_QOS, Stage, StageParameters
from sal_height.sensor import Sensor
from sal_height.settings import setting

HELD_EARLY = 256
"""Messages held that wait for their sensor info: a dwell of the greatest number of channels, twice."""

HELD_SENSORS = 4
"""Sensor descriptions held: messages made with one may come after the next. Those of which messages have come stay."""

CONTRADICTION = (
    "SensorInfo contradicts the earlier one of config_hash {!r}, which stays in force; give a description whose values "
    "have changed another config_hash."
)

GONE_AFTER = 3
"""Dwells in a row that lack a channel before the next ones are no longer held back for it."""

MAY_BE_LOST = (
    "messages get lost or come late where this node lags, or where the publisher has little shared memory "
    "(`sal-height transport` gives it more)"
)
"""Why messages that were published may not come."""

RESET = Rejected("reset", "The node was reset before the dwell was complete.")

REHEARSED_BYTES = 32_000_000
"""Largest dwell that is rehearsed: the work on a larger one takes longer than tables and loading of code."""

TICK_S = 0.1
"""Period at which the node looks for dwells that are overdue."""


READERS: dict[type, Callable[[bytes], Any]] = {
    ChannelFrame: messages.received_frame,
    ComplexImage: messages.received_image,
}
"""What makes a message of its bytes, by its type."""


class DwellParameters(StageParameters):
    """Parameters of every node that waits for what belongs to a dwell."""

    timeout_s: float = setting(
        5.0,
        "longest wait for what a dwell lacks; it counts while the node has nothing else to do, or once the sensor has "
        "moved on by as much",
        unit="s",
        minimum=0.01,
        maximum=3600.0,
    )
    max_unfinished_dwells: int = setting(
        8, "unfinished dwells that are held before the oldest is given up", minimum=1, maximum=10_000
    )


class ChannelParameters(DwellParameters):
    """Parameters of every node that takes one message of each channel."""

    missing_channels: str = setting(
        "refuse",
        "what becomes of a dwell of which channels have not come in time: refuse drops it, proceed processes the other "
        "channels as if these were dead",
        choices=("refuse", "proceed"),
    )
    min_channels: int = setting(
        2, "smallest number of channels to proceed with if others are missing", minimum=1, maximum=128
    )


class _Early(NamedTuple):
    """A message that waits for its sensor info, and when it came, s of a steady clock."""

    message: Any
    came: float


class WholeDwell(NamedTuple):
    """A dwell that waits for its processing.

    Attributes:
        messages: one of each channel, in their order.
        sensor: that they were made with.
        supplies: what `DwellStage.supplies` returned.
    """

    messages: list[Any]
    sensor: Sensor
    supplies: Any


class DwellStage(Stage):
    """Takes one message per channel and hands over complete dwells.

    Messages that come before their sensor info wait for it. A dwell that stays incomplete is given up and counted, and
    the next one is not affected. It is given up when the node has waited for timeout_s without anything to do; or when
    the dwell is older than timeout_s and messages come whose stamps are that far from its own. So neither a slow
    machine nor a source that waits for the graph makes a dwell time out. The same holds for a message whose sensor info
    does not come.
    """

    parameters: type[DwellParameters] = DwellParameters

    def __init__(self, name: str, message_type: type, topic: str, **node_arguments: Any) -> None:
        """Declare the parameters; subscribe to `topic` and to sensor_info.

        Names of parameters in braces in `topic` stand for their values.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(name, **node_arguments)
        self._sensors = Held[Sensor](HELD_SENSORS)
        self._assembler: DwellAssembler[Any] = DwellAssembler(self.channels_of)
        self._early: list[_Early] = []
        self._latest_ns = 0
        self._waiting = WaitingClock()
        self._absences: dict[str, Counter[int]] = {}
        self._rehearsed = False
        self._to_rehearse: Sensor | None = None
        self._message_type = message_type
        self.listen(SensorInfo, "sensor_info", self._on_sensor_info, LATCHED_QOS)
        topic = topic.format_map(dict(self.current_parameters()))
        self._inlet = self.listen(message_type, topic, self._on_message, read=self.decode)
        self.every(TICK_S, self._tick)

    def channels_of(self, sensor: Sensor) -> int:
        """Number of messages that make a dwell of a sensor whole."""
        return sensor.detector_count

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

    def decode(self, cdr: bytes) -> Any:
        """The message of one channel that these bytes are.

        Raises:
            RuntimeError: they are none.
        """
        return READERS[self._message_type](cdr)

    def read_calibration(self, message: CalibrationMessage) -> Calibration | None:
        """The calibration of a message; None: it cannot be used, which is counted."""
        try:
            return messages.calibration_from_message(message)
        except UserError as error:
            self.ignore("calibration", error)
            return None

    def rehearse(self, sensor: Sensor) -> None:
        """Process a made-up dwell of `sensor`, and publish nothing (on the worker thread)."""

    @property
    def is_ready(self) -> bool:
        """Whether a sensor is described and the node has rehearsed for it: the first dwell takes no longer then."""
        return self._rehearsed and super().is_ready

    def advance(self) -> None:
        """Hand over what is complete; give up what has waited too long or is too much to hold."""
        parameters, now = self.current_parameters(), time.monotonic()
        idle = self._waiting.waited_s > parameters.timeout_s
        for dwell in self._assembler.held():
            missing = self._hand_over(dwell) if self._is_complete(dwell) else None
            old = now - dwell.began > parameters.timeout_s and self._assembler.is_passed(dwell, parameters.timeout_s)
            if (idle or old) and dwell in self._assembler:
                self._give_up(dwell, missing or self._incomplete(dwell, f"within {parameters.timeout_s:g} s"))
        for dwell in self._assembler.surplus(parameters.max_unfinished_dwells, parameters.max_memory_bytes):
            self._give_up(dwell, self._surplus(dwell))
        self._limit_early(parameters, idle, now)

    def forget(self) -> None:
        """Drop what has not become a whole dwell yet, and forget what has been gathered of those before."""
        self._drop_unfinished(RESET)
        for config_hash, absences in self._absences.items():
            absences.clear()
            self._assembler.forget_finished(config_hash)
        super().forget()

    def destroy_node(self) -> None:
        """Drop what has not become a whole dwell yet, and end the node."""
        self._drop_unfinished(ENDED)
        super().destroy_node()

    def _drop_unfinished(self, reason: Rejected) -> None:
        """Drop the messages of unfinished dwells, and those that wait for their sensor info."""
        for dwell in self._assembler.held():
            self._assembler.take(dwell)
            self.reject(len(dwell.items), reason)
        early, self._early = self._early, []
        if early:
            self.reject(len(early), reason)

    def note_progress(self) -> None:
        """Something that dwells wait for has come: the node has not been waiting in vain."""
        self._waiting.restart()

    def _tick(self) -> None:
        self._waiting.tick(time.monotonic(), busy=self.jobs > 0)
        self.advance()

    def _is_complete(self, dwell: Dwell[Any]) -> bool:
        """Whether all channels have come, except those that are given up."""
        absences = self._absences.get(dwell.key.config_hash, Counter())
        return not dwell.absent or (self._may_proceed(dwell) and all(absences[c] >= GONE_AFTER for c in dwell.absent))

    def _may_proceed(self, dwell: Dwell[Any]) -> bool:
        """Whether the channels that have come may be processed without the others."""
        parameters = self.current_parameters()
        if not isinstance(parameters, ChannelParameters):
            return False
        return parameters.missing_channels == "proceed" and len(dwell.items) >= parameters.min_channels

    def _hand_over(self, dwell: Dwell[Any]) -> Rejected | None:
        """Submit a dwell, with blank messages for channels that are absent, if there is all that it needs.

        Returns:
            What it still waits for, or None.
        """
        frames = with_blanks(dwell)
        try:
            supplies = self.supplies(frames, dwell.sensor)
        except Rejected as missing:
            return missing
        except Exception as error:  # noqa: BLE001 (no message may end the node, nor stay for ever)
            self._assembler.take(dwell)
            self.reject(len(dwell.items), self.unexpected(error))
            return None
        self._assembler.take(dwell)
        if dwell.absent:
            sentence = f"Dwell {dwell.key.number} is processed without channels {dwell.absent}, which have not come."
            self.ignore("missing channels", UserError(sentence))
        whole = WholeDwell(frames, dwell.sensor, supplies)
        self.submit(len(dwell.items), lambda: self.process(*whole), dwell.size, whole)
        return None

    def _give_up(self, dwell: Dwell[Any], reason: Rejected) -> None:
        """End the wait for a dwell: proceed with the channels that have come if that is allowed, or drop it."""
        self._absences.setdefault(dwell.key.config_hash, Counter()).update(dwell.absent)
        if dwell.absent and self._may_proceed(dwell):
            missing = self._hand_over(dwell)
            if missing is None:
                return
            reason = missing
        self._assembler.take(dwell)
        self.reject(len(dwell.items), reason)

    def _limit_early(self, parameters: DwellParameters, idle: bool, now: float) -> None:
        """Drop messages that have waited too long for their sensor info, and the oldest of too many."""
        kept: list[_Early] = []
        size = 0
        for early in reversed(self._early):
            size += early.message.size
            passed_s = abs(self._latest_ns - early.message.stamp_ns) * 1e-9
            overdue = idle or min(now - early.came, passed_s) > parameters.timeout_s
            if overdue or len(kept) == HELD_EARLY or size > parameters.max_memory_bytes:
                self.reject(1, self._unmatched(early.message))
            else:
                kept.append(early)
        self._early = kept[::-1]

    def _on_sensor_info(self, message: SensorInfo) -> None:
        try:
            sensor = messages.sensor_from_message(message)
        except UserError as error:
            self.ignore("sensor info", error)
            return
        known = self._sensors.get(sensor.config_hash)
        if known is not None and known.digest != sensor.digest:
            self.ignore("sensor info", UserError(CONTRADICTION.format(sensor.config_hash)))
            return
        self.hardware_id = sensor.name
        if known is None and not self._sensors.is_in_use:
            self._rehearse_with(sensor)
        gone = self._sensors.put(sensor.config_hash, sensor)
        self._absences.setdefault(sensor.config_hash, Counter())
        self._assembler.forget_finished(sensor.config_hash)
        if gone:
            self._forget(gone)
        waiting, self._early = self._early, []
        for early in waiting:
            self._take_in(early.message, early.came)
        self.advance()

    def _rehearse_with(self, sensor: Sensor) -> None:
        """Rehearse once the worker comes to it; if more sensors are described until then, with the last one only."""
        is_due, self._to_rehearse = self._to_rehearse is not None, sensor
        if not is_due:
            self.submit(0, self._rehearse)

    def _rehearse(self) -> int:
        """Rehearse; whatever goes wrong will be told when it concerns a dwell.

        There is no rehearsal for large dwells, which would gain little and wait long for it, nor once messages of a
        sensor have come, which are to be processed.
        """
        sensor, self._to_rehearse = self._to_rehearse, None
        if sensor and sensor.dwell_bytes <= REHEARSED_BYTES:
            with suppress(Exception):
                self.rehearse(sensor)
        self._rehearsed = True
        return 0

    def _forget(self, config_hash: str) -> None:
        """Drop the unfinished dwells of a sensor whose description is not held any more."""
        for dwell in self._assembler.held():
            if dwell.key.config_hash == config_hash:
                missing = None if dwell.absent else self._hand_over(dwell)
                if dwell in self._assembler:
                    self._give_up(dwell, missing or self._incomplete(dwell, "before other sensors replaced theirs"))
        self._absences.pop(config_hash, None)
        self._assembler.forget_finished(config_hash)

    def _on_message(self, message: Any) -> None:
        if not self.takes():
            return
        self._waiting.restart()
        if self._take_in(message, time.monotonic()):
            self.advance()

    def _take_in(self, message: Any, now: float) -> bool:
        """Add a message to its dwell; whether there may be something to hand over or to give up now."""
        try:
            sensor = self._sensors.use(message.config_hash)
            if sensor is None:
                self._early.append(_Early(message, now))
                self._latest_ns = message.stamp_ns
                return True
            self.check(message, sensor)
            absences = self._absences[sensor.config_hash]
            absences.pop(message.channel, None)
            dwell = self._assemble(message, sensor, now)
            self._latest_ns = message.stamp_ns
        except Exception as error:  # noqa: BLE001 (no message may end the node)
            self.reject(1, self.unexpected(error))
            return False
        parameters = self.current_parameters()
        crowded = self._assembler.is_crowded(parameters.max_unfinished_dwells, parameters.max_memory_bytes)
        return dwell.is_whole or crowded or bool(absences)

    def _assemble(self, message: Any, sensor: Sensor, now: float) -> Dwell[Any]:
        """Add a message to its dwell.

        Raises:
            Rejected: the same has come before; if several nodes publish, they may all do so.
        """
        key = Key(sensor.config_hash, message.dwell, message.stamp_ns)
        try:
            return self._assembler.add(key, sensor, message.channel, message, now, message.size)
        except Rejected as error:
            if self._inlet.publishers < 2:
                raise
            crowd = f"{self._inlet.publishers} nodes publish {self._inlet.topic}: each must have channels of its own."
            raise Rejected(error.reason, f"{error} {crowd}") from error

    def _incomplete(self, dwell: Dwell[Any], when: str) -> Rejected:
        return Rejected(
            "incomplete dwell",
            f"Dwell {dwell.key.number}: channels {dwell.absent} did not come {when}; {MAY_BE_LOST}.",
        )

    def _surplus(self, dwell: Dwell[Any]) -> Rejected:
        parameters = self.current_parameters()
        awaited = f"channels {dwell.absent}" if dwell.absent else "what it needs besides its channels"
        return Rejected(
            "buffer full",
            f"Dwell {dwell.key.number} was the oldest unfinished one of more than {parameters.max_unfinished_dwells} "
            f"(max_unfinished_dwells) or {parameters.max_memory_mb} MB (max_memory_mb); it still waited for {awaited}; "
            f"{MAY_BE_LOST}.",
        )

    def _unmatched(self, message: Any) -> Rejected:
        if not self._sensors:
            return Rejected("no sensor info", "No usable message on sensor_info; publish one (transient local).")
        known = ", ".join(self._sensors)
        return Rejected(
            "contradicts sensor info",
            f"Dwell {message.dwell}, channel {message.channel}: config_hash {message.config_hash!r} is none of "
            f"those on sensor_info ({known}).",
        )


def with_blanks(dwell: Dwell[Any]) -> list[Any]:
    """The messages of all channels of a dwell, with blank ones in the place of those that have not come."""
    blanks = {channel: _blank(dwell.messages[0], channel) for channel in dwell.absent}
    items = {**dwell.items, **blanks}
    return [items[channel] for channel in sorted(items)]


def _blank(message: Any, channel: int) -> Any:
    """A message of zeros in the place of one that has not come: estimators leave such a channel out as dead."""
    blank = copy.copy(message)
    blank.channel = channel
    blank.samples = np.zeros_like(message.samples)
    return blank
