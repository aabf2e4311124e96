"""The platform's track, drawn piece by piece, so that each position is stored once however long the flight is."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sal_height.geometry import PlatformState
from sal_height.numeric import F64

PIECE_NS = 200_000_000
"""Least length of a piece that is drawn, ns."""

MOST_PLACES = 4096
"""Greatest number of positions that wait; of more, the oldest are dropped."""

DRAWN_PLACES = 32
"""Approximate number of positions drawn per piece; it is short, and a platform is inert."""

FARTHEST_M, LONGEST_NS = 5.0, 5_000_000_000
"""Greatest distance (m), in addition to half the path, of a position from the one before moved on by its velocity, and
greatest time between both (ns) at which they are joined."""


class Piece(NamedTuple):
    """A part of a track without gaps.

    Attributes:
        stamp_ns: time of its last position, ns since the epoch.
        received_ns: time at which that arrived, ns since the epoch.
        places: positions in map, shape (positions, 3), m.
    """

    stamp_ns: int
    received_ns: int
    places: F64


class Track:
    """The places of a platform that have not been drawn yet."""

    def __init__(self) -> None:
        self._states: list[PlatformState] = []
        self._received_ns = 0

    def add(self, state: PlatformState, received_ns: int) -> int:
        """Take a state in; the time from the first that waits to it, ns."""
        self._states.append(state)
        del self._states[:-MOST_PLACES]
        self._received_ns = received_ns
        return abs(state.stamp_ns - self._states[0].stamp_ns)

    def pieces(self) -> list[Piece]:
        """Positions that wait, cut where the platform, or its clock, cannot have gone from one to the next.

        The last position is kept as the first of the next piece.
        """
        states = self._states
        cuts = [i + 1 for i, (one, other) in enumerate(pairwise(states)) if not _joined(one, other)]
        parts = [states[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(states)], strict=True)]
        self._states = states[-1:]
        return [_piece(part, self._received_ns) for part in parts if len(part) > 1]


def _piece(states: list[PlatformState], received_ns: int) -> Piece:
    kept = np.unique(np.linspace(0, len(states) - 1, min(len(states), DRAWN_PLACES)).round().astype(int))
    return Piece(states[-1].stamp_ns, received_ns, np.array([states[i].position for i in kept]))


def _joined(one: PlatformState, other: PlatformState) -> bool:
    """True if a platform can have gone from one state to the other."""
    step_ns = other.stamp_ns - one.stamp_ns
    way = one.velocity * step_ns * 1e-9
    off = float(np.linalg.norm(other.position - one.position - way))
    return 0 < step_ns <= LONGEST_NS and off <= FARTHEST_M + 0.5 * float(np.linalg.norm(way))
