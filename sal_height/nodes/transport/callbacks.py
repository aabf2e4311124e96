"""Callbacks that accept the times of transport, or whose errors do not end the node."""

from __future__ import annotations

import functools
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


def with_times(callback: Callable[[Any, dict[str, Any]], Any]) -> Callable[..., Any]:
    """A callback of a subscription that takes a message and the times of its transport, as executors call it.

    EventsExecutor hands both over as one tuple, the other executors of rclpy one after the other.
    """

    @functools.wraps(callback)  # rclpy looks at the parameters of a callback
    def call(*arguments: Any) -> Any:
        return callback(*(arguments[0] if len(arguments) == 1 else arguments))

    return call
