"""Slope of the ground at each pixel of a height image, from the pixels around it.

Positions are averaged, not only heights, because errors of elevation move a point to the side as much as upwards: a
plane fitted to heights over displaced positions would be too flat or too steep. The mean of points of a plane lies on
the plane, whichever of them are missing, so that the differences of a few means fix its slope.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, in_parallel
from sal_height.relief import _kernels as kernels

SLOPE_ERROR = 0.03
"""Standard deviation of slopes (m/m) that windows are wide enough for; sigma at a position is then good to 3 %."""

KNOWN = 0.2
"""Greatest standard deviation (m/m) of a slope that is used; beyond it the ground's slope counts as not known."""

MISFIT = 2.5
"""Greatest spread of pixels about their plane, over that expected from their errors; beyond it there is no plane."""

WIDEST = 32
"""Greatest half-width of a window in pixels."""

LEAST_PIXELS = 2**14
"""Pixels that are worth a thread."""


def ground_slope(points: F64, covariance: F64, spacing: float) -> tuple[F64, F64]:
    """Slope of the ground at each pixel, and its standard deviation.

    Points are averaged in square windows; the slope is that of the plane through the means half a window before and
    behind, left and right of the pixel. At a step, on rubble and next to a false height the pixels spread about their
    planes by more than their errors (MISFIT), and the slope is not known. All windows of an image are equal, as narrow
    as gives slopes of SLOPE_ERROR in the median: first on level ground, then on the slopes that were found.

    Args:
        points: east, north and height of the scatterers, m, shape (3, rows, cols); NaN where absent.
        covariance: covariance of their own errors, m^2, shape (rows, cols, 3, 3).
        spacing: spacing of pixels on the ground, the smaller of both axes, m.

    Returns:
        Slope towards east and north, m/m, shape (rows, cols, 2), and the root of the sum of both variances, shape
        (rows, cols); NaN where the slope is not known.
    """
    points, covariance = np.ascontiguousarray(points), np.ascontiguousarray(covariance)
    centred = np.empty((4, *points.shape[1:]))
    kernels.centre_points(points, covariance, centred)
    seen = centred[3] > 0
    if not seen.any():
        return np.full((*seen.shape, 2), np.nan), np.full(seen.shape, np.nan)
    half = _half_width(float(np.sqrt(median(covariance[..., 2, 2][seen]))), spacing)
    slope, error = _planes(centred, covariance, half)
    middle = median(error[seen])
    if SLOPE_ERROR < middle < np.inf and half < WIDEST:  # errors fall as the square of the width
        half = min(int(np.ceil(half * np.sqrt(middle / SLOPE_ERROR))), WIDEST)
        slope, error = _planes(centred, covariance, half)
    known = error <= KNOWN
    return np.where(known[..., None], slope, np.nan), np.where(known, error, np.nan)


def _planes(centred: F64, covariance: F64, half: int) -> tuple[F64, F64]:
    """Slopes of the planes in windows, and their standard deviation (m/m), infinite where there is no plane.

    Args:
        centred: points and whether they count, as filled by `centre_points`, shape (4, rows, cols).
        covariance: covariance of their own errors, m^2, shape (rows, cols, 3, 3).
        half: half-width of the windows, pixels.
    """
    shape = centred.shape[1:]
    # Least fraction of the pixels of a window that must have a height; a window in a corner of the image has 4 of 9.
    least_share = 0.25
    least, limits = LEAST_PIXELS // shape[1] + 1, (least_share, MISFIT**2)
    means = _window_means(centred, half)
    slope, (steepness, off, error) = np.empty((*shape, 2)), np.empty((3, *shape))
    in_parallel(
        lambda part: kernels.fit_planes(centred, means, half, part, slope, steepness, off),
        shape[0],
        least,
    )
    (spread,) = _window_means(off[None], half)

    def judge(part: slice) -> None:
        share, counts = means[3, part], centred[3, part]
        kernels.judge_planes(
            covariance[part], slope[part], steepness[part], share, spread[part], half, limits, counts, error[part]
        )

    in_parallel(judge, shape[0], least)
    return slope, error


def median(values: F64) -> float:
    """Median of some numbers, one at least."""
    middle = len(values) // 2
    ordered = np.partition(values, (max(middle - 1, 0), middle))
    return float(ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def _half_width(sigma: float, spacing: float) -> int:
    """Half-width k in pixels of the windows of an image, from the sigma of its heights (m) and the spacing of pixels.

    The difference of the means of (2 k + 1)^2 pixels each, 2 k pixels apart, has the variance 2 sigma^2 / (2 k + 1)^2
    at most; both axes together give the slope the standard deviation sigma / (k (2 k + 1) spacing).
    """
    pixels = sigma / spacing
    return next((half for half in range(1, WIDEST) if pixels / (half * (2 * half + 1)) <= SLOPE_ERROR), WIDEST)


def _window_means(values: F64, half: int) -> F64:
    """Means of images over the window around each pixel, shape (images, rows, cols); beyond the edge they are 0."""
    means = np.empty(values.shape)

    def average(part: slice) -> None:
        for image, mean in zip(values[part], means[part], strict=True):
            kernels.average_windows(image, half, mean)

    in_parallel(average, len(values), LEAST_PIXELS // values[0].size + 1)
    return means
