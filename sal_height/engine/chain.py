"""The chain host: stages joined by calls, for bags, arrays and notebooks.

An item that is fed goes through all stages; what they make or leave out comes back in the order in which it was made.
Nothing waits for time: whoever feeds the chain announces what no longer arrives (`nothing_before`), and finishes it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from sal_height.engine.results import DwellKey, Product, Result
from sal_height.engine.stage import Decision, Job, Rehearsal, Stage


class Made(NamedTuple):
    """A product, or something that a stage left out or reports.

    Attributes:
        stage: stage that made it.
        dwell: dwell of the job; None: it was not a job of a dwell.
        result: product or report.
    """

    stage: Stage
    dwell: DwellKey | None
    result: Result


class Chain:
    """Stages in the order of the data, joined by the names of their ports."""

    def __init__(self, stages: Sequence[Stage], settings: Sequence[Any]) -> None:
        """Join stages.

        Args:
            stages: stages in the order of the data.
            settings: settings of each stage.
        """
        self.stages = list(stages)
        self._consumers: dict[str, list[Stage]] = {}
        self._pending: dict[Stage, deque[Job]] = {stage: deque() for stage in stages}
        makers: dict[str, int] = {}
        self._has_feedback = False
        for number, (stage, values) in enumerate(zip(stages, settings, strict=True)):
            for port in stage.outputs(values):
                makers[port.name] = number
        for number, (stage, values) in enumerate(zip(stages, settings, strict=True)):
            for port in stage.inputs(values):
                self._consumers.setdefault(port.name, []).append(stage)
                self._has_feedback |= makers.get(port.name, -1) >= number
        self._at_once = {stage: 1 if self._has_feedback else stage.at_once for stage in stages}
        self._made: deque[Made] = deque()

    def change(self, stage: Stage, settings: Any, before: DwellKey) -> None:
        """Have a stage use other settings from a dwell on."""
        stage.change(settings, before)

    def schedule(self, stage: Stage, before: DwellKey, port: str, item: Any) -> None:
        """Have a stage accept an item right before the job of a dwell is made."""
        stage.schedule(before, port, item)

    def give(self, stage: Stage, port: str, item: Any) -> None:
        """Have a stage accept an item now, which does not go to others."""
        self._take(stage, stage.accept(port, item))

    def start(self, stamp_ns: int = 0) -> Iterator[Made]:
        """Yield what the stages make before anything is fed."""
        for stage in self.stages:
            self._take(stage, stage.start(stamp_ns))
        yield from self._results(drain=False)

    def feed(self, port: str, item: Any) -> Iterator[Made]:
        """Yield what the stages make of an item on a port, as far as it is due."""
        self._deliver(port, item)
        yield from self._results(drain=False)

    def nothing_before(self, port: str, stamp_ns: int) -> Iterator[Made]:
        """Yield what the stages make or give up because no item with an earlier stamp will be fed to a port."""
        for stage in self._consumers.get(port, ()):
            self._take(stage, stage.nothing_before(port, stamp_ns))
        yield from self._results(drain=False)

    def finish(self) -> Iterator[Made]:
        """Yield what the stages make or give up as nothing more is fed: stage by stage, in the order of the data."""
        yield from self._results(drain=True)
        for stage in self.stages:
            self._take(stage, stage.finish())
            yield from self._results(drain=True)

    def _deliver(self, port: str, item: Any) -> None:
        for stage in self._consumers.get(port, ()):
            self._take(stage, stage.accept(port, item))

    def _take(self, stage: Stage, decisions: Sequence[Decision], dwell: DwellKey | None = None) -> None:
        """Keep jobs for later, and hand products on to the stages that consume them."""
        for one in decisions:
            if isinstance(one, Job):
                if not isinstance(one.inputs, Rehearsal):
                    self._keep(stage, one)
                continue
            self._made.append(Made(stage, dwell, one))
            if isinstance(one, Product):
                self._deliver(one.port, one.item)

    def _keep(self, stage: Stage, job: Job) -> None:
        """Keep a job for later."""
        self._pending[stage].append(job)

    def _results(self, *, drain: bool) -> Iterator[Made]:
        """Process the jobs that are due, and yield what was made."""
        while due := self._due(drain=drain):
            stage, jobs = due
            for job, results in zip(jobs, stage.process(jobs), strict=True):
                self._conclude(stage, job, results)
            yield from self._given()
        yield from self._given()

    def _conclude(self, stage: Stage, job: Job, results: Sequence[Result]) -> None:
        """Hand on the results of a job, and notify its stage of them."""
        self._take(stage, results, job.dwell)
        self._take(stage, stage.note_done(job, results))

    def _due(self, *, drain: bool) -> tuple[Stage, list[Job]] | None:
        """The first stage that has enough jobs to be worth it, or any if all are to be done, and these jobs."""
        for stage in self.stages:
            pending, most = self._pending[stage], self._at_once[stage]
            if len(pending) >= most or (drain and pending):
                return stage, [pending.popleft() for _ in range(min(most, len(pending)))]
        return None

    def _given(self) -> Iterator[Made]:
        while self._made:
            yield self._made.popleft()
