"""Objects between processes: large arrays through shared memory, objects that never change once."""

from __future__ import annotations

import io
import mmap
import pickle
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from sal_height.calibration import Calibration
from sal_height.engine.image_items import Source
from sal_height.engine.provenance import Provenance
from sal_height.sensor import Sensor
from sal_height.settings import Settings

SHARED = (Sensor, Settings, Calibration, Provenance)
"""Classes of objects that are never changed, and of which a process keeps the ones that it was sent."""

KEPT = 256
"""Objects of these classes that the receiver keeps: the one whose last use is longest ago makes room for the next."""

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


def copy_into(memory: mmap.mmap, at: int, array: Array) -> None:
    """Copy an array into memory at an offset."""
    np.frombuffer(memory, array.dtype, array.size, at)[:] = array.reshape(-1)


def array_in(memory: mmap.mmap) -> ArrayAt:
    """Function that returns arrays in memory, which are not copied."""

    def array_at(at: int, dtype: str, shape: tuple[int, ...]) -> Array:
        return np.frombuffer(memory, dtype, int(np.prod(shape)), at).reshape(shape)

    return array_at


class Known:
    """Shared objects that a receiver keeps, as their sender knows them."""

    def __init__(self) -> None:
        self._kept: OrderedDict[int, tuple[int, Any]] = OrderedDict()

    def place_of(self, shared: Any) -> tuple[int, bool]:
        """Place at which the receiver keeps an object, and whether it has it already; else it is to be sent."""
        found = self._kept.get(id(shared))
        if found is not None:
            self._kept.move_to_end(id(shared))
            return found[0], True
        place = len(self._kept) if len(self._kept) < KEPT else self._kept.popitem(last=False)[1][0]
        self._kept[id(shared)] = place, shared  # as long as it is kept, no other object has its identity
        return place, False


class Pickler(pickle.Pickler):
    """Sends shared objects once, and large arrays through shared memory."""

    def __init__(self, file: io.BytesIO, known: Known, put: Put) -> None:
        super().__init__(file, protocol=5)
        self._known, self._put = known, put

    def reducer_override(self, obj: Any) -> Any:
        """Substitute for an object that is not sent as it is; called for instances of classes only, each once."""
        kind = type(obj)
        if kind is np.ndarray:
            least_shared_bytes = 16_384  # smaller arrays do not go through shared memory
            if obj.nbytes >= least_shared_bytes and obj.flags.c_contiguous:
                at = self._put(obj)
                if at is not None:
                    return _array_sent, (at, obj.dtype.str, obj.shape)
        elif isinstance(obj, Source):  # who made the job has frames and odometry
            return replace(obj, frames=(), states=[]).__reduce_ex__(5)
        elif isinstance(obj, SHARED):
            place, is_kept = self._known.place_of(obj)
            return (_kept_object, (place,)) if is_kept else (_new_object, (place, pickle.dumps(obj, protocol=5)))
        return NotImplemented


_READING = threading.local()
"""The `Unpickler` that reads in a thread, for the functions that stand for what is not sent as it is."""


def _array_sent(at: int, dtype: str, shape: tuple[int, ...]) -> Array:
    """The array at an offset of the shared memory."""
    reading: Unpickler = _READING.unpickler
    return reading.array_at(at, dtype, shape)


def _kept_object(place: int) -> Any:
    """The shared object that is kept at a place."""
    return _READING.unpickler.known[place]


def _new_object(place: int, sent: bytes) -> Any:
    """A shared object, which is kept at a place from now on."""
    _READING.unpickler.known[place] = made = pickle.loads(sent)  # noqa: S301 (our own process wrote it)
    return made


class Unpickler(pickle.Unpickler):
    """Reads what `Pickler` has written.

    Attributes:
        known: shared objects that are kept, by their places.
        array_at: function that returns the arrays in shared memory.
    """

    def __init__(self, file: io.BytesIO, known: dict[int, Any], array_at: ArrayAt | None) -> None:
        super().__init__(file)
        self.known = known
        self.array_at = array_at or _no_array

    def load(self) -> Any:
        """The object that was written."""
        _READING.unpickler = self
        try:
            return super().load()
        finally:
            del _READING.unpickler


def _no_array(at: int, dtype: str, shape: tuple[int, ...]) -> Array:
    raise ValueError(f"There is no shared memory that has an array of shape {shape} and type {dtype} at {at}.")
