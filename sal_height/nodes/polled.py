"""Odometry of many samples, which a node takes when its stage needs them: to wake up for each takes longest."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.timer import Timer

from sal_height.engine.compression import Compression
from sal_height.engine.frames import Frames
from sal_height.engine.stage import Decision
from sal_height.messages.odometry import samples_of
from sal_height.nodes.transport.endpoints import Inlet

FEWEST = 8
"""Messages that are read together at least; a few are read faster one by one."""

PERIOD_S = 0.002
"""Time from one look to the next while a dwell waits for odometry, s."""

MANY_HZ = 200.0
"""Rate of messages above which they are looked for, 1/s, and below half of which an executor waits for them again: a
dwell waits for the next one for a few looks at most."""

MEASURED_S = 0.5
"""Time in which the rate is measured, s."""

SHORTEST_QUEUE = 1000
"""Least depth of a subscription that is looked at: its stage decides every .1 s at least, and no more samples arrive
until then. With a shorter queue, which users can set, the executor waits for each sample."""


class PolledOdometry:
    """Odometry of a stage. If it is much, what has arrived is accepted before the stage decides on anything else.

    While a dwell waits for odometry then, a timer looks for it.
    """

    def __init__(self, node: Node, inlet: Inlet, timer: Timer, stage: Compression, frames: Frames) -> None:
        """Take the messages of a subscription whenever they are many; no executor waits for them then.

        Args:
            node: node of the subscription.
            inlet: subscription to the odometry.
            timer: timer whose callback has the stage decide.
            stage: stage that accepts the odometry.
            frames: names and axes of the frames of the odometry.
        """
        self._node, self._inlet, self._timer, self._stage, self._frames = node, inlet, timer, stage, frames
        self._is_accepting = False
        self._since_s, self._received = time.monotonic(), 0
        self._receive, inlet.receive = inlet.receive, self._receive_first
        timer.cancel()

    def decisions(self, ask: Callable[[], Sequence[Decision]]) -> Sequence[Decision]:
        """The decisions of the stage on the odometry that has arrived, and then on what it is asked."""
        accepted = self._accept() if self._inlet.is_polled else ()
        decided = ask()
        self._measure_rate()
        self._look_while_awaited()
        return [*accepted, *decided] if accepted else decided

    def _accept(self) -> Sequence[Decision]:
        """Have the stage accept what has arrived; a few messages, and those that may be faulty, one by one."""
        if self._is_accepting:  # another one, which arrived before
            return ()
        messages = list(self._inlet.take_waiting())
        if len(messages) >= FEWEST and not self._inlet.has_only_strangers:
            samples = samples_of(messages, self._frames)
            if samples is not None:
                return self._stage.accept_odometry(samples, time.monotonic())
        for cdr in messages:
            self._receive_first(cdr)
        return ()

    def _receive_first(self, cdr: bytes) -> None:
        """Receive a message, before those that have arrived after it."""
        self._is_accepting = True
        self._receive(cdr)
        self._is_accepting = False

    def _look_while_awaited(self) -> None:
        """Have the timer run if a dwell waits for odometry that nobody else waits for, and stand still if not."""
        if self._inlet.is_polled and self._stage.awaits_odometry:
            if self._timer.is_canceled():
                self._timer.reset()
        elif not self._timer.is_canceled():
            self._timer.cancel()

    def _measure_rate(self) -> None:
        """Look for messages from now on if they are many, and have the executor wait for them if not."""
        now_s, received = time.monotonic(), self._inlet.received
        if now_s - self._since_s < MEASURED_S:
            return
        rate_hz = (received - self._received) / (now_s - self._since_s)
        self._since_s, self._received = now_s, received
        is_polled = rate_hz > (0.5 * MANY_HZ if self._inlet.is_polled else MANY_HZ)
        if is_polled is not self._inlet.is_polled:
            self._inlet.is_polled = is_polled
            if self._node.executor:
                self._node.executor.wake()  # for it waits for other subscriptions now
