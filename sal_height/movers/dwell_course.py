"""Pixels along the path of a target through successive dwells, and their likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sal_height.movers.dwell_paths import DwellPaths, Sight
from sal_height.movers.likelihood import POWERS_IN_DWELLS
from sal_height.numeric import C128, F64


@dataclass(frozen=True, eq=False)
class Course:
    """Pixels along the path of a target.

    Attributes:
        paths: paths of targets with the same velocity along the flight.
        sight: pixels around the target.
        moving: amplitudes matched to targets under the near squints (`DwellPaths.matched`).
        gains: gains of the beam (see there).
        row: row in the middle dwell over that of a target at rest.
        speed: velocity of the migration, m/s.
        likelihood: logarithm of the likelihood ratio of speckle, the best of the squints.
    """

    paths: DwellPaths
    sight: Sight
    moving: C128
    gains: F64
    row: float
    speed: float
    likelihood: float

    @classmethod
    def of(cls, paths: DwellPaths, sight: Sight, row: float, speeds: F64) -> Self:
        """The course with the likeliest of several migrations (m/s) from a row."""
        return cls.matched_by(paths, sight, paths.matched(sight, paths.lobes.near), row, speeds)

    @classmethod
    def matched_by(cls, paths: DwellPaths, sight: Sight, matched: tuple[C128, F64], row: float, speeds: F64) -> Self:
        """The same by the amplitudes and gains of the near squints; every second one decides between migrations."""
        near, (moving, gains), speed = paths.lobes.near, matched, float(speeds[0])
        if len(speeds) > 1:
            each_path = paths.path(sight, row, speeds)
            each = paths.ratios(moving[1::2], gains[1::2], each_path, near[1::2], POWERS_IN_DWELLS[::2], points=False)
            speed = float(speeds[each.max(axis=-1).argmax()])
        path = paths.path(sight, row, np.array([speed]))
        likelihood = float(paths.ratios(moving, gains, path, near, points=False).max())
        return cls(paths, sight, moving, gains, row, speed, likelihood)

    @property
    def powers(self) -> F64:
        """Power of the target in each dwell, under the squint that is best there, shape (dwells,)."""
        along = self.paths.on_path(self.moving, self.path[0])[0]
        return np.asarray((np.abs(along) ** 2).max(axis=0) * self.sight.backgrounds)

    @property
    def likelihood_of_others(self) -> float:
        """Logarithm of the likelihood by all dwells but the middle one."""
        weights, parts = self.path
        others = np.arange(len(self.paths.seconds)) != self.paths.middle
        path = weights * others[:, None], parts * others
        return float(self.paths.ratios(self.moving, self.gains, path, self.paths.lobes.near, points=False).max())

    @property
    def path(self) -> tuple[F64, F64]:
        """Weights of the rows, and parts that are in the image (`DwellPaths.path`)."""
        return self.paths.path(self.sight, self.row, np.array([self.speed]))
