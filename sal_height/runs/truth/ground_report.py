"""The ground from all dwells of a bag, and its errors against the terrain of a simulated flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.imaging import image_beams
from sal_height.io import or_null
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, Bool, error_statistics, mean_of
from sal_height.relief import GroundEstimate, GroundKind, GroundMap, fine_cell_size, ground_spacings
from sal_height.runs.truth.surface_report import COVERAGE
from sal_height.simulation import SimulatedFlight, VisibleSurface
from sal_height.simulation.lit_surfaces import ground_cells

MAX_CELLS = 4_000_000
"""Greatest number of cells of an estimate, as of the parameter of ground_mapper."""


def ground_of(images: Sequence[HeightImage]) -> GroundEstimate | None:
    """Estimate the ground from all height images of one estimator at once; None: they have no surface.

    Raises:
        Rejected: the ground seen has more than MAX_CELLS cells.
    """
    fields = [messages.field_from_message(image) for image in images]
    grid = fields[0].grid
    ground = GroundMap(fine_cell_size(grid), max(ground_spacings(grid)), MAX_CELLS)
    for field, image in zip(fields, images, strict=True):
        ground.enter(field, messages.aperture_from_message(image.aperture))
    ground.settle()
    return ground.estimate()


@dataclass(frozen=True, eq=False)
class TrueGround:
    """The terrain in the cells of an estimate; arrays of its shape (rows, cols).

    Attributes:
        height: height of the terrain, m; NaN outside the scene and the images.
        lit: cells that are lit and inside the array in some dwell.
        shadow: cells that are inside the array in some dwell, and lit in none.
    """

    height: F64
    lit: Bool
    shadow: Bool


def true_ground(
    estimate: GroundEstimate,
    images: Sequence[HeightImage],
    flight: SimulatedFlight,
    surfaces: Mapping[int, VisibleSurface],
) -> TrueGround:
    """The terrain of a simulated flight in the cells of an estimate.

    Args:
        estimate: estimate of the ground.
        images: images from which it was made.
        flight: the flight.
        surfaces: lit surfaces of each dwell.
    """
    height, lit, inside = (np.full(estimate.height.shape, value) for value in (np.nan, False, False))
    first = np.floor(np.array([estimate.north, estimate.east]) / estimate.cell_size).astype(np.intp)
    for image in images:
        grid, aperture = messages.grid_from_message(image.grid), messages.aperture_from_message(image.aperture)
        beams = image_beams(flight.sensor, messages.recorded_window(image.provenance, "azimuth"))
        surface, side = surfaces[image.dwell], flight.sensor.look_side
        cells = ground_cells(flight.scene, surface, aperture, grid, beams, side, estimate.cell_size)
        place = cells.number - first
        there = np.all((place >= 0) & (place < np.array(height.shape)), axis=1)
        at = tuple(place[there].T)
        height[at] = cells.height[there]
        lit[at] |= (cells.lit & cells.inside)[there]
        inside[at] |= cells.inside[there]
    return TrueGround(height, lit, inside & ~lit)


def ground_statistics(estimate: GroundEstimate, truth: TrueGround, tolerance: float) -> dict[str, Any]:
    """Part `ground` of a report: how much of the lit ground is known, and the errors of measured and other heights.

    `right`: fraction of the lit cells with a height right to `tolerance` (m); `lit` and `shadow`: fractions of cells by
    what their heights rest on. The error of each published height is that from the terrain in the middle of its cell,
    next to an edge, too, which sigma has to allow for.
    """
    error = estimate.height - truth.height
    kinds = {kind.name.lower(): estimate.kind == kind for kind in GroundKind}
    measured, interpolated = (kinds[kind.name.lower()] for kind in (GroundKind.MEASURED, GroundKind.INTERPOLATED))
    return {
        "cell_m": estimate.cell_size,
        "tolerance_m": tolerance,
        "right": or_null(mean_of((np.abs(error) < tolerance)[truth.lit])),
        "lit": {name: or_null(mean_of(cells[truth.lit])) for name, cells in kinds.items()},
        "shadow": {name: or_null(mean_of(cells[truth.shadow])) for name, cells in kinds.items()},
        "measured": _errors(error[measured], estimate.sigma[measured]),
        "interpolated": _errors(error[interpolated], estimate.sigma[interpolated]),
    }


def _errors(error: F64, sigma: F64) -> dict[str, Any]:
    known = np.isfinite(error)
    found = error_statistics(error[known], sigma[known])
    return {"cells": found.count, **found.in_metres(COVERAGE)}
