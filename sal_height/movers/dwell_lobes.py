"""Amplitudes of the channels in dwells that follow each other, in all directions in which targets are looked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.numeric import C128, F64, Bool, Index

SQUINT_STEP, FARTHEST = 0.05, 3.2
"""Step of the squints in the middle dwell, and the greatest, in beamwidths along the flight."""

ELEVATION_STEP = 0.05
"""Of the search, in beamwidths."""

BESIDE = 0.15
"""By how much farther than half way to the next dwell a mover may be from the middle of the beam, in beamwidths."""


@dataclass(frozen=True, eq=False)
class Lobes:
    """Amplitudes of the channels in each dwell for targets in all directions.

    Attributes:
        squints: in the middle dwell, rad, shape (squints,).
        elevations: in the middle dwell, rad, shape (elevations,).
        amplitudes: shape (squints, dwells, elevations, channels).
        ahead: how much greater the squint of one place is in each dwell than in the middle one, rad, shape (dwells,).
        higher: the same of the elevation.
        known: whether the squint in a dwell is in the main lobe, shape (squints, dwells).
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
        """Those of dwells whose squints and elevations of one place are so much greater than in the middle one, rad."""
        width = beams.track_beamwidth
        count = round(FARTHEST / SQUINT_STEP)
        squints = width * SQUINT_STEP * np.arange(-count, count + 1, dtype=np.float64)
        elevations = np.arange(*beams.domain(0.0), ELEVATION_STEP * beams.beamwidth, dtype=np.float64)
        under = squints[:, None, None] + ahead[:, None]
        amplitudes = beams.response(elevations + higher[:, None], under)
        lobe = max(pattern.main_lobe for pattern in beams.patterns) * width
        others = np.abs(ahead[ahead != 0])
        reach = (others.min() / 2 if len(others) else 0.0) + BESIDE * width
        known, near = np.abs(under[..., 0]) < lobe, np.flatnonzero(np.abs(squints) <= reach)
        return cls(squints, elevations, amplitudes, ahead, higher, known, near)

    def turned(self, ahead: F64) -> Self:
        """Those of targets that each dwell sees farther ahead by so much, rad, shape (dwells,), to the nearest step.

        The farthest squints have the amplitude of those beside them.
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
