"""The last few descriptions of a kind, by name: those in use stay when others come."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, TypeVar

Value = TypeVar("Value")

HELD_CALIBRATIONS = 4
"""Calibrations that a node holds: images made with one may come after the next."""


class Held(Generic[Value]):
    """Values by name, so many at most.

    When there are too many, one goes that was never used, the oldest of them; else the one whose last use is longest
    ago. So nobody can push out what is in use by describing things that do not exist.
    """

    def __init__(self, capacity: int) -> None:
        """Hold so many values."""
        self._capacity = capacity
        self._unused: dict[str, Value] = {}
        self._used: dict[str, Value] = {}

    def __len__(self) -> int:
        """Number of values."""
        return len(self._unused) + len(self._used)

    def __iter__(self) -> Iterator[str]:
        """Names, in the order in which they go."""
        return iter([*self._unused, *self._used])

    @property
    def is_in_use(self) -> bool:
        """Whether any of them has been used."""
        return bool(self._used)

    def get(self, name: str) -> Value | None:
        """The value of that name, whether in use or not; None if it is not held."""
        return self._used.get(name, self._unused.get(name))

    def put(self, name: str, value: Value) -> str | None:
        """Hold a value, in place of the one of that name; returns the name of one that had to go for it, if any."""
        if name in self._used:
            self._used[name] = value
            return None
        self._unused.pop(name, None)
        self._unused[name] = value
        if len(self) <= self._capacity:
            return None
        gone = next((other for other in self if other != name), name)
        for values in (self._unused, self._used):
            values.pop(gone, None)
        return gone

    def use(self, name: str) -> Value | None:
        """The value of that name, which is in use from now on; None if it is not held."""
        value = self._used.pop(name, None)
        if value is None:
            value = self._unused.pop(name, None)
        if value is not None:
            self._used[name] = value
        return value
