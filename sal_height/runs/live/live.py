"""`sal-height live`: the graph with a sensor that does not wait for it, a test of the core before, and the account."""

from __future__ import annotations

import bisect
import json
import logging
import math
import time
from array import array
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.task import Future

from sal_height import messages
from sal_height.bag.topics import stamp_ns_of
from sal_height.elevation import ElevationEstimator
from sal_height.engine.dwells import DwellStage
from sal_height.engine.heights import HeightStage
from sal_height.engine.movers import MOVERS
from sal_height.engine.registry import STAGES
from sal_height.errors import UserError
from sal_height.geometry import PlatformState, Trajectory
from sal_height.graph.air import check_air
from sal_height.graph.catalogue import DETECTOR, HEIGHTS, TRACKER, check_parameters, consumers
from sal_height.graph.ensemble import Conductor, Ensemble, members_of
from sal_height.graph.node_classes import NODES
from sal_height.graph.plan import RECORDER, Execution, Plan
from sal_height.graph.reporting import PARAMETERS, PRESET, merged, reporting
from sal_height.graph.supervisor import Supervisor
from sal_height.graph.watch import AccountBook, Watcher, looks
from sal_height.io import new_folder
from sal_height.messages import AIR
from sal_height.messages.types import HeightImage
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.playing.playlist import Playlist
from sal_height.nodes.transport.domain import ros_domain
from sal_height.nodes.transport.middleware import provide_shared_memory
from sal_height.numeric import available_processors
from sal_height.pipeline import Compressor, heights
from sal_height.rehearsal import made_up_heights
from sal_height.relief import PriorEstimate, track
from sal_height.runs.chain.entry import MAPPER
from sal_height.runs.live.sensor_bag import Feed
from sal_height.sensor import Sensor
from sal_height.topics import LOSSES, ODOMETRY, SENSOR_INFO
from sal_height.workers.processes import Interruption, process_age_s, run_in_copy

_LOG = logging.getLogger(__name__)

SOURCE = "paced_player"


def make_tables(sensor: Sensor, stages: list[str], values: Mapping[str, Mapping[str, Any]]) -> None:
    """Rehearse for a sensor, so that nodes that are forked later find all tables made and all code loaded."""
    parameters = {name: NODES[name].parameters(**values.get(name, {})) for name in stages}
    for name in stages:
        with suppress(UserError):  # its node will say why
            if isinstance(stage := STAGES[name](parameters[name]), DwellStage):
                stage.rehearse_for(sensor, parameters[name])
            if name == TRACKER:
                track(*made_up_heights(np.random.default_rng(0)), PriorEstimate(), parameters[name])


def core_rate_hz(
    playlist: Playlist, sensor: Sensor, stages: list[str], values: Mapping[str, Mapping[str, Any]], processors: int
) -> float:
    """Dwells per second that N processors could compress, turn into heights and track, without any messages.

    It is an upper bound of what the graph achieves: messages need time as well. Infinity: there are too few
    dwells to estimate it.
    """
    parameters = {name: NODES[name].parameters(**values.get(name, {})) for name in stages}
    estimators = _estimators(stages)
    states = [messages.state_from_message(message) for message in playlist.odometry]
    compressor, prior = Compressor(), PriorEstimate()
    begun: float | None = None
    dwells, spent_s = 0, 0.0
    for frames in playlist.frames():
        try:
            history = messages.history_from_messages(frames)
            way = _track_of(states, history.stamp_ns, history.stamp_of_last_pulse_ns)
            slc = compressor.add(history, way, sensor, parameters["sar_compression"])
            if slc is None:
                continue
            fields = [heights(slc, sensor, estimators[name], parameters[name]) for name in estimators]
            if TRACKER in stages:
                _, _, prior = track(fields[0], slc.aperture, prior, parameters[TRACKER])
        except UserError:
            continue  # its node will say why
        if begun is None:
            begun = time.process_time()
            continue
        dwells, spent_s = dwells + 1, time.process_time() - begun
        if spent_s > 0.25:  # after the first dwell, which is slower than the others
            break
    return processors * dwells / spent_s if dwells else math.inf


