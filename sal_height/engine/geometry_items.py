"""The aperture from which images are seen, as messages state it, and checks of it and of the grid of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, quaternion_of, rotation_matrix
from sal_height.numeric import F64, arrays_of, joined_bytes

FARTHEST = 1e7
"""Greatest distance from the origin of the map, m: what is farther, or higher, is no place that a platform sees."""

FASTEST = 1e5
"""Greatest speed of a platform, m/s: ten times that of satellites."""

FINEST = 1e-6
"""Least distance of pixels, m: finer than any wavelength."""


@dataclass(frozen=True, eq=False)
class Aperture:
    """State of the sensor in the middle of the aperture, with its rotation as a quaternion.

    A matrix and back gives another last bit; the numbers that a message carries are those of the quaternion.

    Attributes:
        position: position of the antenna in map, m, shape (3,).
        orientation: orientation of the sensor frame in map, quaternion x, y, z, w.
        velocity: velocity of the antenna in map axes, m/s, shape (3,).
        length: length of the synthetic aperture, m.
        covariance: covariance of position (m^2) and rotation about x, y, z of map (rad^2), shape (6, 6); 0: not known.
        sliding: True if the aperture slides along the flight with the columns.
    """

    position: F64
    orientation: tuple[float, float, float, float]
    velocity: F64
    length: float
    covariance: F64
    sliding: bool

    @classmethod
    def of(cls, state: ApertureState) -> Aperture:
        """The same as a message states it."""
        x, y, z, w = quaternion_of(state.rotation)
        covariance = np.asarray(state.covariance, np.float64).reshape(6, 6)
        return cls(
            state.position,
            (float(x), float(y), float(z), float(w)),
            state.velocity,
            float(state.length),
            covariance,
            state.sliding,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """To be sent to another process, with all arrays as one object."""
        arrays = joined_bytes((self.position, self.velocity, self.covariance))
        return _aperture_of, (arrays, self.orientation, self.length, self.sliding)

    @cached_property
    def state(self) -> ApertureState:
        """The same as images and heights are made with."""
        return ApertureState(
            self.position, self.velocity, rotation_matrix(self.orientation), self.length, self.covariance, self.sliding
        )

    def __eq__(self, other: object) -> bool:
        """True if all numbers are equal."""
        return self is other or (
            isinstance(other, Aperture)
            and (self.orientation, self.length, self.sliding) == (other.orientation, other.length, other.sliding)
            and all(
                np.array_equal(ours, theirs)
                for ours, theirs in (
                    (self.position, other.position),
                    (self.velocity, other.velocity),
                    (self.covariance, other.covariance),
                )
            )
        )

    __hash__ = None  # type: ignore[assignment]


def _aperture_of(
    arrays: bytes, orientation: tuple[float, float, float, float], length: float, sliding: bool
) -> Aperture:
    position, velocity, covariance = arrays_of(arrays, ((3,), (3,), (6, 6)))
    return Aperture(position, orientation, velocity, length, covariance, sliding)


def are_equal(one: Grid, other: Grid) -> bool:
    """True if two grids have the same pixels."""
    return one is other or (
        (one.row_spacing, one.col_spacing, one.rows, one.cols)
        == (other.row_spacing, other.col_spacing, other.rows, other.cols)
        and np.array_equal(one.origin, other.origin)
        and np.array_equal(one.row_direction, other.row_direction)
        and np.array_equal(one.col_direction, other.col_direction)
    )


def check_geometry(grid: Grid, aperture: Aperture, where: str) -> None:
    """Check that the grid and the aperture of an image are finite and possible.

    Raises:
        Rejected: a value is not finite or beyond FARTHEST, a direction or the orientation has not the norm 1, a spacing
            is less than FINEST, or the velocity is 0; the message begins with `where`.
    """
    directions = grid.row_direction.tolist(), grid.col_direction.tolist()
    places = *grid.origin.tolist(), *aperture.position.tolist(), *aperture.velocity.tolist()
    spacings = grid.row_spacing, grid.col_spacing
    if not all(abs(number) <= FARTHEST for number in (*places, *directions[0], *directions[1], *spacings)):
        raise Rejected(
            "not finite",
            f"{where}: grid or aperture has values that are NaN, infinite or beyond {FARTHEST:g} m, farther than "
            "any platform sees.",
        )
    norms = [math.hypot(*numbers) for numbers in (*directions, aperture.orientation)]
    if not (all(abs(norm - 1) <= 0.01 for norm in norms) and min(spacings) >= FINEST):
        raise Rejected(
            "wrong geometry",
            f"{where}: row_direction, col_direction and orientation have the norms {np.round(norms, 3).tolist()}, the "
            f"spacings are {grid.row_spacing:g} and {grid.col_spacing:g} m; norms must be 1, spacings {FINEST:g} m or "
            "more.",
        )
    if not aperture.velocity.any():
        raise Rejected("wrong geometry", f"{where}: aperture.velocity is 0; a synthetic aperture needs motion.")
