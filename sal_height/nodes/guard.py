"""Guard of callbacks, so that an error in one does not end the node."""

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
