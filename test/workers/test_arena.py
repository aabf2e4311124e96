"""Blocks of shared memory: none overlap, and all that is released is free again."""

from __future__ import annotations

import gc
from itertools import pairwise

import numpy as np
import pytest

from sal_height.workers.arena import Arena, MemoryBlock, Region


def test_blocks_do_not_overlap_and_join_again_in_whatever_order_they_are_released() -> None:
    arena = Arena(1 << 16)
    blocks = [arena.allocate(size) for size in (1, 64, 65, 1000, 4096)]
    assert None not in blocks
    ends = [(block.start, block.start + block.size) for block in blocks if block]
    assert all(start % 64 == 0 for start, _ in ends)
    assert all(end <= start for (_, end), (start, _) in pairwise(ends))
    for block in (blocks[1], blocks[3], blocks[0], blocks[4], blocks[2]):
        assert block is not None
        arena.release(block)
    assert arena.free_bytes == 1 << 16
    assert arena.allocate(1 << 16) == MemoryBlock(0, 1 << 16)


def test_what_has_no_room_is_refused_and_the_lowest_room_is_taken_first() -> None:
    arena = Arena(1024)
    first, second = arena.allocate(512), arena.allocate(256)
    assert first is not None
    assert second is not None
    assert arena.allocate(512) is None
    arena.release(first)
    assert arena.allocate(100) == MemoryBlock(0, 128)


def test_a_shrunk_block_gives_its_end_back() -> None:
    arena = Arena(1024)
    block = arena.allocate(1024)
    assert block is not None
    assert arena.shrink(block, 100) == MemoryBlock(0, 128)
    assert arena.free_bytes == 1024 - 128


def test_a_block_is_released_once_no_array_in_it_is_left() -> None:
    arena = Arena(4096)
    block = arena.allocate(4096)
    assert block is not None
    whole = arena.bytes_of(block)
    part = whole[64:128].view(np.float64).reshape(2, 4)
    del whole
    gc.collect()
    assert arena.free_bytes == 0
    part[:] = 1.0
    assert arena.offset_of(part) == 64
    assert arena.offset_of(np.zeros(3)) is None
    del part
    gc.collect()
    assert arena.free_bytes == 4096


@pytest.mark.parametrize("size", [0, 128, 1 << 12])
def test_a_region_counts_what_had_no_room(size: int) -> None:
    arena = Arena(1 << 12)
    region = Region(arena.memory, MemoryBlock(0, size) if size else None)
    one, other = np.arange(8.0), np.arange(20.0)
    found = [region.put(one), region.put(other)]
    assert found == {0: [None, None], 128: [0, None], 1 << 12: [0, 64]}[size]
    assert region.asked == 64 + 192
    assert region.used == sum(room for at, room in zip(found, (64, 192), strict=True) if at is not None)
    if found[1] is not None:
        assert np.array_equal(np.frombuffer(arena.memory, float, 20, found[1]), other)
