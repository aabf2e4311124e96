"""Tracking of height images: the error of each pixel's own measurement, and its position at the tracked height."""

from __future__ import annotations

import numpy as np

from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, Grid, locate_at_height
from sal_height.numeric import F64, Bool
from sal_height.relief._tracking_kernels import fill_sights, judge_pixels, mark_company
from sal_height.relief.heights import HeightField, Surface
from sal_height.relief.position_error import circle_covariance
from sal_height.relief.prior import PriorEstimate
from sal_height.relief.settings import DEFAULT_TRACKING, TrackingSettings
from sal_height.relief.smoothing import MeasuredHeights, ReliefPrior, TrackedRelief, smoothed


def ground_spacings(grid: Grid) -> tuple[float, float]:
    """Spacing of the rows and of the columns of a height image on level ground, m."""
    return grid.row_spacing / float(np.hypot(*grid.row_direction[:2])), grid.col_spacing


def look_side_of(grid: Grid, aperture: ApertureState) -> int:
    """Look side of the middle of the image: +1 right of the track, -1 left."""
    east, north, _ = (grid.middle - aperture.position).tolist()
    ahead_east, ahead_north, _ = aperture.direction.tolist()
    return 1 if ahead_north * east > ahead_east * north else -1


def track(
    field: HeightField,
    aperture: ApertureState,
    before: PriorEstimate,
    settings: TrackingSettings = DEFAULT_TRACKING,
) -> tuple[HeightField, ReliefPrior | None, PriorEstimate]:
    """Track a height image (`tracked_field`) with the prior that follows from it and from the dwells before.

    One with too few heights for a prior, as over woods or water, stays as it was measured: of a relief of which nothing
    is known, neighbours know nothing.

    Args:
        field: measured heights.
        aperture: state of the platform.
        before: estimate of the prior from earlier dwells; `PriorEstimate()`: no earlier dwells.
        settings: settings of the tracking.

    Returns:
        The tracked height image, the prior with which it was tracked, None without one, and the estimate of the prior
        after this dwell.
    """
    measured = MeasuredHeights(field.first.height, field.first.own_sigma, ground_spacings(field.grid))
    found = before.after(measured, settings)
    if not found:
        return field, None, before
    prior, after = found
    relief = smoothed(measured, prior, settings)
    return tracked_field(field, relief, aperture, settings.interpolation_limit * prior.sigma), prior, after


def tracked_field(
    field: HeightField, relief: TrackedRelief, aperture: ApertureState, greatest_sigma: float
) -> HeightField:
    """Replace heights by tracked ones, each at its position on the circle of its pixel's range and Doppler.

    Pixels of one surface that were tracked become OK. What contradicts the track in company (`in_company`) is no
    outlier but ground beyond a step: it stays as it was measured. So do pixels of several surfaces or an extended one,
    which are not the relief. Any other outlier becomes LOW_CNR: it may be a peak of noise, or the track may be wrong,
    so that neither is its height. A pixel of which nothing is known (UNKNOWN) becomes INTERPOLATED if the measured
    pixels of its column that are next to it at nearer and at farther range were tracked, and the standard deviation is
    at most `greatest_sigma`. Elsewhere it has no height. Nothing is extrapolated: beyond the last measured pixel the
    ground has most often left the span of the array. Pixels that were not measured have the range and Doppler of their
    centres.

    Args:
        field: measured heights.
        relief: heights tracked from them with their `own_sigma`, shape of the image.
        aperture: state of the platform.
        greatest_sigma: greatest standard deviation of an interpolated height, m.
    """
    measured = np.isfinite(field.first.height)
    # The circle about the track is the same from every position of a sliding aperture.
    slant_range, along = _seen_from(aperture.position, field, measured, aperture.direction)
    positions = locate_at_height(relief.height, slant_range, along, aperture, look_side_of(field.grid, aperture))
    step = in_company(field.first, relief.outlier)
    unknown = _UNKNOWN[field.validity] & (relief.sigma <= greatest_sigma)
    validity, (kept, shown) = np.empty_like(field.validity), np.empty((2, *measured.shape), np.bool_)
    judge_pixels(field.validity, measured, positions, relief.outlier, step, unknown, validity, kept, shown)
    own = circle_covariance(relief.sigma.astype(np.float64), positions, aperture)
    first = Surface.seen_from(aperture, positions, own, field.first.cnr_db).where(shown)
    first.take(field.first, kept)
    return HeightField(field.grid, validity, (first, *field.surfaces[1:]))


def _seen_from(antenna: F64, field: HeightField, measured: Bool, direction: F64) -> tuple[F64, F64]:
    """Slant range, and its part along a direction (m), of measured heights and of the centres of the other pixels."""
    grid = field.grid
    steps = np.array([grid.row_spacing * grid.row_direction, grid.col_spacing * grid.col_direction])
    sight, slant_range = np.empty((*measured.shape, 3)), np.empty(measured.shape)
    fill_sights(antenna, np.ascontiguousarray(field.first.positions), measured, grid.origin, steps, sight, slant_range)
    return slant_range, sight @ direction


UNKNOWN = (Validity.LOW_CNR, Validity.AMBIGUOUS, Validity.MISSING_DATA, Validity.SATURATED, Validity.IMPRECISE)
"""Reasons that do not concern the ground; the others state that it is not one surface, or not there."""


_UNKNOWN = np.zeros(256, np.bool_)
_UNKNOWN[list(UNKNOWN)] = True


def in_company(surface: Surface, outlier: Bool) -> Bool:
    """Outliers that have three or more of the same height among the eight pixels around them, shape (rows, cols)."""
    company = np.empty(outlier.shape, np.bool_)
    height, variance = np.ascontiguousarray(surface.height), surface.own_sigma**2
    same = 3.0  # standard deviations of their difference up to which two heights count as the same
    mark_company(height, variance, outlier, same, 3, company)
    return company
