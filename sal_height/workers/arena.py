"""Shared memory in blocks: one process allocates and releases, all of them read and write."""

from __future__ import annotations

import mmap
import weakref
from bisect import insort
from collections import deque
from typing import NamedTuple

import numpy as np

from sal_height.engine.frame_items import address_of
from sal_height.workers.transfer import Array, copy_into, room_for


class MemoryBlock(NamedTuple):
    """A part of the memory: its start and size, bytes."""

    start: int
    size: int


class Arena:
    """Memory shared by processes that are forked after it was made; one thread of one process allocates.

    What was released last is allocated first where it fits at the lowest address, so that few pages are ever touched.
    """

    def __init__(self, size: int) -> None:
        """Reserve `size` bytes, of which only those that are used take memory."""
        self.memory = mmap.mmap(-1, size)
        self._free = [MemoryBlock(0, size)]
        self._released: deque[MemoryBlock] = deque()
        self._begin = address_of(np.frombuffer(self.memory, np.uint8, 1))
        self._size = size

    def allocate(self, size: int) -> MemoryBlock | None:
        """A block of at least `size` bytes; None: there is none."""
        self._collect()
        room = room_for(max(1, size))
        for place, free in enumerate(self._free):
            if free.size >= room:
                if free.size == room:
                    del self._free[place]
                else:
                    self._free[place] = MemoryBlock(free.start + room, free.size - room)
                return MemoryBlock(free.start, room)
        return None

    def release(self, block: MemoryBlock) -> None:
        """Give a block back; may be called by any thread, also while one allocates."""
        self._released.append(block)

    def shrink(self, block: MemoryBlock, size: int) -> MemoryBlock:
        """Keep the first `size` bytes of a block, and give the others back."""
        room = min(block.size, room_for(size))
        if room < block.size:
            self.release(MemoryBlock(block.start + room, block.size - room))
        return MemoryBlock(block.start, room)

    @property
    def free_bytes(self) -> int:
        """Bytes that are not allocated."""
        self._collect()
        return sum(block.size for block in self._free)

    def offset_of(self, array: Array) -> int | None:
        """Offset of an array that is in the memory; None: it is elsewhere."""
        at = address_of(array) - self._begin
        return at if 0 <= at < self._size else None

    def bytes_of(self, block: MemoryBlock) -> Array:
        """The bytes of a block as an array; once neither it nor a view of it is left, the block is released."""
        whole = np.frombuffer(self.memory, np.uint8, block.size, block.start)
        weakref.finalize(whole, self.release, block).atexit = False
        return whole

    def _collect(self) -> None:
        """Make what was released free, and join it to what is free before and after it."""
        while self._released:
            block = self._released.popleft()
            if not block.size:
                continue
            insort(self._free, block)
            place = self._free.index(block)
            for first in (place, place - 1):
                if 0 <= first < len(self._free) - 1:
                    one, other = self._free[first], self._free[first + 1]
                    if one.start + one.size == other.start:
                        self._free[first : first + 2] = [MemoryBlock(one.start, one.size + other.size)]


class Region:
    """A block that a worker writes arrays into, one after the other.

    Attributes:
        block: block; one of no bytes if there is none.
        used: bytes that are written.
        asked: bytes of all arrays that were to be written, also of those that found no room.
    """

    def __init__(self, memory: mmap.mmap, block: MemoryBlock | None) -> None:
        """Write into a block; None: there is none."""
        self._memory, self.block = memory, block or MemoryBlock(0, 0)
        self.used = self.asked = 0

    def put(self, array: Array) -> int | None:
        """Copy an array into the block and return its offset; None: there is no room for it."""
        room = room_for(array.nbytes)
        self.asked += room
        if self.used + room > self.block.size:
            return None
        at = self.block.start + self.used
        copy_into(self._memory, at, array)
        self.used += room
        return at
