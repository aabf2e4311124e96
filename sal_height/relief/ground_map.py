"""Map of the ground: the measurements of all dwells so far, and the estimate from them.

The map keeps merged layers of the dwells (`layers`), in square tiles. A new dwell changes the estimate on the ground
that it has seen and a little around it, which is estimated again; `settle` estimates all of it at once. Small dwells
side by side are estimated together, for an estimate of few cells takes as long as one of many.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce

import numpy as np

from sal_height.geometry import ApertureState, Grid
from sal_height.numeric import I64, Bool
from sal_height.relief.cell_map import TILE, CellMap, Relief, hull, tiles_of
from sal_height.relief.ground import GroundEstimate, GroundGrid, estimated_ground, unseen
from sal_height.relief.heights import HeightField
from sal_height.relief.layers import Layers, height_offset, joined_dwells, layers_of, merged_dwell, single_layers
from sal_height.relief.offsets import LASTING, SharedError
from sal_height.relief.settings import DEFAULT_GROUND, GroundSettings
from sal_height.relief.tracked import ground_spacings
from sal_height.relief.visibility import silent_cells

MARGIN = 4
"""Cells around what a dwell has seen in which the estimate may change, and as many more that are taken into account."""

LEAST_CELLS = 2**14
"""Cells that are worth an estimate before one is requested: ten dwells of sal_spotlight, 50 ms."""

ARRAYS = ("height", "sigma", "kind", "count")
"""Names of the arrays of an estimate."""


def fine_cell_size(grid: Grid) -> float:
    """Return the greatest 1, 2 or 5 times a power of ten (m) that is at most 3/4 of a pixel of `grid` on the ground."""
    most = 0.75 * max(ground_spacings(grid))
    decade = 10.0 ** np.floor(np.log10(most))
    return float(next(step * decade for step in (5, 2, 1) if step * decade <= most * (1 + 1e-9)))


class GroundMap(CellMap):
    """The highest surface of all ground that was seen, estimated whenever it is requested."""

    def __init__(
        self,
        cell_size: float,
        spacing: float,
        max_cells: int,
        settings: GroundSettings = DEFAULT_GROUND,
        shared: SharedError = LASTING,
    ) -> None:
        """An empty map.

        Args:
            cell_size: side of a cell, m.
            spacing: spacing of pixels on level ground, the greater of along range and along track, m.
            max_cells: greatest number of cells of the rectangle around all that was seen.
            settings: settings of the estimate.
            shared: course of the height error that all pixels of a dwell share.
        """
        super().__init__(cell_size, max_cells, shared)
        self.spacing = spacing
        self.settings = settings
        self._tiles: dict[tuple[int, int], Layers] = {}
        self._silent: dict[tuple[int, int], Bool] = {}  # cells of tiles that pixels without a signal show in shadow
        self._estimate: GroundEstimate | None = None  # of whole tiles
        self._stale: I64 | None = None  # the rectangle around cells seen since they were estimated

    def add(self, field: HeightField, aperture: ApertureState, time: float = 0.0) -> None:
        """Enter all surfaces of a dwell; estimate once there are LEAST_CELLS new cells. See `CellMap.add`."""
        seen = self.enter(field, aperture, time)
        if seen is None:
            return
        together = seen if self._stale is None else hull(self._stale, seen)
        if _count(together) < LEAST_CELLS:
            self._stale = together
        else:
            self._renew()
            self._stale = seen
            if _count(seen) >= LEAST_CELLS:
                self._renew()

    def enter(self, field: HeightField, aperture: ApertureState, time: float = 0.0) -> I64 | None:
        """Enter all surfaces that a dwell saw from `aperture` at a time, s; the estimate is not brought up to date.

        Returns:
            Row and column of the first and of the last cell that has a surface, shape (2, 2); None: no such cell.

        Raises:
            Rejected: the map would have more than `max_cells` cells; it does not change.
        """
        layers = merged_dwell(layers_of(field, aperture, time), self.cell_size, self.settings.gate)
        if not len(layers):
            return None
        cells = layers.cells(self.cell_size)
        seen = np.stack([cells.min(axis=0), cells.max(axis=0)])
        self._grow(seen)
        if self._shared.varying:
            numbers, heights, _ = single_layers(layers, self.cell_size)
            self._compare_offsets(numbers, heights, time)
            if self.contradiction:
                self._stale = self._corners
        self._join({place: layers.where(there) for place, there in tiles_of(cells)}, layers, seen)
        silent = silent_cells(field, aperture, self.settings.gate, self.cell_size)
        for place, there in tiles_of(silent):
            self._silent.setdefault(place, np.zeros((TILE, TILE), bool))[tuple((silent[there] % TILE).T)] = True
        return seen

    def _join(self, tiles: Mapping[tuple[int, int], Layers], new: Layers, seen: I64) -> None:
        """Enter new layers, by tiles and all together, in the cells from seen[0] to seen[1]; only these are merged."""
        size, gate = self.cell_size, self.settings.gate
        others, known = {}, {}
        for place in tiles.keys() & self._tiles.keys():
            cells = self._tiles[place].cells(size)
            there = ((cells >= seen[0]) & (cells <= seen[1])).all(axis=1)
            others[place], known[place] = self._tiles[place].where(~there), self._tiles[place].where(there)
        offset = height_offset(list(known.values()), new, size, gate)
        for place, layers in tiles.items():
            self._tiles[place] = (
                others[place].and_those(joined_dwells(known[place], layers, offset, self._shared, size, gate))
                if place in known
                else layers
            )

    def settle(self) -> None:
        """Estimate all ground at once."""
        self._stale = self._corners
        self._renew()

    def estimate(self) -> GroundEstimate | None:
        """Return the estimate up to now; None if nothing was seen yet."""
        self._renew()
        if self._estimate is None or self._corners is None:
            return None
        return _part(self._estimate, self._corners)

    def _relief(self, corners: I64) -> Relief:
        self._renew()
        assert self._estimate is not None  # noqa: S101 (`_grow` made it)
        ground = _part(self._estimate, corners)
        height, sigma = ground.height.astype(np.float32), ground.sigma.astype(np.float32)
        disagreement = np.full_like(height, np.nan)  # merging does not keep it
        place = ground.east, ground.north, ground.cell_size
        return Relief(*place, height, sigma, disagreement, ground.count.copy(), ground.kind.copy())

    def _grow(self, seen: I64) -> None:
        """Make the estimate large enough for cells from seen[0] to seen[1]."""
        corners = self._grown(seen)
        whole = np.stack([corners[0] // TILE * TILE, corners[1] // TILE * TILE + TILE - 1])
        old, self._corners = self._estimate, corners
        if old is not None and (whole == _corners_of(old)).all():
            return
        rows, cols = (whole[1] - whole[0] + 1).tolist()
        north, east = ((whole[0] + 0.5) * self.cell_size).tolist()
        self._estimate = unseen(east, north, self.cell_size, (rows, cols))
        if old is not None:
            _paste(old, self._estimate)

    def _renew(self) -> None:
        """Estimate the stale cells and MARGIN around them again, as far as they have been seen."""
        if self._stale is None or self._corners is None:
            return
        inner = _common(self._stale + MARGIN * OUTWARDS, self._corners)
        outer = _common(inner + MARGIN * OUTWARDS, self._corners)
        self._stale = None
        rows, cols = (outer[1] - outer[0] + 1).tolist()
        grid = GroundGrid((int(outer[0, 0]), int(outer[0, 1])), (rows, cols), self.cell_size, self.spacing)
        assert self._estimate is not None  # noqa: S101 (`_grow` made it)
        _paste(
            _part(
                estimated_ground(self._within(outer), self._silent_within(outer), grid, self.settings, self._shared),
                inner,
            ),
            self._estimate,
        )

    def _within(self, corners: I64) -> Layers:
        """All layers in the cells from corners[0] to corners[1]."""
        first, last = corners // TILE
        places = [(row, col) for row in range(first[0], last[0] + 1) for col in range(first[1], last[1] + 1)]
        tiles = [self._tiles[place] for place in places if place in self._tiles]
        layers = reduce(Layers.and_those, tiles[1:], tiles[0])
        cells = layers.cells(self.cell_size)
        return layers.where(((cells >= corners[0]) & (cells <= corners[1])).all(axis=1))

    def _silent_within(self, corners: I64) -> Bool:
        """True for cells from corners[0] to corners[1] that pixels without a signal show to be in shadow."""
        first, last = corners // TILE
        none = np.zeros((TILE, TILE), bool)
        tiles = [
            [self._silent.get((row, col), none) for col in range(first[1], last[1] + 1)]
            for row in range(first[0], last[0] + 1)
        ]
        row, col = corners[0] - first * TILE
        rows, cols = corners[1] - corners[0] + 1
        return np.block(tiles)[row : row + rows, col : col + cols]


OUTWARDS = np.array([[-1], [1]])
"""Makes a rectangle of cells, given by row and column of its first and of its last cell, larger by a cell."""


def _common(one: I64, other: I64) -> I64:
    """The rectangle that two have in common."""
    return np.stack([np.maximum(one[0], other[0]), np.minimum(one[1], other[1])])


def _count(corners: I64) -> int:
    """Number of cells of a rectangle."""
    return int(np.prod(corners[1] - corners[0] + 1))


def _corners_of(estimate: GroundEstimate) -> I64:
    """Row and column, counted from the map's origin, of the first and of the last cell."""
    first = np.floor(np.array([estimate.north, estimate.east]) / estimate.cell_size).astype(np.int64)
    return np.stack([first, first + np.array(estimate.height.shape) - 1])


def _part(estimate: GroundEstimate, corners: I64) -> GroundEstimate:
    """The cells from corners[0] to corners[1] of an estimate, as views."""
    (row, col), (end_row, end_col) = corners - _corners_of(estimate)[0] + np.array([[0], [1]])
    there = np.s_[row:end_row, col:end_col]
    north, east = ((corners[0] + 0.5) * estimate.cell_size).tolist()
    return GroundEstimate(east, north, estimate.cell_size, *(getattr(estimate, name)[there] for name in ARRAYS))


def _paste(part: GroundEstimate, whole: GroundEstimate) -> None:
    """Copy the cells of a part into an estimate that contains all of them."""
    there = _part(whole, _corners_of(part))
    for name in ARRAYS:
        getattr(there, name)[...] = getattr(part, name)
