"""A graph beside a sensor that does not wait, for a long time, with a fault every few seconds.

`python -m benchmarks.soak --minutes 30` (or `make soak MINUTES=30`) plays a preset at a given share of the highest rate
that this machine sustains, does one of the faults of `faults`, or kills or stops a node, every 20 s, in an order that
follows from the seed, and prints what of its promises was kept: every account balanced at every moment, nothing left
out and no height missing but within the seconds after a fault, heights of every other time as in lockstep, memory.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts

from sal_height.workers.processes import ONE_THREAD

if TYPE_CHECKING:
    from sal_height.runs.live.live import Watched

FAULT_KINDS = (
    *("hostile sensor_info", "hostile platform/odometry", "hostile phase_history", "hostile slc", "hostile ml/height"),
    *("second odometry", "other sensors", "frames twice", "busy processors", "other parameters"),
)
"""Those of `faults.FAULTS`, which are done by a process of its own."""

TO_NODES = ("kill", "stop")
"""Signals: SIGKILL, and SIGSTOP for some seconds."""

STOPPED_S = 2.0
RECOVERY_S = 12.0
"""From a fault to the end of what it may cost, at least: its program starts in 2 s and lasts 2, and nodes wait 5 s in
vain."""

AFTERWARDS_S = 7.0
"""From the end of the program of a fault to the end of what it may cost."""

WAIT_S, LEAST_WAIT_S = 5.0, 1.0
"""Time for which nodes wait for what a dwell lacks. While they are busy they go by stamps, which pass at the rate of
the sensor, and else by the clock."""

LONG_S = 600.0
"""The memory of a process is judged once it has run for so long: before, caches fill."""

SHARE = 0.8
"""Of the highest rate that is sustained, the one that is played at."""

EDGE_DWELLS = 3
"""Dwells that may be on their way when a stretch without a fault begins or ends."""


AFTER_ALL_S = 6.0
"""Time without a fault at the end of a run with chosen kinds, which is judged."""


@dataclass
class Moment:
    """An observation of the graph at a time."""

    at_s: float
    heights: dict[str, int]
    left_out: Counter[str]
    unbalanced: list[str]
    memory_mb: dict[tuple[str, int], float]


@dataclass
class Fault:
    """A fault of the graph with its time; its program, if it is done by one, and when that had ended."""

    at_s: float
    what: str
    program: subprocess.Popen[bytes] | None = None
    ended_s: float = math.inf

    def over_s(self, recovery_s: float) -> float:
        """When it can have no effect any more, which takes so long at least."""
        return max(self.at_s + recovery_s, self.ended_s + AFTERWARDS_S if self.program else 0.0)


@dataclass
class Soak:
    """Does the faults, and keeps what is seen.

    Attributes:
        every_s: time from one fault to the next.
        seed: position in the list of faults to start at.
        lasts_s: duration; no fault is done that cannot be over before.
        recovery_s: least time from a fault to the end of what it may cost, s.
        kinds: faults to do, one after the other, and then none; empty: all kinds in turn.
        faults: faults so far.
        moments: observations, about one a second.
    """

    every_s: float
    seed: int
    lasts_s: float = math.inf
    recovery_s: float = RECOVERY_S
    kinds: tuple[str, ...] = ()
    faults: list[Fault] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    _stopped: list[tuple[float, int]] = field(default_factory=list)

    def show(self, watched: Watched) -> None:
        """Record the state of the graph, and do the next fault if its time has come.

        Raises:
            KeyboardInterrupt: all `kinds` are done, and enough was seen of the time after them.
        """
        now = watched.elapsed_s
        self.moments.append(_moment_of(watched))
        for until_s, pid in list(self._stopped):
            if now >= until_s:
                self._stopped.remove((until_s, pid))
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
        for fault in self.faults:
            if fault.program and math.isinf(fault.ended_s) and fault.program.poll() is not None:
                fault.ended_s = now
        if self.kinds and len(self.faults) == len(self.kinds):
            if now > AFTER_ALL_S + max(fault.over_s(self.recovery_s) for fault in self.faults):
                raise KeyboardInterrupt
        elif now >= self.every_s * (len(self.faults) + 1) and now + self.recovery_s < self.lasts_s:
            self.faults.append(self._next(watched))
            sys.stderr.write(f"{now:.0f} s: {self.faults[-1].what}\n")

    def _next(self, watched: Watched) -> Fault:
        """Do a fault: kinds take turns, and so do the nodes that signals are sent to."""
        number = len(self.faults) + self.seed
        kinds = (*FAULT_KINDS, *TO_NODES, *TO_NODES, *TO_NODES)
        # 7 has no factor in common with the number of all kinds, 16.
        kind = self.kinds[len(self.faults)] if self.kinds else kinds[number * 7 % len(kinds)]
        if kind not in TO_NODES:
            words = [sys.executable, "-m", "benchmarks.faults", kind, str(number)]
            return Fault(watched.elapsed_s, kind, subprocess.Popen(words))  # noqa: S603 (our own module)
        names = sorted(watched.book.entries)
        name = names[(number * 5 + number // 16) % len(names)]
        pid = watched.book.entries[name].account.pid
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
        if kind == "stop":
            self._stopped.append((watched.elapsed_s + STOPPED_S, pid))
        return Fault(watched.elapsed_s, f"{kind} {name}")

    @property
    def failed(self) -> list[str]:
        """Faults that could not be done."""
        return [fault.what for fault in self.faults if fault.program and fault.program.poll() not in (None, 0)]

    def quiet(self) -> Iterator[list[Moment]]:
        """The moments of every stretch that no fault can have an effect on."""
        begins = accumulate([0.0, *(fault.over_s(self.recovery_s) for fault in self.faults)], max)
        ends = [*(fault.at_s for fault in self.faults), math.inf]
        for begin, end in zip(begins, ends, strict=True):
            inside = [moment for moment in self.moments if begin <= moment.at_s < end]
            if len(inside) > 1:
                yield inside

    def left_out(self) -> dict[str, Counter[str]]:
        """Dwells left out in stretches without a fault, by time: time, and time since the last fault."""
        found: dict[str, Counter[str]] = {}
        for stretch in self.quiet():
            for earlier, later in pairwise(stretch):
                if more := later.left_out - earlier.left_out:
                    before = [fault for fault in self.faults if fault.at_s < later.at_s][-1:]
                    since = "".join(f" ({later.at_s - fault.at_s:.0f} s after {fault.what})" for fault in before)
                    found[f"{later.at_s:.0f} s{since}"] = more
        return found


def _moment_of(watched: Watched) -> Moment:
    unbalanced, memory, left_out = [], {}, Counter[str]()
    for name, entry in watched.book.entries.items():
        account = entry.account
        sum_of = account.processed + sum(account.dropped.values()) + account.waiting
        if account.received != sum_of:
            unbalanced.append(f"{name}: {account.received} in, {sum_of} accounted for")
        left_out.update({f"{name} {reason}": count for reason, count in account.dropped.items()})
        memory[name, account.pid] = account.memory_mb
    counts = {topic: len(ages) for topic, ages in watched.latencies_s.items()}
    return Moment(watched.elapsed_s, counts, left_out, unbalanced, memory)


def verdict(soak: Soak, offered_hz: float, different: list[str]) -> list[tuple[bool, str]]:
    """Promises, each with True if it was kept and a sentence about it."""
    stretches = list(soak.quiet())
    unbalanced = [sentence for moment in soak.moments for sentence in moment.unbalanced]
    left_out = soak.left_out()
    in_all = sum(left_out.values(), Counter[str]())
    quiet_s = sum(last.at_s - first.at_s for first, *_, last in stretches)
    missing = {}
    for topic in soak.moments[-1].heights:
        lacks = {
            first.at_s: offered_hz * (last.at_s - first.at_s)
            - (last.heights[topic] - first.heights[topic])
            - EDGE_DWELLS
            for first, *_, last in stretches
        }
        missing[topic] = {at_s: lack for at_s, lack in lacks.items() if lack > 0}
    growth = _growth(soak.moments)
    worst, most = max(growth.items(), key=lambda entry: entry[1], default=("", 0.0))
    grown = f"{len(growth)} nodes that ran for {LONG_S:.0f} s"
    return [
        (not unbalanced, f"accounts that were not balanced: {len(unbalanced)} {unbalanced[:1]}"),
        (
            not left_out,
            f"messages left out in {quiet_s:.0f} s without a fault: {dict(in_all)}"
            + "".join(f"\n    {when}: {dict(what)}" for when, what in left_out.items()),
        ),
        (
            not any(missing.values()),
            f"heights missing in {quiet_s:.0f} s without a fault: "
            + ", ".join(
                f"{topic} {sum(lacks.values()):.0f}"
                + "".join(f" ({lack:.0f} from {at_s:.0f} s)" for at_s, lack in lacks.items())
                for topic, lacks in missing.items()
            ),
        ),
        (not different, f"heights unlike those of the lockstep run, without a fault: {len(different)} {different[:1]}"),
        (
            all(share < 0.01 for share in growth.values()),
            f"memory of {grown} grows by {100 * most:.2f} % at most {worst}",
        ),
        (not soak.failed, f"faults that could not be done: {soak.failed}"),
    ]


def _growth(moments: list[Moment]) -> dict[str, float]:
    """By how much the memory of each process that ran for LONG_S has grown from its second third to its last."""
    series: dict[tuple[str, int], list[tuple[float, float]]] = defaultdict(list)
    for moment in moments:
        for key, memory in moment.memory_mb.items():
            series[key].append((moment.at_s, memory))
    growth: dict[str, float] = {}
    for (name, _), samples in series.items():
        if samples[-1][0] - samples[0][0] < LONG_S:
            continue
        third = len(samples) // 3
        middle, last = (sum(memory for _, memory in part) for part in (samples[third : 2 * third], samples[-third:]))
        growth[name] = max(growth.get(name, -1.0), last / middle - 1)
    return growth


def unlike_lockstep(out: Path, lockstep: Path, soak: Soak, begin_ns: int) -> list[str]:
    """The heights of `ml` in the bags of a soak, of stretches without a fault, that are not those of a lockstep run."""
    import numpy as np  # noqa: PLC0415 (how many threads it may use is decided before)

    from sal_height.bag.reader import BagReader  # noqa: PLC0415
    from sal_height.errors import UserError  # noqa: PLC0415

    def images(bag: Path) -> Iterator[tuple[int, Any]]:
        reader = BagReader(bag)
        for message in reader.messages(["/ml/height"]):
            yield message.log_time_ns, reader.decode(message.type_name, message.cdr)

    true = {image.dwell: np.array(image.surfaces[0].height) for _, image in images(lockstep)}
    times = [(begin_ns + first.at_s * 1e9, begin_ns + last.at_s * 1e9) for first, *_, last in soak.quiet()]
    different = []
    for bag in sorted(out.glob("bag*")):
        with suppress(UserError):  # its recorder was killed: it is for `salvage`
            for at_ns, image in images(bag):
                if any(first < at_ns < last for first, last in times):
                    wanted, made = true.get(image.dwell), np.array(image.surfaces[0].height)
                    if wanted is None or not np.allclose(made, wanted, rtol=0, atol=1e-6, equal_nan=True):
                        different.append(f"dwell {image.dwell}")
    return different


app = cyclopts.App(name="python -m benchmarks.soak", help_format="plaintext")


@app.default
def soak(
    *,
    minutes: Annotated[float, cyclopts.Parameter(validator=cyclopts.validators.Number(gt=0))] = 30.0,
    every: Annotated[float, cyclopts.Parameter(validator=cyclopts.validators.Number(gt=0))] = 20.0,
    recovery: Annotated[float, cyclopts.Parameter(validator=cyclopts.validators.Number(gt=0))] = RECOVERY_S,
    preset: str = "sal_spotlight",
    rate: Annotated[float | None, cyclopts.Parameter(validator=cyclopts.validators.Number(gt=0))] = None,
    budget: Annotated[float | None, cyclopts.Parameter(validator=cyclopts.validators.Number(gt=0))] = None,
    seed: int = 0,
) -> int:
    """Play a sensor against the graph for a long time, with faults, and print which promises were kept.

    Args:
        minutes: How long.
        every: Time from one fault to the next, s.
        recovery: From a fault to the end of what it may cost, s; less than the time to the next fault.
        preset: Sensor, flight and scene.
        rate: Seconds of the sensor in a second. Default: 0.8 of the highest that is sustained, which is looked for.
        budget: Latency budget, s. Default: that of live.
        seed: Where in the list of faults to begin.
    """
    if recovery >= every:
        sys.stderr.write(f"--recovery is {recovery:g} and --every {every:g}; it must be less, or nothing is judged.\n")
        return 2
    run = Soak(every, seed, 60 * minutes, recovery)
    promises = perform(run, preset, rate, budget)
    sys.stdout.writelines(f"{'kept' if kept else 'BROKEN'}: {sentence}\n" for kept, sentence in promises)
    return int(not all(kept for kept, _ in promises))


def perform(run: Soak, preset: str, rate: float | None, budget: float | None) -> list[tuple[bool, str]]:
    """Play a sensor against a graph with faults, print what happened, and give the verdict on each promise.

    Args:
        run: faults to do; it records what happens.
        preset: name of sensor, flight and scene.
        rate: seconds of the sensor in a second; None: SHARE of the highest that is sustained.
        budget: latency budget, s; None: that of live.
    """
    os.environ.update(ONE_THREAD | os.environ)

    from sal_height.graph.plan import Execution  # noqa: PLC0415
    from sal_height.runs.live.live import Live, live  # noqa: PLC0415
    from sal_height.runs.live.sensor_bag import Feed, record_sensor  # noqa: PLC0415
    from sal_height.runs.replay.bag_replay import replay  # noqa: PLC0415
    from sal_height.simulation import load_preset  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        bag = record_sensor(load_preset(preset), 1, folder / "sensor")
        if rate is None:
            from benchmarks.live_runs import highest_rate, watch  # noqa: PLC0415

            rate = SHARE * highest_rate(lambda tried: watch(bag, tried, 20.0), 0.3)[0]
        how = Live(rate, run.lasts_s, budget or 0.0, supervised=True)
        patience = {
            name: {"timeout_s": max(LEAST_WAIT_S, WAIT_S * rate)}
            for name in ("sar_compression", "ml_height", "monopulse")
        }
        watched = live(Feed.of_bag(bag), folder / "live", patience, how, Execution("host"), run.show)
        replay(bag, folder / "lockstep", {}, estimators=["ml"])
        begin_ns = round(watched.began_at_s * 1e9)
        different = unlike_lockstep(folder / "live", folder / "lockstep" / "bag", run, begin_ns)
        report = json.loads((folder / "live" / "report.json").read_text(encoding="utf-8"))
    starts = {name: node["processes"] for name, node in report["nodes"].items()}
    sys.stdout.write(
        f"{preset} at {rate:.3g} of its pace for {watched.elapsed_s / 60:.3g} minutes: "
        f"{watched.offered_hz:.1f} dwells/s, {watched.heights} heights, {len(run.faults)} faults; "
        f"processes of each node: {starts}\n"
    )
    return verdict(run, watched.offered_hz, different)


if __name__ == "__main__":
    sys.exit(app(result_action="return_value"))
