"""Starts the processes of an ensemble again that have ended."""

from __future__ import annotations

import logging
import signal
from dataclasses import dataclass

from sal_height.errors import UserError
from sal_height.graph.ensemble import Ensemble

_LOG = logging.getLogger(__name__)

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 30.0
"""Time from the end of a process to its next start, s: it doubles from time to time, up to the longest."""

STEADY_S = 60.0
"""Running time of a process, s, after which the wait for its next start is the shortest one again."""


@dataclass
class _Fate:
    """State of a process: time of its last start, delay before the next one, s, and the time at which that is due."""

    began: float
    wait_s: float = FIRST_WAIT_S
    due: float | None = None


class Supervisor:
    """Starts processes again that have ended, each after a wait, and reports it."""

    def __init__(self, ensemble: Ensemble, now: float) -> None:
        """Watch the processes of `ensemble` from the time `now`, s of the monotonic clock."""
        self._ensemble = ensemble
        self._fates = {name: _Fate(now) for name in ensemble.processes}

    def look(self, now: float) -> list[str]:
        """Report processes that have ended, and start those again whose delay is over; returns their names."""
        started = []
        for name, status in self._ensemble.ended().items():
            fate = self._fates[name]
            if fate.due is None:
                self._await(name, fate, now, f"ended {_described(status)}")
            elif now >= fate.due:
                try:
                    self._ensemble.start_again(name)
                except UserError as error:
                    self._await(name, fate, now, f"could not be started ({error})")
                    continue
                fate.began, fate.due = now, None
                started.append(name)
        return started

    def _await(self, name: str, fate: _Fate, now: float, what: str) -> None:
        """Have a process started again in some time."""
        if now - fate.began > STEADY_S:
            fate.wait_s = FIRST_WAIT_S
        fate.due = now + fate.wait_s
        _LOG.warning("%s %s; it is started again in %.3g s.", self._ensemble.describe(name), what, fate.wait_s)
        fate.wait_s = min(2 * fate.wait_s, LONGEST_WAIT_S)


def _described(status: int) -> str:
    """End of a process, in words."""
    if status >= 0:
        return f"with status {status}, and what it said is above"
    try:
        return f"by {signal.Signals(-status).name}"
    except ValueError:
        return f"by signal {-status}"
