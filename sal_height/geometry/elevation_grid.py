"""Elevation models in a coordinate reference system, and in a map with its origin in the middle of the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from sal_height.errors import UserError
from sal_height.geometry.earth import sphere_coordinates, sphere_point
from sal_height.geometry.geodesy import Origin
from sal_height.geometry.projection import Projection
from sal_height.numeric import F64, bilinear


@dataclass(frozen=True, eq=False)
class ElevationModel:
    """Heights of the ground on nodes around the map origin, bilinear between them.

    Attributes:
        name: name in messages.
        east: arc distances of the nodes from the map origin, increasing, shape (n_east,), m.
        north: arc distances of the nodes, increasing, shape (n_north,), m.
        height: heights above the sphere, shape (n_north, n_east), m.
        origin: geodetic position of the map origin; None if the file does not state it.
    """

    name: str
    east: F64
    north: F64
    height: F64
    origin: Origin | None = None

    def heights(self, east: npt.ArrayLike, north: npt.ArrayLike) -> F64:
        """Height (m) of the ground at arc distances `east`, `north` (m); NaN outside the model."""
        return bilinear(self.north, self.east, self.height, north, east)


@dataclass(frozen=True, eq=False)
class ElevationGrid:
    """Elevations in cells of a coordinate reference system, north up.

    Attributes:
        name: name in messages.
        elevation: elevations of the cells' centres, the northernmost row first, shape (rows, cols), m.
        west: outer edge of the first column, in units of the system, as the next three.
        north: outer edge of the first row.
        width: width of a cell.
        height: height of a cell.
        system: pyproj.CRS with three axes, geographic or projected.
    """

    name: str
    elevation: F64
    west: float
    north: float
    width: float
    height: float
    system: Any

    def model(self) -> ElevationModel:
        """The model around a map origin in its middle, on nodes as far apart as the cells are in the middle.

        Every node has the height of the model at its position, bilinear between cells: positions are those of PROJ,
        heights above the sphere of the map follow from those above the ellipsoid, or the geoid if the system states it.
        Where north of the system is not that of the map, nodes outside the model are left out.

        Raises:
            UserError: the system has no known relation to WGS 84, or needs a grid that is not installed.
        """
        projection = self._projection()
        rows, cols = self.elevation.shape
        dx, dy = self._spacing(projection)
        east, north = (np.arange(cols) - (cols - 1) / 2) * dx, (np.arange(rows) - (rows - 1) / 2) * dy
        level = float(self.elevation.mean())
        # PROJ gives positions at 33 knots along each side; between them coordinates are cubic, to 1 mm in 200 km.
        few_east, few_north = (np.linspace(axis[0], axis[-1], 33) for axis in (east, north))
        positions = self._in_cells(projection.coordinates(sphere_point(*np.meshgrid(few_east, few_north), level)))
        row, col, up = (RectBivariateSpline(few_north, few_east, values)(north, east) for values in positions)
        south_end, north_end, west_end, east_end = _inside(row, col, self.elevation.shape)
        kept = np.ix_(range(south_end, north_end), range(west_end, east_end))
        height = map_coordinates(self.elevation, [row[kept], col[kept]], order=1, mode="nearest") + level - up[kept]
        return ElevationModel(self.name, east[west_end:east_end], north[south_end:north_end], height, projection.origin)

    def _projection(self) -> Projection:
        """The system with its map origin on the ellipsoid below the middle of the model."""
        rows, cols = self.elevation.shape
        found = Projection(Origin(0.0, 0.0, 0.0), self.system, self.system.name)
        middle = np.array([self.west + cols / 2 * self.width, self.north - rows / 2 * self.height, 0.0])
        latitude, longitude, _ = (float(value) for value in found.geodetic(middle * self._units))
        if not np.isfinite([latitude, longitude]).all():
            raise UserError(f"Elevation model {self.name} is outside the area of its coordinate reference system.")
        return replace(found, origin=Origin(latitude, longitude, 0.0))

    @property
    def _units(self) -> F64:
        """Factors from units of the system to rad; 1 for lengths, which PROJ uses as they are."""
        if not self.system.is_geographic:
            return np.ones(3)
        return np.array([*(axis.unit_conversion_factor for axis in self.system.axis_info[:2]), 1.0])

    def _spacing(self, projection: Projection) -> tuple[float, float]:
        """Distance of the centres of cells eastwards and northwards in the middle of the model, m."""
        rows, cols = self.elevation.shape
        middle = np.array([self.west + cols / 2 * self.width, self.north - rows / 2 * self.height, 0.0])
        steps = middle + np.array([[0, 0, 0], [self.width, 0, 0], [0, self.height, 0]])
        east, north, _ = sphere_coordinates(projection.positions(steps * self._units))
        dx, dy = np.hypot(east[1:] - east[0], north[1:] - north[0]).tolist()
        return dx, dy

    def _in_cells(self, coordinates: F64) -> tuple[F64, F64, F64]:
        """Row and column of positions in the model, from 0 at the first cell's centre, and their heights, m."""
        x, y, up = np.moveaxis(coordinates / self._units, -1, 0)
        vertical = self.system.axis_info[2].unit_conversion_factor
        return (self.north - y) / self.height - 0.5, (x - self.west) / self.width - 0.5, up * vertical


def _inside(row: F64, col: F64, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """The first node from the south that is kept, the one after the last, and the same from the west.

    Nodes are left out on the side that reaches out farthest, until all are in cells of the model.

    Args:
        row: row in the model of each node, shape (north, east).
        col: column in the model of each node, same shape.
        shape: shape of the model.
    """
    beyond = np.maximum.reduce([-0.5 - row, row - shape[0] + 0.5, -0.5 - col, col - shape[1] + 0.5])
    ends = [0, len(row), 0, row.shape[1]]
    while ends[1] - ends[0] > 2 and ends[3] - ends[2] > 2:
        south, north, west, east = ends
        sides = (
            beyond[south, west:east],
            beyond[north - 1, west:east],
            beyond[south:north, west],
            beyond[south:north, east - 1],
        )
        worst = int(np.argmax([np.sum(side > 1e-6) / len(side) for side in sides]))
        if not (sides[worst] > 1e-6).any():
            break
        ends[worst] += -1 if worst % 2 else 1
    return ends[0], ends[1], ends[2], ends[3]
