"""Fast spotlight image former: dechirp to the scene, transform range, transform azimuth (spectral analysis, SPECAN).

Within a spotlight dwell that is short against the range, a target's phase from pulse to pulse is that of the middle of
its row plus a term linear in the antenna's position (Cumming & Wong, Digital Processing of SAR Data, 2005, chapter 9).
The first is removed exactly, whatever the track; a chirp z-transform of each row, with the row's own scale, sorts the
second into columns. The error of this approximation is known before anything is computed: `expected_error`.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from sal_height.geometry import Grid
from sal_height.imaging.formers.backprojection import blank_invalid
from sal_height.imaging.formers.straight_track import straight_track
from sal_height.imaging.pixels import Processing
from sal_height.numeric import (
    C64,
    F64,
    ChirpZ,
    blocks,
    chirp_z,
    in_threads,
    outer_phasors,
    rows_at_once,
    unit_phasors,
)
from sal_height.sensor import PhaseHistory, Sensor


def focus_spotlight(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Images of all detectors, (detectors, rows, cols); parameters and result as of `backprojection.backproject`."""
    by_range, by_azimuth = transforms(history, antenna, sensor, processing, grid)
    image = np.empty((len(history.samples), *grid.shape), dtype=np.complex64)
    in_threads(lambda samples, made: _focus(samples, by_range, by_azimuth, made), history.samples, image)
    blank_invalid(image, history, antenna, sensor, processing, grid)
    return image


def _focus(samples: C64, by_range: ChirpZ, by_azimuth: ChirpZ, image: C64) -> None:
    """Focus one detector: range, corner turn, azimuth."""
    compressed = np.empty((len(image), len(samples)), dtype=np.complex64)
    by_range.fill_columns(samples, compressed)
    by_azimuth.fill_rows(compressed, image)


def transforms(
    history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid
) -> tuple[ChirpZ, ChirpZ]:
    """Transforms of the pulses to rows and of the rows to columns, the same for all detectors."""
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
    along = (np.arange(grid.cols) - middle[1])[:, None] * grid.col_step

    def add_phases(rows: slice) -> None:
        to_pulses = cdist(middles[rows], antenna) - to_centre
        by_azimuth.before[rows] *= unit_phasors(sensor.centre_wavenumber * to_pulses)
        # A row bows: over its columns, the range from the middle of the track is not that of its middle.
        row_middle = np.linalg.norm(middles[rows] - track.middle, axis=-1)
        bow = cdist(middles[rows], track.middle - along) - row_middle[:, None]
        by_azimuth.after[rows] *= unit_phasors(sensor.centre_wavenumber * bow)

    in_threads(add_phases, blocks(grid.rows, rows_at_once(max(pulses, grid.cols))))
    return ChirpZ(dechirp, by_range.spectrum, by_range.after), by_azimuth


def _rows(antenna: F64, grid: Grid) -> tuple[F64, F64]:
    """Range (m) of the middle of every row, and -d^2 range / (d column d antenna) along the track, 1/m: (rows,)."""
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
    middle = (grid.rows - 1) / 2, (grid.cols - 1) / 2
    track = straight_track(antenna, grid.col_direction)
    scale = np.interp(rows, np.arange(grid.rows), _rows(antenna, grid)[1])
    pixels, middles = grid.points(rows[:, None], cols), grid.points(rows, np.full(5, middle[1]))
    distance = np.linalg.norm(pixels[:, :, None] - antenna, axis=-1)
    # The distance that the former uses: that of the row's middle, its bow, and a term linear in both positions.
    row_range = np.linalg.norm(middles - track.middle, axis=-1)
    bow = np.linalg.norm(pixels - track.middle, axis=-1) - row_range[:, None]
    places = scale[:, None] * (cols - middle[1]) * grid.col_spacing
    model = cdist(middles, antenna)[:, None] + bow[..., None] - places[..., None] * track.even
    phase = sensor.centre_wavenumber * (distance - model)
    # The range that it uses: that of the scene's middle in every pulse, and even steps from row to row.
    centre = grid.points(*middle)
    nominal = np.linalg.norm(centre - antenna, axis=-1) - np.linalg.norm(centre - track.middle)
    migration = (distance - nominal - row_range[:, None, None]) / sensor.range_resolution
    return float(np.max(np.mean(phase**2 + (np.pi * migration) ** 2 / 3, axis=-1)))
