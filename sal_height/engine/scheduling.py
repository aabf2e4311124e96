"""Changes of settings, calibrations and the like that belong to a dwell: each takes effect right before its job.

A dwell can be scheduled to be left out, too.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Any, ClassVar

from sal_height.errors import Rejected


class Scheduling:
    """The part of a stage that keeps what was scheduled before dwells, and accepts it when their jobs are made."""

    changeable: ClassVar[Sequence[str]] = ()
    """Attributes, in addition to the settings, that scheduled items may change; copy() copies them."""

    _settings: Any
    _is_reset: bool
    _decisions: list[Any]

    def __init__(self) -> None:
        """Start without changes."""
        self._scheduled: dict[Hashable, Sequence[tuple[str, Any]]] = {}
        self._left_out: dict[Hashable, Rejected] = {}
        """Reasons for which dwells make no job."""
        self._is_applying = False

    @abstractmethod
    def accept_scheduled(self, port: str, item: Any) -> None:
        """Accept an item that was scheduled; one that cannot be used is a notice. Port "": it is no item of a port."""

    def schedule(self, before: Hashable, port: str, item: Any) -> None:
        """Have an item accepted right before the job of a dwell is made.

        If the dwell is lost, the item is accepted then: changes before it apply to the dwells after it.

        Args:
            before: key of the dwell.
            port: name of the port of the item; empty: it is none of a port.
            item: item of the kind of the port; without a port other settings, a Reset after which the dwell is
                processed as the first one, or the reason for which the dwell is left out once it has all it needs.
        """
        if isinstance(item, Rejected):
            self._left_out[before] = item
        else:
            self._scheduled[before] = (*self._scheduled.get(before, ()), (port, item))

    def apply_scheduled(self, dwell: Hashable) -> None:
        """Accept what was scheduled right before a dwell."""
        self._is_applying = True
        try:
            for port, item in self._scheduled.pop(dwell, ()):
                self.accept_scheduled(port, item)
        finally:
            self._is_applying = False

    @contextmanager
    def as_before(self, dwell: Hashable) -> Iterator[None]:
        """Context in which what was scheduled before a dwell has been accepted; nothing is decided in it."""
        if dwell not in self._scheduled:
            yield
            return
        values = {name: getattr(self, name) for name in ("_settings", "_is_reset", *self.changeable)}
        for name in self.changeable:
            setattr(self, name, copy(values[name]))
        scheduled, decided = self._scheduled[dwell], len(self._decisions)
        self.apply_scheduled(dwell)
        try:
            yield
        finally:
            for name, value in values.items():
                setattr(self, name, value)
            self._scheduled[dwell] = scheduled
            del self._decisions[decided:]
