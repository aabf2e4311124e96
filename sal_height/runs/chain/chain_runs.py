"""Bags on the chain host: how their dwells were processed in flight is found out, and they are processed so again.

Nothing here needs ROS. Products are those of nodes, value for value.
"""

from __future__ import annotations

import bisect
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import accumulate, islice
from pathlib import Path
from typing import Any, NamedTuple

from sal_height.bag.described import sensors_of
from sal_height.bag.played import ALL, chosen, read_contents
from sal_height.bag.reader import BagMessage
from sal_height.calibration import Calibration
from sal_height.engine.air import AIR_PARAMETERS
from sal_height.engine.calibrations import StatedCalibration
from sal_height.engine.chain import Chain, Made
from sal_height.engine.compression import Compression
from sal_height.engine.results import DwellKey, Loss, Notice, reason_of
from sal_height.engine.stage import FOREVER_NS, Stage
from sal_height.errors import UserError
from sal_height.graph.catalogue import ADJUSTER, DETECTOR, NodeParameters, consumers, parameters_of
from sal_height.graph.plan import ALL_PROCESSED, AsFlown, Plan
from sal_height.messages.kinds import kind_of_topic
from sal_height.progress import Bar
from sal_height.runs.chain.entry import Part, chain_of
from sal_height.runs.chain.replay_parameters import ReplayPlan, processing_of
from sal_height.runs.chain.stage_run import Fed, StageRun
from sal_height.sensor import Sensor
from sal_height.topics import CALIBRATION, ODOMETRY, PHASE_HISTORY, SENSOR_INFO, TF_STATIC

COMPRESSION = "sar_compression"

TAKEN = (ODOMETRY, *AIR_PARAMETERS, PHASE_HISTORY)
"""Topics of a whole replay that are read in the order of the bag."""


class _Read(NamedTuple):
    """Items of a message, the loss if it cannot be used, and a flag that is True if it cannot be decoded."""

    items: Sequence[Any]
    refused: Loss | Notice | None = None
    is_broken: bool = False


def plan(bag: Path, given: NodeParameters, estimators: Collection[str] = (), *, for_heights: bool = True) -> ReplayPlan:
    """Find out how the dwells of a bag were processed in flight, and what of that the user wants otherwise.

    Args:
        bag: folder of the bag, or its file.
        given: parameters of nodes that replace recorded ones.
        estimators: names of those whose heights are made; none: as `chain_of` has it.
        for_heights: True if a bag of one detector is refused.

    Raises:
        UserError: the bag cannot be used, or a parameter is not allowed.
    """
    part = Part()
    reader = part.open(bag)
    chain = chain_of(reader, PHASE_HISTORY, estimators)
    made_here = replace(
        chain,
        makers=[name for name in chain.makers if name not in (ADJUSTER, DETECTOR)],
        stages=[name for name in chain.stages if name not in (ADJUSTER, DETECTOR)],
    )
    if for_heights and not made_here.makers:
        raise UserError(f"Bag {bag} is of a sensor with one detector, of which no heights can be made.")
    processing = processing_of(reader, chain, part, consumers(made_here.makers), given)
    if not processing.frames:
        raise UserError(f"Bag {bag} has no readable frame on topic {PHASE_HISTORY}; see `sal-height bag check {bag}`.")
    return replace(processing, chain=made_here)


