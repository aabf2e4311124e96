"""The chain host as tests drive it: with a clock that only waiting moves, and an account of each stage.

Everything goes through `Chain`: what a test holds is what bags, arrays and notebooks run on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any, Self

from flown_items import Item, count_of, flight_items, small_flight

from sal_height.engine.chain import Chain, Made
from sal_height.engine.compression import Compression
from sal_height.engine.height_items import Heights
from sal_height.engine.heights import height_stage
from sal_height.engine.results import Event, Loss, Notice, Product, Result
from sal_height.engine.stage import Decision, Job, Stage
from sal_height.simulation import SimulatedFlight

IMAGE = {"rows": 46, "cols": 12, "air": "none"}
DETECTORS = 8
TICK_S = 0.1
LONGEST_S = 60.0


class Hosted:
    """A stage of a chain, and the counts of its messages by the names of /diagnostics.

    Attributes:
        stage: the stage.
        settings: its settings.
        ports: its inputs by name.
        counts: messages, losses and events by name; processed are those of jobs that lost nothing.
        last_drop: message on what was left out last.
        last_rejection: reason and message of what was left out or ignored last.
    """

    def __init__(self, joined: Joined, stage: Stage, settings: Any) -> None:
        self._joined, self.stage, self.settings = joined, stage, settings
        self.ports = {port.name: port for port in stage.inputs(settings)}
        self.counts: Counter[str] = Counter()
        self.last_rejection = self.last_drop = ""

    def ask(self, step: Callable[[], Sequence[Decision] | None]) -> None:
        """Do something with the stage."""
        self._joined.keep(self._joined.chain.ask(self.stage, step))

    def set(self, **values: Any) -> None:
        """Set parameters."""
        self.settings = self.settings.changed(**values)
        self.stage.change(self.settings)

    def forget(self) -> None:
        """Forget what has been gathered so far."""
        self.ask(self.stage.reset)

    def conclude(self) -> None:
        """Nothing more arrives."""
        self.ask(self.stage.finish)

    def receive(self, port: str, item: Any) -> None:
        """Count the messages of an item that arrives."""
        self.counts["in"] += count_of(item) if self.ports[port].counted else 0

    def drop(self, messages: int, reason: str, sentence: str) -> None:
        self.counts[f"dropped.{reason}"] += messages
        self.last_drop, self.last_rejection = sentence, f"{reason}: {sentence}"

    def ignore(self, kind: str, sentence: str) -> None:
        self.counts[f"ignored.{kind}"] += 1
        self.last_rejection = f"{kind}: {sentence}"

    def counted(self, under: str) -> dict[str, int]:
        """Messages that were "dropped." or "ignored.", by reason."""
        return {name.removeprefix(under): count for name, count in self.counts.items() if name.startswith(under)}

    def summary(self) -> dict[str, int]:
        """All counts, as the tally of a node has them."""
        always = {name: self.counts[name] for name in ("in", "processed")}
        return {**self.counts, **always, "waiting": always["in"] - always["processed"] - self._lost}

    @property
    def _lost(self) -> int:
        return sum(self.counted("dropped.").values())


class Clocked(Chain):
    """A chain whose stages know the time, and process every job at once.

    Attributes:
        hosts: stages with their counts.
        now_s: time of all stages, s.
    """

    def __init__(self, hosts: Sequence[Hosted]) -> None:
        super().__init__([one.stage for one in hosts], [one.settings for one in hosts])
        self.hosts = {one.stage: one for one in hosts}
        self.now_s = 1000.0
        self._at_once = dict.fromkeys(self.stages, 1)

    def ask(self, stage: Stage, step: Callable[[], Sequence[Decision] | None]) -> Iterable[Made]:
        """Do something with a stage; what comes of it."""
        self._take(stage, step() or ())
        return self._results(drain=False)

    def advance(self, seconds: float) -> Iterable[Made]:
        """Time passes."""
        self.now_s += seconds
        for stage in self.stages:
            yield from self.ask(stage, lambda stage=stage: stage.advance(self.now_s, busy=False))

    def _deliver(self, port: str, item: Any) -> None:
        for stage in self._consumers.get(port, ()):
            self.hosts[stage].receive(port, item)
            self._take(stage, stage.accept(port, item, self.now_s))

    def _conclude(self, stage: Stage, job: Job, results: Sequence[Result]) -> None:
        self.hosts[stage].counts["processed"] += job.messages
        super()._conclude(stage, job, results)


class Joined:
    """Stages joined in a chain, and what they made.

    Attributes:
        hosts: stages with their counts, by name.
    """

    def __init__(self) -> None:
        self.hosts: dict[str, Hosted] = {}

    def join(self, stage: Stage, settings: Any) -> Hosted:
        """Add a stage after those that there are, before anything is fed."""
        assert "chain" not in vars(self), "the stages have started"
        host = self.hosts[stage.name] = Hosted(self, stage, settings)
        return host

    @cached_property
    def chain(self) -> Clocked:
        """The chain, which starts when it is first used."""
        chain = Clocked(list(self.hosts.values()))
        self.keep(chain.start())
        return chain

    def feed(self, items: Iterable[Item]) -> Self:
        """Items arrive."""
        for item in items:
            self.keep(self.chain.feed(*item))
        return self

    def announce(self, port: str, stamp_ns: int) -> None:
        """The source announces what will not arrive."""
        self.keep(self.chain.nothing_before(port, stamp_ns))

    def finish(self) -> Self:
        """Nothing more arrives."""
        self.keep(self.chain.finish())
        return self

    def wait(self, condition: Callable[[], Any], what: str = "") -> None:
        """Let time pass until something has happened."""
        began_s = self.chain.now_s
        while not condition():
            accounts = {name: (one.summary(), one.last_rejection) for name, one in self.hosts.items()}
            assert self.chain.now_s - began_s < LONGEST_S, f"waited in vain for {what}: {accounts}"
            self.keep(self.chain.advance(TICK_S))

    def lost(self, stage: str = "sar_compression") -> dict[str, int]:
        """Messages that a stage has lost, by reason."""
        return self.hosts[stage].counted("dropped.")

    def report(self, made: Made) -> None:
        """Keep a product or file."""

    def keep(self, results: Iterable[Made]) -> None:
        """Count what was made or left out."""
        for made in results:
            one, host = made.result, self.hosts[made.stage.name]
            if isinstance(one, Loss):
                host.drop(one.messages, one.reason, one.sentence)
                host.counts["processed"] -= one.messages if made.dwell else 0
            elif isinstance(one, Notice):
                host.ignore(one.kind, one.sentence)
            elif isinstance(one, Event):
                host.counts[one.name] += one.times
            else:
                self.report(made)


class Chained(Joined):
    """The way from frames to heights: compression and estimators.

    Attributes:
        heights: by estimator and dwell.
    """

    def __init__(
        self,
        image: Mapping[str, Any] = MappingProxyType(IMAGE),
        heights: Mapping[str, Any] = MappingProxyType({}),
        estimators: Iterable[str] = ("monopulse", "ml"),
    ) -> None:
        """Settings: `image` of the compression, `heights` of the estimators."""
        super().__init__()
        self.heights: dict[tuple[str, int], Heights] = {}
        for kind, given in ((Compression, image), *((height_stage(name), heights) for name in estimators)):
            settings = kind.settings(**given)
            self.join(kind(settings), settings)

    def report(self, made: Made) -> None:
        if isinstance(made.result, Product) and isinstance(made.result.item, Heights):
            item = made.result.item
            self.heights[item.estimator, item.key.number] = item


_REFERENCE: dict[tuple[str, int], Heights] = {}


def reference() -> Mapping[tuple[str, int], Heights]:
    """Heights of the first dwells of the small flight when all is well."""
    if not _REFERENCE:
        _REFERENCE.update(heights_of(small_flight(), range(2)).heights)
    return _REFERENCE


def heights_of(flight: SimulatedFlight, dwells: Iterable[int] = (0,), **settings: Any) -> Chained:
    """What a chain makes of some dwells of a flight."""
    return Chained(**settings).feed(flight_items(flight, dwells=dwells)).finish()
