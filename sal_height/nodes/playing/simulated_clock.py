"""The topic /clock beside what is played of a bag, from which nodes with use_sim_time take their time."""

from __future__ import annotations

import threading
import time
from contextlib import suppress

from rclpy._rclpy_pybind11 import RCLError
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sal_height import messages
from sal_height.messages.types import Clock
from sal_height.nodes.playing.pace import Pace
from sal_height.nodes.transport.message_types import class_of, publish

CLOCK = "/clock"

PERIOD_S = 0.01
"""Time from one message on /clock to the next; the machine may be late by more than that again, and 40 in a second are
promised."""

CLOCK_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""As `ros2 bag play` publishes it; nodes ask for less."""


class SimulatedClock:
    """Tells the time of a recorded sensor, and waits for what is due.

    The time stands still until something is waited for. It never passes what is waited for before that has been played,
    so that no node reads a time at which it should have received more, and it lags behind that by its period at most;
    after a delay it catches up.
    """

    def __init__(self, node: Node, first_ns: int, rate: float) -> None:
        """Tell the time `first_ns` (ns of the sensor) from now on; later it runs `rate` times as fast as real time."""
        self._publisher = node.create_publisher(class_of(Clock), CLOCK, CLOCK_QOS)
        self._rate = rate
        self._pace: Pace | None = None
        self._limit_ns, self._told_ns = first_ns, first_ns
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._publish(first_ns)
        self._thread = threading.Thread(target=self._run, name="clock", daemon=True)
        self._thread.start()

    def wait_until(self, due_ns: int) -> bool:
        """Wait until a time of the sensor (ns); False if the node ends before."""
        if self._pace is None:
            self._pace = Pace(self._limit_ns, time.monotonic(), self._rate)
        self._limit_ns = max(self._limit_ns, due_ns)
        wait_s = self._pace.wait_s(due_ns)
        if self._ending.wait(wait_s) if wait_s > 0 else self._ending.is_set():
            return False
        if due_ns - self._told_ns > PERIOD_S * self._rate * 1e9:  # the thread that tells the time lags behind
            self._publish(due_ns)
        return True

    def stand_still(self) -> None:
        """Stop the time at what was waited for last, and tell it at once."""
        self._pace = None
        self._publish(self._limit_ns)

    def end(self) -> None:
        """Tell no more time, and end every wait; may be called twice."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            limit_ns, pace = self._limit_ns, self._pace  # the limit first: it rises only once the time runs
            self._publish(min(pace.now_ns(), limit_ns) if pace else limit_ns)

    def _publish(self, time_ns: int) -> None:
        """Tell a time, but never an earlier one than before."""
        with self._lock, suppress(RCLError):  # the context may end meanwhile
            self._told_ns = max(self._told_ns, time_ns)
            publish(self._publisher, Clock(clock=messages.to_stamp(self._told_ns)))
