"""Odometry that a node takes when its stage needs it: to wake up for each of hundreds of samples takes longest."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

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


class PolledOdometry:
    """Odometry of a stage: what has arrived is accepted before the stage decides on anything else.

    While a dwell waits for odometry, a timer looks for it.
    """

    def __init__(self, inlet: Inlet, timer: Timer, stage: Compression, frames: Frames) -> None:
        """Take the messages of a subscription, for which the executor does not wait then.

        Args:
            inlet: subscription to the odometry.
            timer: timer whose callback has the stage decide.
            stage: stage that accepts the odometry.
            frames: names and axes of the frames of the odometry.
        """
        self._inlet, self._timer, self._stage, self._frames = inlet, timer, stage, frames
        self._is_accepting = False
        inlet.is_polled = True
        timer.cancel()

    def decisions(self, ask: Callable[[], Sequence[Decision]]) -> Sequence[Decision]:
        """The decisions of the stage on the odometry that has arrived, and then on what it is asked."""
        accepted = self._accept()
        decided = ask()
        self._look_while_awaited()
        return [*accepted, *decided] if accepted else decided

    def _accept(self) -> Sequence[Decision]:
        """Have the stage accept what has arrived; a few messages, and those that may be faulty, one by one."""
        if self._is_accepting:  # one by one; those that have arrived since then follow
            return ()
        messages = list(self._inlet.take_waiting())
        if len(messages) >= FEWEST and not self._inlet.has_only_strangers:
            samples = samples_of(messages, self._frames)
            if samples is not None:
                return self._stage.accept_odometry(samples, time.monotonic())
        self._is_accepting = True
        for cdr in messages:
            self._inlet.receive(cdr)
        self._is_accepting = False
        return ()

    def _look_while_awaited(self) -> None:
        """Have the timer run if a dwell waits for odometry, and stand still if none does."""
        if self._stage.awaits_odometry != self._timer.is_canceled():
            return
        if self._stage.awaits_odometry:
            self._timer.reset()
        else:
            self._timer.cancel()
