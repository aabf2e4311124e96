"""Memory that a process and its worker share."""

from __future__ import annotations

import numpy as np

from sal_height.runs.side_by_side import Ring


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
