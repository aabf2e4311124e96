"""A stage that works on whole dwells: it gathers their messages and the sensor that they belong to."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

from sal_height.engine.gathering import Dwell, DwellAssembler, WaitingClock
from sal_height.engine.kept import Kept
from sal_height.engine.results import DwellKey, Result
from sal_height.engine.settings import DwellSettings
from sal_height.engine.stage import ENDED, FOREVER_NS, RESET, Job, Port, Rehearsal, Reset, Stage
from sal_height.errors import Rejected, UserError
from sal_height.sensor import Sensor
from sal_height.topics import SENSOR_INFO

EARLY_KEPT = 256
"""Messages that wait for their sensor info: a dwell of the greatest number of channels, twice."""

SENSORS_KEPT = 4
"""Sensor descriptions that are kept: messages made with one may arrive after the next. Those of which messages have
arrived stay."""

CONTRADICTION = (
    "SensorInfo contradicts the earlier one of config_hash {!r}, which stays in force; give a description whose values "
    "have changed another config_hash."
)

GONE_AFTER = 3
"""Dwells in a row that lack a channel before the next ones no longer wait for it."""

MAY_BE_LOST = (
    "messages get lost or arrive late where this node lags, or where the publisher has little shared memory "
    "(`sal-height transport` gives it more)"
)
"""Why messages that were published may not arrive."""

REHEARSED_BYTES = 32_000_000
"""Largest dwell that is rehearsed: the work on a larger one takes longer than tables and loading of code."""


SENSOR_PORT = Port(SENSOR_INFO, Sensor, "description of the sensor, latched", latched=True)


class _Early(NamedTuple):
    """A message that waits for its sensor info, and the time at which it arrived, s of the host's clock."""

    message: Any
    arrived: float


class WholeDwell(NamedTuple):
    """A dwell that is complete.

    Attributes:
        key: sensor, number and stamp.
        messages: messages of all channels, in their order; or the item that is all of them.
        sensor: sensor that they were made with.
        supplies: result of `DwellStage.supplies`.
    """

    key: DwellKey
    messages: Any
    sensor: Sensor
    supplies: Any


