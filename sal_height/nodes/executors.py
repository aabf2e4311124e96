"""Which executor spins a node.

rclpy's EventsExecutor is told of messages by the middleware: it takes a tenth of the time of an executor that makes a
wait set of all its nodes' topics, timers and services for every message. It hands over messages without the times of
their transport, though; whoever needs these (`Role.takes_message_info`) is spun by wait sets.
"""

from __future__ import annotations

import sys
import threading
from contextlib import redirect_stderr, suppress

from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

STOP_PERIOD_S = 0.1
"""How long a thread that spins a node may go on after it was asked to stop."""


def needs_wait_set(node: Node) -> bool:
    """Whether a node takes the times of transport beside its messages."""
    return bool(getattr(node, "takes_message_info", False))


def events_executor(context: Context) -> Executor:
    """An executor without nodes.

    rclpy has it report crashes on the standard error stream, and fails where that is no file, as in a notebook.
    """
    with redirect_stderr(sys.__stderr__):
        return EventsExecutor(context=context)


def executor_for(node: Node) -> Executor:
    """An executor of its own for a node, which has been added."""
    context = node.context
    executor = SingleThreadedExecutor(context=context) if needs_wait_set(node) else events_executor(context)
    executor.add_node(node)
    return executor


class Spinning:
    """A thread that spins a node by an executor of its own."""

    def __init__(self, node: Node) -> None:
        """Begin."""
        self._node = node
        self._executor = executor_for(node)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, name=f"spin {node.get_name()}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Let the callback at hand end, and run no other; the node can be destroyed then."""
        self._stopping.set()
        self._executor.wake()
        self._thread.join()
        self._executor.remove_node(self._node)
        self._executor.shutdown()

    def _spin(self) -> None:
        with suppress(ExternalShutdownException, RCLError):  # the context may end meanwhile
            while not self._stopping.is_set() and self._node.context.ok():
                self._executor.spin_once(timeout_sec=STOP_PERIOD_S)
