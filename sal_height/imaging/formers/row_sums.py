"""Fast spotlight image former for narrow images: all pixels of a row read the range profiles at the same range.

Backprojection reads each pulse's range profile again for every pixel. If the pixels of a row are at one range but for
a small part of a cell, all can use the value in its middle. A row is then a product of matrices, phases (columns,
pulses) times profiles (pulses, detectors); phases are exact, whatever the track.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from sal_height.geometry import Grid
from sal_height.imaging.formers._kernels import fill_turns, read_profiles
from sal_height.imaging.formers.backprojection import blank_invalid
from sal_height.imaging.pixels import Processing
from sal_height.numeric import C64, F64, OVERSAMPLING, blocks, dense_profiles, in_parallel, tap_polynomials
from sal_height.sensor import PhaseHistory, Sensor

PHASES_OF_THREAD = 2**18  # at least: fewer are not worth a thread of their own


def focus_rows(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Images of all detectors, (detectors, rows, cols); parameters and result as of `backprojection.backproject`."""
    profiles = row_profiles(history, antenna, sensor, processing, grid)
    detectors, pulses, frequencies = history.samples.shape
    weights = processing.azimuth_weights(pulses)
    track = np.vstack([antenna.T, history.reference_range, weights / (weights.sum() * frequencies)])
    image = np.empty((detectors, *grid.shape), dtype=np.complex64)
    starts, turns_per_metre = grid.points(np.arange(grid.rows), 0.0), sensor.centre_wavenumber / (2 * np.pi)

    def focus(part: slice) -> None:
        for first in range(part.start, part.stop, at_once):
            rows = slice(first, min(first + at_once, part.stop))
            turns = np.empty((rows.stop - rows.start, grid.cols, pulses), dtype=np.complex64)
            fill_turns(starts[rows], grid.col_step, track, turns_per_metre, turns.view(np.float32))
            image[:, rows] = (turns @ profiles[:, rows].transpose(1, 0, 2)).transpose(2, 0, 1)

    # A thread keeps the phases of 2**15 pixels and pulses: a quarter of a megabyte.
    at_once, of_thread = (max(1, phases // (grid.cols * pulses)) for phases in (2**15, PHASES_OF_THREAD))
    in_parallel(focus, grid.rows, of_thread)
    blank_invalid(image, history, antenna, sensor, processing, grid)
    return image


def row_profiles(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Range profiles of every pulse at the middle of every row: complex64, shape (pulses, rows, detectors)."""
    detectors, pulses, frequencies = history.samples.shape
    delay = cdist(antenna, _row_middles(grid, np.arange(float(grid.rows)))) - history.reference_range[:, None]
    half_window, middle = sensor.range_window / 2, (OVERSAMPLING * frequencies) // 2
    per_metre, taps = OVERSAMPLING * frequencies / sensor.range_window, tap_polynomials()
    weights, found = processing.range_weights(frequencies), np.empty((pulses, grid.rows, detectors), dtype=np.complex64)
    # 128 dense profiles of pulses and detectors: half a megabyte of 256 frequencies, which fits into a cache.
    for block in blocks(pulses, max(1, 128 // detectors)):
        dense = dense_profiles(history.samples[:, block], weights)
        numbers = found[block].view(np.float32)
        read_profiles(delay[block], dense.view(np.float32), taps, per_metre, middle, half_window, numbers)
    return found


def expected_error(antenna: F64, sensor: Sensor, grid: Grid) -> float:
    """Power of the difference to backprojection over that of the image, by geometry; the worst of 25 pixels.

    A profile read x cells off the pixel's range adds (pi x)^2 / 3.
    """
    rows, cols = (np.linspace(0, n - 1, 5) for n in grid.shape)
    pixels = grid.points(rows[:, None], cols).reshape(-1, 3)
    off = cdist(pixels, antenna).reshape(5, 5, -1) - cdist(_row_middles(grid, rows), antenna)[:, None]
    return float(np.max(np.mean((np.pi * off / sensor.range_resolution) ** 2, axis=-1))) / 3


def _row_middles(grid: Grid, rows: F64) -> F64:
    """Positions (m) in the middle of some rows, shape (rows, 3)."""
    return grid.points(rows, np.full(len(rows), (grid.cols - 1) / 2))