class DwellStage(Stage):
    """Accepts one message per channel and makes a job of each complete dwell.

    Messages that arrive before their sensor info wait for it. A dwell that stays incomplete is given up and counted,
    and the next one is not affected. Where the source announces what no longer arrives, it is given up exactly then,
    and dwells are processed in the order of their first messages. Otherwise it is given up when the stage has waited
    for timeout_s without anything to do; or when the dwell is older than timeout_s and messages arrive whose stamps are
    that far from its own. So neither a slow machine nor a source that waits for the graph makes a dwell time out. The
    same applies to a message whose sensor info does not arrive.
    """

    settings = DwellSettings
    dwell_port: ClassVar[str]
    """Port of the messages that dwells are made of; names of settings in braces stand for their values."""

    whole_kind: ClassVar[type | None] = None
    """Class of items that are a whole dwell by themselves; `count` is the number of messages that they stand for."""

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._port = self.dwell_port.format_map(dict(self._settings))
        self._sensors = Kept[Sensor](SENSORS_KEPT)
        self._assembler: DwellAssembler[Any] = DwellAssembler(self.channels_of)
        self._early: list[_Early] = []
        self._latest_ns = 0
        self._waiting = WaitingClock()
        self._absences: dict[str, Counter[int]] = {}
        self._to_rehearse: Sensor | None = None
        self._rehearsing = self._rehearsed = False

    # Declarations of subclasses about their dwells.

    def channels_of(self, sensor: Sensor) -> int:
        """Number of messages that make a dwell of a sensor whole."""
        return sensor.detector_count

    def channel_of(self, message: Any) -> int:
        """Number of the channel of a message."""
        return int(message.channel)

    @abstractmethod
    def check(self, message: Any, sensor: Sensor) -> None:
        """Raise Rejected if the message cannot be processed with `sensor`."""

    def check_whole(self, item: Any, sensor: Sensor) -> None:
        """Raise Rejected if an item that is a whole dwell cannot be processed with `sensor`."""

    def supplies(self, key: DwellKey, messages: Any, sensor: Sensor) -> Any:  # noqa: ARG002 (subclasses use them)
        """Data that a dwell needs in addition to its messages, as they are now; they are part of the job.

        Raises:
            Rejected: they have not arrived yet; the dwell is dropped for this reason if they never do.
        """
        return None

    def note_job(self, whole: WholeDwell) -> None:
        """A job is made of a dwell."""

    def is_hopeless(self, dwell: Dwell[Any], missing: Rejected) -> bool:  # noqa: ARG002
        """True if what a dwell still waits for will not arrive, by what the source has announced."""
        return self._none_before.get(self._port, 0) == FOREVER_NS

    def series_of(self, whole: WholeDwell) -> str | None:  # noqa: ARG002
        """Series of the job of a dwell; None: it does not depend on those before."""
        return None

    def receive_other(self, port: str, item: Any) -> None:
        """Accept an item of another port than those of dwells and of sensors."""
        raise NotImplementedError(port)

    def rehearse_for(self, sensor: Sensor, settings: Any) -> None:
        """Process a made-up dwell of a sensor (the heavy side)."""

    @abstractmethod
    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        """Process a dwell (the heavy side).

        Raises:
            UserError: it cannot be processed.
        """

    # Decisions.

    @property
    def is_ready(self) -> bool:
        """True if a sensor is described and the stage has rehearsed for it: the first dwell takes no longer then."""
        return self._rehearsed

    def receive(self, port: str, item: Any) -> None:
        """Accept a description of a sensor, a message of a dwell, or another item."""
        if port == SENSOR_INFO:
            self._receive_sensor(item)
        elif port != self._port:
            self.receive_other(port, item)
        else:
            self._waiting.restart()
            if self._gather(item, self._now_s):
                self.hand_over_complete()

    def tick(self, *, busy: bool) -> None:
        """Hand over what is complete; give up what has waited too long."""
        self._waiting.tick(self._now_s, busy=busy)
        self.hand_over_complete()

    def note_progress(self) -> None:
        """Something that dwells wait for has arrived: the stage has not been waiting in vain."""
        self._waiting.restart()

    def hand_over_complete(self) -> None:
        """Make jobs of complete dwells; give up what has waited too long or takes too much memory."""
        if self._is_applying:  # a dwell that is being decided on is not decided on within that
            return
        settings, now = self._settings, self._now_s
        timed = not self.announced
        idle = timed and self._waiting.waited_s > settings.timeout_s
        for dwell in self._assembler.unfinished():
            missing = self._hand_over(dwell) if self._is_complete(dwell) else None
            if self.announced and dwell in self._assembler:
                break  # dwells are processed in the order of their first messages
            old = (
                timed
                and now - dwell.began > settings.timeout_s
                and self._assembler.is_passed(dwell, settings.timeout_s)
            )
            if (idle or old) and dwell in self._assembler:
                self._give_up(dwell, missing or self._incomplete(dwell, f"within {settings.timeout_s:g} s"))
        for dwell in self._assembler.surplus(settings.max_unfinished_dwells, settings.max_memory_bytes):
            missing = self._hand_over(dwell) if self.announced and not dwell.absent else self._surplus(dwell)
            if missing is not None:
                self._give_up(dwell, missing)
        self._limit_early(idle=idle)

    def give_up_hopeless(self) -> None:
        """Give up dwells of which channels, or what else they need, will not arrive."""
        for dwell in self._assembler.unfinished():
            with self.as_before(dwell.key):
                waits = dwell.absent and not self._is_announced_gone(dwell)
                lacks_channels = not waits and not self._is_complete(dwell)
            if lacks_channels:
                self._give_up(dwell, self._incomplete(dwell, "before the source went on"))
            elif not waits and (missing := self._hand_over(dwell)):
                with self.as_before(dwell.key):
                    is_hopeless = self.is_hopeless(dwell, missing)
                if is_hopeless:
                    self._give_up(dwell, missing)
            if dwell in self._assembler:
                break  # dwells are processed in the order of their first messages
        self._limit_early(idle=False)

    def forget(self) -> None:
        """Drop what has not become a whole dwell yet, and forget what has been gathered of those before."""
        self._drop_unfinished(RESET)
        for sensor, absences in self._absences.items():
            absences.clear()
            self._assembler.forget_finished(sensor)
        self.add_own_job(Reset(), self.own_series)

    def conclude(self) -> None:
        """Give up what waits: nothing more arrives."""
        for port in {port.name for port in self.inputs(self._settings)}:
            self._none_before[port] = FOREVER_NS
        self.give_up_hopeless()
        self.conclude_work()

    def conclude_work(self) -> None:
        """Decide what is done once all jobs have been processed."""

    def leave_out(self) -> None:
        """Drop what has not become a whole dwell yet."""
        self._drop_unfinished(ENDED)

    def follow(self, job: Job, results: Sequence[Result]) -> None:  # noqa: ARG002
        """Rehearse for the sensor that was described last, unless messages of one have arrived meanwhile."""
        if not isinstance(job.inputs, Rehearsal):
            return
        sensor, self._to_rehearse, self._rehearsing = self._to_rehearse, None, False
        if sensor is None or self._sensors.is_in_use:
            self._rehearsed = True
        else:
            self._add_rehearsal(sensor)

    def work(self, job: Job) -> Iterator[Result]:
        """Process a dwell, a rehearsal or a reset."""
        if isinstance(job.inputs, WholeDwell):
            yield from self.work_on(job.inputs, job)
        elif isinstance(job.inputs, Rehearsal) and job.inputs.sensor:
            with suppress(Exception):  # whatever goes wrong will be reported when it concerns a dwell
                self.rehearse_for(job.inputs.sensor, job.settings)
        elif isinstance(job.inputs, Reset):
            yield from self.forget_work()
        else:
            yield from self.work_otherwise(job)

    def forget_work(self) -> Iterator[Result]:
        """Forget what the heavy side keeps of the dwells before."""
        yield from ()

    def work_otherwise(self, job: Job) -> Iterator[Result]:
        """Process a job that is no dwell."""
        raise NotImplementedError(repr(job.inputs))

    def _is_complete(self, dwell: Dwell[Any]) -> bool:
        """True if all channels have arrived, except those that are given up."""
        if not dwell.absent:
            return True
        absences = self._absences.get(dwell.key.sensor, Counter())
        is_gone = all(absences[channel] >= GONE_AFTER for channel in dwell.absent)
        return (self._is_announced_gone(dwell) if self.announced else is_gone) and self._may_proceed(dwell)

    def _is_announced_gone(self, dwell: Dwell[Any]) -> bool:
        """True if the source has announced that no more channels of a dwell will arrive."""
        return dwell.key.stamp_ns < self._none_before.get(self._port, dwell.key.stamp_ns)

    def _may_proceed(self, dwell: Dwell[Any]) -> bool:
        """True if the channels that have arrived may be processed without the others."""
        settings = self._settings
        proceeds = getattr(settings, "missing_channels", "refuse") == "proceed"
        return proceeds and dwell.count >= settings.min_channels

    def _hand_over(self, dwell: Dwell[Any]) -> Rejected | None:
        """Make a job of a dwell, with blank messages for channels that are absent, if there is all that it needs.

        Returns:
            Reason for which it still waits, or None.
        """
        messages = dwell.content
        try:
            supplies = self._supplied(dwell.key, messages, dwell.sensor)
        except Rejected as missing:
            return missing
        except Exception as error:  # noqa: BLE001 (no message may end the host, nor stay for ever)
            self._lose(dwell, error)
            return None
        self._assembler.take(dwell)
        if dwell.absent:
            sentence = (
                f"Dwell {dwell.key.number} is processed without channels {dwell.absent}, which were not received."
            )
            self.warn("missing channels", UserError(sentence), dwell.key)
        whole = WholeDwell(dwell.key, messages, dwell.sensor, supplies)
        self.note_job(whole)
        self.add_job(whole.key, whole, messages=dwell.count, size=dwell.size, series=self.series_of(whole))
        return None

    def _supplied(self, key: DwellKey, messages: Any, sensor: Sensor) -> Any:
        """Data that a dwell needs, after the changes scheduled before it, which must not take effect while it waits.

        Raises:
            Rejected: they have not arrived yet.
        """
        if key in self._scheduled:
            with self.as_before(key):
                self.supplies(key, messages, sensor)
            self.apply_scheduled(key)
        return self.supplies(key, messages, sensor)

    def _give_up(self, dwell: Dwell[Any], reason: Rejected) -> None:
        """End the wait for a dwell: proceed with the channels that have arrived if that is allowed, or drop it."""
        self._absences.setdefault(dwell.key.sensor, Counter()).update(dwell.absent)
        with self.as_before(dwell.key):
            proceeds = dwell.absent and self._may_proceed(dwell)
        missing = self._hand_over(dwell) if proceeds else reason
        if missing is not None:
            self._lose(dwell, missing)

    def _lose(self, dwell: Dwell[Any], error: Exception) -> None:
        """Drop a dwell; changes scheduled before it apply to those after it."""
        self._assembler.take(dwell)
        self.drop(error, dwell.count, dwell.key)
        self.apply_scheduled(dwell.key)

    def _limit_early(self, *, idle: bool) -> None:
        """Drop messages that have waited too long for their sensor info, and the oldest of too many."""
        settings, kept, size = self._settings, list[_Early](), 0
        hopeless = idle or self._none_before.get(SENSOR_INFO, 0) == FOREVER_NS
        for early in reversed(self._early):
            size += early.message.size
            passed_s = abs(self._latest_ns - early.message.key.stamp_ns) * 1e-9
            waited_s = min(self._now_s - early.arrived, passed_s)
            overdue = hopeless or (not self.announced and waited_s > settings.timeout_s)
            if overdue or len(kept) == EARLY_KEPT or size > settings.max_memory_bytes:
                self._drop_early(self._unmatched(early.message), early.message)
            else:
                kept.append(early)
        self._early = kept[::-1]

    def _is_whole(self, message: Any) -> bool:
        """True if an item is a whole dwell by itself."""
        return self.whole_kind is not None and isinstance(message, self.whole_kind)

    def _receive_sensor(self, sensor: Sensor) -> None:
        known = self._sensors.get(sensor.config_hash)
        if known is not None and known.digest != sensor.digest:
            self.warn("sensor info", UserError(CONTRADICTION.format(sensor.config_hash)))
            return
        self.sensor_name = sensor.name
        if known is None and not self._sensors.is_in_use:
            self._add_rehearsal(sensor)
        gone = self._sensors.put(sensor.config_hash, sensor)
        self._absences.setdefault(sensor.config_hash, Counter())
        self._assembler.forget_finished(sensor.config_hash)
        if gone:
            self._forget_sensor(gone)
        waiting = [one for one in self._early if one.message.key.sensor == sensor.config_hash]
        self._early = [one for one in self._early if one.message.key.sensor != sensor.config_hash]
        for early in waiting:
            self._gather(early.message, early.arrived)
        self.hand_over_complete()

    def _add_rehearsal(self, sensor: Sensor) -> None:
        """Rehearse, but not for large dwells, which would gain little and wait long for it.

        Of sensors that are described while a rehearsal waits or runs, the last is rehearsed afterwards.
        """
        if sensor.dwell_bytes > REHEARSED_BYTES:
            self._rehearsed = self._rehearsed or not self._rehearsing
        elif self._rehearsing:
            self._to_rehearse = sensor
        else:
            self._rehearsing = True
            self.add_own_job(Rehearsal(sensor))

    def _forget_sensor(self, config_hash: str) -> None:
        """Drop the unfinished dwells of a sensor whose description is not kept any more."""
        for dwell in self._assembler.unfinished():
            if dwell.key.sensor == config_hash:
                missing = None if dwell.absent else self._hand_over(dwell)
                if dwell in self._assembler:
                    self._give_up(dwell, missing or self._incomplete(dwell, "before other sensors replaced theirs"))
        self._absences.pop(config_hash, None)
        self._assembler.forget_finished(config_hash)

    def _gather(self, message: Any, now: float) -> bool:
        """Add a message to its dwell; True if there may be something to make a job of or to give up now."""
        try:
            sensor = self._sensors.use(message.key.sensor)
            if sensor is None:
                self._early.append(_Early(message, now))
                self._latest_ns = message.key.stamp_ns
                return True
            absences = self._absences[sensor.config_hash]
            if self._is_whole(message):
                self.check_whole(message, sensor)
                dwell = self._assembler.add_whole(message.key, sensor, message, now, message.size)
            else:
                self.check(message, sensor)
                channel = self.channel_of(message)
                absences.pop(channel, None)
                dwell = self._insert(channel, message, sensor, now)
            self._latest_ns = message.key.stamp_ns
        except Exception as error:  # noqa: BLE001 (no message may end the host)
            if self._is_whole(message):
                self.drop(error, message.count, message.key)
            else:
                self.drop_message(error, message.key)
            return False
        settings = self._settings
        crowded = self._assembler.is_crowded(settings.max_unfinished_dwells, settings.max_memory_bytes)
        return dwell.is_whole or crowded or bool(absences)

    def _insert(self, channel: int, message: Any, sensor: Sensor, now: float) -> Dwell[Any]:
        """Add the message of a channel to its dwell.

        Raises:
            Rejected: the same has arrived before; if several nodes publish, they may all do so.
        """
        try:
            return self._assembler.add(message.key, sensor, channel, message, now, message.size)
        except Rejected as error:
            publishers = self.publishers_of(self._port)
            if publishers < 2:
                raise
            crowd = f"{publishers} nodes publish {self._port}: each must have channels of its own."
            raise Rejected(error.reason, f"{error} {crowd}") from error

    def _drop_unfinished(self, reason: Rejected) -> None:
        """Drop the messages of unfinished dwells, and those that wait for their sensor info."""
        for dwell in self._assembler.unfinished():
            self._lose(dwell, reason)
        early, self._early = self._early, []
        for one in early:
            self._drop_early(reason, one.message)

    def _drop_early(self, reason: Rejected, message: Any) -> None:
        """Drop a message that has waited for its sensor info."""
        if self._is_whole(message):
            self.drop(reason, message.count, message.key)
        else:
            self.drop_message(reason, message.key)

    def _incomplete(self, dwell: Dwell[Any], when: str) -> Rejected:
        return Rejected(
            "incomplete dwell",
            f"Dwell {dwell.key.number}: channels {dwell.absent} did not arrive {when}; {MAY_BE_LOST}.",
        )

    def _surplus(self, dwell: Dwell[Any]) -> Rejected:
        settings = self._settings
        awaited = f"channels {dwell.absent}" if dwell.absent else "what it needs in addition to its channels"
        return Rejected(
            "buffer full",
            f"Dwell {dwell.key.number} was the oldest unfinished one of more than {settings.max_unfinished_dwells} "
            f"(max_unfinished_dwells) or {settings.max_memory_mb} MB (max_memory_mb); it still waited for {awaited}; "
            f"{MAY_BE_LOST}.",
        )

    def _unmatched(self, message: Any) -> Rejected:
        if not self._sensors:
            return Rejected("no sensor info", "No usable message on sensor_info; publish one (transient local).")
        known = ", ".join(self._sensors)
        of = "" if self._is_whole(message) else f", channel {self.channel_of(message)}"
        return Rejected(
            "contradicts sensor info",
            f"Dwell {message.key.number}{of}: config_hash {message.key.sensor!r} is none of those on sensor_info "
            f"({known}).",
        )
