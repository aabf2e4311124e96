"""Maps of ground: cells of one grid in which the heights of successive dwells are combined.

The grid lies along the arc distances east and north of `geometry.sphere_coordinates`; the edges of its cells are at
multiples of the cell size, so that maps of different flights fit. The layer of the map decides which data of a cell are
kept and how heights of dwells are combined: the mean of all dwells (`map.ReliefMap`) or the highest surface
(`ground_map.GroundMap`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.errors import Rejected
from sal_height.extras import import_extra
from sal_height.geometry import ApertureState
from sal_height.numeric import F32, F64, I64, U8, Index, ShortRepr, draw_array
from sal_height.relief.heights import HeightField
from sal_height.relief.labelled import flags, height_attributes, place_attributes
from sal_height.relief.offsets import LASTING, OffsetTest, SharedError

TILE = 128
"""Side in cells of the square tiles by which the memory of a map grows."""


class GroundKind(IntEnum):
    """Basis of the height of a cell; the values are those of ReliefMap.msg."""

    MEASURED = 0
    INTERPOLATED = 1
    SHADOW = 2
    UNSEEN = 3


@dataclass(frozen=True, eq=False)
class Relief(ShortRepr):
    """A map at some time; arrays of shape (rows, cols), row 0 the southernmost.

    Attributes:
        east: arc distance east of the centre of cell (0, 0) from the map's origin, m.
        north: arc distance north of the same, m.
        cell_size: side of a cell, m.
        height: height of the ground at the centre of the cell, above the sphere, m; NaN where nothing was seen.
        sigma: standard deviation of that height, m; NaN where nothing was seen.
        disagreement: spread of the dwells' heights over that expected from their sigmas, if errors of different dwells
            are independent: the square root of chi-square per degree of freedom (Birge ratio, Phys. Rev. 40, 1932,
            p. 207). Near 1 if the sigmas are right, smaller if dwells err alike; greater where something moved. NaN
            where fewer than two dwells saw the cell.
        count: number of dwells that saw the cell.
        kind: basis of each height (`GroundKind`), uint8; None: measurements, wherever the height is not NaN.
    """

    east: float
    north: float
    cell_size: float
    height: F32
    sigma: F32
    disagreement: F32
    count: npt.NDArray[np.uint32]
    kind: U8 | None = None

    def __post_init__(self) -> None:
        """Refuse a height without a finite sigma, which nobody could use.

        Raises:
            ValueError: a height has a sigma that is not finite.
        """
        unknown = np.isfinite(self.height) & ~np.isfinite(self.sigma)
        if unknown.any():
            raise ValueError(f"{np.count_nonzero(unknown)} heights of a map have no finite sigma.")

    def to_xarray(self) -> Any:
        """The map as an xarray.Dataset with the dimensions y (north) and x (east), along the sphere of the map.

        Raises:
            UserError: xarray is not installed.
        """
        xarray = import_extra("xarray", "Making labelled arrays")
        rows, cols = self.height.shape
        axes = {"y": self.north + self.cell_size * np.arange(rows), "x": self.east + self.cell_size * np.arange(cols)}
        texts = {
            "height": height_attributes(None),
            "sigma": {"units": "m", "long_name": "standard deviation of height"},
            "disagreement": {"units": "1", "long_name": "spread of the dwells over that expected"},
            "count": {"units": "1", "long_name": "number of dwells that saw the cell"},
            "kind": {"long_name": "basis of the height", **flags(GroundKind)},
        }
        layers = {name: (("y", "x"), getattr(self, name), text) for name, text in texts.items()}
        known = {name: layer for name, layer in layers.items() if layer[1] is not None}
        return xarray.Dataset(known, {name: (name, at, place_attributes(name, None)) for name, at in axes.items()})

    def plot(self, axes: Any = None) -> Any:
        """Draw the heights of the map; returns the axes.

        Args:
            axes: axes of Matplotlib; None: those of a new figure.
        """
        (rows, cols), edge = self.height.shape, self.cell_size / 2
        left, lower = self.east - edge, self.north - edge
        extent = (left, left + cols * self.cell_size, lower, lower + rows * self.cell_size)
        names = ("distance east (m)", "distance north (m)", "height above the sphere (m)")
        return draw_array(self.height, extent, names, axes=axes)


class CellMap(ABC):
    """A map that grows with the ground that is seen, in tiles of TILE × TILE cells.

    Its memory is proportional to the area seen, not to the number of dwells. A rectangle of cells is given by row and
    column of its first and of its last cell, counted from the map's origin, shape (2, 2).

    Attributes:
        cell_size: side of a cell, m.
        max_cells: greatest number of cells of the rectangle around all that was seen.
        contradiction: message on the stated course of the shared error, from the dwell on that contradicts it; shared
            errors do not average out in the map then. None: there is no contradiction.
    """

    def __init__(self, cell_size: float, max_cells: int, shared: SharedError = LASTING) -> None:
        """An empty map; `shared`: course of the height error that all pixels of a dwell share."""
        self.cell_size = cell_size
        self.max_cells = max_cells
        self._shared = shared
        self._offsets = OffsetTest(shared)
        self.contradiction: str | None = None
        self._corners: I64 | None = None  # the rectangle around all that was seen

    @abstractmethod
    def add(self, field: HeightField, aperture: ApertureState, time: float = 0.0) -> None:
        """Enter the heights of a dwell seen from `aperture` at a time, s; if they are refused, the map does not change.

        Time matters where a course of the shared error is stated; dwells of one time share all of it.

        Raises:
            Rejected: the map would have more than `max_cells` cells.
        """

    def settle(self) -> None:  # noqa: B027 (most maps are final at any time)
        """Make the map final: all dwells have been entered."""

    def relief(self) -> Relief | None:
        """Return the map up to now; None if nothing was seen yet."""
        return None if self._corners is None else self._relief(self._corners)

    def _compare_offsets(self, cells: I64, heights: F64, time: float) -> None:
        """Enter a dwell into the test of what is stated; arguments as in `OffsetTest.add`."""
        self._offsets.add(cells, heights, time)
        self.contradiction = self.contradiction or self._offsets.contradiction
        if self.contradiction:
            self._shared = LASTING

    @abstractmethod
    def _relief(self, corners: I64) -> Relief:
        """The cells of the rectangle around all that was seen."""

    def _grown(self, seen: I64) -> I64:
        """The rectangle around all that was seen and the rectangle `seen`.

        Raises:
            Rejected: the rectangle has more than `max_cells` cells.
        """
        corners = seen if self._corners is None else hull(self._corners, seen)
        rows, cols = (corners[1] - corners[0] + 1).tolist()
        if rows * cols > self.max_cells:
            raise Rejected(
                "map full",
                f"With these heights the map would have {rows} x {cols} cells of {self.cell_size:g} m, more than the "
                f"{self.max_cells} that max_cells allows.",
            )
        return corners


def hull(one: I64, other: I64) -> I64:
    """The smallest rectangle of cells around two."""
    return np.stack([np.minimum(one[0], other[0]), np.maximum(one[1], other[1])])


def cell_numbers(row: I64, col: I64) -> I64:
    """One number for each row and column of cells, which are counted from the map's origin."""
    most_cells = 2**31  # more than lie between the map's origin and any cell, along either axis
    return row * most_cells + col


def tiles_of(cells: I64) -> Iterator[tuple[tuple[int, int], Index]]:
    """Row and column of each tile that has some of the cells, shape (n, 2), and the numbers of these in `cells`."""
    rows, cols = (cells // TILE).T
    if (rows == rows[:1]).all() and (cols == cols[:1]).all():  # a dwell is often smaller than a tile
        groups = [np.arange(len(rows))]
    else:
        most_tiles = 2**30  # more than lie between the map's origin and any cell, along either axis
        number = rows * (2 * most_tiles) + cols
        order = np.argsort(number, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    for there in groups:
        if there.size:
            yield (int(rows[there[0]]), int(cols[there[0]])), there
