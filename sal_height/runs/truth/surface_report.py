"""Errors of published surfaces as report.json, tables and pictures state them: by kind of pixel, and the lit ground.

Nothing that is published remains uncounted: each surface of each pixel with a height is in one of the kinds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.beams import Beams, column_squint
from sal_height.elevation import USABLE, Validity, speckle_crb
from sal_height.geometry import ApertureState
from sal_height.imaging import Processing, azimuth_resolution, image_beams
from sal_height.io import or_null
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, Bool, Index, error_statistics, fraction_of, mean_of
from sal_height.progress import Bar
from sal_height.relief import HeightField
from sal_height.runs.truth.comparison import (
    FOUND_ORDERS,
    NO_SURFACES,
    TRUE_ORDERS,
    PublishedErrors,
    SurfaceComparison,
    compare,
    joined_comparisons,
    reach_along,
    true_order,
)
from sal_height.simulation import SimulatedFlight, VisibleSurface
from sal_height.simulation.lit_surfaces import CONNECTED, GroundCells, LitSurfaces, ground_cells, lit_surfaces

TOLERANCE_BEAMWIDTHS = 0.11
"""Error, across the line of sight, up to which a height is called right: 6 cm of height in sal_spotlight."""

COVERAGE = ("bias_m", "rms_m", "median_m", "s68_m", "sigma_m", "within_1_sigma", "within_2_sigma", "beyond_5_sigma")
"""Entries of a report on errors of surfaces and of the ground."""

CELL_PIXELS = 0.5
"""Side of a cell of the ground in pixels of the height image on level ground."""


@dataclass(frozen=True, eq=False)
class GroundCoverage:
    """Cells of the ground that the images of a run reach by range and Doppler; arrays of shape (cells,).

    Attributes:
        size: side of a cell, m.
        tolerance: error of a height up to which it is right, m.
        number: row (north) and column (east) of the cell, counted from the map's origin, shape (cells, 2); its centre
            is at (number + 0.5) sizes.
        terrain: height of the ground in the middle of the cell, m.
        inside: True where the cell is inside the array in some image.
        lit: True where it is lit as well in such an image.
        right: True where a surface is published whose height is right: in the cell's pixel, or in that before or behind
            it in range.
        silent: True where nothing was found in its pixels but noise.
    """

    size: float
    tolerance: float
    number: Index
    terrain: F64
    inside: Bool
    lit: Bool
    right: Bool
    silent: Bool

    @property
    def shares(self) -> dict[str, float | None]:
        """Fractions of lit cells and of shadow inside the array; and of right ones among the lit."""
        inside, lit, right = (int(np.count_nonzero(chosen)) for chosen in (self.inside, self.lit, self.right))
        parts = {"lit": (lit, inside), "shadow": (inside - lit, inside), "right": (right, lit)}
        return {name: or_null(fraction_of(*counts)) for name, counts in parts.items()}


@dataclass(frozen=True, eq=False)
class Judged:
    """The height images of one estimator against the truth.

    Attributes:
        comparison: every published surface against the lit surfaces.
        ground: the ground within reach of the images.
        bounds: Cramér-Rao bound averaged over speckle, m, of each pixel that has one surface and is found so.
    """

    comparison: SurfaceComparison
    ground: GroundCoverage
    bounds: F64


def height_beamwidth(flight: SimulatedFlight) -> float:
    """Difference in height of one beamwidth at the middle of the swath, m."""
    track = flight.preset.flight
    return float(flight.sensor.beamwidth * track.slant_range_m * np.sin(track.look_angle_rad))


def as_flown(
    field: HeightField, aperture: ApertureState, flight: SimulatedFlight, dwell: int
) -> tuple[HeightField, ApertureState]:
    """Positions of the pixels of a height image and of its points, seen from where the platform was.

    Range and Doppler count from there, not from the odometry's position; a pixel is compared with what it saw. Heights
    and covariances stay as they were published. In stripmap the error of the odometry is that in the middle of the last
    block.

    Args:
        field: the heights.
        aperture: aperture of the image as which they are published.
        flight: flight that was simulated.
        dwell: number of the dwell of the image, or of the block that completed it.
    """
    true = flight.aperture(dwell)
    stated = aperture
    if aperture.sliding:
        track = flight.track(dwell).mounted(flight.sensor.mounting)
        stated = track.aperture(flight.dwell_start_ns(dwell), flight.pulse_times)
    off = stated.position - true.position
    surfaces = tuple(replace(surface, positions=surface.positions - off) for surface in field.surfaces)
    grid = replace(field.grid, origin=field.grid.origin - off)
    return replace(field, grid=grid, surfaces=surfaces), replace(aperture, position=aperture.position - off)


def true_surfaces(
    field: HeightField,
    aperture: ApertureState,
    processing: Processing,
    looks: tuple[int, int],
    flight: SimulatedFlight,
    surface: VisibleSurface,
) -> LitSurfaces:
    """The lit surfaces of the pixels of a height image, and of those beside it along the flight within reach.

    Args:
        field: height image, with its grid as it was flown.
        aperture: its aperture, as it was flown.
        processing: windows of the images.
        looks: pixels of the images that were averaged in range and azimuth.
        flight: flight that was simulated.
        surface: lit scatterers.
    """
    grid = field.grid
    farthest = int(np.ptp(surface.positions @ grid.col_direction) / grid.col_spacing)
    beside = min(reach_along(field), farthest)
    wide = replace(grid, origin=grid.points(0, -beside), cols=grid.cols + 2 * beside)
    seen = np.pad(field.first.positions, ((0, 0), (beside, beside), (0, 0)), constant_values=np.nan)
    sensor = flight.sensor
    connected = max(CONNECTED, 1.5 * flight.scene.layer_spacing / height_beamwidth(flight))
    cell = sensor.range_resolution, azimuth_resolution(sensor, aperture, flight.preset.flight.slant_range_m)
    reach = processing.reach(cell, (grid.row_spacing / looks[0], grid.col_spacing / looks[1]))
    beams = image_beams(sensor, processing.azimuth_window)
    return lit_surfaces(surface, aperture, wide, cell, reach, beams, connected, seen)


def judged(images: Sequence[HeightImage], flight: SimulatedFlight, surfaces: Mapping[int, VisibleSurface]) -> Judged:
    """Compare all height images of one estimator with what their dwells saw."""
    sensor, track = flight.sensor, flight.preset.flight
    across = height_beamwidth(flight)
    spacing = images[0].grid
    size = float(max(spacing.row_spacing / np.sin(track.look_angle_rad), spacing.col_spacing)) * CELL_PIXELS
    tolerance = float(TOLERANCE_BEAMWIDTHS * across)
    comparisons, seen, bounds = [], [], []
    for image in Bar(images, desc=f"truth of {images[0].estimator}", unit="image", delay=1, leave=False):
        field, published_as = messages.field_from_message(image), messages.aperture_from_message(image.aperture)
        flown, aperture = as_flown(field, published_as, flight, image.dwell)
        range_window, azimuth_window = (
            messages.recorded_window(image.provenance, axis) for axis in ("range", "azimuth")
        )
        processing, looks = Processing(range_window, azimuth_window), (image.range_looks, image.azimuth_looks)
        beams, surface = image_beams(sensor, processing.azimuth_window), surfaces[image.dwell]
        truth = true_surfaces(flown, aperture, processing, looks, flight, surface)
        comparisons.append(compare(field, truth, sensor.beamwidth))
        of_pixels = truth.middle(field.grid.cols)
        bound = height_bound(of_pixels, flown, aperture, beams, flight, looks[0] * looks[1])
        one = true_order(of_pixels, sensor.beamwidth) == TRUE_ORDERS.index("one")
        bounds.append(bound[one & (field.validity == Validity.OK)])
        cells = ground_cells(flight.scene, surface, aperture, flown.grid, beams, sensor.look_side, size)
        silent = np.isin(field.validity, (Validity.NO_SIGNAL, Validity.LOW_CNR))[*cells.pixel.T]
        seen.append((cells, _is_right(field, cells, tolerance), silent))
    return Judged(joined_comparisons(comparisons), _coverage(seen, size, tolerance), np.concatenate(bounds))


def height_bound(
    truth: LitSurfaces, field: HeightField, aperture: ApertureState, beams: Beams, flight: SimulatedFlight, looks: int
) -> F64:
    """Cramér-Rao bound of the height of the strongest surface of each pixel, if it were alone, averaged over speckle.

    Args:
        truth: lit surfaces of the pixels.
        field: height image, with its grid as it was flown.
        aperture: its aperture, as it was flown.
        beams: beams of the image.
        flight: flight that was simulated.
        looks: number of looks of a pixel.

    Returns:
        Standard deviations, m, shape (rows, cols); NaN where nothing is lit, infinite for a single look.
    """
    track, sensor = flight.preset.flight, flight.sensor
    height_slope = track.slant_range_m * np.sin(track.look_angle_rad)  # of height over elevation, m/rad
    cnr = 10 ** (flight.preset.cnr_db / 10) * truth.power[0]
    squint = column_squint(field.grid, aperture, sensor.beams, sensor.look_side)
    with np.errstate(invalid="ignore"):  # where nothing is lit
        return height_slope * speckle_crb(beams, truth.elevation[0], squint, cnr, looks)


def _is_right(field: HeightField, cells: GroundCells, tolerance: float) -> Bool:
    """True if a surface of the pixel of each cell, or of the pixels next to it in range, has the cell's height."""
    right = np.zeros(len(cells.height), dtype=bool)
    for step in (-1, 0, 1):
        row = np.clip(cells.pixel[:, 0] + step, 0, field.grid.rows - 1)
        for surface in field.surfaces:
            right |= np.abs(surface.height[row, cells.pixel[:, 1]] - cells.height) < tolerance
    return right


