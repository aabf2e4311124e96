"""Height images against the truth of a simulated scene: errors, bounds, and the mosaic of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.beams import Beams
from sal_height.geometry import ApertureState, Grid, pixels_at
from sal_height.numeric import F64, Bool
from sal_height.simulation.scene import VisibleSurface


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
