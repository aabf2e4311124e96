"""Choice of the executor that spins a node.

The middleware notifies rclpy's EventsExecutor of messages: it takes a tenth of the time of an executor that makes a
wait set of all its nodes' topics, timers and services for every message.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from contextlib import redirect_stderr
from typing import Any

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node


def events_executor(context: Context) -> Executor:
    """An executor without nodes.

    rclpy has it report crashes on the standard error stream, and fails where that is no file, as in a notebook.
    """
    with redirect_stderr(sys.__stderr__):
        return EventsExecutor(context=context)


def executor_for(node: Node) -> Executor:
    """An executor of its own for a node, which has been added."""
    executor = events_executor(node.context)
    executor.add_node(node)
    return executor


def with_times(callback: Callable[[Any, dict[str, Any]], Any]) -> Callable[..., Any]:
    """A callback of a subscription that takes a message and the times of its transport, as executors call it.

    EventsExecutor hands both over as one tuple, the other executors of rclpy one after the other.
    """

    @functools.wraps(callback)  # rclpy looks at the parameters of a callback
    def call(*arguments: Any) -> Any:
        return callback(*(arguments[0] if len(arguments) == 1 else arguments))

    return call
