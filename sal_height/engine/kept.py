"""The last few descriptions of a kind, by name: those in use stay when others arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, Self, TypeVar

Value = TypeVar("Value")


class Kept(Generic[Value]):
    """Values by name, up to a number.

    When there are too many, one goes that was never used, the oldest of them; else the one whose last use is longest
    ago. So nobody can push out what is in use by describing things that do not exist.
    """

    def __init__(self, capacity: int) -> None:
        """Keep up to `capacity` values."""
        self._capacity = capacity
        self._unused: dict[str, Value] = {}
        self._used: dict[str, Value] = {}

    def __copy__(self) -> Self:
        """The same values; the copy keeps others later."""
        copied = type(self)(self._capacity)
        copied._unused, copied._used = dict(self._unused), dict(self._used)  # noqa: SLF001 (of our own class)
        return copied

    def __len__(self) -> int:
        """Number of values."""
        return len(self._unused) + len(self._used)

    def __iter__(self) -> Iterator[str]:
        """Names, in the order in which they go."""
        return iter([*self._unused, *self._used])

    @property
    def is_in_use(self) -> bool:
        """True if any of them has been used."""
        return bool(self._used)

    def get(self, name: str) -> Value | None:
        """The value of that name, whether in use or not; None if it is not kept."""
        return self._used.get(name, self._unused.get(name))

    def put(self, name: str, value: Value) -> str | None:
        """Keep a value, in place of the one of that name; returns the name of one that had to go for it, if any."""
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
        """The value of that name, which is in use from now on; None if it is not kept."""
        value = self._used.pop(name, None)
        if value is None:
            value = self._unused.pop(name, None)
        if value is not None:
            self._used[name] = value
        return value


class RecentValues(Generic[Value]):
    """Values by name, each made when it is first asked for; those that were asked for last are kept."""

    def __init__(self, capacity: int, make: Callable[[], Value]) -> None:
        """Keep up to `capacity` values, which `make` makes."""
        self._capacity = capacity
        self._make = make
        self._values: dict[str, Value] = {}

    def of(self, name: str) -> Value:
        """The value of a name."""
        value = self._values.pop(name) if name in self._values else self._make()
        self._values[name] = value
        return value

    def take_surplus(self) -> list[Value]:
        """Remove the values that are too many, and return them."""
        names = list(self._values)[: -self._capacity]
        return [self._values.pop(name) for name in names]

    def remove(self, name: str) -> None:
        """Remove the value of a name, if it is kept."""
        self._values.pop(name, None)

    def take_all(self) -> list[Value]:
        """Remove all values, and return them, that asked for last being the last."""
        values, self._values = list(self._values.values()), {}
        return values

    def values(self) -> list[Value]:
        """All values, that asked for last being the last."""
        return list(self._values.values())
