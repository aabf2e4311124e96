"""Slope of the ground at each pixel of a height image, from the pixels around it.

Positions are averaged, not only heights, because errors of elevation move a point to the side as much as upwards: a
plane fitted to heights over displaced places would be too flat or too steep. The mean of points of a plane lies on the
plane, whichever of them are missing, so that the differences of a few means fix its slope.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sal_height.numeric import F64, Bool, in_parallel
from sal_height.relief._kernels import average_windows, fit_planes
from sal_height.relief.position_error import variance_at_place

SLOPE_ERROR = 0.03
"""Standard deviation of slopes (m/m) that windows are made wide enough for; sigma at a place is then good to 3 %."""

KNOWN = 0.2
"""Greatest standard deviation (m/m) of a slope that is used; beyond it the ground's slope counts as not known."""

MISFIT = 2.5
"""Greatest spread of pixels about their plane, over what their errors let expect; beyond it there is no plane."""

LEAST_SHARE = 0.25
"""Least share of the pixels of a window that must have a height; a window in a corner of the image has 4 of 9."""

WIDEST = 32
"""Greatest half-width of a window in pixels."""

LEAST_PIXELS = 2**14
"""Pixels that are worth a thread."""


def ground_slope(points: F64, covariance: F64, spacing: float) -> tuple[F64, F64]:
    """Slope of the ground at each pixel, and its standard deviation.

    Points are averaged in square windows; the slope is that of the plane through the means half a window before and
    behind, left and right of the pixel. At a step, on rubble and beside a false height the pixels spread about their
    planes by more than their errors (MISFIT), and the slope is not known. All windows of an image are equal, as narrow
    as gives slopes of SLOPE_ERROR in the median: first on level ground, then on the slopes that were found.

    Args:
        points: east, north and height of the scatterers, m, shape (3, rows, cols); NaN where there is none.
        covariance: of their own errors, m^2, shape (rows, cols, 3, 3).
        spacing: of pixels on the ground, the smaller of both axes, m.

    Returns:
        Slope towards east and north, m/m, shape (rows, cols, 2), and the root of the sum of both variances, shape
        (rows, cols); NaN where the slope is not known.
    """
    seen = np.isfinite(points[0] + points[1] + points[2]) & np.isfinite(covariance[..., 2, 2])
    if not seen.any():
        return np.full((*seen.shape, 2), np.nan), np.full(seen.shape, np.nan)
    half = _half_width(float(np.sqrt(np.median(covariance[seen, 2, 2]))), spacing)
    slope, error = _planes(points, covariance, seen, half)
    median = float(np.median(error[seen]))
    if SLOPE_ERROR < median < np.inf and half < WIDEST:  # errors fall as the square of the width
        half = min(int(np.ceil(half * np.sqrt(median / SLOPE_ERROR))), WIDEST)
        slope, error = _planes(points, covariance, seen, half)
    known = error <= KNOWN
    return np.where(known[..., None], slope, np.nan), np.where(known, error, np.nan)


def _planes(points: F64, covariance: F64, seen: Bool, half: int) -> tuple[F64, F64]:
    """Slopes of the planes in windows, and their standard deviation (m/m), infinite where there is no plane.

    Args:
        points: m, shape (3, rows, cols).
        covariance: of their own errors, m^2, shape (rows, cols, 3, 3).
        seen: the points that count, shape (rows, cols).
        half: half-width of the windows in pixels.
    """
    from_middle = np.stack([np.where(seen, axis - axis[seen].mean(), 0.0) for axis in points])
    *totals, share = _window_means([*from_middle, seen.astype(np.float64)], half)
    slope, (steepness, off) = np.empty((*seen.shape, 2)), np.empty((2, *seen.shape))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        means = np.stack(totals) / share
        in_parallel(
            lambda part: fit_planes(from_middle, means, seen, half, part, slope, steepness, off),
            len(seen),
            LEAST_PIXELS // seen.shape[1] + 1,
        )
        count = share * (2 * half + 1) ** 2
        spread = _window_means([np.nan_to_num(off)], half)[0] / share * count / (count - 1)
        variance = variance_at_place(covariance, slope)
        # Each of the two steps has twice the variance of a mean, at most.
        error = 2 * variance / count * steepness
        planar = seen & (share >= LEAST_SHARE) & (spread <= MISFIT**2 * variance) & np.isfinite(error)
    return slope, np.where(planar, np.sqrt(error), np.inf)


def _half_width(sigma: float, spacing: float) -> int:
    """Half-width k in pixels of the windows of an image, from the sigma of its heights (m) and the spacing of pixels.

    The difference of the means of (2 k + 1)^2 pixels each, 2 k pixels apart, has the variance 2 sigma^2 / (2 k + 1)^2
    at most; both axes together give the slope the standard deviation sigma / (k (2 k + 1) spacing).
    """
    half = np.arange(1, WIDEST + 1)
    wide_enough = half[sigma / spacing / (half * (2 * half + 1)) <= SLOPE_ERROR]
    return int(wide_enough[0]) if wide_enough.size else WIDEST


def _window_means(values: Sequence[F64], half: int) -> F64:
    """Means over the window around each pixel; values beyond the edge count as 0."""
    means = np.empty((len(values), *values[0].shape))

    def average(part: slice) -> None:
        for image, mean in zip(values[part], means[part], strict=True):
            average_windows(image, half, mean)

    in_parallel(average, len(values), LEAST_PIXELS // values[0].size + 1)
    return means
