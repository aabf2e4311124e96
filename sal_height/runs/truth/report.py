"""Accuracy of a run: errors of every estimator against the true heights and ground, in ground coordinates."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.beams import column_squint
from sal_height.elevation import speckle_crb
from sal_height.engine.tracker import PREFIX
from sal_height.errors import Rejected, UserError
from sal_height.geometry import sphere_coordinates
from sal_height.graph.catalogue import HEIGHTS, TRACKER
from sal_height.graph.reporting import PRESET, SEED
from sal_height.imaging import azimuth_resolution, image_beams
from sal_height.io import or_null
from sal_height.messages import field_from_message
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, Bool, error_statistics, mean_of
from sal_height.relief import GroundEstimate, GroundKind, GroundMap, fine_cell_size, ground_spacings, height_variance
from sal_height.runs.truth.surface_report import (
    COVERAGE,
    TOLERANCE_BEAMWIDTHS,
    Judged,
    height_beamwidth,
    judged,
    surface_statistics,
)
from sal_height.simulation import SimulatedFlight, VisibleSurface, flight_of, parse_preset, truth_image
from sal_height.simulation.lit_surfaces import ground_cells

_LOG = logging.getLogger(__name__)

BEFORE_BOUND = ("bias_m", "rms_m", "median_m", "s68_m", "sigma_m")

AFTER_BOUND = ("within_1_sigma", "beyond_5_sigma")

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
        # As subscribers see them: a height published with a sigma beyond all bounds is not valid.
        single = any(np.any(field_from_message(one).validity == HeightImage.OK) for one in images.get(prefix, ()))
        numbers[prefix] = statistics(mosaic(images[prefix], flight, surfaces) if single else None)
        if prefix in heights:
            numbers[prefix]["surfaces"] = surface_statistics(heights[prefix])
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


@dataclass(frozen=True)
class Mosaic:
    """Errors of height images in ground cells, each the mean of its pixels weighted by 1 / sigma^2; NaN where unseen.

    Attributes:
        error: estimated minus true height, m, shape (rows, cols); without pixels that have no scatterer.
        sigma: predicted standard deviation, m, with the mean of those that pose and beams leave, which no average
            reduces; of tracked pixels, whose errors are common, that of one.
        bound: Cramer-Rao bound averaged over speckle for all looks in the cell, m.
        single: True where all pixels have a single scatterer.
        valid_share: valid pixels over all pixels of the images.
        two_share: pixels with two separate scatterers, over all pixels.
        ghosts: valid pixels in which there is no scatterer.
    """

    error: F64
    sigma: F64
    bound: F64
    single: Bool
    valid_share: float
    two_share: float
    ghosts: int


@dataclass(frozen=True)
class _Pixels:
    """Valid pixels of height images, one entry each.

    Attributes:
        east: arc distance east of the map origin, m.
        north: arc distance north of the map origin, m.
        height: estimated height, m.
        sigma: predicted standard deviation of the height, m.
        common: part of sigma due to pose and beams, which is common to pixels and dwells, m.
        truth: true height, m; NaN where there is no scatterer.
        bound: Cramer-Rao bound for two looks averaged over speckle, m: 1 / sqrt(information of one look).
        single: True where the pixel has a single scatterer.
    """

    east: F64
    north: F64
    height: F64
    sigma: F64
    common: F64
    truth: F64
    bound: F64
    single: Bool


def mosaic(images: Sequence[HeightImage], flight: SimulatedFlight, surfaces: Mapping[int, VisibleSurface]) -> Mosaic:
    """Combine the height images of one estimator into ground cells, and compare them with the true heights.

    A dwell that a source has repeated is in it once: its errors are the same each time, and no average reduces them.
    """
    once = {image.dwell: image for image in reversed(images)}.values()
    parts = [_pixels(image, flight, surfaces[image.dwell]) for image in once]
    pixels = _Pixels(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Pixels)))
    grid = images[0].grid
    looks = images[0].range_looks * images[0].azimuth_looks
    level_row = grid.row_spacing / np.sin(flight.preset.flight.look_angle_rad)
    cell_pixels = 1.5  # side of a ground cell in pixels on level ground: large enough that few cells stay empty
    step = (cell_pixels * level_row, cell_pixels * grid.col_spacing)
    row_of, col_of = np.rint(pixels.north / step[0]).astype(int), np.rint(pixels.east / step[1]).astype(int)
    first_row, first_col = row_of.min(), col_of.min()
    shape = (row_of.max() - first_row + 1, col_of.max() - first_col + 1)
    cell = (row_of - first_row) * shape[1] + col_of - first_col
    weight = 1 / pixels.sigma**2
    real = np.isfinite(pixels.truth)

    def total(values: F64) -> F64:
        return np.bincount(cell, values, shape[0] * shape[1]).reshape(shape)

    with np.errstate(divide="ignore", invalid="ignore"):
        weights, count = total(weight), total(real.astype(np.float64))
        error = total(np.where(real, weight * (pixels.height - pixels.truth), 0.0)) / total(weight * real)
        information = total(np.where(real, 1 / pixels.bound**2, 0.0)) / count
        own, common = total(weight**2 * (pixels.sigma**2 - pixels.common**2)), total(weight * pixels.common)
        return Mosaic(
            error=error,
            sigma=(total(weight * pixels.sigma) if images[0].estimator == PREFIX else np.sqrt(own + common**2))
            / weights,
            bound=1 / np.sqrt((count * looks - 1) * information),
            single=(total((real & ~pixels.single).astype(np.float64)) == 0) & (count > 0),
            valid_share=_share(images, HeightImage.OK),
            two_share=_share(images, HeightImage.TWO_SCATTERERS),
            ghosts=int(np.count_nonzero(~real)),
        )


def _share(images: Sequence[HeightImage], validity: int) -> float:
    """Fraction of the pixels that have this validity, averaged over the images."""
    return float(np.mean([np.mean(np.asarray(image.validity) == validity) for image in images]))


def statistics(result: Mosaic | None) -> dict[str, Any]:
    """Errors over the cells with a single scatterer; numbers that do not exist (no valid pixel) are None.

    Errors are those of `ErrorStatistics`, and `crb_m` is the mean Cramér-Rao bound averaged over speckle, m. `valid` is
    the fraction of valid pixels, `two_scatterers` that of pixels with the heights of two, `ghost_pixels` the number of
    valid ones without a scatterer. `layover` has the same errors over the other cells, whose pixels have several
    scatterers and were still found valid.
    """
    if result is None:
        none = np.zeros(0)
        return {"valid": 0.0, "two_scatterers": 0.0, "ghost_pixels": 0, **_errors(none, none, none)}
    cells, seen = np.stack([result.error, result.sigma, result.bound]), np.isfinite(result.error)
    return {
        "valid": result.valid_share,
        "two_scatterers": result.two_share,
        "ghost_pixels": result.ghosts,
        **_errors(*cells[:, seen & result.single]),
        "layover": _errors(*cells[:, seen & ~result.single]),
    }


def _errors(error: F64, sigma: F64, bound: F64) -> dict[str, Any]:
    """Entries of the report on errors of cells, their predicted standard deviations and their bounds, all in m."""
    found = error_statistics(error, sigma)
    return {
        "cells": found.count,
        **found.in_metres(BEFORE_BOUND),
        "crb_m": or_null(mean_of(bound)),
        **found.in_metres(AFTER_BOUND),
    }


def _pixels(image: HeightImage, flight: SimulatedFlight, visible: VisibleSurface) -> _Pixels:
    """The valid pixels of a height image, with the truth."""
    grid, aperture = messages.grid_from_message(image.grid), messages.aperture_from_message(image.aperture)
    sensor, track = flight.sensor, flight.preset.flight
    cell = sensor.range_resolution * azimuth_resolution(sensor, aperture, track.slant_range_m)
    beams = image_beams(sensor, messages.recorded_window(image.provenance, "azimuth"))
    truth = truth_image(visible, aperture, grid, cell, beams)
    squint = column_squint(grid, aperture, sensor.beams, sensor.look_side)
    height_slope = track.slant_range_m * np.sin(track.look_angle_rad)  # of height over elevation, m/rad
    with np.errstate(invalid="ignore"):  # where nothing stands
        cnr = 10 ** (flight.preset.cnr_db / 10) * truth.power
        bound = height_slope * speckle_crb(beams, truth.elevation, squint, cnr, 2)

    field = messages.field_from_message(image)
    valid = field.validity == HeightImage.OK
    surface = field.first
    positions, sigma, covariance = surface.positions[valid], surface.sigma[valid], surface.common_covariance
    common = np.zeros_like(sigma) if covariance is None else np.sqrt(height_variance(covariance[valid], positions))
    east, north, height = sphere_coordinates(positions)
    return _Pixels(
        east,
        north,
        height,
        sigma,
        np.minimum(common, sigma),
        truth.height[valid],
        bound[valid],
        truth.single[valid],
    )


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
