"""The heights of a bag in one map, as a Cloud-Optimized GeoTIFF."""

from __future__ import annotations

from pathlib import Path

from sal_height.errors import UserError
from sal_height.exports.heights import RecordedHeights
from sal_height.relief import ProjectedAxes, ReliefMap, check_geotiff, fitting_cell_size, write_geotiff


def write_map(heights: RecordedHeights, path: Path, cell_size: float = 0.0) -> tuple[int, int]:
    """Write the map of the scatterers of all dwells, as node relief_mapper makes it; returns its rows and columns.

    Args:
        heights: heights of a bag.
        path: file to write.
        cell_size: side of a cell, m; 0: that of the pixels.

    Raises:
        UserError: the package rasterio is not installed, there is no height, the map has too many cells, or the file
            cannot be written.
    """
    check_geotiff(path)
    axes = ProjectedAxes.around(heights.projection) if heights.projection else None
    grown, last_ns = None, 0
    most_cells = 100_000_000  # greatest number of cells of a map: 400 MB for each of its layers
    for dwell in heights.dwells("cog"):
        field, aperture = axes.field(dwell.field, dwell.aperture) if axes else (dwell.field, dwell.aperture)
        grown = grown or ReliefMap(cell_size or fitting_cell_size(field.grid, aperture), most_cells)
        grown.add(field)
        last_ns = max(last_ns, dwell.stamp_ns)
    relief = grown.relief() if grown else None
    if relief is None:
        raise UserError(f"Topic {heights.topic} of bag {heights.reader.path} has no valid height.")
    placed = axes.relief(relief) if axes else relief
    write_geotiff(path, placed, heights.projection, last_ns, heights.facts)
    rows, cols = placed.height.shape
    return rows, cols
