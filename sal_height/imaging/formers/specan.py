"""Fast spotlight image former: dechirp to the scene, transform range, transform azimuth (spectral analysis, SPECAN).

Within a spotlight dwell that is short against the range, a target's phase from pulse to pulse is that of the middle of
its row plus a term linear in the antenna's place (Cumming & Wong, Digital Processing of SAR Data, 2005, chapter 9). The
first is removed exactly, whatever the track; a chirp z-transform of each row, with the row's own scale, sorts the
second into columns. What that leaves out is known before anything is computed: `expected_error`.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from sal_height.geometry import Grid
from sal_height.imaging.formers.accuracy import check_expected_error
from sal_height.imaging.formers.backprojection import valid_pixels
from sal_height.imaging.formers.straight_track import straight_track
from sal_height.imaging.weighting import Processing
from sal_height.numeric import (
    C64,
    F64,
    WORKERS,
    ChirpZ,
    blocks,
    chirp_z,
    distance_phasors,
    outer_phasors,
    rows_at_once,
    unit_phasors,
)
from sal_height.sensor import PhaseHistory, Sensor


@dataclass(frozen=True)
class _Factors:
    """What is multiplied into the data of every detector alike.

    Attributes:
        range: transform of the pulses, with `before` of shape (pulses, frequencies); what comes after is in `azimuth`.
        azimuth: transform of the rows, with `before` of shape (rows, pulses) and `after` of shape (rows, cols), NaN
            outside the range window.
    """

    range: ChirpZ
    azimuth: ChirpZ


def focus_spotlight(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Images of all detectors, (detectors, rows, cols); parameters and result as of `backprojection.backproject`.

    Raises:
        UserError: the image would differ from backprojection's by more than accuracy.ALLOWED_ERROR.
    """
    check_expected_error("specan", expected_error(antenna, sensor, grid))
    factors = _factors(history, antenna, sensor, processing, grid)
    image = np.empty((len(history.samples), *grid.shape), dtype=np.complex64)
    with ThreadPoolExecutor(WORKERS) as pool:
        detectors = iter(range(len(image)))  # of which each worker takes the next
        list(pool.map(lambda _: _focus(history.samples, factors, image, detectors), range(WORKERS)))
    image[:, ~valid_pixels(history, antenna, sensor, 0.0, grid)] = np.nan
    return image


def _focus(samples: C64, factors: _Factors, image: C64, detectors: Iterator[int]) -> None:
    """Focus some detectors, one after the other: range, corner turn, azimuth."""
    rows, pulses = image.shape[1], samples.shape[1]
    compressed = np.empty((rows, pulses), dtype=np.complex64)
    for detector in detectors:
        for block in blocks(pulses, rows_at_once(factors.range.length)):
            compressed[:, block] = factors.range.apply(samples[detector, block], block).T
        for block in blocks(rows, rows_at_once(factors.azimuth.length)):
            image[detector, block] = factors.azimuth.apply(compressed[block], block)


