"""Ground that is known beforehand: targets that stand out, also from a file, and an elevation model."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sal_height.adjustment.equations import Equation, Form
from sal_height.adjustment.matching import REFERENCE, GriddedSurface, Points
from sal_height.errors import UserError
from sal_height.numeric import F64

Heights = Callable[[F64, F64], F64]
"""Heights (m) at arc distances east and north (m), NaN where they are unknown."""


@dataclass(frozen=True)
class Target:
    """A point target at a known position.

    Attributes:
        east: distance east along the sphere, m.
        north: distance north along the sphere, m.
        height: height over the sphere, m.
        sigma: standard deviation of each coordinate, m.
    """

    east: float
    north: float
    height: float
    sigma: float = 0.01

    @property
    def place(self) -> F64:
        """East, north and height, m."""
        return np.array([self.east, self.north, self.height])

    def sighted(self, points: Points, form: Form, expected: F64, reach: F64) -> Equation | None:
        """Estimates the displacement of a dwell from its image of the target.

        Args:
            points: points of the dwell, as published.
            form: displacement of the dwell.
            expected: prior value of that displacement, m, shape (3,).
            reach: greatest difference from it, m, shape (3,).

        Returns:
            None: the target is not in the image, or does not stand out.
        """
        off = points.place - self.place - expected
        near = np.flatnonzero(np.all(np.abs(off) <= reach, axis=1))
        if not near.size:
            return None
        power = 10 ** (points.cnr_db / 10)
        brightest = near[np.argmax(power[near])]
        # Pixels up to 2.5 spacings apart show the same target.
        apart = np.linalg.norm(points.place[near, :2] - points.place[brightest, :2], axis=1) > 2.5 * points.spacing
        others = power[near[apart]].max() if apart.any() else 0.0
        # 6 dB brighter than all else where it may be, and than half of the image.
        if power[brightest] < 10 ** (6.0 / 10) * max(others, float(np.median(power))):
            return None
        same = near[~apart & (power[near] > power[brightest] / 4)]
        weight = power[same] / power[same].sum()
        shift = weight @ points.place[same] - self.place
        variance = np.array([points.spacing**2 / 12] * 2 + [float(weight @ points.sigma[same] ** 2)]) + self.sigma**2
        return form.equals(shift, np.diag(1 / variance))


@dataclass(frozen=True)
class Terrain:
    """An elevation model.

    Attributes:
        heights: function that returns the heights of the ground.
        sigma: standard deviation of each height, and of a constant offset of the model per axis, m.
    """

    heights: Heights
    sigma: float

    def around(self, points: Points, reach: F64) -> GriddedSurface | None:
        """The surface around points, up to `reach` (m, shape (3,)) farther; None: all of it is unknown."""
        step = points.spacing / 2
        low = points.place[:, :2].min(axis=0) - reach[:2]
        size = np.ceil((points.place[:, :2].max(axis=0) + reach[:2] - low) / step).astype(int) + 1
        east, north = (low[axis] + step * np.arange(size[axis]) for axis in range(2))
        height = self.heights(*np.meshgrid(east, north, indexing="ij"))
        if not np.isfinite(height).any():
            return None
        sigma = np.where(np.isfinite(height), self.sigma, np.nan)
        return GriddedSurface(low, step, height, sigma, np.full(height.shape, REFERENCE))


@dataclass(frozen=True)
class References:
    """All known ground."""

    targets: tuple[Target, ...] = ()
    terrain: Terrain | None = None

    @property
    def ground_sigma(self) -> float:
        """Standard deviation of a constant offset of the elevation model per axis, m."""
        return self.terrain.sigma if self.terrain else 0.0

    def without_terrain(self) -> References:
        """The targets alone."""
        return replace(self, terrain=None)


UNKNOWN_GROUND = References()


COLUMNS = ("east_m", "north_m", "height_m")
"""Columns that a file must have."""

SIGMA = "sigma_m"
"""Column that it may have: standard deviation of each of the three."""

LEAST_SIGMA_M, FARTHEST_M = 1e-4, 1e6


def read_targets(path: Path) -> tuple[Target, ...]:
    """The targets of a CSV file with the columns east_m, north_m, height_m, and sigma_m if it is not 0.01 (all in m).

    Raises:
        UserError: it cannot be read, a column is missing or unknown, a value is not allowed, or there is no target.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            targets = tuple(_targets(csv.reader(file), path))
    except UserError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"Cannot read {path} with targets: {reason}.") from error
    if not targets:
        raise UserError(f"File {path} has no targets; each is a line with {', '.join(COLUMNS)}.")
    return targets


def _targets(lines: Iterator[list[str]], path: Path) -> Iterator[Target]:
    """Parses the lines of a file, of which the first names the columns."""
    names = [name.strip() for name in next(lines, [])]
    if sorted(names) not in (sorted(COLUMNS), sorted([*COLUMNS, SIGMA])):
        raise UserError(
            f"File {path}: the columns are {', '.join(names) or 'none'}; they must be {', '.join(COLUMNS)}, and may be "
            f"{SIGMA}."
        )
    for number, line in enumerate(lines, 2):
        if not "".join(line).strip():
            continue
        where = f"File {path}, line {number}"
        if len(line) != len(names):
            raise UserError(f"{where}, has {len(line)} values; there must be {len(names)}, as columns.")
        values = {name: _number(text, f"{where}: {name}") for name, text in zip(names, line, strict=True)}
        sigma = values.pop(SIGMA, Target.sigma)
        if not LEAST_SIGMA_M <= sigma <= FARTHEST_M:
            raise UserError(f"{where}: {SIGMA} is {sigma:g}; it must be {LEAST_SIGMA_M:g} to {FARTHEST_M:g} m.")
        yield Target(values["east_m"], values["north_m"], values["height_m"], sigma)


def _number(text: str, what: str) -> float:
    """Parses the number in a field of a file."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= FARTHEST_M:  # NaN is refused, too
        raise UserError(f"{what} is {text.strip()!r}; it must be a number of at most {FARTHEST_M:g} m.")
    return number
