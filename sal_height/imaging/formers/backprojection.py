"""Time-domain backprojection: exact for any trajectory and any pixels; the reference for the fast image formers."""

from __future__ import annotations

import math

import numpy as np

from sal_height.geometry import Grid
from sal_height.imaging.formers._kernels import add_pulses, keep_filled, keep_reached
from sal_height.imaging.pixels import Processing
from sal_height.numeric import (
    C64,
    F32,
    F64,
    OVERSAMPLING,
    TAPS,
    WORKERS,
    Bool,
    blocks,
    dense_profiles,
    in_threads,
    tap_polynomials,
)
from sal_height.sensor import PhaseHistory, Sensor


def backproject(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Images of all detectors at the pixels of `grid`, (detectors, rows, cols); see `backproject_points`."""
    image = np.empty((len(history.samples), *grid.shape), dtype=np.complex64)
    rows = max(1, 3 * 2**15 // grid.cols)  # at a time, over all pulses: bounds the memory
    for first in range(0, grid.rows, rows):
        block = np.arange(first, min(first + rows, grid.rows))
        points = grid.points(block[:, None], np.arange(grid.cols)).reshape(-1, 3)
        values = backproject_points(history, antenna, sensor, processing, points, grid.col_direction)
        image[:, block] = values.reshape(-1, len(block), grid.cols)
    return image


def backproject_points(
    history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, points: F64, direction: F64
) -> C64:
    """Value of every detector's image at some points, by the same filter.

    image(p) = sum over pulses and frequencies of w(f) a(p) samples exp(+j 4 pi f (|p - antenna| - reference) / c), over
    the sum of the weights w and a. In stripmap a is the azimuth window over the angle to the pulse, and 0 beyond the
    processed angle; in spotlight it is the window over all pulses.

    Distances and phases are float64 until the phase has been reduced to one turn; from there on float32 does, as the
    samples have no more digits (`make bench` measures the error). Geometry is computed once for all detectors.

    Args:
        history: phase history of all detectors in a dwell, as fast-time frequencies.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: sensor with wavelength and frequencies.
        processing: windows, and the processed angle in stripmap.
        points: positions, m, shape (points, 3).
        direction: unit vector of flight, shape (3,); used in stripmap only.

    Returns:
        Complex64, shape (detectors, points); NaN where a point leaves the range window in some pulse, and in stripmap
        where the pulses do not fill the processed angle.
    """
    along = points @ direction
    points = np.ascontiguousarray(points.T)
    detectors, pulses, frequencies = history.samples.shape
    image = np.zeros((detectors, 2, points.shape[1]), dtype=np.float32)
    weight, valid = np.zeros(points.shape[1]), np.ones(points.shape[1], dtype=np.bool_)
    range_weights = processing.range_weights(frequencies)
    azimuth_weights, taper = processing.azimuth_weights(pulses), processing.taper()
    track = np.column_stack([antenna, history.reference_range, antenna @ direction, azimuth_weights])
    taps = tap_polynomials()
    scales = np.array(
        [
            OVERSAMPLING * frequencies / sensor.range_window,
            (OVERSAMPLING * frequencies) // 2,
            sensor.centre_wavenumber / (2 * np.pi),
            sensor.range_window / 2,
            processing.angle,
            abs(float((antenna[-1] - antenna[0]) @ direction)) / max(1, pulses - 1),
        ]
    )
    # Pixels of a thread: fewer are not worth one.
    size = int(np.clip(math.ceil(points.shape[1] / WORKERS), 2048, 4096))
    pulses_at_once = 16  # whose dense profiles are kept: a few megabytes
    apart = np.empty((pulses_at_once, OVERSAMPLING * frequencies + TAPS, 2, detectors), dtype=np.float32)
    for block in blocks(pulses, pulses_at_once):
        dense = dense_profiles(history.samples[:, block], range_weights)
        profiles = apart[: len(dense)]
        profiles[:, :, 0], profiles[:, :, 1] = dense.real, dense.imag

        def add(piece: slice, profiles: F32 = profiles, block: slice = block) -> None:
            add_pulses(
                points[:, piece].copy(), along[piece], track[block], profiles, taps, taper, scales,
                image[:, :, piece], weight[piece], valid[piece],
            )  # fmt: skip

        in_threads(add, blocks(points.shape[1], size))
    valid &= (weight > 0) & filled_apertures(points.T, antenna, direction, processing.angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        image /= np.where(valid, weight * frequencies, np.nan).astype(np.float32)
    result = np.empty((detectors, points.shape[1]), dtype=np.complex64)
    result.real, result.imag = image[:, 0], image[:, 1]
    return result


def filled_apertures(points: F64, antenna: F64, direction: F64, angle: float) -> Bool:
    """True for points whose whole processed angle the pulses cover; (points,)."""
    ends = [
        (position - points) @ direction / np.linalg.norm(position - points, axis=-1) for position in antenna[[0, -1]]
    ]
    return np.asarray((np.minimum(*ends) <= -angle / 2) & (np.maximum(*ends) >= angle / 2)) if angle else np.array(True)


def blank_invalid(
    image: C64, history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid
) -> None:
    """Make an image NaN where that of `backproject` is."""
    valid = valid_pixels(history, antenna, sensor, processing.angle, grid)
    if not valid.all():
        image[:, ~valid] = np.nan


def valid_pixels(history: PhaseHistory, antenna: F64, sensor: Sensor, angle: float, grid: Grid) -> Bool:
    """Mask of the values of `backproject` that are not NaN, (rows, cols); `angle` as of `Processing`."""
    valid = np.ones(grid.shape, dtype=np.bool_)
    starts, step, direction = grid.points(np.arange(grid.rows), 0.0), grid.col_step, grid.col_direction
    if angle:
        keep_filled(starts, step, antenna[[0, -1]], direction, angle, valid)
    track = np.column_stack([antenna, history.reference_range, antenna @ direction])
    spacing = abs(float((antenna[-1] - antenna[0]) @ direction)) / max(1, len(antenna) - 1)
    keep_reached(starts, step, direction, track, sensor.range_window / 2, angle, spacing, valid)
    return valid
