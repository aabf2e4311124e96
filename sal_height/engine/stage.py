"""Stages: cheap decisions on what arrives, and heavy work on jobs that have all they need.

`accept`, `advance`, `nothing_before`, `change`, `reset` and `finish` are cheap: they decide what is complete, late or
hopeless, and return jobs and what was left out. `process` is heavy and does nothing but compute. A host decides when
and where it runs; nothing else differs between hosts, and so the products cannot. The two sides share no state: what
`process` needs is in its jobs, or belongs to it alone; what the cheap side must know of the work done, the host states
by `note_done`. So the two may be two copies of a stage, in two processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, TypeAlias

from sal_height.engine.results import (
    DwellKey,
    Event,
    Notice,
    Result,
    loss_of,
    reason_of,
)
from sal_height.engine.scheduling import Scheduling
from sal_height.errors import Rejected
from sal_height.sensor import Sensor
from sal_height.settings import Settings, setting


class Port(NamedTuple):
    """An input or output of a stage; topics, types of messages and QoS of a node follow from it.

    Attributes:
        name: name of the topic, relative to the namespace.
        kind: class of the items.
        about: description for tables.
        per_channel: True if a dwell is one message for each channel.
        latched: True if the last item is kept for later subscribers.
        optional: True if the stage can work without an item on it.
        counted: True if its messages are what the stage works on: an account counts them as received, and an inactive
            node leaves them out.
    """

    name: str
    kind: type
    about: str
    per_channel: bool = False
    latched: bool = False
    optional: bool = False
    counted: bool = False


@dataclass(frozen=True, eq=False)
class Job:
    """All that `process` needs.

    Attributes:
        dwell: dwell that it is about; None: work of the stage's own, which is never left out.
        inputs: data that it works on.
        settings: settings that apply to it.
        messages: number of messages that it consumes.
        size: size of these messages, bytes.
        series: name of a series, whose jobs are processed one after the other; None: in any order, side by side.
        complete_s: time at which it was complete, s of the host's clock; the latency budget counts from then.
        order: place of the dwell in the order in which the stage made jobs of dwells, from 0.
    """

    dwell: DwellKey | None
    inputs: Any
    settings: Any
    messages: int = 0
    size: int = 0
    series: str | None = None
    complete_s: float = 0.0
    order: int = 0


Decision: TypeAlias = Job | Result


class Rehearsal(NamedTuple):
    """Input of a job that makes the tables and loads the code for the first dwell of a sensor, or of any (None)."""

    sensor: Sensor | None = None


@dataclass(frozen=True)
class Reset:
    """Input of a job that forgets what the heavy side keeps of the dwells before."""


class StageSettings(Settings):
    """Settings of every stage: how much may wait for its processing."""

    max_queued_dwells: int = setting(
        8, "dwells that may wait for their processing, in addition to the one in work", minimum=1, maximum=10_000
    )
    queue_policy: str = setting(
        "oldest",
        "which dwell is dropped when too many wait: the oldest of those that wait, or the newest, which has just "
        "arrived",
        choices=("oldest", "newest"),
    )
    latency_budget_s: float = setting(
        0.0,
        "longest time that a dwell may wait for its processing once it is complete; those that have waited longer are "
        "left out; 0: as long as it takes",
        unit="s",
        minimum=0.0,
        maximum=86400.0,
    )
    max_memory_mb: int = setting(
        2048,
        "memory for unfinished dwells, and as much again for dwells that wait for their processing",
        unit="MB",
        minimum=1,
        maximum=1_000_000,
    )

    autostart: bool = setting(
        True,
        "start active; if not, the node works once it was configured and activated, as by ros2 lifecycle",
        read_only=True,
    )

    @property
    def max_memory_bytes(self) -> int:
        """Memory for unfinished dwells, bytes."""
        return self.max_memory_mb * 1_000_000


class FileInput(NamedTuple):
    """A file that the host reads before the start.

    Attributes:
        name: name under which the stage receives its content.
        kind: kind of the content, which says how it is read: "calibration", "elevation model" or "targets".
        path: path of the file.
    """

    name: str
    kind: str
    path: str


RESETS = "resets"
"""Event of a dwell before which a stage was reset."""

RESET = Rejected("reset", "The node was reset before the dwell was complete.")
ENDED = Rejected("ended", "The node is ending; what waits and what arrives now is left out.")

FOREVER_NS = 2**63 - 1
"""A time after all stamps, ns."""


class Stage(Scheduling):
    """Base of all stages; subclasses declare what they accept and make, and override what they need.

    Attributes:
        name: name of the stage or of its node, for provenance.
        sensor_name: name of the sensor that was described last; empty: none was, or the stage needs none.
    """

    usual_name: ClassVar[str] = ""
    """Name of the stage, and of its node unless that is given another one."""

    about: ClassVar[str] = ""
    """Description of the stage, in one sentence."""

    settings: ClassVar[type[StageSettings]] = StageSettings
    """Its settings; those of its node are its parameters."""

    commands: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Commands in addition to `reset`, by name, with their descriptions."""

    concludes: ClassVar[bool] = False
    """True if jobs that wait when its host ends are processed, and what is due at the end is done."""

    is_parallel: ClassVar[bool] = False
    """True if jobs without a series can be processed by copies of the stage, which need not state `note_done`."""

    at_once: ClassVar[int] = 1
    """Jobs that it processes faster together than one by one, at most."""

    niceness: ClassVar[int] = 0
    """Degree to which its work gives way to other threads, as in nice(1)."""

    def __init__(self, settings: Any, files: Mapping[str, Any] = MappingProxyType({}), name: str = "") -> None:
        """Start without dwells.

        Args:
            settings: object of the class `settings`.
            files: contents of the files that `files` names, by name.
            name: name of the stage, for provenance; empty: the usual one.

        Raises:
            UserError: the settings contradict each other or the files.
        """
        super().__init__()
        self.name = name or self.usual_name
        self.sensor_name = ""
        self._settings = settings
        self._files = dict(files)
        self._decisions: list[Decision] = []
        self._now_s = 0.0
        self._none_before: dict[str, int] = {}
        self._jobs_of_dwells = 0
        self.publishers_of: Callable[[str], int] = _one_publisher
        """Number of publishers of a port, for messages; the host knows it."""
        self._is_reset = False
        """True if the next dwell is the first one after a reset."""
        self.describe_sources: Callable[[], str] = str
        """Sentences, each after a space, on publishers of the inputs that are not right; else nothing."""

    # What the stage declares.

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        """Ports that it accepts items on, with these settings."""
        raise NotImplementedError

    @classmethod
    def described_inputs(cls) -> Sequence[Port]:
        """All ports that it accepts items on with some settings, for tables; of heights the estimator is a setting."""
        settings = cls.settings()
        chosen = f"{getattr(settings, 'estimator', '')}/height"
        ports = cls.inputs(settings)
        return [port._replace(name="<estimator>/height") if port.name == chosen else port for port in ports]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:
        """Ports that it makes products for, with these settings."""
        raise NotImplementedError

    @classmethod
    def described_outputs(cls) -> Sequence[Port]:
        """All ports that it makes products for with some settings, for tables."""
        return cls.outputs(cls.settings())

    @classmethod
    def files(cls, settings: Any) -> Sequence[FileInput]:  # noqa: ARG003 (subclasses use them)
        """Files that are read before the start, with these settings."""
        return ()

    @classmethod
    def written_files(cls, settings: Any) -> Sequence[tuple[type, str]]:  # noqa: ARG003
        """Class of the content and path of each file that will be written, to be refused before the start."""
        return ()

    # The cheap side.

    def start(self, stamp_ns: int) -> Sequence[Decision]:
        """Decisions before anything arrives; `stamp_ns` (ns of the host's clock) is for the stamps of products."""
        return self._collected(self.begin, stamp_ns)

    def accept(self, port: str, item: Any, now_s: float = 0.0) -> Sequence[Decision]:
        """Accept an item from a port.

        An item that cannot be used is a `Loss` or a `Notice` among the decisions; nothing is raised.

        Args:
            port: name of the port.
            item: item of the kind of the port.
            now_s: time of the host's clock, s.
        """
        self._now_s = now_s
        return self._collected(self.receive, port, item)

    def advance(self, now_s: float, *, busy: bool) -> Sequence[Decision]:
        """Time has passed: give up what has waited too long. Has no effect where the source announces its end.

        Args:
            now_s: time of the host's clock, s.
            busy: True if jobs of this stage wait or run.
        """
        self._now_s = now_s
        return self._collected(lambda: self.tick(busy=busy))

    def nothing_before(self, port: str, stamp_ns: int) -> Sequence[Decision]:
        """Give up what waits for items with an earlier stamp on a port: the source announces that none will arrive.

        From the first announcement on no time-out counts. The latest announcement counts: that of a clock which has
        started again is earlier than the one before.
        """
        self._none_before[port] = stamp_ns
        return self._collected(self.give_up_hopeless)

    def change(self, settings: Any, before: DwellKey | None = None) -> None:
        """Use other settings from a dwell on, or from the next job that is made."""
        if before is None:
            self._settings = settings
        else:
            self.schedule(before, "", settings)

    def reset(self) -> Sequence[Decision]:
        """Forget what was gathered of the dwells so far, once the jobs before have been processed."""
        self._is_reset = True
        return self._collected(self.forget)

    def command(self, name: str) -> Sequence[Decision]:
        """Do what `commands` says; the result has an `Answer`."""
        raise NotImplementedError(name)

    def finish(self) -> Sequence[Decision]:
        """Nothing more arrives: process or give up what waits, and conclude."""
        return self._collected(self.conclude)

    def abandon(self) -> Sequence[Decision]:
        """The host ends: leave out what has not become a job."""
        return self._collected(self.leave_out)

    def note_done(self, job: Job, results: Sequence[Result]) -> Sequence[Decision]:
        """A job has been processed, by this stage or a copy of it; every host states this after each job."""
        return self._collected(self.follow, job, results)

    @property
    def needed_ports(self) -> Sequence[str]:
        """Optional ports without which the next dwell cannot be processed, as far as is known now."""
        return ()

    @property
    def own_series(self) -> str:
        """Series of the jobs that change what the heavy side keeps of the dwells before."""
        return self.name

    @property
    def unpublished(self) -> int:
        """Dwells that have been processed and whose products follow once later ones have arrived."""
        return 0

    @property
    def is_ready(self) -> bool:
        """True if what takes time before the first dwell is done."""
        return True

    @property
    def announced(self) -> bool:
        """True if the source says when nothing more arrives."""
        return bool(self._none_before)

    # The heavy side.

    def process(self, jobs: Sequence[Job]) -> Iterator[Sequence[Result]]:
        """Process jobs, in their order, and give the results of each.

        What a job cannot do is a `Loss` among its results; nothing is raised.
        """
        yield from (self.processed(job, self.work) for job in jobs)

    def processed(self, job: Job, work: Any) -> Sequence[Result]:
        """The results of one job; an error becomes the loss of its messages."""
        results: list[Result] = []
        try:
            for result in work(job):
                results.append(result)  # noqa: PERF402 (those before an error count)
        except Exception as error:  # noqa: BLE001 (no input may end a host)
            results.append(loss_of(error, job.dwell, job.messages))
        return results

    # What subclasses implement; they decide by `add`, `drop`, `warn` and `count`.

    def begin(self, stamp_ns: int) -> None:
        """Decide what is published or done before anything arrives."""

    def receive(self, port: str, item: Any) -> None:
        """Accept an item from a port; what it raises is a notice."""
        raise NotImplementedError

    def tick(self, *, busy: bool) -> None:
        """Give up what has waited too long."""

    def give_up_hopeless(self) -> None:
        """Give up what waits for items that the source has announced not to arrive."""

    def forget(self) -> None:
        """Forget what was gathered."""

    def conclude(self) -> None:
        """Give up or process what waits, and do what is due at the end."""

    def leave_out(self) -> None:
        """Drop what has not become a job."""

    def follow(self, job: Job, results: Sequence[Result]) -> None:
        """Learn from the results of a job, on the cheap side, what it needs to know of the heavy one."""

    def work(self, job: Job) -> Iterable[Result]:
        """Process a job (the heavy part).

        Raises:
            UserError: it cannot be processed.
        """
        raise NotImplementedError

    # Tools of subclasses.

    def add(self, decision: Decision) -> None:
        """Decide something."""
        self._decisions.append(decision)

    def add_job(
        self, dwell: DwellKey, inputs: Any, *, messages: int = 1, size: int = 0, series: str | None = None
    ) -> None:
        """Make a job of a dwell, which gets the next place in the order, unless the dwell is to be left out."""
        order, self._jobs_of_dwells = self._jobs_of_dwells, self._jobs_of_dwells + 1
        if (reason := self._left_out.get(dwell)) is not None:
            self.drop(reason, messages, dwell)
            return
        if self._is_reset:
            self._is_reset = False
            self.add(Event(RESETS, dwell))
        self.add(Job(dwell, inputs, self._settings, messages, size, series, self._now_s, order))

    def add_own_job(self, inputs: Any, series: str | None = None) -> None:
        """Make a job of the stage's own, which is never left out."""
        self.add(Job(None, inputs, self._settings, series=series, complete_s=self._now_s))

    def drop(self, error: Exception, messages: int, dwell: DwellKey | None = None) -> None:
        """Leave the messages of a dwell out because of an error."""
        self.add(loss_of(error, dwell, messages))

    def drop_message(self, error: Exception, dwell: DwellKey | None) -> None:
        """Leave a message out that cannot be part of its dwell."""
        self.add(replace(loss_of(error, dwell, 1), is_dwell=False))

    def warn(self, kind: str, error: Exception, dwell: DwellKey | None = None) -> None:
        """Count and report something that could not be used, or that is doubtful."""
        loss = loss_of(error, dwell, 0)
        self.add(Notice(kind, loss.sentence, dwell, loss.trace))

    def count(self, event: str) -> None:
        """Count an event."""
        self.add(Event(event))

    def accept_scheduled(self, port: str, item: Any) -> None:
        """Accept an item that was scheduled; one that cannot be used is a notice. Port "": it is no item of a port."""
        if isinstance(item, Reset):
            self._is_reset = True
            self.add_own_job(item, self.own_series)
            return
        if not port:
            self._settings = item
            return
        try:
            self.receive(port, item)
        except Exception as error:  # noqa: BLE001 (no input may end a host)
            self.warn(reason_of(error), error)

    def _collected(self, decide: Callable[..., None], *arguments: Any) -> Sequence[Decision]:
        """The decisions of a method that is called with arguments."""
        before, self._decisions = self._decisions, []
        try:
            decide(*arguments)
        except Exception as error:  # noqa: BLE001 (no input may end a host)
            self.warn(reason_of(error), error)
        finally:
            decided, self._decisions = self._decisions, before
        return decided


def _one_publisher(port: str) -> int:  # noqa: ARG001
    return 1
