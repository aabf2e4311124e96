"""Relief map: the heights of successive dwells, averaged in the cells of one grid on the ground.

The map uses the strongest scatterer of each pixel, and a weaker one if it is all but certain to be there (0.99): a map
used for navigation must not contain obstacles that do not exist, so a false alarm of the order of a pixel must stay
out; and it must not miss a kerb or a car whose brighter neighbour in layover is the road.
Estimators that state no probability give their strongest scatterers only; the others stay in the points of dwells.

The height of a cell is that of the ground at its centre: heights are moved there along the slope of the ground
(`slope.ground_slope`). Sigma is that of a height at a fixed position, on ground of that slope
(`position_error.variance_at_place`). Where the slope is not known, heights are not moved, sigma is that of the worst
slope up to STEEPEST, and that slope times the distance to the centre is added.

The errors of pixels are independent, except for the part caused by the platform's pose and by uncertain beams, which
all pixels of a dwell share. No message says how alike these are in different dwells: a pose that drifts, a boresight
and beams err in the same way for many. Averaging therefore does not reduce the common part unless its course is stated
(`offsets`): its sigma is the mean of those of the dwells, which is right if they all err alike, and too large
otherwise. Nor does it enter a weight: an error that all share cancels wherever heights are compared, so that a greater
one makes sigma greater and moves no height.

Structure of the ground within a cell is no error that dwells average away: what they see of it is added to sigma as it
is (`structure`), beyond an offset that a dwell has in all cells. Sigma is too small if a spatial prior couples
neighbouring pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.elevation import ORDERS
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, sphere_coordinates
from sal_height.numeric import F64, I64, Bool, in_parallel
from sal_height.relief._map_kernels import COLUMNS, average_cells, gather_pixels, read_cells, update_cells
from sal_height.relief.cell_map import TILE, CellMap, Relief, cell_numbers, tiles_of
from sal_height.relief.heights import HeightField, Surface
from sal_height.relief.offsets import LASTING, LEAST_SHARED, SharedError
from sal_height.relief.position_error import STEEPEST
from sal_height.relief.slope import LEAST_PIXELS, ground_slope, median
from sal_height.relief.structure import structure_variance
from sal_height.relief.tracked import ground_spacings


class ReliefMap(CellMap):
    """Mean heights of all dwells."""

    def __init__(self, cell_size: float, max_cells: int, shared: SharedError = LASTING) -> None:
        """An empty map.

        Args:
            cell_size: side of a cell, m.
            max_cells: greatest number of cells of the rectangle around all that was seen.
            shared: course of the height error that all pixels of a dwell share.
        """
        super().__init__(cell_size, max_cells, shared)
        # The columns of `update_cells`.
        self._tiles: dict[tuple[int, int], F64] = {}

    def add(self, field: HeightField, aperture: ApertureState | None = None, time: float = 0.0) -> None:  # noqa: ARG002
        """Enter the heights of a dwell; the aperture makes no difference. See `CellMap.add`."""
        pixels = _pixels_of(field)
        if not pixels.height.size:
            return
        cells = np.floor(pixels.place[::-1] / self.cell_size).astype(np.int64)
        seen = np.array([cells.min(axis=1), cells.max(axis=1)])
        corners = self._grown(seen)
        self._enter(_averaged(pixels, cells, seen, self.cell_size), time)
        self._corners = corners

    def _enter(self, seen: _Cells, time: float) -> None:
        """Enter a dwell's mean heights."""
        if self._shared.varying:
            self._compare_offsets(cell_numbers(seen.row, seen.col), seen.height, time)
        index = seen.row % TILE * TILE + seen.col % TILE
        tiles = list(tiles_of(np.stack([seen.row, seen.col], axis=-1)))
        before = np.full(len(index), np.nan)
        for tile, here in tiles:
            if tile not in self._tiles:
                self._tiles[tile] = np.zeros((TILE * TILE, COLUMNS))
            else:
                known = self._tiles[tile][index[here]]
                before[here] = np.where(known[:, 1] > 0, known[:, 0], np.nan)
        rise = (seen.height - before)[np.isfinite(before)]
        offset = median(rise) if len(rise) >= LEAST_SHARED else 0.0
        for tile, here in tiles:
            update_cells(
                index[here],
                seen.height[here],
                seen.own[here],
                seen.structure[here],
                seen.common[here],
                offset,
                time,
                self._shared.correlation,
                self._tiles[tile],
            )

    def _relief(self, corners: I64) -> Relief:
        first, last = corners
        height, variance, disagreement = np.full((3, *(last - first + 1)), np.nan, np.float32)
        count, misfit = np.zeros(height.shape, np.uint32), np.zeros((*height.shape, 3), np.float32)
        for place, tile in self._tiles.items():
            corner = TILE * np.array(place)
            (south, west), (end_row, end_col) = np.maximum(first, corner), np.minimum(last + 1, corner + TILE)
            of_tile = np.s_[south - corner[0] : end_row - corner[0], west - corner[1] : end_col - corner[1]]
            there = np.s_[south - first[0] : end_row - first[0], west - first[1] : end_col - first[1]]
            read_cells(
                tile.reshape(TILE, TILE, COLUMNS)[of_tile],
                self._shared.varying**2,
                height[there],
                variance[there],
                misfit[there],
                disagreement[there],
                count[there],
            )
        sigma = np.sqrt(variance + structure_variance(misfit))
        north, east = ((first + 0.5) * self.cell_size).tolist()
        return Relief(east, north, self.cell_size, height, sigma, disagreement, count)


