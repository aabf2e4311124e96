"""Mappers before the first dwell."""

from __future__ import annotations

import pickle
from typing import Any

import pytest

from sal_height.engine.mapper import GroundMapper, Mapper, ReliefMapper
from sal_height.engine.results import Result
from sal_height.engine.stage import Job, Rehearsal
from sal_height.engine.tracker import made_up_item
from sal_height.relief import CellMap


@pytest.mark.parametrize("kind", [ReliefMapper, GroundMapper])
def test_a_mapper_is_ready_once_made_up_heights_are_in_a_map_of_their_own(
    kind: type[Mapper], monkeypatch: pytest.MonkeyPatch
) -> None:
    entered, empty_map = list[CellMap](), kind.empty_map

    def noted(*arguments: Any) -> CellMap:
        entered.append(empty_map(*arguments))
        return entered[-1]

    monkeypatch.setattr(kind, "empty_map", noted)
    stage = kind(kind.settings())
    (rehearsal,) = stage.start(0)
    assert isinstance(rehearsal, Job)
    assert rehearsal.inputs == Rehearsal()
    assert not stage.is_ready
    assert results_of(stage, rehearsal) == []
    assert stage.is_ready
    assert len(entered) == 1
    assert entered[0].relief() is not None
    (end,) = stage.finish()
    assert results_of(stage, end) == []  # no map is published


def test_a_mapper_whose_map_has_no_room_for_made_up_heights_is_ready_nevertheless() -> None:
    stage = ReliefMapper(ReliefMapper.settings(cell_size_m=1e-3, max_cells=1))
    (rehearsal,) = stage.start(0)
    assert results_of(stage, rehearsal) == []
    assert stage.is_ready


def results_of(stage: Mapper, job: Any) -> list[Result]:
    """The results of a job, of which the stage is notified."""
    (results,) = stage.process([job])
    assert not stage.note_done(job, results)
    return list(results)


def test_made_up_heights_are_as_a_worker_sends_them() -> None:
    """Compiled loops are loaded anew for arrays that may not be written, which those from another process are."""
    heights = made_up_item("map")
    received = pickle.loads(pickle.dumps(heights, protocol=5))  # noqa: S301 (our own bytes)
    for name in ("position", "velocity", "covariance"):
        assert not getattr(heights.aperture, name).flags.writeable
        assert getattr(received.aperture, name).flags == getattr(heights.aperture, name).flags
