"""What a node says of the memory of its process."""

from __future__ import annotations

import mmap
import sys
from multiprocessing.shared_memory import SharedMemory

import pytest

from sal_height.nodes.accounts.tally import process_numbers

SIZE_MB = 50


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells it")
def test_memory_is_that_of_the_process_without_what_it_shares() -> None:
    before = process_numbers()["memory_mb"]
    own = mmap.mmap(-1, SIZE_MB * 1_000_000, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)  # new pages, whatever was freed
    own.write(bytes(len(own)))
    with_own = process_numbers()["memory_mb"]
    assert with_own - before == pytest.approx(SIZE_MB, abs=5)
    shared = SharedMemory(create=True, size=SIZE_MB * 1_000_000)
    try:
        shared.buf[: len(own)] = own[:]
        assert process_numbers()["memory_mb"] - with_own == pytest.approx(0, abs=5)
    finally:
        shared.close()
        shared.unlink()