def _track_of(states: list[PlatformState], begin_ns: int, end_ns: int) -> Trajectory:
    """The odometry around a dwell: passes have turns between them, for which it has no states.

    Raises:
        UserError: it is empty, or contradicts itself.
    """
    stamps = [state.stamp_ns for state in states]
    first = max(0, bisect.bisect_right(stamps, begin_ns) - 1)
    return Trajectory(states[first : bisect.bisect_left(stamps, end_ns) + 1])


def _estimators(stages: list[str]) -> dict[str, ElevationEstimator]:
    """Estimators of the stages that estimate heights, by the name of the stage."""
    return {name: stage.estimator for name in stages if issubclass(stage := STAGES[name], HeightStage)}


@dataclass(frozen=True)
class Live:
    """Settings of a live run.

    Attributes:
        rate: seconds of the sensor in a second.
        seconds: duration, s; infinity: until it is interrupted.
        budget_s: latency budget; 0: that of the preset, or the default.
        supervised: True if nodes that have ended are started again.
    """

    rate: float = 1.0
    seconds: float = float("inf")
    budget_s: float = 0.0
    supervised: bool = False


@dataclass
class Watched:
    """Progress of a live graph.

    Attributes:
        elapsed_s: time since the sensor began to deliver.
        offered_hz: dwells in a second that the sensor delivers, as planned.
        book: the accounts of all nodes.
        latencies_s: latencies from the last pulse of a dwell to its height image, s, by topic.
        cpu_at_start_s: processor time of the nodes' processes when the sensor began.
        began_at_s: time when the sensor started, s since the epoch.
        start_s: time from the start of this program to the end of each step of the start, s: tables are made, dwells
            are there, all nodes are ready, the first height has arrived.
    """

    elapsed_s: float
    offered_hz: float
    book: AccountBook = field(default_factory=AccountBook)
    latencies_s: dict[str, array[float]] = field(default_factory=dict)
    cpu_at_start_s: dict[str, float] = field(default_factory=dict)
    began_at_s: float = 0.0
    start_s: dict[str, float] = field(default_factory=dict)

    def cpu_per_second(self, node: str) -> float:
        """Processor seconds that the processes of a node have used per second since the sensor started."""
        used = self.accounts[node].cpu_s - self.cpu_at_start_s.get(node, 0.0)
        return used / self.elapsed_s if self.elapsed_s else 0.0

    @property
    def accounts(self) -> dict[str, Account]:
        """Accounts of all nodes by name."""
        return {name: entry.account for name, entry in self.book.entries.items()}

    @property
    def heights(self) -> int:
        """Number of height images received."""
        return sum(len(values) for values in self.latencies_s.values())

    def as_json(self) -> dict[str, Any]:
        """Entries of report.json."""
        return {
            "start_s": self.start_s,
            "elapsed_s": self.elapsed_s,
            "sensor_dwells_per_s": self.offered_hz,
            "latency_s": {
                topic: dict(zip(("p50", "p95", "p99.9"), np.percentile(values, [50, 95, 99.9]).tolist(), strict=True))
                for topic, values in self.latencies_s.items()
                if values
            },
            "heights": {topic: len(values) for topic, values in self.latencies_s.items()},
            "processor_seconds_per_second": {name: self.cpu_per_second(name) for name in self.accounts},
            "nodes": {
                name: {**entry.account.numbers, "last_drop": entry.account.last_drop, "processes": entry.lives}
                for name, entry in self.book.entries.items()
            },
        }


