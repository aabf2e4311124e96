"""Playback of a replay: its start, rate and repetitions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sal_height.bag.played import LOCKSTEP, PACED
from sal_height.errors import UserError
from sal_height.runs.chain.replay_parameters import ReplayPlan


@dataclass(frozen=True)
class Playing:
    """Start, rate and repetitions of the playback of a bag.

    Attributes:
        clock: name of the clock, one of `player.CLOCKS`.
        rate: seconds of the sensor in a second; None: 1, if the clock has a rate at all.
        loops: number of times that the bag is played.
    """

    clock: str = LOCKSTEP
    rate: float | None = None
    loops: int = 1

    def __post_init__(self) -> None:
        """Refuse values that contradict the clock.

        Raises:
            UserError: a value contradicts the clock.
        """
        if self.rate is not None and self.clock != PACED:
            raise UserError(f"Option --rate has no meaning with --clock {self.clock}; give it with --clock {PACED}.")
        if self.loops > 1 and self.clock == LOCKSTEP:
            raise UserError(
                f"Option --loop has no meaning with --clock {LOCKSTEP}; give it with --clock paced or burst."
            )

    def check(self, processing: ReplayPlan) -> None:
        """Refuse to repeat what changed in flight: the nodes would go into the next pass with what the last one left.

        Raises:
            UserError: something changed after the first dwell that is played.
        """
        if self.loops > 1 and (
            late := [one.dwell.number for one in processing.changes if one.dwell != processing.first]
        ):
            raise UserError(
                f"Option --loop cannot repeat what changed in flight before dwell {late[0]}; set the parameters for "
                "all dwells by --param, or choose dwells without a change by --dwells."
            )

    @property
    def is_paced(self) -> bool:
        """True if the player publishes the time of the sensor."""
        return self.clock == PACED

    @property
    def for_player(self) -> dict[str, Any]:
        """Parameters of the player."""
        rate = {} if self.rate is None else {"rate": float(self.rate)}
        return {"clock": self.clock, "loops": self.loops, **rate}

    def report(self) -> dict[str, Any]:
        """Entries of the report on the playback."""
        return {"clock": self.clock, "rate": (self.rate or 1.0) if self.is_paced else None, "loops": self.loops}


IN_LOCKSTEP = Playing()