def fitting_cell_size(grid: Grid, aperture: ApertureState) -> float:
    """Return the smallest 1, 2 or 5 times a power of ten (m) that covers a pixel of `grid` on level ground.

    Raises:
        Rejected: the grid is seen from straight above, where a pixel has no length across.
    """
    sight = grid.middle - aperture.position
    sight /= np.linalg.norm(sight)
    across = float(np.hypot(sight[0], sight[1]))
    if across < 1e-3:
        raise Rejected("wrong geometry", "The height image is seen from straight above; it must be seen from the side.")
    pixel = max(grid.row_spacing * abs(float(sight @ grid.row_direction)) / across, grid.col_spacing)
    decade = 10.0 ** np.floor(np.log10(pixel))
    return float(next(step * decade for step in (1, 2, 5, 10) if step * decade >= pixel * (1 - 1e-9)))


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Heights of a dwell for a map, one for each scatterer.

    Attributes:
        place: arc distances east and north of the map's origin, m, shape (2, pixels).
        height: height above the sphere, m, shape (pixels,).
        slope: slope of the ground towards east and north, m/m, shape (2, pixels); 0 where it is not known.
        slope_error: standard deviation of the slope, m/m, shape (pixels,); NaN where it is not known.
        own: variance of the height at that position, m^2, shape (pixels,).
        common: part of that variance that the pixels of the dwell share, m^2.
    """

    place: F64
    height: F64
    slope: F64
    slope_error: F64
    own: F64
    common: F64


@dataclass(frozen=True, eq=False)
class _Cells:
    """Mean heights of a dwell in the cells that it has seen, shape (cells,) each, in the order of rows.

    Attributes:
        row: row of the cell, counted from the map's origin.
        col: column of the cell, counted from the map's origin.
        height: height at the centre of the cell, m.
        own: variance of its independent errors, m^2.
        structure: variance of the heights in the cell, m^2; 0 where these agree within their errors.
        common: standard deviation of the error that it shares with others, m.
    """

    row: I64
    col: I64
    height: F64
    own: F64
    structure: F64
    common: F64


def _supported(field: HeightField) -> list[Bool]:
    """Pixels of each surface that enter a map."""
    always, never = np.ones(field.grid.shape, np.bool_), np.zeros(field.grid.shape, np.bool_)
    probability = field.order_probability
    if probability is None:
        return [always] + [never] * (len(field.surfaces) - 1)
    points = probability[..., : ORDERS - 1]  # of 0, 1, 2, 3 scatterers
    weaker = [points[..., number + 1 :].sum(axis=-1) >= 0.99 for number in range(1, len(field.surfaces))]
    return [always, *weaker]


def _pixels_of(field: HeightField) -> _Pixels:
    """The scatterers of a dwell that enter a map."""
    supported = _supported(field)
    table, end = np.empty((8, sum(int(np.count_nonzero(there)) for there in supported))), 0
    spacing = min(ground_spacings(field.grid))
    for surface, there in zip(field.surfaces, supported, strict=True):
        if there.any():
            end = _gather(surface, there, spacing, table, end)
    place, (height, *slope, error, own, common) = table[:2, :end], table[2:, :end]
    return _Pixels(np.ascontiguousarray(place), height, np.stack(slope), error, own, common)


def _gather(surface: Surface, there: Bool, spacing: float, table: F64, start: int) -> int:
    """Fill the columns of a table from `start` on with the scatterers of a surface `there`, see `gather_pixels`.

    `spacing` is that of pixels on the ground, m.

    Returns:
        The column after the last one filled.
    """
    points = np.empty((3, *there.shape))

    def fill(part: slice) -> None:
        points[:, part] = sphere_coordinates(surface.positions[part])

    in_parallel(fill, len(there), LEAST_PIXELS // there.shape[1] + 1)
    own, common = np.ascontiguousarray(surface.own_covariance), surface.common_covariance
    slope, error = ground_slope(points, own, spacing)
    shared = np.empty((0, 0, 3, 3)) if common is None else np.ascontiguousarray(common)
    return int(gather_pixels(points, own, shared, there, slope, error, STEEPEST, table, start))


def _averaged(pixels: _Pixels, cells: I64, corners: I64, cell_size: float) -> _Cells:
    """Height at the centre of each cell that was seen: the mean of its pixels, moved along their mean slope.

    The weights are w = 1 / own; own parts add up to sum w^2 own / (sum w)^2, and of the common part, which is one
    error, the mean sigma is taken. Added are the slope's error times the distance of the pixels' mean position from
    the centre; and where slopes are not known, STEEPEST times the pixels' distances. Where the heights in the cell
    spread by more than 2.5 times their errors, that spread is structure: the cell contains a step.

    Args:
        pixels: heights of a dwell.
        cells: row and column of each pixel's cell, shape (2, pixels).
        corners: the rectangle around these cells.
        cell_size: side of a cell, m.
    """
    first, last = corners
    rows, cols = (last - first + 1).tolist()
    index = (cells[0] - first[0]) * cols + (cells[1] - first[1])
    occupied = np.zeros(rows * cols, np.bool_)
    occupied[index] = True
    seen, numbers = np.flatnonzero(occupied), np.cumsum(occupied) - 1
    row, col = seen // cols + first[0], seen % cols + first[1]
    centre = cell_size * (np.stack([col, row], axis=-1) + 0.5)
    sums = np.zeros((len(seen), 12))
    average_cells(
        numbers[index],
        pixels.place,
        pixels.height,
        pixels.slope,
        pixels.slope_error,
        pixels.own,
        pixels.common,
        centre,
        STEEPEST,
        sums,
    )
    _, _, _, height, slope_error, east, north, unmoved, own, own_of_mean, common, spread = sums.T
    moved = slope_error * np.hypot(east, north)
    step = np.where(spread > 2.5**2 * own, spread, 0.0)
    return _Cells(row, col, height, own_of_mean + moved**2 + unmoved**2, step, common)
