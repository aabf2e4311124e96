"""Heights of a dwell in the coordinates of a projection, so that the map made of them lies in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.geometry import ApertureState, Projection, sphere_coordinates, sphere_point
from sal_height.numeric import F64, ShortRepr
from sal_height.relief.cell_map import Relief
from sal_height.relief.heights import HeightField, Surface


@dataclass(frozen=True, eq=False)
class ProjectedAxes(ShortRepr):
    """Map axes in which arc distances east and north of the origin are coordinates of a projection.

    A map is made in them as it is in those of the flight: `Relief` and everything before it knows nothing of a
    projection. Easting, northing and height of a point are exact. Directions and covariances of a dwell are turned as
    one, by the mean turn around its middle; over the 5 km of a large dwell it changes by
    less than 30 urad.

    Attributes:
        projection: projection of the coordinates.
        false_origin: easting and northing of the origin of these axes, m, shape (2,).
    """

    projection: Projection
    false_origin: F64

    @classmethod
    def around(cls, projection: Projection) -> ProjectedAxes:
        """Axes near the origin of the flight's map."""
        here = projection.coordinates(np.zeros(3))[:2]
        # Eastings and northings of false origins are multiples of it, m: cells of maps of different flights fit then.
        multiple = 10_000.0
        return cls(projection, np.round(here / multiple) * multiple)

    def positions(self, positions: F64) -> F64:
        """Positions in these axes of positions in map, m, both of shape (..., 3)."""
        easting, northing, height = np.moveaxis(self.projection.coordinates(positions), -1, 0)
        return sphere_point(easting - self.false_origin[0], northing - self.false_origin[1], height)

    def turn(self, position: F64) -> F64:
        """The rotation from map axes to these at a point, shape (3, 3): that nearest to the derivative of positions."""
        step = 100.0  # m
        ends = self.positions(position + step * np.concatenate([np.eye(3), -np.eye(3)]))
        left, _, right = np.linalg.svd((ends[:3] - ends[3:]).T / (2 * step))
        return np.asarray(left @ right)

    def field(self, field: HeightField, aperture: ApertureState) -> tuple[HeightField, ApertureState]:
        """The heights of a dwell, and the aperture that it was seen from, in these axes."""
        grid = field.grid
        middle = grid.middle
        turn = self.turn(middle)
        both = np.kron(np.eye(2), turn)
        # What is farther away stays where it is seen from the middle of the dwell.
        there = self.positions(middle)
        seen_from = replace(
            aperture,
            position=there + (aperture.position - middle) @ turn.T,
            velocity=turn @ aperture.velocity,
            rotation=turn @ aperture.rotation,
            covariance=both @ aperture.covariance @ both.T,
        )
        placed = replace(
            grid,
            origin=there + turn @ (grid.origin - middle),
            row_direction=turn @ grid.row_direction,
            col_direction=turn @ grid.col_direction,
        )
        surfaces = tuple(self._surface(surface, turn) for surface in field.surfaces)
        return replace(field, grid=placed, surfaces=surfaces), seen_from

    def relief(self, relief: Relief) -> Relief:
        """A map that was made in these axes, in coordinates of the projection."""
        easting, northing = self.false_origin.tolist()
        return replace(relief, east=relief.east + easting, north=relief.north + northing)

    def _surface(self, surface: Surface, turn: F64) -> Surface:
        positions = self.positions(surface.positions)
        common = surface.common_covariance
        return replace(
            surface,
            positions=positions,
            height=sphere_coordinates(positions)[2],
            own_covariance=turn @ surface.own_covariance @ turn.T,
            common_covariance=None if common is None else turn @ common @ turn.T,
        )