def live(
    feed: Feed,
    out: Path,
    parameters: dict[str, dict[str, Any]],
    how: Live,
    execution: Execution,
    show: Callable[[Watched], None],
) -> Watched:
    """Play a sensor at its pace against the graph, until the time is over or the user interrupts.

    Args:
        feed: the sensor, whose dwells may still be simulated meanwhile.
        out: output folder, new or empty, for the bag of the products and report.json.
        parameters: values that replace those that the bag was made with.
        how: pace, duration and latency budget.
        execution: execution of the nodes, and topics to record in addition to heights and diagnostics.
        show: function called once a second with the accounts received so far.

    Raises:
        UserError: the bag or a parameter cannot be used, nodes do not start, or one ends.
    """
    values = check_parameters(merged(merged(consumers(feed.nodes), feed.parameters), parameters))
    stages = ["sar_compression", *feed.nodes, *((TRACKER, MAPPER) if feed.nodes else ())]
    make_tables(feed.sensor, stages, values)  # while the dwells are simulated
    start_s = {"tables": process_age_s()}
    playlist = feed.playlist()
    start_s["dwells"] = process_age_s()
    air = [topic for topic in AIR if any(item.topic == topic for item in playlist.items)]
    check_air(values, [feed.sensor], air, f"Bag {feed.bag}")
    interval_s = 1 / (playlist.dwell_rate_hz * how.rate)
    of_preset = json.loads(feed.custom_data.get(PRESET, "{}")).get("latency_budget_s")
    budget_s = how.budget_s or of_preset or max(3 * interval_s, 0.2)
    shares = _limits(stages, budget_s, execution)
    # The map has no latency budget: a dwell is as good for it a second later, and a large map is published that long.
    values = merged({**shares, MAPPER: {"max_queued_dwells": 256}}, values)
    source = {"bag": str(feed.bag), "rate": how.rate, "max_memory_mb": 1 + int(playlist.size / 1e6) * 2}
    folder = new_folder(out)
    topics = [f"{HEIGHTS[name]}/height" for name in stages if name in HEIGHTS]
    topics += [MOVERS] if DETECTOR in stages else []
    recorded = [
        SENSOR_INFO,
        ODOMETRY,
        *air,
        "diagnostics",
        LOSSES,
        *topics,
        *(t.removeprefix("/") for t in execution.record),
    ]
    custom_data = {**feed.custom_data, PARAMETERS: json.dumps(values)}
    nodes = {**values, SOURCE: source, RECORDER: {"node_parameters": True}}  # which may be changed in flight
    plan = Plan(SOURCE, stages, list(dict.fromkeys(recorded)), folder / "bag", nodes, 0, custom_data)
    processors = available_processors()
    known = {
        "bag": feed.bag.name,
        "rate": how.rate,
        "latency_budget_s": budget_s,
        "processors": processors,
    }

    def test() -> int:
        warn_of_overload(core_rate_hz(playlist, feed.sensor, stages, values, processors), 1 / interval_s, processors)
        return 0

    tested = run_in_copy(test, "self test")  # while the nodes start

    def let_go_and_show(watched: Watched) -> None:
        if tested:
            tested.poll()  # a process stays in lists until it is asked how it ended
        show(watched)

    watched = Watched(0.0, 1 / interval_s, latencies_s={topic: array("d") for topic in topics}, start_s=start_s)
    with reporting(folder, known) as report, ros_domain(execution.domain):
        provide_shared_memory(sum(len(frame.samples) for frame in next(playlist.frames())))
        _perform(plan, execution, how, playlist, watched, let_go_and_show)
        report.update(watched.as_json())
        report["parameters"] = values
    return watched


def _limits(stages: list[str], budget_s: float, execution: Execution) -> dict[str, dict[str, Any]]:
    """Latency budget of each stage, s, and dwells that may wait for it.

    In the live host the budget counts from the complete dwell at each of them, and the compression leaves out what
    cannot be in time: what comes after it finishes what was begun, several dwells at once, unless that is twice as
    late. Else each counts from its own input, and a dwell passes three.
    """
    timed = [name for name in stages if name != MAPPER]
    if execution.processes != "host":
        return {name: {"latency_budget_s": budget_s / 3} for name in timed}
    later = {"latency_budget_s": 2 * budget_s, "max_queued_dwells": 32}
    return {name: {"latency_budget_s": budget_s} if name == "sar_compression" else later for name in timed}


def warn_of_overload(core_hz: float, sensor_hz: float, processors: int) -> None:
    """Say that the machine is too slow for a sensor, if even the core alone is."""
    if core_hz < sensor_hz:
        _LOG.warning(
            "The %d processors here can process at most %.3g dwells/s, and the sensor delivers %.3g: the others will "
            "be left out, the oldest first. Use more processors, fewer estimators, smaller images, or a lower --rate.",
            processors,
            core_hz,
            sensor_hz,
        )


