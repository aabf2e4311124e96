"""The pace at which a recorded sensor is played."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Pace:
    """When what a sensor delivered is due to be played.

    Attributes:
        origin_ns: a time of the sensor, ns.
        began: when that is due, s of the monotonic clock.
        rate: seconds of the sensor in a second.
    """

    origin_ns: int
    began: float
    rate: float

    def wait_s(self, due_ns: int) -> float:
        """From now until a time of the sensor (ns) has come, s; negative if it has passed."""
        return self.began + (due_ns - self.origin_ns) * 1e-9 / self.rate - time.monotonic()

    def now_ns(self) -> int:
        """The time of the sensor that it is now, ns."""
        return self.origin_ns + round((time.monotonic() - self.began) * self.rate * 1e9)
