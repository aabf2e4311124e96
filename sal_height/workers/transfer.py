"""Objects between processes: large arrays through shared memory, objects that never change once."""

from __future__ import annotations

import functools
import io
import mmap
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from sal_height.calibration import Calibration
from sal_height.sensor import Sensor
from sal_height.settings import Settings

SHARED = (Sensor, Settings, Calibration)
"""Classes of objects that are never changed, and of which a process keeps the ones that it was sent."""

Array: TypeAlias = np.ndarray[Any, np.dtype[Any]]
Put = Callable[[Array], int | None]
"""Function that has an array in shared memory and returns its offset; None: there is no room for it."""

ArrayAt = Callable[[int, str, tuple[int, ...]], Array]
"""Function that returns the array at an offset, of a type and shape."""

ALIGNMENT = 64
"""Arrays in shared memory begin at multiples of so many bytes."""


def room_for(size: int) -> int:
    """Bytes that an array of `size` bytes takes in shared memory."""
    return -(-size // ALIGNMENT) * ALIGNMENT


@dataclass
class Ring:
    """Memory shared by two processes; it is released in the order in which it was written."""

    memory: mmap.mmap
    size: int
    at: int = 0
    used: int = 0
    taken: int = 0
    """Bytes used by the current message."""

    @classmethod
    def of(cls, size: int) -> Ring:
        """A ring of `size` bytes, shared by processes that are forked."""
        return cls(mmap.mmap(-1, size), size)

    def put(self, array: Array) -> int | None:
        """Copy an array into the ring and return its offset; None: there is no room for it."""
        room = room_for(array.nbytes)
        if not self.used:
            self.at = 0
        wraps = self.at + room > self.size
        skipped = self.size - self.at if wraps else 0
        if self.used + skipped + room > self.size:
            return None
        at = 0 if wraps else self.at
        copy_into(self.memory, at, array)
        self.at, self.used, self.taken = at + room, self.used + skipped + room, self.taken + skipped + room
        return at

    def release(self, taken: int) -> None:
        """Release the bytes of the oldest message."""
        self.used -= taken


def copy_into(memory: mmap.mmap, at: int, array: Array) -> None:
    """Copy an array into memory at an offset."""
    np.frombuffer(memory, array.dtype, array.size, at)[:] = array.reshape(-1)


def array_in(memory: mmap.mmap) -> ArrayAt:
    """Function that returns arrays in memory, which are not copied."""

    def array_at(at: int, dtype: str, shape: tuple[int, ...]) -> Array:
        return np.frombuffer(memory, dtype, int(np.prod(shape)), at).reshape(shape)

    return array_at


@functools.cache
def _is_shared(kind: type) -> bool:
    """True if objects of a class are sent once."""
    return issubclass(kind, SHARED)


class Pickler(pickle.Pickler):
    """Sends shared objects once, and large arrays through shared memory."""

    def __init__(self, file: io.BytesIO, known: dict[int, tuple[int, Any]], put: Put | None) -> None:
        super().__init__(file, protocol=5)
        self._known, self._put = known, put

    def persistent_id(self, obj: Any) -> Any:
        """Substitute for an object that is not sent as it is; called for every one, however small."""
        kind = type(obj)
        if kind is np.ndarray:
            least_shared_bytes = 16_384  # smaller arrays do not go through shared memory
            if self._put and obj.nbytes >= least_shared_bytes and obj.flags.c_contiguous:
                at = self._put(obj)
                if at is not None:
                    return "array", at, obj.dtype.str, obj.shape
            return None
        if not _is_shared(kind):  # type: ignore[arg-type]
            return None
        if id(obj) in self._known:
            return "known", self._known[id(obj)][0]
        number = len(self._known)
        self._known[id(obj)] = number, obj
        return "new", number, pickle.dumps(obj, protocol=5)


class Unpickler(pickle.Unpickler):
    """Reads what `Pickler` has written."""

    def __init__(self, file: io.BytesIO, known: dict[int, Any], array_at: ArrayAt | None) -> None:
        super().__init__(file)
        self._known, self._array_at = known, array_at

    def persistent_load(self, pid: Any) -> Any:
        """The object that was sent otherwise."""
        kind, *rest = pid
        if kind == "array" and self._array_at:
            return self._array_at(*rest)
        if kind == "new":
            self._known[rest[0]] = pickle.loads(rest[1])  # noqa: S301 (our own process wrote it)
        return self._known[rest[0]]