class BagRun(StageRun):
    """The dwells of a bag, processed by stages that are joined by calls.

    Attributes:
        scheme: how the dwells of the bag are processed.
        sensors: sensors that the bag describes, by config_hash.
    """

    def __init__(
        self,
        scheme: ReplayPlan,
        names: Sequence[str],
        *,
        topics: Sequence[str] = TAKEN,
        jobs: int = 1,
        settings: Mapping[str, Any] | None = None,
        as_flown: AsFlown = ALL_PROCESSED,
    ) -> None:
        """Make the stages.

        Args:
            scheme: how the dwells of the bag are processed.
            names: names of the stages, in the order of the data.
            topics: topics that are fed in the order of the bag.
            jobs: dwells that are processed side by side.
            settings: settings of stages that replace those of the scheme.
            as_flown: dwells that stages leave out as in flight.

        Raises:
            UserError: a value is not allowed, or a file cannot be read.
        """
        given = settings or {}
        values = {name: given.get(name, parameters_of(name, scheme.values.get(name, {}))) for name in names}
        self.scheme = scheme
        self._reader, self._topics = scheme.reader, topics
        self._as_flown = as_flown
        if COMPRESSION in values and values[COMPRESSION].mounting_from_tf and not self._has(TF_STATIC):
            raise UserError(
                f"Bag {scheme.reader.path} has no topic {TF_STATIC}, from which parameter mounting_from_tf takes the "
                "place of the sensor; record it with the flight, or set sar_compression.mounting_from_tf to false."
            )
        super().__init__(values, jobs)
        self.sensors, refused = sensors_of(self._reader) if self._has(SENSOR_INFO) else ({}, [])
        for error in refused:
            self.losses.note("sensor info", str(error))
        dwells = sorted(scheme.frames.items(), key=lambda item: item[1].last_ns)
        self._ends_ns = [times.last_ns for _, times in dwells]
        stamps = (dwell.stamp_ns for dwell, _ in reversed(dwells))
        self._none_before = [*list(accumulate(stamps, min))[::-1], FOREVER_NS]
        self._ended = 0

    def results(self, doing: str = "", fed: Fed | None = None) -> Iterator[Made]:
        """Products that the stages make of the dwells, and their losses, as of `StageRun.results`."""
        with ExitStack() as stack:
            chain = self.joined(stack)
            self._state_mountings()
            self._schedule_changes(chain)
            yield from self.accounted(self._fed(chain, doing, fed))

    @property
    def begin_ns(self) -> int:
        """Time of the first message of the bag, ns."""
        return self._reader.begin_ns

    def time_of(self, dwell: DwellKey) -> int:
        """Time at which the last frame of a dwell was recorded, ns."""
        return self.scheme.frames[dwell].last_ns

    def _state_mountings(self) -> None:
        """Have the compression use the mountings of the flight."""
        for stage in self.stages.values():
            if isinstance(stage, Compression):
                for sensor, mounting in self.scheme.mountings.items():
                    stage.state_mounting(sensor, mounting)

    def _schedule_changes(self, chain: Chain) -> None:
        """Schedule settings and calibrations of the flight, each from its dwell on, and dwells to be left out."""
        now = dict(self.settings)
        calibrations = self.calibrations()
        for change in self.scheme.changes:
            for name, wanted in change.parameters.items():
                if name in now:
                    now[name] = now[name].changed(**wanted)
                    chain.change(self.stages[name], now[name], change.dwell)
            for one, _ in filter(None, map(calibrations.get, change.calibrations)):
                for name, stage in self.stages.items():
                    if CALIBRATION in {port.name for port in stage.inputs(now[name])}:
                        self._give_calibration(chain, stage, change.dwell, StatedCalibration(one))
        for name, stage in self.stages.items():
            for dwell, item in self._as_flown.scheduled(name):
                chain.schedule(stage, dwell, "", item)

    def _give_calibration(self, chain: Chain, stage: Stage, before: DwellKey, item: StatedCalibration) -> None:
        """Have the compression apply a calibration from a dwell on; others look it up by its identity."""
        if isinstance(stage, Compression):
            chain.schedule(stage, before, CALIBRATION, item)
        else:
            chain.give(stage, CALIBRATION, item)

    def calibrations(self) -> dict[str, tuple[Calibration, BagMessage]]:
        """The calibrations of the bag that were applied and can be used, with their messages, by their identity.

        Raises:
            UserError: the bag is damaged.
        """
        named = {name for change in self.scheme.changes for name in change.calibrations}
        found: dict[str, tuple[Calibration, BagMessage]] = {}
        for recorded in self._messages([CALIBRATION]) if named else ():
            items, trouble, _ = self._read(CALIBRATION, recorded)
            if trouble:
                self.losses.add(COMPRESSION, trouble)
            for item in items:
                if item.calibration.id in named:
                    found[item.calibration.id] = item.calibration, recorded
        return found

    def _fed(self, chain: Chain, doing: str, fed: Fed | None) -> Iterator[Made]:
        if fed:
            self._pass_latched(fed)
        yield from chain.start(self._reader.begin_ns)
        for sensor in self.sensors.values():
            yield from chain.feed(SENSOR_INFO, sensor)
        for recorded in self._messages([TF_STATIC]):
            yield from self._feed(chain, TF_STATIC, recorded, None)
        yield from chain.nothing_before(TF_STATIC, FOREVER_NS)
        for port in set(AIR_PARAMETERS).intersection(self._topics):  # earlier dwells have waited for it
            for recorded in islice(self._messages([port]), 1):
                for item in self._read(port, recorded).items:  # a refused one is counted where it is fed
                    yield from chain.feed(port, item)
        messages = self._chosen()
        if doing:
            topics = (self._reader.topics[_topic_of(port)] for port in self._topics if self._has(port))
            messages = Bar(messages, total=sum(topic.count for topic in topics), unit="message", desc=doing)
        for recorded in messages:
            yield from self._announced(chain, recorded.log_time_ns)
            yield from self._feed(chain, recorded.topic.lstrip("/"), recorded, fed)
        yield from self._announced(chain, FOREVER_NS)
        yield from chain.finish()

    def _pass_latched(self, fed: Fed) -> None:
        """Pass on the calibrations that were applied, and the descriptions of sensors."""
        for _, recorded in self.calibrations().values():
            fed(CALIBRATION, recorded, ())
        for recorded in self._messages([SENSOR_INFO]):
            fed(SENSOR_INFO, recorded, None if self._read(SENSOR_INFO, recorded).is_broken else ())

    def _feed(self, chain: Chain, port: str, recorded: BagMessage, fed: Fed | None) -> Iterator[Made]:
        """Feed a message of the bag; one that cannot be used is counted, as a node counts it."""
        items, refused, is_broken = self._read(port, recorded)
        if fed:
            fed(port, recorded, None if is_broken else items)
            if is_broken:
                return
        if refused:
            yield Made(next(iter(self.stages.values())), None, refused)
        for item in items:
            yield from chain.feed(port, item)

    def _chosen(self) -> Iterator[BagMessage]:
        """The messages of the dwells that are processed, and what belongs to them."""
        if self.scheme.dwells == ALL:
            return self._messages(self._topics)
        return (one.recorded for one in chosen(read_contents(self._messages(self._topics)), self.scheme.dwells))

    def _announced(self, chain: Chain, now_ns: int) -> Iterator[Made]:
        """Let the stages know which dwells have had their last frame before a time of the bag."""
        ended = bisect.bisect_left(self._ends_ns, now_ns)
        if ended > self._ended:
            self._ended = ended
            yield from chain.nothing_before(PHASE_HISTORY, self._none_before[ended])

    def _messages(self, ports: Collection[str]) -> Iterator[BagMessage]:
        topics = [_topic_of(port) for port in ports if self._has(port)]
        return self._reader.messages(topics) if topics else iter(())

    def _has(self, port: str) -> bool:
        """True if the bag has a topic."""
        return _topic_of(port) in self._reader.topics

    def _read(self, port: str, recorded: BagMessage) -> _Read:
        """Items of a message, and the loss if it cannot be used."""
        kind = kind_of_topic(port)
        if recorded.type_name != kind.type_name:
            return _Read(())
        try:
            return _Read(kind.read(recorded.cdr, self.settings.get(COMPRESSION)))
        except UserError as error:
            is_broken, reason, sentence = False, reason_of(error), f"A message on {port} is not used. {error}"
        except RuntimeError as error:
            is_broken, reason, sentence = True, "broken message", f"A message on {port} cannot be decoded: {error}."
        if kind.trouble:
            return _Read((), Notice(kind.trouble, sentence), is_broken)
        return _Read((), Loss(None, 1, reason, sentence, is_dwell=False), is_broken)


def _topic_of(port: str) -> str:
    """The topic of a port, in the names of the reader."""
    return f"/{port.lstrip('/')}"


def run_of(plan: Plan, processing: ReplayPlan, jobs: int) -> BagRun:
    """The dwells of a bag as a replay processes them without nodes.

    Raises:
        UserError: a value is not allowed, or a file cannot be read.
    """
    topics = [topic for topic in plan.played if topic != SENSOR_INFO]
    scheme = replace(processing, values=plan.parameters)
    return BagRun(scheme, plan.stages, topics=topics, jobs=jobs, as_flown=plan.as_flown)


def only_sensor(run: BagRun) -> Sensor:
    """The sensor of a bag that has one.

    Raises:
        UserError: it describes several.
    """
    if len(run.sensors) > 1:
        names = ", ".join(sensor.name for sensor in run.sensors.values())
        bag = run.scheme.reader.path
        raise UserError(f"Bag {bag} describes several sensors ({names}); cut it by `sal-height bag cut`.")
    (sensor,) = run.sensors.values()
    return sensor
