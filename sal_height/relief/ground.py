"""The ground from all surfaces that dwells have measured: the height, sigma and kind of each cell.

The surfaces of all pixels are points with the covariance of their position, most of them on the ground, some on walls,
and a few that do not exist. From them follows the highest surface of each cell of a grid on the ground:

1. Points of the same piece of surface are merged (`layers`), which is all that is kept of dwells.
2. Points that are connected to hardly any others, although there are others around them, are ghosts; so is what could
   not have been seen behind what stands in front of it, unless it is what stands in front that contradicts more.
3. Points with others steeply above and below them are on walls.
4. The highest that is left in each cell is its measured height. The ground between them is a membrane that tears at
   steps (`membrane`), to which every measurement is taken along its slope to the middle of its cell.
5. A cell within the footprint of a measurement is MEASURED. Another one is SHADOW if the ground in front hides it, as
   is one without a measurement of its own that pixels without a signal show to be hidden. Another one is INTERPOLATED
   if it lies in a small gap of ground that is the same on both sides, and else has no height. Next to a tear a height
   may be that of the other side: half of the step is added to its sigma.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation, distance_transform_edt, uniform_filter

from sal_height.numeric import F64, I64, U8, Bool, ShortRepr
from sal_height.relief import _kernels as kernels
from sal_height.relief.cell_map import GroundKind
from sal_height.relief.layers import Layers, Neighbours, neighbours, on_walls, supported
from sal_height.relief.membrane import Membrane, deviation, fitted_membrane, footprint
from sal_height.relief.offsets import LASTING, SharedError
from sal_height.relief.settings import GroundSettings
from sal_height.relief.visibility import blocking_cells, contradicted


@dataclass(frozen=True, eq=False)
class GroundEstimate(ShortRepr):
    """Heights of the highest surface of the cells of a grid; arrays of shape (rows, cols), row 0 the southernmost.

    Attributes:
        east: arc distance east of the centre of cell (0, 0) from the map's origin, m.
        north: arc distance north of the same, m.
        cell_size: side of a cell, m.
        height: height above the sphere, m; NaN where the kind is UNSEEN or SHADOW.
        sigma: standard deviation of that height at the centre of the cell, m; NaN for the same kinds.
        kind: `GroundKind` of each cell, uint8.
        count: number of dwells that have measured the height, uint32; 0 where it is not measured.
    """

    east: float
    north: float
    cell_size: float
    height: F64
    sigma: F64
    kind: U8
    count: npt.NDArray[np.uint32]


@dataclass(frozen=True)
class GroundGrid:
    """Cells of a rectangle of ground.

    Attributes:
        first: row (north) and column (east) of the first cell, counted from the map's origin.
        shape: number of rows and columns.
        cell_size: side of a cell, m.
        spacing: spacing of the measured pixels on level ground, the greater of along range and along track, m.
    """

    first: tuple[int, int]
    shape: tuple[int, int]
    cell_size: float
    spacing: float

    def places(self, layers: Layers) -> F64:
        """Row and column of layers in cells of this grid, shape (n, 2); whole numbers are middles of cells."""
        return layers.place[:, 1::-1] / self.cell_size - 0.5 - np.array(self.first)

    def numbers(self, layers: Layers) -> I64:
        """Flat numbers of the cells in which layers lie, shape (n,)."""
        row, col = np.rint(self.places(layers)).astype(np.int64).T
        return row * self.shape[1] + col


def unseen(east: float, north: float, cell_size: float, shape: tuple[int, int]) -> GroundEstimate:
    """An estimate of ground of which nothing was seen."""
    height, sigma = np.full(shape, np.nan), np.full(shape, np.nan)
    kind = np.full(shape, GroundKind.UNSEEN, np.uint8)
    return GroundEstimate(east, north, cell_size, height, sigma, kind, np.zeros(shape, np.uint32))


def estimated_ground(
    layers: Layers, silent: Bool, grid: GroundGrid, settings: GroundSettings, shared: SharedError = LASTING
) -> GroundEstimate:
    """Estimate the ground in all cells of `grid` from the layers that lie in them.

    Args:
        layers: measured pieces of surface.
        silent: cells in shadow by the pixels without a signal (`visibility.silent_cells`), shape of the grid.
        grid: cells of the estimate.
        settings: settings of the estimate.
        shared: course of the height error that all pixels of a dwell share.
    """
    east, north = ((index + 0.5) * grid.cell_size for index in grid.first[::-1])
    tops = highest_surfaces(layers, grid, settings)
    if not len(tops):
        return unseen(east, north, grid.cell_size, grid.shape)
    number = grid.numbers(tops)
    measured = np.zeros(grid.shape, dtype=bool)
    measured.ravel()[number] = True
    membrane, slope, variance = _settled(tops, number, grid, settings)
    covered, nearest = membrane.covered, tuple(membrane.nearest)
    sides = [_sides(membrane.height, covered, axis) for axis in (0, 1)]
    level, half = _between_sides(sides, slope, grid, settings)
    towards = np.broadcast_to(tops.towards.mean(axis=0), (grid.shape[0] * grid.shape[1], 2))
    hidden, floor = _hidden(membrane.height, covered, measured, sides, towards, grid)
    jump = np.maximum(_jumps_beside(membrane), np.where(hidden, membrane.height - floor, 0.0))
    sure = covered & (measured | (jump == 0))
    kind = np.select(
        [silent & ~measured, sure, hidden & ~covered, (level | covered) & np.isfinite(membrane.height)],
        [GroundKind.SHADOW, GroundKind.MEASURED, GroundKind.SHADOW, GroundKind.INTERPOLATED],
        GroundKind.UNSEEN,
    ).astype(np.uint8)
    common, count = np.zeros(grid.shape), np.zeros(grid.shape, np.int64)
    common.ravel()[number] = shared.averaged(variance, tops.averaged)
    count.ravel()[number] = tops.dwells
    sigma = deviation(membrane, grid.spacing / grid.cell_size)
    total = sigma**2 + common[nearest] + np.where(covered, jump**2 / 4, half**2)
    known = np.isin(kind, (GroundKind.MEASURED, GroundKind.INTERPOLATED)) & np.isfinite(total.astype(np.float32))
    kind[~known & (kind != GroundKind.SHADOW)] = GroundKind.UNSEEN
    return GroundEstimate(
        east,
        north,
        grid.cell_size,
        np.where(known, membrane.height, np.nan),
        np.where(known, np.sqrt(total), np.nan),
        kind,
        np.where(kind == GroundKind.MEASURED, count[nearest], 0).astype(np.uint32),
    )


def highest_surfaces(layers: Layers, grid: GroundGrid, settings: GroundSettings) -> Layers:
    """The highest layer of each cell, without ghosts and without the pieces of walls between their foot and top."""
    if not len(layers):
        return layers
    reach = settings.reach_pixels * grid.spacing
    pairs = neighbours(layers, reach, settings.gate)
    real = supported(layers, pairs, reach, settings.least_pixels) & ~_scattered(layers, pairs, reach, grid)
    layers, pairs = layers.where(real), pairs.among(real)
    if not len(layers):
        return layers
    ghosts = _contradicted(layers, grid)
    inner = on_walls(layers, pairs, grid.spacing / 2 + grid.cell_size / 2)
    layers = layers.where(~(ghosts | inner))
    return layers.where(_highest(layers, grid))


def _scattered(layers: Layers, pairs: Neighbours, reach: float, grid: GroundGrid) -> Bool:
    """Layers around which half of all neighbours, or more, differ by over four times their distance, shape (n,).

    Such heights, as in a canopy, do not determine any ground; next to a wall they are fewer.
    """
    steep = np.abs(pairs.rise) > np.maximum(4 * reach, pairs.error)
    size, first, second = len(layers), pairs.first, pairs.second
    number = grid.numbers(layers)
    sums = []
    scattered_cells = 19  # side in cells of the square in which heights must not be scattered
    for chosen in (steep, np.ones_like(steep)):
        count = np.bincount(first[chosen], minlength=size) + np.bincount(second[chosen], minlength=size)
        cells = np.bincount(number, count, grid.shape[0] * grid.shape[1]).reshape(grid.shape)
        sums.append(uniform_filter(cells, scattered_cells).ravel()[number])
    return np.asarray(sums[0] > 0.5 * sums[1])


def _contradicted(layers: Layers, grid: GroundGrid) -> Bool:
    """Layers that could not have been seen behind others, or that hide more than they could, shape (n,)."""
    highest = _highest(layers, grid)
    number, size = grid.numbers(layers), grid.shape[0] * grid.shape[1]
    top = np.full(grid.shape, np.nan)
    top.ravel()[number[highest]] = layers.place[highest, 2]
    distance, nearest = distance_transform_edt(np.isnan(top), return_indices=True)
    owner = np.ravel_multi_index(tuple(nearest), grid.shape).ravel()
    footprints = np.where(
        distance <= footprint(grid.spacing / grid.cell_size), top.ravel()[owner].reshape(grid.shape), np.nan
    )
    lines, cells = blocking_cells(grid.places(layers), layers.place[:, 2], layers.towards, footprints, grid.cell_size)
    surface_wrong, point_wrong = contradicted(lines, owner[cells], len(layers), size)
    is_top = np.zeros(len(layers), dtype=bool)
    is_top[highest] = True
    return point_wrong | (is_top & surface_wrong[number])


def _highest(layers: Layers, grid: GroundGrid) -> I64:
    """Number of the highest layer in each cell that has one."""
    order = np.lexsort((-layers.place[:, 2], grid.numbers(layers)))
    _, first = np.unique(grid.numbers(layers)[order], return_index=True)
    return order[first]


def _settled(tops: Layers, number: I64, grid: GroundGrid, settings: GroundSettings) -> tuple[Membrane, F64, F64]:
    """The membrane through the tops, taken along its own slopes to the middles of their cells.

    A plane of the slope g turns an error e of a position into one of height at a fixed one, (-g, 1) e. Returns the
    membrane, its slope (m per cell, shape (rows, cols, 2)) and the variance (m^2) from the common errors of each top.
    """
    offset = grid.places(tops) - np.rint(grid.places(tops))
    slope, steepest = np.zeros((*grid.shape, 2)), grid.cell_size  # m per cell; 45 degrees, until slopes are known
    passes = 2  # number of fits: with unknown slopes, and with those that the first one has found
    # Least variance of a height at a place over that of the height itself, on slopes along which the errors go.
    least_variance_share = 0.25
    for _ in range(passes):
        there = slope.reshape(-1, 2)[number]
        normal = np.column_stack([-there[:, ::-1] / grid.cell_size, np.ones(len(tops))])
        own, common = (np.einsum("ni,nij,nj->n", normal, part, normal) for part in (tops.own, tops.common))
        height, sigma = np.full(grid.shape, np.nan), np.full(grid.shape, np.nan)
        height.ravel()[number] = tops.place[:, 2] - np.sum(there * offset, axis=1)
        sigma.ravel()[number] = np.sqrt(np.maximum(own, least_variance_share * tops.own[:, 2, 2]))
        membrane = fitted_membrane(height, sigma, grid.spacing / grid.cell_size, settings.gate, slope, steepest)
        slope, steepest = _slopes(membrane), 0.0
    return membrane, slope, common


def _slopes(membrane: Membrane) -> F64:
    """Slope of the membrane along rows and columns, m per cell, shape (rows, cols, 2); steps are not part of it."""
    slope = np.empty((2, *membrane.height.shape))
    across = np.empty(membrane.height.shape[::-1])
    slope_cells = 7  # side in cells of the square in which slopes are averaged
    kernels.mean_rises(membrane.height, membrane.joined[0], slope_cells // 2, slope[0])
    there = np.ascontiguousarray(membrane.joined[1].T)
    kernels.mean_rises(np.ascontiguousarray(membrane.height.T), there, slope_cells // 2, across)
    slope[1] = across.T
    return np.moveaxis(slope, 0, -1)


def _jumps_beside(membrane: Membrane) -> F64:
    """Greatest step between each cell and its four neighbours where the membrane is torn, m; 0 where it is whole.

    There is no step to a neighbour without a height.
    """
    jump = np.zeros(membrane.height.shape)
    for axis, joint in enumerate(membrane.joined):
        step = np.where(joint, 0.0, np.nan_to_num(np.abs(np.diff(membrane.height, axis=axis))))
        before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        jump = np.maximum(jump, np.maximum(np.pad(step, before), np.pad(step, after)))
    return jump


def _between_sides(sides: list[Sides], slope: F64, grid: GroundGrid, settings: GroundSettings) -> tuple[Bool, F64]:
    """Cells in a gap whose nearest measured cells on both sides have the same height, and half their difference, m.

    The difference due to the slope (m per cell, shape (rows, cols, 2)) is subtracted.

    The gap is examined along rows and along columns, each up to `interpolation_pixels` away; one must show the same
    height on both sides, and neither a step.
    """
    reach = settings.interpolation_pixels * grid.spacing / grid.cell_size
    same, step, half = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool), np.zeros(grid.shape)
    steepest_gap = 0.6  # greatest slope across a gap that is interpolated, 30 degrees
    for axis, ((before, lower), (after, upper)) in enumerate(sides):
        near = (before <= reach) & (after <= reach)
        difference = np.abs(upper - lower)
        level = near & (difference <= steepest_gap * (before + after) * grid.cell_size)
        same, step = same | level, step | (near & ~level)
        beyond_slope = np.abs(upper - lower - slope[..., axis] * (before + after))
        half = np.where(level, np.maximum(half, beyond_slope / 2), half)
    return same & ~step, half


Sides = tuple[tuple[F64, F64], tuple[F64, F64]]
"""Distance (cells) and height (m) of the cell before each one along an axis, and of the one after it."""


def _sides(height: F64, covered: Bool, axis: int) -> Sides:
    """Distance in cells and height of the last covered cell before each along an axis, and of the first after it."""
    length = height.shape[axis]
    place = np.expand_dims(np.arange(length), 1 - axis) * np.ones(height.shape, np.int64)
    before = np.maximum.accumulate(np.where(covered, place, -1), axis=axis)
    after = np.flip(np.minimum.accumulate(np.flip(np.where(covered, place, length), axis), axis=axis), axis)
    sides = []
    for side, exists in ((before, before >= 0), (after, after < length)):
        there = np.take_along_axis(height, np.clip(side, 0, length - 1), axis)
        sides.append((np.where(exists, np.abs(side - place), np.inf), np.where(exists, there, np.nan)))
    return sides[0], sides[1]


def _hidden(
    height: F64, covered: Bool, measured: Bool, sides: list[Sides], towards: F64, grid: GroundGrid
) -> tuple[Bool, F64]:
    """Cells that the covered ones would hide from the sensor at the lowest of the known heights nearest to them.

    Examined are the cells that are not covered, and adjacent ones that are not measured: their heights are known from
    others. Returns these lowest heights, m, too.
    """
    beside = [_sides(height, measured, axis) for axis in (0, 1)]
    outside, inside = (np.fmin.reduce([side for pair in both for _, side in pair]) for both in (sides, beside))
    floor = np.where(covered, inside, outside)
    top = np.where(covered, height, np.nan)
    place = np.moveaxis(np.indices(grid.shape), 0, -1).reshape(-1, 2).astype(np.float64)
    looked_at = binary_dilation(~covered, iterations=2) & ~measured & np.isfinite(floor)
    cells = np.flatnonzero(looked_at)
    lines, _ = blocking_cells(place[cells], floor.ravel()[cells], towards[cells], top, grid.cell_size)
    hidden = np.zeros(grid.shape, dtype=bool)
    hidden.ravel()[cells[lines]] = True
    return hidden, floor
