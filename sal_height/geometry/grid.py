"""Pixel grids of images in the map frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.geometry.frames import ApertureState
from sal_height.numeric import F64, Complex, ShortRepr, arrays_of, joined_bytes


@dataclass(frozen=True, eq=False)
class Grid(ShortRepr):
    """Pixel centres of an image in a plane of the map frame; the same content as sal_height_msgs/ImageGrid.

    Attributes:
        origin: centre of pixel (0, 0), shape (3,), m.
        row_direction: unit vector of growing row (range), shape (3,).
        col_direction: unit vector of growing col (along the flight), shape (3,).
        row_spacing: spacing of rows, m.
        col_spacing: spacing of columns, m.
        rows: number of rows.
        cols: number of columns.
    """

    origin: F64
    row_direction: F64
    col_direction: F64
    row_spacing: float
    col_spacing: float
    rows: int
    cols: int

    def __reduce__(self) -> tuple[Any, ...]:
        """To be sent to another process, with all vectors as one object."""
        vectors = joined_bytes((self.origin, self.row_direction, self.col_direction))
        return _grid_of, (vectors, self.row_spacing, self.col_spacing, self.rows, self.cols)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Edges of the image in its plane from the outer corner of pixel (0, 0), m: first and last column, and row."""
        return 0.0, self.cols * self.col_spacing, 0.0, self.rows * self.row_spacing

    @property
    def col_step(self) -> F64:
        """Step from a column to the next, m, shape (3,)."""
        return self.col_spacing * self.col_direction

    @property
    def middle(self) -> F64:
        """Middle of the image, m, shape (3,)."""
        return self.points((self.rows - 1) / 2, (self.cols - 1) / 2)

    def points(self, row: npt.ArrayLike, col: npt.ArrayLike) -> F64:
        """Return the positions (m) of fractional pixel indices, shape (..., 3)."""
        down = np.asarray(row, dtype=np.float64)[..., None] * (self.row_spacing * self.row_direction)
        along = np.asarray(col, dtype=np.float64)[..., None] * (self.col_spacing * self.col_direction)
        return self.origin + down + along

    def pixels(self) -> F64:
        """Return the positions (m) of all pixel centres, shape (rows, cols, 3)."""
        return self.points(np.arange(self.rows)[:, None], np.arange(self.cols)[None, :])


def pixels_at(across: F64, along: F64, aperture: ApertureState, grid: Grid) -> tuple[F64, F64]:
    """Return the fractional rows and columns of points at distances `across` from the track and `along` it (m).

    `across` is the distance from the track, `along` the coordinate along it from the aperture. The columns of a strip
    need not run along the track: `along` selects a line of pixels, and `across` one point of that line.
    """
    # Pixels with the coordinate `along` lie on a line: col = col_at_first_row - skew * row.
    start, down = grid.origin - aperture.position, grid.row_spacing * grid.row_direction
    side = grid.col_spacing * grid.col_direction
    skew = float(down @ aperture.direction) / float(side @ aperture.direction)
    col_at_first_row = (along - start @ aperture.direction) / (side @ aperture.direction)
    # Along that line |pixel - position|^2 is a quadratic in row; its greater root is the point sought.
    line = down - skew * side
    square, slope = line @ line, start @ line + col_at_first_row * (side @ line)
    beyond = start @ start + col_at_first_row * (2 * start @ side + col_at_first_row * (side @ side))
    row = (np.sqrt(slope**2 - square * (beyond - across**2 - along**2)) - slope) / square
    return row, col_at_first_row - skew * row


def ranges_of_phase(grid: Grid, aperture: ApertureState) -> F64:
    """Distances R (m) of the pixels of an image; the phase of a response changes over pixels by 4 pi R / wavelength.

    They are those from the middle of the aperture. A sliding aperture moves with the columns, and every column is abeam
    of it: along a row the phase of a response is constant, even where wind drifts the antenna away from the pixels. So
    the distances are those of the middle column, whose aperture is at `aperture`.

    Args:
        grid: positions of the pixels.
        aperture: state of the platform with which the image was made.

    Returns:
        Shape (rows, cols), or (rows, 1) if the aperture slides.
    """
    pixels = grid.points(np.arange(grid.rows), (grid.cols - 1) / 2)[:, None] if aperture.sliding else grid.pixels()
    return np.asarray(np.linalg.norm(pixels - aperture.position, axis=-1))


def without_range_phase(image: Complex, grid: Grid, aperture: ApertureState, wavelength: float) -> Complex:
    """Multiply an image by exp(-j 4 pi R / wavelength), R being the distances of `ranges_of_phase`.

    A point's image has the phase 4 pi (R of the pixel - R of the point) / wavelength, which changes from pixel to
    pixel, faster with distance from the middle of the image. Without it the point's response is centred on spatial
    frequency 0 and can be interpolated.

    Args:
        image: complex pixels, shape (rows, cols).
        grid: positions of the pixels.
        aperture: state of the platform with which the image was made.
        wavelength: wavelength of the carrier, m.

    Returns:
        complex128 image, shape (rows, cols).
    """
    return image * np.exp(-4j * np.pi / wavelength * ranges_of_phase(grid, aperture))


def _grid_of(vectors: bytes, row_spacing: float, col_spacing: float, rows: int, cols: int) -> Grid:
    origin, row_direction, col_direction = arrays_of(vectors, ((3,), (3,), (3,)))
    return Grid(origin, row_direction, col_direction, row_spacing, col_spacing, rows, cols)
