"""A host for tests: it drives a stage by a script, processes its jobs as it is told, and keeps the accounts."""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from sal_height.engine.results import DwellKey, Loss, Notice, Product, Result
from sal_height.engine.stage import Decision, Job, Rehearsal, Stage

Step = Callable[[Stage], Sequence[Decision] | None]
"""Something that a host does with a stage."""


def accept(port: str, item: Any, now_s: float = 0.0) -> Step:
    """An item arrives."""
    return lambda stage: stage.accept(port, item, now_s)


def advance(now_s: float, *, busy: bool = False) -> Step:
    """Time has passed."""
    return lambda stage: stage.advance(now_s, busy=busy)


def nothing_before(port: str, stamp_ns: int) -> Step:
    """The source announces what will not arrive."""
    return lambda stage: stage.nothing_before(port, stamp_ns)


def scheduled_before(dwell: DwellKey, port: str, item: Any) -> Step:
    """An item that is accepted right before a dwell."""
    return lambda stage: stage.schedule(dwell, port, item)


def finish(stage: Stage) -> Sequence[Decision]:
    """Nothing more arrives."""
    return stage.finish()


@dataclass
class Driven:
    """A stage, and what came of it.

    Attributes:
        stage: that decides.
        worker: that processes the jobs; another copy of the stage, or itself.
        group: number of jobs that are processed at once.
        deferred: whether all jobs are processed at the end of the script only.
        pickled: whether jobs go to the worker as to another process.
        rehearses: whether rehearsals are processed; if not, they are taken for done.
        jobs: that were made.
        decided: all other decisions.
        results: of each job, in the order of the jobs.
    """

    stage: Stage
    worker: Stage
    group: int = 1
    deferred: bool = False
    pickled: bool = False
    rehearses: bool = True
    jobs: list[Job] = field(default_factory=list)
    decided: list[Result] = field(default_factory=list)
    results: list[Sequence[Result]] = field(default_factory=list)

    def play(self, script: Iterable[Step]) -> Driven:
        """Do all steps, and process all jobs."""
        for step in script:
            self.do(step)
        self.process(len(self.jobs) - len(self.results))
        return self

    def do(self, step: Step) -> Sequence[Result]:
        """Do a step; returns what was decided at once, and the results of jobs that were processed."""
        before, processed = len(self.decided), len(self.results)
        self._take(step(self.stage) or ())
        return [*self.decided[before:], *(one for results in self.results[processed:] for one in results)]

    def deliver(self, items: Iterable[tuple[str, Any]]) -> None:
        """Items arrive, each on its port."""
        for item in items:
            self.do(accept(*item))

    def process(self, count: int) -> None:
        """Process the next jobs, and whatever these entail."""
        while count > 0 and (jobs := self.jobs[len(self.results) :][: min(count, self.group)]):
            found = self.processed(jobs)
            self.results += found
            for job, results in zip(jobs, found, strict=True):
                self._take(self.stage.note_done(job, results))
            count -= len(jobs)
            if self.deferred:
                count = len(self.jobs) - len(self.results)

    def processed(self, jobs: Sequence[Job]) -> list[Sequence[Result]]:
        """What the worker makes of some jobs."""
        sent = [job for job in jobs if self.rehearses or not isinstance(job.inputs, Rehearsal)]
        found = [list(results) for results in self.worker.process(self._copied(sent))]
        found = self._copied(found)
        assert len(found) == len(sent)
        return [[] for _ in range(len(jobs) - len(sent))] + found  # rehearsals come first

    def _copied(self, what: list[Any]) -> list[Any]:
        """The same as another process receives it, each by itself."""
        return [pickle.loads(pickle.dumps(one)) for one in what] if self.pickled else what  # noqa: S301 (our own)

    def _take(self, decisions: Sequence[Decision]) -> None:
        for one in decisions:
            (self.jobs if isinstance(one, Job) else self.decided).append(one)
        waiting = len(self.jobs) - len(self.results)
        if not self.deferred:
            self.process(waiting // self.group * self.group)

    @property
    def made(self) -> list[Product]:
        """All products."""
        return [one for one in self.all_results() if isinstance(one, Product)]

    @property
    def losses(self) -> list[Loss]:
        """All losses."""
        return [one for one in self.all_results() if isinstance(one, Loss)]

    @property
    def notices(self) -> list[Notice]:
        """All notices."""
        return [one for one in self.all_results() if isinstance(one, Notice)]

    def all_results(self) -> Iterator[Result]:
        """What was decided at once, and then what came of jobs."""
        yield from self.decided
        for results in self.results:
            yield from results

    def lost(self) -> Counter[str]:
        """Messages that were lost, by reason."""
        counts: Counter[str] = Counter()
        for one in self.losses:
            counts[one.reason] += one.messages
        return counts

    def warned(self) -> Counter[str]:
        """Notices by kind."""
        return Counter(one.kind for one in self.notices)


def drive(stage: Stage, script: Iterable[Step] = (), **options: Any) -> Driven:
    """A stage that processes its own jobs, after a script."""
    return Driven(stage, options.pop("worker", stage), **options).play(script)
