"""Measured discrimination characteristics: gamma as a function of the angle off the equisignal direction."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

from sal_height.beams import Beams
from sal_height.elevation.monopulse.inversion import (
    Inversion,
    equisignal_elevation,
    inversion_between,
)
from sal_height.errors import UserError

SLOPE_COLUMNS = ["angle_rad", "gamma"]
"""Columns in the first line of a slope table's file."""


@dataclass(frozen=True)
class SlopeTable:
    """A measured discrimination characteristic (relief paper, figure 2): gamma over the angle off theta_0.

    Attributes:
        angle: theta_h, increasing, rad.
        gamma: Delta / Sigma there, rising or falling throughout.

    Raises:
        UserError: there are fewer than two nodes or unequal numbers of angles and values, values are not finite, angles
            do not increase, or the slope is 0 or changes sign.
    """

    angle: tuple[float, ...]
    gamma: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.angle) != len(self.gamma) or len(self.angle) < 2:
            raise UserError(
                f"A slope table has {len(self.angle)} angles and {len(self.gamma)} values; it needs as many of both, "
                "2 or more."
            )
        if not (np.all(np.isfinite([self.angle, self.gamma])) and np.all(np.diff(self.angle) > 0)):
            raise UserError("A slope table has angles or values that are not finite, or angles that do not increase.")
        steps = np.diff(self.gamma)
        turns = np.flatnonzero(np.sign(steps) != np.sign(self.gamma[-1] - self.gamma[0]))
        if turns.size or not steps.any():
            turn = int(turns[0]) if turns.size else 0
            raise UserError(
                f"A slope table changes sign between {self.angle[turn]:.6g} and {self.angle[turn + 1]:.6g} rad, where "
                f"gamma goes from {self.gamma[turn]:.6g} to {self.gamma[turn + 1]:.6g}; it must rise or fall all along."
            )

    def invert(self, pair: Beams, gamma: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
        """Find elevations around the equisignal direction of `pair` by a monotonic cubic (PCHIP) through the nodes.

        The slope is that of the chord between two nodes. Outside the table gamma is BELOW or ABOVE. Arguments as in
        `invert_linear`, which broadcast.
        """
        gamma, squint = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(squint, dtype=np.float64))
        order = slice(None, None, 1 if self.gamma[-1] > self.gamma[0] else -1)
        angles, values = np.array(self.angle)[order], np.array(self.gamma)[order]
        section = np.clip(np.searchsorted(values, gamma, side="right") - 1, 0, len(values) - 2)
        elevation = equisignal_elevation(pair, squint) + PchipInterpolator(values, angles)(
            np.clip(gamma, values[0], values[-1])
        )
        slope = (np.diff(values) / np.diff(angles))[section]
        return inversion_between(elevation, slope, gamma, (values[0], values[-1]), np.ones(gamma.shape, dtype=np.bool_))


def read_slope_table(path: Path) -> SlopeTable:
    """Read a slope table from a CSV file: a line `angle_rad,gamma`, then one line for each node.

    Raises:
        UserError: the file cannot be read, its first line or another line is wrong, or `SlopeTable` refuses its nodes.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            header, *rows = [row for row in csv.reader(stream) if row] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"Slope table {path} cannot be read: {error}.") from error
    if [name.strip() for name in header] != SLOPE_COLUMNS:
        raise UserError(f"Slope table {path} begins with {','.join(header)!r}; it must be '{','.join(SLOPE_COLUMNS)}'.")
    try:
        angle, gamma = zip(*((float(a), float(g)) for a, g in rows), strict=True) if rows else ((), ())
    except ValueError as error:
        raise UserError(f"Slope table {path} has a row that is not two numbers; all must be: {error}.") from error
    return SlopeTable(angle, gamma)