def _factors(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> _Factors:
    pulses, frequencies = history.samples.shape[1:]
    middle = (grid.rows - 1) / 2, (grid.cols - 1) / 2
    centre = grid.points(*middle)
    to_centre = np.linalg.norm(centre - antenna, axis=-1)
    delay = to_centre - history.reference_range
    index = np.arange(frequencies) - frequencies // 2
    wavenumber = sensor.centre_wavenumber + sensor.wavenumber_step * index
    # Range: dechirp to the centre; rows then lie at even steps of range.
    row_range, scale = _rows(antenna, grid)
    step = (row_range[-1] - row_range[0]) / max(1, grid.rows - 1)
    by_range = chirp_z(np.array([sensor.wavenumber_step * step]), frequencies, frequencies // 2, grid.rows, middle[0])
    dechirp = outer_phasors(delay, wavenumber)
    dechirp *= by_range.before * processing.range_weights(frequencies).astype(np.float32)
    dechirp *= (processing.azimuth_weights(pulses) / (pulses * frequencies)).astype(np.float32)[:, None]
    # Azimuth: the middle of each row keeps its phase, then columns lie at even steps of the row's own scale.
    track = straight_track(antenna, grid.col_direction)
    by_azimuth = chirp_z(
        -sensor.centre_wavenumber * scale * track.spacing * grid.col_spacing,
        pulses,
        (pulses - 1) / 2,
        grid.cols,
        middle[1],
    )
    middles = grid.points(np.arange(grid.rows), np.full(grid.rows, middle[1]))
    row_phase = distance_phasors(sensor.centre_wavenumber, middles, antenna, to_centre)
    row_phase *= by_azimuth.before
    # A row bows: over its columns, the range from the middle of the track is not that of its middle.
    row_middle = np.linalg.norm(middles - track.middle, axis=-1)
    columns = _columns(grid)
    after = distance_phasors(sensor.centre_wavenumber, middles, track.middle - columns, np.zeros(grid.cols))
    after *= by_azimuth.after
    after *= unit_phasors(-sensor.centre_wavenumber * row_middle)[:, None]
    return _Factors(ChirpZ(dechirp, by_range.spectrum, by_range.after), ChirpZ(row_phase, by_azimuth.spectrum, after))


def _distances(points: F64, antenna: F64) -> F64:
    """Distances (m) of points (points, 3) from antenna positions (pulses, 3): (points, pulses)."""
    x, y, z = (points[:, None, axis] - antenna[:, axis] for axis in range(3))
    x *= x
    x += y * y
    x += z * z
    return np.sqrt(x, out=x)


def _rows(antenna: F64, grid: Grid) -> tuple[F64, F64]:
    """Range (m) of the middle of every row, and -d^2 range / (d column place, d antenna place) there, 1/m: (rows,)."""
    sight = grid.points(np.arange(grid.rows), np.full(grid.rows, (grid.cols - 1) / 2)) - antenna.mean(axis=0)
    distance = np.linalg.norm(sight, axis=-1)
    along = sight @ grid.col_direction
    return distance, (distance**2 - along**2) / distance**3


def expected_error(antenna: F64, sensor: Sensor, grid: Grid) -> float:
    """Power of the difference to backprojection over that of the image, by geometry; the worst of 25 pixels.

    A phase error p (rad) of a pulse adds p^2, also one that is the same in all pulses, and a range error of x cells
    (pi x)^2 / 3.
    """
    rows, cols = (np.linspace(0, n - 1, 5) for n in grid.shape)
    middle = (grid.cols - 1) / 2
    track = straight_track(antenna, grid.col_direction)
    _, scale = _rows(antenna, grid)
    pixels = grid.points(rows[:, None], cols[None, :])
    middles = grid.points(rows, np.full(5, middle))
    distance = np.linalg.norm(pixels[:, :, None] - antenna, axis=-1)
    model = (
        _distances(middles, antenna)[:, None]
        + (np.linalg.norm(pixels - track.middle, axis=-1) - np.linalg.norm(middles - track.middle, axis=-1)[:, None])[
            ..., None
        ]
        - (
            np.interp(rows, np.arange(grid.rows), scale)[:, None, None]
            * ((cols - middle) * grid.col_spacing)[:, None]
            * track.even
        )
    )
    phase = sensor.centre_wavenumber * (distance - model)
    row_range = np.linalg.norm(middles - track.middle, axis=-1) - np.linalg.norm(
        grid.points((grid.rows - 1) / 2, middle) - track.middle
    )
    to_centre = np.linalg.norm(grid.points((grid.rows - 1) / 2, middle) - antenna, axis=-1)
    migration = (distance - to_centre - row_range[:, None, None]) / sensor.range_resolution
    return float(np.max(np.mean(phase**2 + (np.pi * migration) ** 2 / 3, axis=-1)))


def _columns(grid: Grid) -> F64:
    """Displacement from the middle of a row to each column, m, (cols, 3).

    A column is as far from a position as the middle of its row is from that position less this.
    """
    return (np.arange(grid.cols) - (grid.cols - 1) / 2)[:, None] * grid.col_spacing * grid.col_direction
