"""Tracking of height images: the error of each pixel's own measurement, and its position at the tracked height."""

from __future__ import annotations

import numpy as np

from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, Grid, locate_at_height
from sal_height.numeric import F64, Bool
from sal_height.relief.field_tracking import estimated_field_prior, smoothed_field
from sal_height.relief.heights import HeightField, Surface, shared_variance
from sal_height.relief.range_tracking import ReliefPrior, TrackedRelief, estimated_prior, smoothed

INTERPOLATED_SIGMA = np.sqrt(0.5)
"""Greatest sigma of an interpolated height over that of the relief: neighbours have halved the variance at least."""

LEAST_OWN_VARIANCE = 0.01
"""Least share of a height's variance that is not due to the pose; in messages sigma is rounded to float32."""


def ground_spacings(grid: Grid) -> tuple[float, float]:
    """Spacing of the rows and of the columns of a height image on level ground, m."""
    return grid.row_spacing / float(np.hypot(*grid.row_direction[:2])), grid.col_spacing


def look_side_of(grid: Grid, aperture: ApertureState) -> int:
    """Look side of the middle of the image: +1 right of the track, -1 left."""
    sight = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2) - aperture.position
    return 1 if np.cross(aperture.direction, [0.0, 0.0, 1.0]) @ sight > 0 else -1


def own_sigma(field: HeightField, aperture: ApertureState) -> F64:
    """Standard deviation of height without the error of the platform's pose, m, shape (rows, cols).

    All pixels of a dwell share the error of the pose, so that averaging over neighbours does not reduce it.
    """
    shared = shared_variance(field.first.positions, aperture)
    return np.sqrt(np.maximum(field.first.sigma**2 - shared, LEAST_OWN_VARIANCE * field.first.sigma**2))


def track(
    field: HeightField,
    aperture: ApertureState,
    length: float | None,
    relief_sigma: float | None,
    gate: float,
    along_track: bool,
) -> tuple[HeightField, ReliefPrior]:
    """Track a height image (`tracked_field`); returns the prior with which it was tracked, too.

    Args:
        field: measured heights.
        aperture: state of the platform.
        length: correlation length of the relief, m; None: estimated.
        relief_sigma: its standard deviation, m; None: estimated.
        gate: measurements farther from their prediction are outliers, standard deviations.
        along_track: whether neighbours along-track are used, too (`field_tracking`).

    Raises:
        UserError: no prior can be estimated (`range_tracking.estimated_prior`).
    """
    height, sigma, spacings = field.first.height, own_sigma(field, aperture), ground_spacings(field.grid)
    if along_track:
        prior = estimated_field_prior(height, sigma, spacings, length, relief_sigma)
        relief = smoothed_field(height, sigma, spacings, prior, gate)
    else:
        prior = estimated_prior(height, sigma, spacings[0], length, relief_sigma)
        relief = smoothed(height, sigma, spacings[0], prior, gate)
    return tracked_field(field, relief, prior, aperture), prior


def tracked_field(
    field: HeightField, relief: TrackedRelief, prior: ReliefPrior, aperture: ApertureState
) -> HeightField:
    """Replace heights by tracked ones, each at its position on the circle of its pixel's range and Doppler.

    Pixels that were measured, with one scatterer or two, become OK. The others, outliers included, become INTERPOLATED
    where pixels of their column were measured at nearer and at farther range, and the standard deviation is at most
    INTERPOLATED_SIGMA times that of the relief. Elsewhere they have no height, and an outlier becomes LOW_CNR: a peak
    of noise. Nothing is extrapolated: beyond the last measured pixel the ground has most often left the span of the
    array. Pixels that were not measured have the range and Doppler of their centres.

    Args:
        field: measured heights.
        relief: heights tracked from them with `own_sigma`, shape of the image.
        prior: with which they were tracked.
        aperture: state of the platform.
    """
    measured = np.isfinite(field.first.height)
    # The circle about the track is the same from every position of a sliding aperture.
    sight = np.where(measured[..., None], field.first.positions, field.grid.pixels()) - aperture.position
    slant_range, along = np.linalg.norm(sight, axis=-1), sight @ aperture.direction
    positions = locate_at_height(relief.height, slant_range, along, aperture, look_side_of(field.grid, aperture))
    located = np.isfinite(positions).all(axis=-1)
    used = measured & ~relief.outlier
    known = located & (used | (_between(used) & (relief.sigma <= INTERPOLATED_SIGMA * prior.sigma)))
    validity = np.select(
        [known & used, known, used, relief.outlier],
        [Validity.OK, Validity.INTERPOLATED, Validity.OUTSIDE_ARRAY, Validity.LOW_CNR],
        field.validity,
    )
    sigma = np.sqrt(relief.sigma**2 + shared_variance(positions, aperture))
    surface = Surface(
        height=np.where(known, relief.height, np.nan),
        sigma=np.where(known, sigma, np.nan),
        cnr_db=field.first.cnr_db,
        positions=np.where(known[..., None], positions, np.nan),
    )
    return HeightField(field.grid, validity.astype(np.uint8), surface, None)


def _between(used: Bool) -> Bool:
    """Pixels with others of the same column that are used, in rows before and after."""
    before, after = np.logical_or.accumulate(used), np.logical_or.accumulate(used[::-1])[::-1]
    return before & after