def _coverage(seen: Sequence[tuple[GroundCells, Bool, Bool]], size: float, tolerance: float) -> GroundCoverage:
    """Coverage by all images together: a cell is inside, lit or right if it is so in one, silent if in all of them."""
    images, right, silent = zip(*seen, strict=True)
    numbers = np.concatenate([cells.number for cells in images])
    number, first, which = np.unique(numbers, axis=0, return_index=True, return_inverse=True)

    def anywhere(parts: Sequence[Bool]) -> Bool:
        return np.bincount(which.ravel(), np.concatenate(parts).astype(np.float64)) > 0

    return GroundCoverage(
        size=size,
        tolerance=tolerance,
        number=number,
        terrain=np.concatenate([cells.height for cells in images])[first],
        inside=anywhere([cells.inside for cells in images]),
        lit=anywhere([cells.inside & cells.lit for cells in images]),
        right=anywhere([cells.inside & cells.lit & true for cells, true in zip(images, right, strict=True)]),
        silent=~anywhere([~quiet for quiet in silent]),
    )


def surface_statistics(judgement: Judged | None) -> dict[str, Any]:
    """Entry of report.json on an estimator; None: it has published no image.

    `valid`: fraction of the lit pixels inside the array with a height; errors of all published surfaces (`_errors`);
    `crb_m`: mean Cramér-Rao bound averaged over speckle of the pixels that have one surface and are found so, m;
    `missed`: fraction of the lit surfaces of which none is published; `ghosts_in_shadow`: fraction of the pixels in
    shadow with a height; `kinds`: the errors by validity; `confusion`: pixels by what they contain (rows) and what was
    found; `lit_ground`: `GroundCoverage.shares`. Numbers that do not exist are None.
    """
    if judgement is None:
        return {"valid": 0.0, **_errors(NO_SURFACES), "crb_m": None}
    result, ground = judgement.comparison, judgement.ground
    kinds = {value.name: result.errors.where(result.errors.validity == value) for value in map(Validity, USABLE)}
    return {
        "valid": or_null(fraction_of(result.valid, result.pixels)),
        **_errors(result.errors),
        "crb_m": or_null(mean_of(judgement.bounds)),
        "missed": or_null(fraction_of(result.missed, result.surfaces)),
        "ghosts_in_shadow": or_null(fraction_of(result.ghosts, result.shadow)),
        "kinds": {name: _errors(errors) for name, errors in kinds.items()},
        "confusion": {"true": list(TRUE_ORDERS), "found": list(FOUND_ORDERS), "pixels": result.confusion.tolist()},
        "lit_ground": {"cell_m": ground.size, "tolerance_m": ground.tolerance, **ground.shares},
    }


def _errors(errors: PublishedErrors) -> dict[str, Any]:
    """Number of surfaces, number of those in shadow, and errors of the others from the nearest true surface.

    `within_extent` is the number of those between the scatterers of a surface that extends over elevations, such as a
    crown: they count as right, but not in what is in metres, as they have no true height. `common_sigma_m` is the mean
    of that part of sigma which all pixels share, m. `own_beyond_5_sigma` is the fraction that is farther than 5 sigma
    from the surface it should be, or has none.
    """
    near, measured = errors.where(np.isfinite(errors.nearest)), errors.from_one_height
    in_metres = [key for key in COVERAGE if key.endswith("_m")]
    return {
        "surfaces": len(errors.sigma),
        "in_shadow": int(np.count_nonzero(errors.ghost)),
        "within_extent": int(np.count_nonzero(errors.within_extent)),
        **error_statistics(near.nearest, near.sigma).in_metres(COVERAGE),
        **error_statistics(measured.nearest, measured.sigma).in_metres(in_metres),
        "common_sigma_m": or_null(mean_of(near.common)),
        "own_beyond_5_sigma": or_null(near.own_beyond_5_sigma),
    }
