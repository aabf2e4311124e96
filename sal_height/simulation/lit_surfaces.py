"""True height images of a scene: the mean of each pixel, and the lit surfaces in it, with layover and shadow.

Independent of the estimators: scatterers of the lit terrain are sorted into pixels by range and Doppler, and those of a
pixel into surfaces by their elevation. Scatterers lie so densely along the terrain that a gap between two elevations
means two surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import maximum_filter

from sal_height.beams import Beams
from sal_height.geometry import ApertureState, Grid, angles_of, aperture_at, pixels_at, sphere_coordinates, sphere_point
from sal_height.numeric import F64, Bool, Index
from sal_height.simulation.scene import Scene, VisibleSurface

CONNECTED = 0.1
"""Widest gap between the elevations of scatterers of one surface, in beamwidths: a quarter of the resolution.

Scatterers on terrain are at most half a range cell apart across the line of sight.
"""

NEIGHBOUR_SHARE = 0.1
"""Power with which a scatterer counts in a pixel that it misses by less than the reach of the pixel.

Between -4 dB at the edge of a pixel and the first null of its response.
"""


@dataclass(frozen=True, eq=False)
class LitSurfaces:
    """The lit surfaces in each pixel, that with the most received power first; NaN where there are no further ones.

    Attributes:
        height: height of the surface in the pixel, m, shape (surfaces, rows, cols): that of the plane through its
            scatterers, weighted by their power, at the given range and Doppler; in their middle, the mean.
        elevation: mean elevation of the scatterers with the same weights, rad, same shape.
        spread: standard deviation of their elevations with the same weights, rad, same shape.
        power: power of its scatterers, per resolution cell; 1 for brightness 1; same shape.
        received: power that the array receives of it over that of the strongest surface in the pixel, same shape.
        inside: True where the elevation is between the first boresight of the array and the last, same shape.
        rise: rise of the plane through its scatterers along the flight, at one range, m/m, same shape.
        lowest: height of the lowest of its scatterers over that plane, 0 or less, m, same shape.
        highest: height of the highest of its scatterers over that plane, m, same shape.
    """

    height: F64
    elevation: F64
    spread: F64
    power: F64
    received: F64
    inside: Bool
    rise: F64
    lowest: F64
    highest: F64

    def middle(self, count: int) -> LitSurfaces:
        """Those of that number of columns in the middle."""
        first = (self.height.shape[-1] - count) // 2
        return LitSurfaces(*(getattr(self, one.name)[..., first : first + count] for one in fields(self)))

    @property
    def counted(self) -> Bool:
        """True for surfaces inside the array with a tenth of the power of the strongest in the pixel, or more."""
        return (self.received >= 0.1) & self.inside

    @property
    def count(self) -> Index:
        """Number of these in each pixel, shape (rows, cols)."""
        return np.count_nonzero(self.counted, axis=0)

    @property
    def mean_height(self) -> F64:
        """Mean height of all surfaces in the pixel, weighted by the power received of them, m, shape (rows, cols)."""
        with np.errstate(invalid="ignore"):
            return np.nansum(self.received * self.height, axis=0) / np.nansum(self.received, axis=0)

    @property
    def shadow(self) -> Bool:
        """True if neither the pixel nor one of its eight neighbours contains a scatterer, shape (rows, cols)."""
        return ~maximum_filter(np.isfinite(self.height[0]), size=3, mode="nearest")


def lit_surfaces(
    surface: VisibleSurface,
    aperture: ApertureState,
    grid: Grid,
    cell: tuple[float, float],
    reach: tuple[float, float],
    beams: Beams,
    connected: float = CONNECTED,
    seen: F64 | None = None,
) -> LitSurfaces:
    """Surfaces in the pixels of a height image.

    A height image publishes points at the range and Doppler of the power in their looks, not at those of the middle of
    a pixel. On a slope the ground there has another height.

    Args:
        surface: lit scatterers.
        aperture: aperture from which range and Doppler are measured.
        grid: pixels of the height image, in the slant plane.
        cell: unweighted resolution in range and azimuth, m.
        reach: distance in range and azimuth from the edge of a pixel to the first null of its response, m.
        beams: beams of the detectors; scatterers outside them are not seen.
        connected: widest gap between the elevations of scatterers of one surface, beamwidths; wider than the spacing of
            the layers of a scene with an extent.
        seen: points of the range and Doppler to which heights belong, in map, m, shape (rows, cols, 3); where they are
            NaN, and for None, heights belong to the middle of their scatterers.
    """
    places = np.stack(_places(surface.positions, aperture, grid), axis=-1)
    pixel, scatterer, share = _members(places, grid, reach)
    # Scatterers of a pixel in the order of their elevations; a new surface starts after each gap.
    order = np.lexsort((surface.elevation[scatterer], pixel))
    pixel, scatterer, share = pixel[order], scatterer[order], share[order]
    weight, elevation = share * surface.power[scatterer], surface.elevation[scatterer]
    starts = (np.diff(pixel, prepend=-1) > 0) | (np.diff(elevation, prepend=0.0) > connected * beams.beamwidth)
    label = np.cumsum(starts) - 1

    def total(values: F64) -> F64:
        return np.bincount(label, values, np.count_nonzero(starts)).astype(np.float64)

    power = total(weight)
    mean = total(weight * elevation) / power
    spread = np.sqrt(total(weight * (elevation - mean[label]) ** 2) / power)
    height = total(weight * surface.heights[scatterer]) / power
    place = places[scatterer]
    middle = np.stack([total(weight * part) for part in place.T], axis=-1) / power[:, None]
    off = place - middle[label]
    higher = surface.heights[scatterer] - height[label]
    slope, extent = _plane(off, higher, weight, label)
    above, start = higher - np.sum(slope[label] * off, axis=-1), np.flatnonzero(starts)
    lowest, highest = (bound.reduceat(above, start) if len(start) else above for bound in (np.minimum, np.maximum))
    if seen is not None:
        asked = np.stack(_places(seen, aperture, grid), axis=-1).reshape(-1, 2)[pixel[starts]]
        height += np.sum(slope * np.clip(np.nan_to_num(asked - middle), -extent, extent), axis=-1)
    received = power * beams.power(mean, total(weight * surface.squint[scatterer]) / power)
    inside = (mean >= beams.span[0]) & (mean <= beams.span[1])
    # Surfaces of a pixel in the order of the power received of them.
    of_pixel = pixel[starts]
    order = np.lexsort((-received, of_pixel))
    first = np.flatnonzero(np.diff(of_pixel[order], prepend=-1) > 0)
    rank = np.arange(len(order)) - np.repeat(first, np.diff(first, append=len(order)))
    shape = max(1, int(rank.max(initial=0)) + 1), grid.rows * grid.cols

    def placed(values: F64) -> F64:
        result = np.full(shape, np.nan)
        result[rank, of_pixel[order]] = values[order]
        return result.reshape(-1, *grid.shape)

    strength = placed(received)
    return LitSurfaces(
        height=placed(height),
        elevation=placed(mean),
        spread=placed(spread),
        power=placed(power) / _cells(grid, cell, reach),
        received=strength / strength[0],
        inside=placed(inside.astype(np.float64)) == 1,
        rise=placed(slope[:, 1]) / grid.col_spacing,
        lowest=placed(lowest),
        highest=placed(highest),
    )


def _plane(off: F64, higher: F64, weight: F64, label: Index) -> tuple[F64, F64]:
    """Slope of the plane through the scatterers of each surface, by row and column, m, and its extent.

    The extent is that of an even surface of the same variance, in rows and columns. Both have the shape (surfaces, 2).

    Args:
        off: row and column of scatterers from the middle of their surface, (scatterers, 2).
        higher: height of scatterers above the mean of their surface, m, (scatterers,).
        weight: weight of the scatterers, (scatterers,).
        label: number of their surface, (scatterers,).
    """

    def total(values: F64) -> F64:
        return np.bincount(label, weight * values).astype(np.float64)

    square = np.stack([np.stack([total(one * other) for one in off.T], axis=-1) for other in off.T], axis=-1)
    along = np.stack([total(one * higher) for one in off.T], axis=-1)[..., None]
    slope = np.linalg.pinv(square, hermitian=True) @ along
    reach = np.sqrt(3 * np.diagonal(square, axis1=1, axis2=2) / total(np.ones(len(off)))[:, None])
    return slope[..., 0], reach


def _places(positions: F64, aperture: ApertureState, grid: Grid) -> tuple[F64, F64]:
    """Row and column of positions (..., 3) by their range and Doppler."""
    sight = positions - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.maximum(np.sum(sight**2, axis=-1) - along**2, 0.0))
    return pixels_at(across, along, aperture, grid)


def _members(places: F64, grid: Grid, reach: tuple[float, float]) -> tuple[Index, Index, F64]:
    """Pairs of pixel and scatterer: number of the pixel, of the scatterer, and fraction of its power.

    A scatterer has its whole power in its own pixel, and NEIGHBOUR_SHARE of it in those that it misses by
    less than its reach (m, in range and azimuth). `places` are rows and columns, (scatterers, 2).
    """
    row, col = places.T
    near_row, near_col = np.rint(row), np.rint(col)
    most = 0.5 + np.array(reach) / (grid.row_spacing, grid.col_spacing)
    parts = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            at_row, at_col = near_row + down, near_col + right
            belongs = (np.abs(row - at_row) <= most[0]) & (np.abs(col - at_col) <= most[1])
            belongs &= (at_row >= 0) & (at_row < grid.rows) & (at_col >= 0) & (at_col < grid.cols)
            which = np.flatnonzero(belongs)
            number = (at_row[which] * grid.cols + at_col[which]).astype(np.intp)
            share = 1.0 if down == right == 0 else NEIGHBOUR_SHARE
            parts.append((number, which, np.full(len(which), share)))
    pixel, scatterer, shares = (np.concatenate(entries) for entries in zip(*parts, strict=True))
    return pixel, scatterer, shares


def _cells(grid: Grid, cell: tuple[float, float], reach: tuple[float, float]) -> float:
    """Resolution cells from which a pixel has power, neighbours by their fraction."""
    own = grid.row_spacing * grid.col_spacing
    reached = (grid.row_spacing + 2 * reach[0]) * (grid.col_spacing + 2 * reach[1])
    return (own + NEIGHBOUR_SHARE * (reached - own)) / (cell[0] * cell[1])


@dataclass(frozen=True, eq=False)
class GroundCells:
    """Cells of the ground whose centres fall into an image by range and Doppler; arrays of one entry per cell.

    Attributes:
        number: row (north) and column (east) of the cell, counted from the map's origin, shape (cells, 2); its centre
            is at (number + 0.5) cells.
        height: height of the terrain at the centre, m.
        lit: True where the sensor sees the centre over everything nearer.
        inside: True where the elevation of the centre is between the first boresight of the array and the last.
        pixel: row and column of the image's pixel that it falls into, shape (cells, 2).
    """

    number: Index
    height: F64
    lit: Bool
    inside: Bool
    pixel: Index


def ground_cells(
    scene: Scene,
    surface: VisibleSurface,
    aperture: ApertureState,
    grid: Grid,
    beams: Beams,
    look_side: int,
    size: float,
) -> GroundCells:
    """Cells of the ground in an image.

    Args:
        scene: scene with the ground.
        surface: lit part of it; only cells between its outermost scatterers are tested.
        aperture: aperture from which range and Doppler are measured.
        grid: pixels of the image.
        beams: beams of the detectors.
        look_side: look side, +1 right, -1 left.
        size: side of a cell, m.
    """
    east, north, _ = sphere_coordinates(surface.positions)
    rows, cols = (np.arange(np.floor(v.min() / size), np.ceil(v.max() / size)).astype(np.intp) for v in (north, east))
    centres = (rows + 0.5) * size
    # Vertical cuts through the terrain, at its nodes and at the centres of cells, ordered outwards.
    outwards = -look_side * int(np.sign(aperture.direction[0]))
    places = np.union1d(scene.north, centres)[::outwards]
    there = np.broadcast_to((cols[:, None] + 0.5) * size, (len(cols), len(places)))
    height = scene.heights(there, places)
    points = sphere_point(there, places, height)
    _, elevation, _ = angles_of(points, aperture_at(points, aperture), look_side)
    lit = elevation >= np.maximum.accumulate(np.nan_to_num(elevation, nan=-np.pi), axis=1)
    # Of these, the centres of cells, and their pixels.
    index = np.searchsorted(places * outwards, centres * outwards)
    sight = points[:, index] - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.maximum(np.sum(sight**2, axis=-1) - along**2, 0.0))
    pixel = np.stack(pixels_at(across, along, aperture, grid), axis=-1)
    kept = np.all((pixel > -0.5) & (pixel < np.array(grid.shape) - 0.5), axis=-1)
    number = np.stack(np.broadcast_arrays(rows, cols[:, None]), axis=-1)
    inside = (elevation >= beams.span[0]) & (elevation <= beams.span[1])
    return GroundCells(
        number=number[kept],
        height=height[:, index][kept],
        lit=lit[:, index][kept],
        inside=inside[:, index][kept],
        pixel=np.rint(pixel[kept]).astype(np.intp),
    )


@dataclass(frozen=True)
class Truth:
    """The true content of a height image; arrays of shape (rows, cols).

    Attributes:
        height: mean height of the scatterers in the pixel, weighted by the power that the array receives of them, m;
            NaN without any.
        elevation: mean elevation of the scatterers with the same weights, rad.
        power: power of a scatterer at that elevation with the same received power, per resolution cell;
            1 for brightness 1.
        single: True where they act as one scatterer: elevation is a function of range, as on sloping ground and unlike
            in layover, with a standard deviation about its regression on range below 0.1 beamwidths.
    """

    height: F64
    elevation: F64
    power: F64
    single: Bool


def truth_image(
    surface: VisibleSurface, aperture: ApertureState, grid: Grid, resolution_cell: float, beams: Beams
) -> Truth:
    """Truth in the pixels of a height image, by counting the scatterers in each.

    Args:
        surface: lit scatterers.
        aperture: aperture from which range and Doppler are measured.
        grid: pixels of the height image, in the slant plane.
        resolution_cell: unweighted range resolution times azimuth resolution, m^2, to which powers refer.
        beams: beams of the detectors; scatterers outside them are not seen.
    """
    sight = surface.positions - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.maximum(np.sum(sight**2, axis=-1) - along**2, 0.0))
    row, col = (np.rint(index).astype(int) for index in pixels_at(across, along, aperture, grid))
    inside = (row >= 0) & (row < grid.rows) & (col >= 0) & (col < grid.cols)
    pixel = row[inside] * grid.cols + col[inside]
    seen_at = surface.elevation[inside]
    gain = beams.power(seen_at, surface.squint[inside])
    received = surface.power[inside] * gain

    def total(values: F64) -> F64:
        return np.bincount(pixel, received * values, grid.rows * grid.cols).astype(np.float64).reshape(grid.shape)

    with np.errstate(divide="ignore", invalid="ignore"):
        power = total(np.ones(len(pixel)))
        elevation = total(seen_at) / power
        off_elevation = seen_at - elevation.ravel()[pixel]
        off_range = across[inside] - (total(across[inside]) / power).ravel()[pixel]
        regression = total(off_elevation * off_range) ** 2 / np.maximum(total(off_range**2), np.finfo(float).tiny)
        spread = np.sqrt(np.maximum(total(off_elevation**2) - regression, 0.0) / power)
        height = total(surface.heights[inside]) / power
        per_gain = power / (total(gain) / power)
    cells = grid.row_spacing * grid.col_spacing / resolution_cell
    return Truth(height, elevation, per_gain / cells, spread < 0.1 * beams.beamwidth)