def _perform(
    plan: Plan, execution: Execution, how: Live, playlist: Playlist, watched: Watched, show: Callable[[Watched], None]
) -> None:
    """Start the nodes of a plan and the sensor, and watch them."""
    with (
        Interruption() as interruption,
        Ensemble(members_of(plan), execution.processes) as ensemble,
        suppress(KeyboardInterrupt),
    ):
        graph = ensemble.graph
        conductor = graph.add(Conductor(plan, context=graph.context))
        graph.add(Watcher(watched.book, context=graph.context))
        clock = DwellClock(how.rate, next(playlist.frames())[0].pulse_time[-1])
        sensor = Beginning(conductor, clock)
        supervisor: Supervisor | None = None

        def look_after() -> None:
            if supervisor is None:
                ensemble.check()
            elif SOURCE in supervisor.look(time.monotonic()):
                sensor.forget()

        def wait(condition: Callable[[], bool], what: str) -> None:
            for _ in looks(graph, interruption, execution.timeout_s):
                if condition():
                    return
                look_after()
            raise UserError(f"Waited {execution.timeout_s:g} s in vain for {what}; the log above may say why.")

        wait(conductor.ready, "all nodes to be ready")
        watched.start_s["ready"] = process_age_s()
        conductor.stop_reading()
        supervisor = Supervisor(ensemble, time.monotonic()) if how.supervised else None
        for topic in watched.latencies_s:
            conductor.subscribe_raw(HeightImage, topic, _keeper(topic, clock, watched))
        wait(sensor.has_begun, f"an answer of node {SOURCE}")
        watched.cpu_at_start_s = {name: a.cpu_s for name, a in watched.accounts.items()}
        watched.began_at_s = time.time()
        for watched.elapsed_s, is_due in looks(graph, interruption, how.seconds):
            look_after()
            sensor.has_begun()
            if is_due:
                show(watched)


def _keeper(topic: str, clock: DwellClock, watched: Watched) -> Callable[[bytes], None]:
    """Receives the heights of a topic."""

    def keep(cdr: bytes) -> None:
        if not watched.heights:
            watched.start_s["first height"] = process_age_s()
        watched.latencies_s[topic].append(clock.age_s(cdr))

    return keep


@dataclass
class DwellClock:
    """Time at which the sensor has delivered a dwell, by the stamp of its products.

    Attributes:
        rate: seconds of the sensor in a second.
        duration_s: time from the stamp of a dwell to its last pulse, s.
        begin_ns: the stamp that the sensor began with, at the same time by the clock of this machine.
    """

    rate: float
    duration_s: float
    begin_ns: int = 0

    def age_s(self, cdr: bytes) -> float:
        """Time since the last pulse of the dwell that a serialized product is of, s."""
        delivered_s = ((stamp_ns_of(cdr) - self.begin_ns) * 1e-9 + self.duration_s) / self.rate
        return (time.time_ns() - self.begin_ns) * 1e-9 - delivered_s


class Beginning:
    """Asks the sensor to start, once, and again after its node was restarted."""

    def __init__(self, conductor: Conductor, clock: DwellClock) -> None:
        """Ask by means of `conductor`; `clock` is notified when the sensor starts."""
        self._conductor, self._clock = conductor, clock
        self._asked: Future | None = None
        self._asked_at = -math.inf
        self._begun = False

    def forget(self) -> None:
        """Forget the sensor's answer, since its node has been restarted."""
        self._begun = False

    def has_begun(self) -> bool:
        """True if the sensor delivers; if it does not, it is asked to, again and again: it may not be there yet."""
        if not self._begun and self._asked and self._asked.done() and self._asked.result().success:
            self._clock.begin_ns = int(self._asked.result().message)
            self._begun, self._asked = True, None
        if not self._begun and time.monotonic() - self._asked_at > 1.0:  # s
            self._asked_at = time.monotonic()
            self._asked = self._conductor.ask()
        return self._begun
