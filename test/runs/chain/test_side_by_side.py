"""Memory that a process and its worker share."""

from __future__ import annotations

import numpy as np

from sal_height.engine.stage import Job
from sal_height.runs.chain.side_by_side import BYTES_TOGETHER, TOGETHER, _together
from sal_height.workers.transfer import Ring


def test_arrays_that_fill_the_ring_exactly_begin_anew_at_its_start() -> None:
    ring = Ring.of(256)
    whole = np.arange(16.0)
    assert [ring.put(whole), ring.put(whole), ring.put(whole)] == [0, 128, None]
    ring.release(128)
    assert ring.put(whole + 1) == 0
    assert np.array_equal(np.frombuffer(ring.memory, float, 16), whole + 1)
    assert ring.used == 256


def test_arrays_that_do_not_fit_before_the_end_begin_anew_at_the_start() -> None:
    ring = Ring.of(320)
    whole = np.arange(16.0)
    assert [ring.put(whole), ring.put(whole)] == [0, 128]
    assert ring.put(whole) is None
    ring.release(128)
    ring.taken = 0
    assert ring.put(whole) == 0
    assert ring.taken == 64 + 128
    ring.release(128)
    assert ring.put(np.zeros(40)) is None


def test_an_array_as_large_as_the_ring_fits_once_all_is_released() -> None:
    ring = Ring.of(256)
    assert ring.put(np.zeros(8)) == 0
    assert ring.put(np.zeros(32)) is None
    ring.release(64)
    assert ring.put(np.zeros(32)) == 0


def test_large_jobs_are_sent_one_by_one() -> None:
    """Images of many of them would fill the memory."""
    sizes = (0, BYTES_TOGETHER // TOGETHER, BYTES_TOGETHER // 2, BYTES_TOGETHER // 2 + 1, 10 * BYTES_TOGETHER)
    assert [_together([Job(None, None, None, size=size)]) for size in sizes] == [TOGETHER, TOGETHER, 2, 1, 1]
