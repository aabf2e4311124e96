"""What holds for every stage: accounts balance, memory is bounded, and it does not matter where jobs are processed."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from driven import Driven, Step, accept, advance, finish, nothing_before
from flown_items import START_NS, count_of
from same_items import difference
from stage_cases import CASES, Case

from sal_height.engine.dwells import EARLY_KEPT, DwellStage
from sal_height.engine.results import DwellKey, Loss, Result
from sal_height.engine.stage import FOREVER_NS, Job, Stage

TIGHT = {"timeout_s": 0.3, "max_unfinished_dwells": 2, "max_memory_mb": 1}
"""Settings, where a stage has them, with which little may wait, and not for long."""

every_stage = pytest.mark.parametrize("case", CASES, ids=str)


def seeds(first: int, few: int, all_of_them: int) -> pytest.MarkDecorator:
    """Some seeds; the rest is thorough."""
    return pytest.mark.parametrize(
        "seed",
        [
            pytest.param(first + number, marks=[pytest.mark.thorough] if number >= few else [])
            for number in range(all_of_them)
        ],
    )


class Idle:
    """A worker that makes nothing of any job."""

    def process(self, jobs: Sequence[Job]) -> Iterator[Sequence[Result]]:
        yield from ([] for _ in jobs)


def tight(case: Case) -> dict[str, Any]:
    return {name: value for name, value in TIGHT.items() if name in case.kind.settings.model_fields}


def reset(stage: Stage) -> Any:
    return stage.reset()


def start(stage: Stage) -> Any:
    return stage.start(START_NS)


def play(case: Case, steps: Sequence[Step], stage: Stage | None = None, **options: Any) -> Driven:
    stage = stage or case.make()
    return Driven(stage, options.pop("worker", stage), rehearses=case.rehearses, **options).play(steps)


def in_order(case: Case) -> list[Step]:
    """All that arrives in a flight, and its end."""
    return [start, *(accept(port, item) for port, item in case.items()), finish]


class Script:
    """What may happen to a stage: items in any order, some of them twice, and whatever a host does in between.

    Attributes:
        steps: of a host.
        fed: counted messages of each dwell among them.
    """

    def __init__(self, case: Case, seed: int, *, has_time: bool) -> None:
        rng = np.random.default_rng(seed)
        self._case, self._rng, self._now_s = case, rng, 0.0
        items = list(case.items())
        self._keys = [item.key for port, item in items if port in case.counted()]
        self._announces = bool(rng.integers(2))
        self.steps: list[Step] = [start]
        self.fed: Counter[DwellKey] = Counter()
        jitter = rng.choice([0.0, 3.0, 100.0])  # from the order of a flight to any order
        for number in np.argsort(np.arange(len(items)) + jitter * rng.random(len(items))).tolist():
            for _ in range(2 if rng.random() < 0.1 else 1):
                self._feed(*items[number])
            if rng.random() < 0.3:
                self._add(self._something(has_time=has_time))
        self._add(finish)

    def _feed(self, port: str, item: Any) -> None:
        if port in self._case.counted():
            self.fed[item.key] += count_of(item)
        self._add(accept(port, item, self._now_s))

    def _add(self, step: Step) -> None:
        self.steps.append(step)

    def _something(self, *, has_time: bool) -> Step:
        """A step of a host that is no item."""
        rng, kind = self._rng, self._case.kind
        other = kind.settings(**self._case.changed).changed(**tight(self._case))
        key = self._keys[rng.integers(len(self._keys))] if self._keys else None
        port = str(rng.choice([port.name for port in kind.inputs(self._case.settings)]))
        command = str(rng.choice(list(kind.commands))) if kind.commands else ""
        stamp_ns = rng.choice([FOREVER_NS, key.stamp_ns if key else 0, key.stamp_ns + 1 if key else 1]).item()
        steps: list[tuple[float, Step]] = [
            (0.1, reset),
            (0.2, lambda stage: stage.change(other)),
            (0.2, lambda stage: stage.change(other, before=key)),
            (0.1 if self._announces else 0.0, nothing_before(port, stamp_ns)),
            (0.05, finish),
            (0.1 if command else 0.0, lambda stage: stage.command(command)),
            (0.25 if has_time else 0.0, self._tick()),
        ]
        weights = np.array([weight for weight, _ in steps])
        return steps[rng.choice(len(steps), p=weights / weights.sum())][1]

    def _tick(self) -> Step:
        self._now_s += float(self._rng.choice([0.1, 1.0]))
        return advance(self._now_s, busy=bool(self._rng.integers(2)))


def check_accounts(driven: Driven, fed: Counter[DwellKey]) -> None:
    """Every counted message is in one job or one loss, and each job ends in results or in one loss."""
    at_once = [one for one in driven.decided if isinstance(one, Loss)]
    taken: Counter[DwellKey | None] = Counter()
    for one in (*driven.jobs, *at_once):
        taken[one.dwell] += one.messages
    assert {key: count for key, count in taken.items() if count} == dict(fed)
    assert len(driven.results) == len(driven.jobs)
    for job, results in zip(driven.jobs, driven.results, strict=True):
        losses = [one for one in results if isinstance(one, Loss)]
        assert [(one.dwell, one.messages) for one in losses] in ([], [(job.dwell, job.messages)])
    faults = [one for one in (*driven.losses, *driven.notices) if one.trace]
    assert not faults, faults[0]


def check_bounds(stage: Stage) -> None:
    """What waits in a stage is not more than its settings allow; one dwell always may."""
    if isinstance(stage, DwellStage):
        settings, waiting, early = stage._settings, stage._assembler.unfinished(), stage._early
        assert len(waiting) <= settings.max_unfinished_dwells
        assert len(waiting) == 1 or sum(dwell.size for dwell in waiting) <= settings.max_memory_bytes
        assert len(early) <= EARLY_KEPT
        assert sum(one.message.size for one in early) <= settings.max_memory_bytes


@every_stage
@seeds(0, 4, 12)
def test_accounts_balance_and_memory_is_bounded_whatever_happens(case: Case, seed: int) -> None:
    """Jobs are made and counted, but not processed."""
    script, driven = Script(case, seed, has_time=True), Driven(case.make(**tight(case)), Idle())
    for step in script.steps:
        driven.do(step)
        check_bounds(driven.stage)
    check_accounts(driven, script.fed)


@every_stage
@seeds(100, 1, 2)
def test_the_cheap_side_touches_nothing_that_the_heavy_side_keeps(case: Case, seed: int) -> None:
    """A copy of the stage that processes all jobs, and decides nothing, makes the same of them."""
    script = Script(case, seed, has_time=True)
    alone = play(case, script.steps, case.make(**tight(case)))
    stage = case.make(**tight(case))
    apart = play(case, script.steps, stage, worker=copy.deepcopy(stage))
    check_accounts(alone, script.fed)
    check_accounts(apart, script.fed)
    assert not difference(alone.decided, apart.decided)
    assert not difference(alone.results, apart.results)
    assert (alone.stage.is_ready, alone.stage.unpublished) == (apart.stage.is_ready, apart.stage.unpublished)


@every_stage
def test_in_the_order_of_a_flight_every_dwell_has_its_product(case: Case) -> None:
    driven = play(case, in_order(case))
    assert not driven.losses
    assert driven.stage.is_ready
    assert driven.stage.unpublished == 0
    assert case.makes is None or len(driven.made) == case.makes


@every_stage
def test_jobs_make_the_same_in_another_process_or_thread_and_later(case: Case) -> None:
    """Without time that passes, which says when what was made may be published."""
    at_once = play(case, in_order(case))
    stage = case.make()
    elsewhere = play(case, in_order(case), stage, worker=copy.deepcopy(stage), pickled=True)
    later = play(case, in_order(case), deferred=True)
    for other in (elsewhere, later):
        assert not difference(at_once.results, other.results)
    stage, running = case.make(), []
    driven = Driven(stage, stage, rehearses=case.rehearses)
    with ThreadPoolExecutor(1) as thread:
        for step in in_order(case):
            jobs = [one for one in step(stage) or () if isinstance(one, Job)]
            running += [thread.submit(driven.processed, [job]) for job in jobs]
    assert not difference(at_once.results, [one.result()[0] for one in running])


@every_stage
@pytest.mark.parametrize("group", [2, 8])
def test_jobs_make_the_same_in_any_groups(case: Case, group: int) -> None:
    """As messages are rounded, and so in every number."""
    one_by_one = play(case, in_order(case))
    together = play(case, in_order(case), group=group)
    assert not difference(one_by_one.results, together.results)
    assert len(one_by_one.jobs) == len(together.jobs)
