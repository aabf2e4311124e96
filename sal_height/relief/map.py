"""Relief map: the heights of successive dwells, averaged in the cells of one grid on the ground.

The grid lies along the arc distances east and north of `geometry.sphere_coordinates`; the edges of its cells are at
multiples of the cell size, so that maps of different flights fit.

The map takes the only or the stronger scatterer of each pixel. The weaker one has a position, too, but it may be a
false alarm, and a map used for navigation must not hold obstacles that do not exist; it stays in the points of dwells.

Sigma is the standard deviation of the mean height of what was seen of a cell, not the spread of the ground within it.
Within a dwell the errors of the pixels are independent, except for the part caused by the platform's pose: all pixels
share it, and averaging does not reduce it. Errors of different dwells are assumed independent; sigma is too small if a
slowly drifting pose errs in the same way for several dwells, or if a spatial prior couples neighbouring pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, height_of, sphere_coordinates, sphere_point
from sal_height.numeric import F32, F64, I64
from sal_height.relief.heights import Surface, shared_variance

TILE = 256
"""Side in cells of the square tiles by which the memory of a map grows."""

SMOOTH = 1e-3
"""Ground distance, as a share of the flight height, over which the variance caused by the pose hardly changes."""

HEIGHT, WEIGHT, CHI_SQUARE, COUNT = range(4)
"""Layers of a tile: mean height (m), 1 / its variance (1/m^2), chi-square, number of dwells."""


@dataclass(frozen=True)
class Box:
    """Cells in a rectangle: rows from `south` to before `north`, columns from `west` to before `east`."""

    south: int
    west: int
    north: int
    east: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.north - self.south, self.east - self.west

    def around(self, other: Box) -> Box:
        """The smallest box that holds both."""
        return Box(
            min(self.south, other.south),
            min(self.west, other.west),
            max(self.north, other.north),
            max(self.east, other.east),
        )

    def within(self, other: Box) -> tuple[slice, slice]:
        """Rows and columns of an array over `other` that lie in this box."""
        return (
            slice(max(self.south - other.south, 0), self.north - other.south),
            slice(max(self.west - other.west, 0), self.east - other.west),
        )


@dataclass(frozen=True, eq=False)
class CellHeights:
    """Heights of one dwell in the cells of a box; arrays of its shape, row 0 the southernmost.

    Attributes:
        box: the cells.
        height: mean height, m; 0 where nothing was seen.
        weight: 1 / variance of that mean, 1/m^2; 0 where nothing was seen.
    """

    box: Box
    height: F64
    weight: F64


@dataclass(frozen=True, eq=False)
class Relief:
    """A map as it stands; arrays of shape (rows, cols), row 0 the southernmost.

    Attributes:
        east: arc distance of the centre of cell (0, 0) from the map's origin, m.
        north: the same, m.
        cell_size: m.
        height: mean height above the sphere, m; NaN where nothing was seen.
        sigma: standard deviation of that mean, m; NaN where nothing was seen.
        disagreement: spread of the dwells' heights over that expected from sigma: the square root of chi-square per
            degree of freedom (Birge ratio, Phys. Rev. 40, 1932, p. 207). Near 1 if sigma is right; greater where
            something moved, or the ground within the cell is steep. NaN where fewer than two dwells saw the cell.
        count: number of dwells that saw the cell.
    """

    east: float
    north: float
    cell_size: float
    height: F32
    sigma: F32
    disagreement: F32
    count: npt.NDArray[np.uint32]


class ReliefMap:
    """A map that grows with the ground that is seen, in tiles of TILE × TILE cells.

    Its memory is proportional to the area seen, not to the number of dwells.
    """

    def __init__(self, cell_size: float, max_cells: int) -> None:
        """An empty map.

        Args:
            cell_size: m.
            max_cells: greatest number of cells of the rectangle around all that was seen.
        """
        self.cell_size = cell_size
        self.max_cells = max_cells
        self._box: Box | None = None
        self._tiles: dict[tuple[int, int], F64] = {}

    def add(self, surface: Surface, aperture: ApertureState) -> None:
        """Enter the heights that a dwell saw from `aperture`; if they are refused, the map does not change.

        Raises:
            Rejected: the map would have more than `max_cells` cells.
        """
        seen = np.isfinite(surface.height + surface.sigma + surface.positions.sum(axis=-1))
        if not seen.any():
            return
        east, north, _ = sphere_coordinates(surface.positions[seen])
        row, col = (np.floor(distance / self.cell_size).astype(np.int64) for distance in (north, east))
        box = Box(int(row.min()), int(col.min()), int(row.max()) + 1, int(col.max()) + 1)
        whole = self._box.around(box) if self._box else box
        if whole.shape[0] * whole.shape[1] > self.max_cells:
            raise Rejected(
                "map full",
                f"With these heights the map would have {whole.shape[0]} x {whole.shape[1]} cells of "
                f"{self.cell_size:g} m, more than the {self.max_cells} that max_cells allows.",
            )
        cell = (row - box.south) * box.shape[1] + col - box.west
        self._combine(_averaged(cell, surface.height[seen], surface.sigma[seen], box, self.cell_size, aperture))
        self._box = whole

    def relief(self) -> Relief | None:
        """Return the map as it stands; None if nothing was seen yet."""
        if self._box is None:
            return None
        box = self._box
        height, sigma, disagreement = (np.full(box.shape, np.nan, np.float32) for _ in range(3))
        count = np.zeros(box.shape, np.uint32)
        for place, cells in self._tiles.items():
            tile = _tile_box(place)
            there, here = tile.within(box), box.within(tile)
            part = cells[(slice(None), *here)]
            with np.errstate(divide="ignore", invalid="ignore"):
                seen = part[COUNT] > 0
                height[there] = np.where(seen, part[HEIGHT], np.nan)
                sigma[there] = np.where(seen, 1 / np.sqrt(part[WEIGHT]), np.nan)
                disagreement[there] = np.where(part[COUNT] > 1, np.sqrt(part[CHI_SQUARE] / (part[COUNT] - 1)), np.nan)
            count[there] = part[COUNT]
        centre = self.cell_size / 2
        return Relief(
            east=box.west * self.cell_size + centre,
            north=box.south * self.cell_size + centre,
            cell_size=self.cell_size,
            height=height,
            sigma=sigma,
            disagreement=disagreement,
            count=count,
        )

    def _combine(self, dwell: CellHeights) -> None:
        """Enter the heights of a dwell."""
        box = dwell.box
        for i in range(box.south // TILE, (box.north - 1) // TILE + 1):
            for j in range(box.west // TILE, (box.east - 1) // TILE + 1):
                tile = _tile_box((i, j))
                part = tile.within(box)
                if dwell.weight[part].any():
                    cells = self._tiles.setdefault((i, j), np.zeros((4, TILE, TILE)))
                    _update(cells[(slice(None), *box.within(tile))], dwell.height[part], dwell.weight[part])


def fitting_cell_size(grid: Grid, aperture: ApertureState) -> float:
    """Return the smallest 1, 2 or 5 times a power of ten (m) that holds a pixel of `grid` on level ground.

    Raises:
        Rejected: the grid is seen from straight above, where a pixel has no length across.
    """
    sight = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2) - aperture.position
    sight /= np.linalg.norm(sight)
    across = float(np.hypot(sight[0], sight[1]))
    if across < 1e-3:
        raise Rejected("wrong geometry", "The height image is seen from straight above; it must be seen from the side.")
    pixel = max(grid.row_spacing * abs(float(sight @ grid.row_direction)) / across, grid.col_spacing)
    decade = 10.0 ** np.floor(np.log10(pixel))
    return float(next(step * decade for step in (1, 2, 5, 10) if step * decade >= pixel * (1 - 1e-9)))


def _averaged(cell: I64, height: F64, sigma: F64, box: Box, cell_size: float, aperture: ApertureState) -> CellHeights:
    """Average the pixels in each cell of `box` with the weights w = 1 / sigma^2.

    If a part c of the variances is common to all pixels, the variance of the mean is
    sum w^2 (sigma^2 - c) / (sum w)^2 + c = 1 / sum w + c (1 - sum w^2 / (sum w)^2).

    Args:
        cell: index of each pixel's cell in the raveled box, shape (n,).
        height: m, shape (n,).
        sigma: m, shape (n,).
        box: the cells.
        cell_size: m.
        aperture: from which they were seen.
    """
    cells = box.shape[0] * box.shape[1]
    weight = 1 / sigma**2
    total = np.bincount(cell, weight, cells)
    seen = np.flatnonzero(total)
    sums = total[seen]
    mean = np.bincount(cell, weight * height, cells)[seen] / sums
    common = _common_in_cells(seen, mean, box, cell_size, aperture)
    variance = 1 / sums + common * (1 - np.bincount(cell, weight**2, cells)[seen] / sums**2)
    heights, weights = np.zeros(cells), np.zeros(cells)
    heights[seen], weights[seen] = mean, 1 / variance
    return CellHeights(box, heights.reshape(box.shape), weights.reshape(box.shape))


def _common_in_cells(cell: I64, height: F64, box: Box, cell_size: float, aperture: ApertureState) -> F64:
    """`shared_variance` of the cells with these indices in the raveled box.

    It changes by parts of the range, and is computed for one cell in each square of SMOOTH times the flight height.
    """
    row, col = np.divmod(cell, box.shape[1])
    side = max(1, int(SMOOTH * height_of(aperture.position) / cell_size))
    square = row // side * (box.shape[1] // side + 1) + col // side
    chosen = np.zeros(square.max() + 1, dtype=np.int64)
    chosen[square] = np.arange(len(cell))
    east, north = (cell_size * (first + index[chosen] + 0.5) for first, index in ((box.west, col), (box.south, row)))
    variance = shared_variance(sphere_point(east, north, height[chosen]), aperture)
    return variance[square]


def _update(cells: F64, height: F64, weight: F64) -> None:
    """Update the weighted means of `cells` with a measurement of `weight` 1 / variance (0: no measurement).

    Chi-square grows by the squared difference from the mean so far, over the variance of that difference. That gives
    the sum of w (h - mean)^2 over all measurements without the cancellation of large squares.
    """
    total = cells[WEIGHT] + weight
    gain = np.divide(weight, total, out=np.zeros_like(weight), where=weight > 0)
    step = gain * (height - cells[HEIGHT])
    cells[CHI_SQUARE] += np.divide(step**2 * cells[WEIGHT], gain, out=np.zeros_like(gain), where=gain > 0)
    cells[HEIGHT] += step
    cells[WEIGHT] = total
    cells[COUNT] += weight > 0


def _tile_box(place: tuple[int, int]) -> Box:
    """Cells of the tile in row and column `place` of tiles."""
    south, west = TILE * place[0], TILE * place[1]
    return Box(south, west, south + TILE, west + TILE)
