"""Amplitudes of the channels in dwells that follow each other, in all directions in which targets are searched for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.movers.search import ELEVATION_STEP
from sal_height.numeric import C128, F64, Bool, Index

FARTHEST = 3.2
"""Largest squint in the middle dwell, beamwidths along the flight."""


@dataclass(frozen=True, eq=False)
class Lobes:
    """Amplitudes of the channels in each dwell for targets in all directions.

    Attributes:
        squints: squints in the middle dwell, shape (squints,), rad.
        elevations: elevations in the middle dwell, shape (elevations,), rad.
        amplitudes: amplitudes of the channels, shape (squints, dwells, elevations, channels).
        ahead: squint of a position in each dwell less that in the middle one, shape (dwells,), rad.
        higher: difference of the elevation likewise, rad.
        known: True where the squint in a dwell is in the main lobe, shape (squints, dwells).
        near: numbers of the squints that a mover of the middle dwell may have.
    """

    squints: F64
    elevations: F64
    amplitudes: F64 | C128
    ahead: F64
    higher: F64
    known: Bool
    near: Index

    @classmethod
    def of(cls, beams: Beams, ahead: F64, higher: F64) -> Self:
        """Amplitudes by the differences of squint and elevation of a position between dwells, rad."""
        width = beams.track_beamwidth
        step = 0.05  # beamwidths
        count = round(FARTHEST / step)
        squints = width * step * np.arange(-count, count + 1, dtype=np.float64)
        elevations = np.arange(*beams.domain(0.0), ELEVATION_STEP * beams.beamwidth, dtype=np.float64)
        under = squints[:, None, None] + ahead[:, None]
        amplitudes = beams.response(elevations + higher[:, None], under)
        lobe = max(pattern.main_lobe for pattern in beams.patterns) * width
        others = np.abs(ahead[ahead != 0])
        # Half way to the next dwell, and 0.15 beamwidths more.
        reach = (others.min() / 2 if len(others) else 0.0) + 0.15 * width
        known, near = np.abs(under[..., 0]) < lobe, np.flatnonzero(np.abs(squints) <= reach)
        return cls(squints, elevations, amplitudes, ahead, higher, known, near)

    def turned(self, ahead: F64) -> Self:
        """Amplitudes for targets that each dwell sees farther ahead, by angles of shape (dwells,), rad.

        Angles are rounded to steps; beyond the outermost squints, amplitudes are those of the outermost.
        """
        step, last = self.squints[1] - self.squints[0], len(self.squints) - 1
        numbers = np.arange(len(self.squints))[:, None] + np.rint(ahead / step).astype(np.intp)
        numbers = np.clip(numbers, 0, last)
        dwells = np.arange(len(ahead))
        amplitudes, known = self.amplitudes[numbers, dwells], self.known[numbers, dwells]
        return replace(self, amplitudes=amplitudes, known=known, ahead=self.ahead + ahead)

    def nearest(self, squints: F64) -> Index:
        """Numbers of the squints nearest to some, without those that are beyond all."""
        numbers = np.rint((squints - self.squints[0]) / (self.squints[1] - self.squints[0])).astype(np.intp)
        return numbers[(numbers >= 0) & (numbers < len(self.squints))]
