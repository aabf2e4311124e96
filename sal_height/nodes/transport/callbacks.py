"""Callbacks that accept the times of transport, whose errors do not end the node, or that no message delays."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any


def guarded(callback: Callable[..., Any], handle: Callable[[Exception], None]) -> Callable[..., Any]:
    """The callback, except that an error in it goes to `handle`, and None is returned."""

    @functools.wraps(callback)  # rclpy looks at the parameters of a callback
    def call(*arguments: Any) -> Any:
        try:
            return callback(*arguments)
        except Exception as error:  # noqa: BLE001 (no message may end the node)
            handle(error)
            return None

    return call


def guarded_with_times(
    callback: Callable[[Any, dict[str, Any]], None], handle: Callable[[Exception], None]
) -> Callable[..., None]:
    """A callback of a subscription that takes a message and the times of its transport; errors go to `handle`.

    EventsExecutor hands both over as one tuple, the other executors of rclpy one after the other.
    """

    @functools.wraps(callback)  # rclpy looks at the parameters of a callback
    def call(*arguments: Any) -> None:
        try:
            callback(*(arguments[0] if len(arguments) == 1 else arguments))
        except Exception as error:  # noqa: BLE001 (no message may end the node)
            handle(error)

    return call


class Repeated:
    """Calls a function at regular times, on a thread of its own, until it is ended.

    A timer of a node is late by all messages that arrived before it: where more arrive than are handled, by ever more.
    """

    def __init__(self, period_s: float, function: Callable[[], Any], name: str) -> None:
        """Start; `function` must not raise, and `name` is that of the thread."""
        self._period_s, self._function = period_s, function
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Wait for the last call; there are no more. May be called twice."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(self._period_s):
            self._function()
