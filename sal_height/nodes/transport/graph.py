"""A set of nodes in one process, spun until something has happened, and the executors that spin nodes.

The middleware notifies rclpy's EventsExecutor of messages: it takes a tenth of the time of an executor that makes a
wait set of all its nodes' topics, timers and services for every message.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from contextlib import redirect_stderr
from types import TracebackType
from typing import Self, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future

from sal_height.nodes.transport.middleware import provide_shared_memory

NodeT = TypeVar("NodeT", bound=Node)


def events_executor(context: Context) -> Executor:
    """An executor without nodes.

    rclpy has it report crashes on the standard error stream, and fails where that is no file, as in a notebook.
    """
    with redirect_stderr(sys.__stderr__):
        return EventsExecutor(context=context)


class Graph:
    """Context, executor and nodes that start and end together.

    Use as a context manager; nodes are made with ``context=graph.context`` and handed over with `add`.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        """Start a context in DDS domain `domain_id` (None: that of ROS_DOMAIN_ID, else 0)."""
        provide_shared_memory()
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.executor = events_executor(self.context)
        self.nodes: list[Node] = []

    def add(self, node: NodeT) -> NodeT:
        """Spin `node` from now on; returns it."""
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def spin_until(self, predicate: Callable[[], bool], timeout_s: float = math.inf) -> bool:
        """Run callbacks until `predicate()` is true (returns True) or `timeout_s` has passed (returns False)."""
        deadline = time.monotonic() + timeout_s
        while not predicate():
            if time.monotonic() >= deadline or not self.context.ok():
                return predicate()
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def spin_for(self, seconds: float) -> None:
        """Run callbacks for `seconds`, without a step in Python from one to the next.

        A thread ends it: the executor looks at the time only when nothing waits, and messages may never stop.
        """
        over = Future()
        clock = threading.Timer(seconds, over.set_result, [None])
        clock.start()
        self.executor.spin_until_future_complete(over, 2 * seconds)  # with no limit it would not sleep between messages
        clock.cancel()  # if the context has ended

    def clear(self) -> None:
        """Destroy the nodes in order."""
        for node in self.nodes:
            self.executor.remove_node(node)
            node.destroy_node()
        self.nodes.clear()

    def close(self) -> None:
        """Destroy the nodes and shut the context down; may be called twice."""
        self.clear()
        self.executor.shutdown()
        rclpy.try_shutdown(context=self.context)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
