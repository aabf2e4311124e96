"""Clocks of a player: the system's at a rate, which may be infinite, and simulated time on the topic /clock."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress

from rclpy._rclpy_pybind11 import RCLError
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sal_height import messages
from sal_height.messages.types import Clock
from sal_height.nodes.transport.message_types import class_of, publish

CLOCK = "/clock"

PERIOD_S = 0.01
"""Time from one message on /clock to the next; the machine may be late by more than that again, and 40 in a second are
promised."""


class PacedClock:
    """The time of a recorded sensor. It stands still until something is waited for; after a delay it catches up."""

    def __init__(self, first_ns: int = 0, rate: float = math.inf, began: float | None = None) -> None:
        """Set the clock.

        Args:
            first_ns: first time, ns of the sensor.
            rate: seconds of the sensor in a second; infinity: everything is due at once.
            began: start of the clock, s of the monotonic clock; None: the first wait.
        """
        self._origin_ns, self._rate, self._began = first_ns, rate, began
        self._limit_ns = first_ns
        self._ending = threading.Event()

    def wait_until(self, due_ns: int) -> bool:
        """Wait until a time of the sensor (ns); False if the node ends before."""
        if self._began is None:
            self._began = time.monotonic()
        self._limit_ns = max(self._limit_ns, due_ns)
        wait_s = self._began + (due_ns - self._origin_ns) * 1e-9 / self._rate - time.monotonic()
        return not (self._ending.wait(wait_s) if wait_s > 0 else self._ending.is_set())

    def stand_still(self) -> None:
        """Stop the time at the last one that was waited for."""
        self._began, self._origin_ns = None, self._limit_ns

    def end(self) -> None:
        """End every wait; may be called twice."""
        self._ending.set()


class SimulatedClock(PacedClock):
    """The same time, published on /clock for nodes with use_sim_time.

    It never passes what is waited for before that has been played, so that no node reads a time at which it should have
    received more, and it lags behind that by its period at most.
    """

    def __init__(self, node: Node, first_ns: int, rate: float) -> None:
        """Publish the time `first_ns` (ns of the sensor) from now on; later it runs at the rate."""
        super().__init__(first_ns, rate)
        quality = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)  # of `ros2 bag play`; nodes ask for less
        self._publisher = node.create_publisher(class_of(Clock), CLOCK, quality)
        self._published_ns = first_ns
        self._lock = threading.Lock()
        self._publish(first_ns)
        self._thread = threading.Thread(target=self._run, name="clock", daemon=True)
        self._thread.start()

    def wait_until(self, due_ns: int) -> bool:
        """Wait until a time of the sensor (ns); False if the node ends before."""
        is_due = super().wait_until(due_ns)
        if is_due and due_ns - self._published_ns > PERIOD_S * self._rate * 1e9:  # the thread lags behind
            self._publish(due_ns)
        return is_due

    def stand_still(self) -> None:
        """Stop the time at the last one that was waited for, and publish it at once."""
        super().stand_still()
        self._publish(self._limit_ns)

    def end(self) -> None:
        """Publish no more time, and end every wait; may be called twice."""
        super().end()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            limit_ns, began = self._limit_ns, self._began  # the limit first: it rises only once the time runs
            if began is not None:
                limit_ns = min(limit_ns, self._origin_ns + round((time.monotonic() - began) * self._rate * 1e9))
            self._publish(limit_ns)

    def _publish(self, time_ns: int) -> None:
        """Publish a time, but never an earlier one than before."""
        with self._lock, suppress(RCLError):  # the context may end meanwhile
            self._published_ns = max(self._published_ns, time_ns)
            publish(self._publisher, Clock(clock=messages.to_stamp(self._published_ns)))
