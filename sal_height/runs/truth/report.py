"""Accuracy of a run: errors of every estimator against the true heights and ground, in ground coordinates."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.errors import Rejected, UserError
from sal_height.graph.catalogue import HEIGHTS, TRACKER
from sal_height.graph.reporting import PRESET, SEED
from sal_height.imaging import image_beams
from sal_height.io import or_null
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, Bool, error_statistics, mean_of
from sal_height.relief import GroundEstimate, GroundKind, GroundMap, fine_cell_size, ground_spacings
from sal_height.runs.truth.surface_report import (
    COVERAGE,
    TOLERANCE_BEAMWIDTHS,
    Judged,
    height_beamwidth,
    judged,
    surface_statistics,
)
from sal_height.simulation import SimulatedFlight, VisibleSurface, flight_of, parse_preset
from sal_height.simulation.lit_surfaces import ground_cells

_LOG = logging.getLogger(__name__)

MAX_CELLS = 4_000_000
"""Greatest number of cells of an estimate, as of the parameter of ground_mapper."""


@dataclass(frozen=True)
class Accuracy:
    """Heights with the truth, by prefix of the topics of their estimator.

    Attributes:
        heights: comparisons of the estimators with any height.
        grounds: estimate of the ground and the terrain, of estimators with any height but the tracked ones.
        statistics: entries of report.json on each height node of the run.
    """

    heights: Mapping[str, Judged]
    grounds: Mapping[str, tuple[GroundEstimate, TrueGround]]
    statistics: Mapping[str, Mapping[str, Any]]


def recorded_flight(reader: BagReader) -> SimulatedFlight | None:
    """The simulated flight that a bag is from; None if it is from no simulation, or from one that cannot be made again.

    It cannot be if, for example, the elevation model of its scene is no longer there.
    """
    if PRESET not in reader.custom_data:
        return None
    try:
        preset = parse_preset(json.loads(reader.custom_data[PRESET]), f"in bag {reader.path}")
        return flight_of(preset, int(reader.custom_data[SEED]))
    except (UserError, ValueError, KeyError):
        return None


def read_accuracy(bag: Path, flight: SimulatedFlight, stages: Sequence[str]) -> Accuracy:
    """Compare the heights of a flight in a bag with the truth, those of the height nodes among `stages`."""
    wanted = [HEIGHTS[name] for name in stages if name in HEIGHTS]
    images = {prefix: found for prefix, found in read_images(bag).items() if prefix in wanted}
    surfaces = {dwell: flight.surface(dwell) for dwell in {one.dwell for found in images.values() for one in found}}
    heights = {prefix: judged(found, flight, surfaces) for prefix, found in images.items()}
    grounds = {}
    for prefix in images.keys() - {HEIGHTS[TRACKER]}:
        try:
            estimate = ground_of(images[prefix])
        except Rejected as error:  # heights are so far apart that it has too many cells
            _LOG.warning("The ground of %s is not reported: %s", prefix, error)
            continue
        if estimate:
            grounds[prefix] = estimate, true_ground(estimate, images[prefix], flight, surfaces)
    numbers = {}
    for prefix in wanted:
        numbers[prefix] = surface_statistics(heights.get(prefix))
        if prefix in grounds:
            tolerance = TOLERANCE_BEAMWIDTHS * height_beamwidth(flight)
            numbers[prefix]["ground"] = ground_statistics(*grounds[prefix], tolerance)
    with_heights = {prefix: one for prefix, one in heights.items() if len(one.comparison.errors.sigma)}
    return Accuracy(with_heights, grounds, numbers)


def read_images(bag: Path) -> dict[str, list[HeightImage]]:
    """The height images in a bag by the prefix of their estimator's topics; estimators without any are left out."""
    reader = BagReader(bag)
    images: dict[str, list[HeightImage]] = {}
    topics = [topic.name for topic in reader.topics.values() if topic.type_name == HEIGHT_TYPE]
    for message in reader.messages(topics) if topics else ():
        image = reader.decode(message.type_name, message.cdr)
        images.setdefault(image.estimator, []).append(image)
    return {prefix: images[prefix] for prefix in HEIGHTS.values() if prefix in images}


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
    """The terrain of a simulated flight in the cells of an estimate."""
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
    found: dict[str, Any] = {
        "cell_m": estimate.cell_size,
        "tolerance_m": tolerance,
        "right": or_null(mean_of((np.abs(error) < tolerance)[truth.lit])),
        "lit": {name: or_null(mean_of(cells[truth.lit])) for name, cells in kinds.items()},
        "shadow": {name: or_null(mean_of(cells[truth.shadow])) for name, cells in kinds.items()},
    }
    for name in ("measured", "interpolated"):
        cells = kinds[name] & np.isfinite(error)
        errors = error_statistics(error[cells], estimate.sigma[cells])
        found[name] = {"cells": errors.count, **errors.in_metres(COVERAGE)}
    return found
