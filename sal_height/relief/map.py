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
from sal_height.numeric import F32, F64, I64, U8
from sal_height.relief.heights import Surface, shared_variance

TILE = 256
"""Side in cells of the square tiles by which the memory of a map grows."""

SMOOTH = 1e-3
"""Ground distance, as a share of the flight height, over which the variance caused by the pose hardly changes."""


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
        kind: what each height rests on (`GroundKind`), uint8; None: on measurements, wherever it is not NaN.
    """

    east: float
    north: float
    cell_size: float
    height: F32
    sigma: F32
    disagreement: F32
    count: npt.NDArray[np.uint32]
    kind: U8 | None = None


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
        self._corners: I64 | None = None  # row and column of the first and of the last cell of that rectangle
        # Of each cell: mean height (m), 1 / its variance (1/m^2), chi-square and number of dwells.
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
        cells = np.floor(np.stack([north, east]) / self.cell_size).astype(np.int64)
        corners = np.stack([cells.min(axis=1), cells.max(axis=1)])
        if self._corners is not None:
            corners = np.stack([np.minimum(corners[0], self._corners[0]), np.maximum(corners[1], self._corners[1])])
        rows, cols = (corners[1] - corners[0] + 1).tolist()
        if rows * cols > self.max_cells:
            raise Rejected(
                "map full",
                f"With these heights the map would have {rows} x {cols} cells of {self.cell_size:g} m, more than the "
                f"{self.max_cells} that max_cells allows.",
            )
        self._enter(*_averaged(cells, surface.height[seen], surface.sigma[seen], self.cell_size, aperture))
        self._corners = corners

    def _enter(self, row: I64, col: I64, height: F64, weight: F64) -> None:
        """Enter a dwell's mean heights (m) in some cells, in the order of rows, with `weight` 1 / variance (1/m^2)."""
        index, tile_cols = row % TILE * TILE + col % TILE, col // TILE
        for tile_row in range(row[0] // TILE, row[-1] // TILE + 1):
            first, end = np.searchsorted(row, [TILE * tile_row, TILE * (tile_row + 1)])
            for tile_col in range(tile_cols.min(), tile_cols.max() + 1):
                here = first + np.flatnonzero(tile_cols[first:end] == tile_col)
                if here.size:
                    tile = self._tiles.setdefault((tile_row, tile_col), np.zeros((TILE * TILE, 4)))
                    tile[index[here]] = _updated(tile[index[here]], height[here], weight[here])

    def relief(self) -> Relief | None:
        """Return the map as it stands; None if nothing was seen yet."""
        if self._corners is None:
            return None
        first, last = self._corners
        origin = first // TILE * TILE  # of the tile that holds the first cell
        whole = tuple((last // TILE * TILE + TILE - origin).tolist())
        height, sigma, disagreement = (np.full(whole, np.nan, np.float32) for _ in range(3))
        count = np.zeros(whole, np.uint32)
        for place, tile in self._tiles.items():
            south, west = (TILE * np.array(place) - origin).tolist()
            there = np.s_[south : south + TILE, west : west + TILE]
            mean, weight, chi_square, dwells = tile.T.reshape(4, TILE, TILE)
            with np.errstate(divide="ignore", invalid="ignore"):
                height[there] = np.where(dwells > 0, mean, np.nan)
                sigma[there] = np.where(dwells > 0, 1 / np.sqrt(weight), np.nan)
                disagreement[there] = np.where(dwells > 1, np.sqrt(chi_square / (dwells - 1)), np.nan)
            count[there] = dwells
        seen = tuple(slice(start, end) for start, end in zip(first - origin, last + 1 - origin, strict=True))
        centre = self.cell_size / 2
        return Relief(
            east=float(first[1]) * self.cell_size + centre,
            north=float(first[0]) * self.cell_size + centre,
            cell_size=self.cell_size,
            height=height[seen],
            sigma=sigma[seen],
            disagreement=disagreement[seen],
            count=count[seen],
        )


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


def _averaged(
    cells: I64, height: F64, sigma: F64, cell_size: float, aperture: ApertureState
) -> tuple[I64, I64, F64, F64]:
    """Average the pixels in each cell with the weights w = 1 / sigma^2.

    If a part c of the variances is common to all pixels, the variance of the mean is
    sum w^2 (sigma^2 - c) / (sum w)^2 + c = 1 / sum w + c (1 - sum w^2 / (sum w)^2).

    Args:
        cells: row and column of each pixel's cell, shape (2, pixels).
        height: m, shape (pixels,).
        sigma: m, shape (pixels,).
        cell_size: m.
        aperture: from which they were seen.

    Returns:
        Row and column of the cells that were seen, in the order of rows, and their mean height (m) and 1 / its variance
        (1/m^2).
    """
    first = cells.min(axis=1)
    shape = tuple(cells.max(axis=1) - first + 1)
    index = np.ravel_multi_index(tuple(cells - first[:, None]), shape)
    weight = 1 / sigma**2
    total = np.bincount(index, weight)
    seen = np.flatnonzero(total)
    row, col = np.unravel_index(seen, shape)
    sums = total[seen]
    mean = np.bincount(index, weight * height)[seen] / sums
    # The common variance changes by parts of the range: it is computed for one cell in each square.
    side = max(1, int(SMOOTH * height_of(aperture.position) / cell_size))
    square = row // side * (shape[1] // side + 1) + col // side
    chosen = np.zeros(square.max() + 1, dtype=np.int64)
    chosen[square] = np.arange(len(seen))
    row, col = row + first[0], col + first[1]
    places = sphere_point(cell_size * (col[chosen] + 0.5), cell_size * (row[chosen] + 0.5), mean[chosen])
    common = shared_variance(places, aperture)[square]
    variance = 1 / sums + common * (1 - np.bincount(index, weight**2)[seen] / sums**2)
    return row, col, mean, 1 / variance


def _updated(cells: F64, height: F64, weight: F64) -> F64:
    """Update the numbers of cells, shape (n, 4), with measurements of `weight` 1 / variance.

    Chi-square grows by the squared difference from the mean so far, over the variance of that difference. That gives
    the sum of w (h - mean)^2 over all measurements without the cancellation of large squares.
    """
    mean, known, chi_square, count = cells.T
    gain = weight / (known + weight)
    step = gain * (height - mean)
    return np.stack([mean + step, known + weight, chi_square + step**2 * known / gain, count + 1], axis=-1)
