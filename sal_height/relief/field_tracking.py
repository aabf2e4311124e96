"""Tracking of the relief in both directions: the height of every cell from its neighbours in range and along-track.

The relief is a Gaussian field whose correlation falls exponentially in range and along-track,

    cov(h, h') = s^2 exp(-|distance along range| / l) exp(-|distance along-track| / l),

about a mean that is itself Gaussian (`ReliefPrior.mean_sigma`). From row to row, a line of cells is a Gauss-Markov
process whose state is the whole line (`_tracking_kernels`). The Kalman filter with that state, whose measurements enter
one by one, and a smoother are exact, but their cost for each cell grows as the square of the line's length. Long lines
are therefore cut into overlapping windows of `window_columns` cells, and each cell takes its height from the window
that it is in the middle of. The result is the exact posterior given the measurements in the window's columns, with the
right standard deviation; columns farther away do not contribute.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import Index, in_parallel
from sal_height.relief import _tracking_kernels as kernels
from sal_height.relief.range_tracking import MeasuredHeights, ReliefPrior, TrackedRelief, smoothed
from sal_height.relief.settings import DEFAULT_TRACKING, TrackingSettings

CELLS_OF_A_THREAD = 2**14
"""Number of cells of windows that are worth a thread."""


def smoothed_field(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate heights from all rows of `window_columns` columns around each cell; exact if there are no more columns.

    The prior is the same in both directions. `range_tracking.smoothed` decides what is an outlier.
    """
    outlier = smoothed(measured, prior, settings).outlier
    deviation, precision = measured.deviations(prior.mean)
    precision[outlier] = 0.0
    rows, cols = deviation.shape
    starts, size = _windows(cols, settings.window_columns)
    edges = [0, *((starts[1:] + starts[:-1] + size) // 2).tolist(), cols]  # in the middle of what two windows share
    steps = float(prior.correlation(measured.spacings[0])), float(prior.correlation(measured.spacings[1]))
    result = TrackedRelief(np.empty_like(measured.height), np.empty_like(measured.height), outlier)

    def work(part: slice) -> None:
        columns, (state, variance) = np.empty((rows, size, size + 1)), np.empty((2, rows, size))
        for number, start in enumerate(starts[part].tolist(), part.start):
            window = deviation[:, start : start + size], precision[:, start : start + size]
            kernels.filter_rows(*window, prior.variances, steps, columns, state, variance)
            kernels.smooth_rows(*window, steps[0], columns, state, variance)
            there = slice(edges[number], edges[number + 1])
            inner = np.s_[:, there.start - start : there.stop - start]
            result.height[:, there] = state[inner] + prior.mean
            result.sigma[:, there] = np.sqrt(variance[inner])

    in_parallel(work, len(starts), -(-CELLS_OF_A_THREAD // (rows * size)))
    return result


def _windows(cols: int, window: int) -> tuple[Index, int]:
    """First columns of the windows, which overlap by half or, to end with the image, by more; and their size."""
    size, half = min(window, cols), window // 2
    return np.minimum(np.arange(0, max(1, cols - half), half), cols - size), size
