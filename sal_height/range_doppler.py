"""Fast stripmap image former: the range-Doppler algorithm (Cumming & Wong, Digital Processing of SAR Data, 2005).

Motion compensation to the middle of the image, and even steps along the track; azimuth FFT; in the two-dimensional
spectrum the exact migration and secondary compression of the middle range; range compression onto a scale that
stretches with Doppler, which corrects the migration of the other ranges; for each row the matched filter in azimuth;
inverse FFT.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from sal_height.backprojection import filled_apertures
from sal_height.chirp_z import ChirpZ, chirp_z
from sal_height.compiled import WORKERS
from sal_height.errors import UserError
from sal_height.fft import Rows
from sal_height.geometry import Grid
from sal_height.phase_history import PhaseHistory
from sal_height.phasors import phasors
from sal_height.processing import Processing
from sal_height.sensor import Sensor
from sal_height.straight_track import Resampling, resampling, straight_track

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

ROWS_AT_ONCE = 32
"""Rows that are transformed at a time: what fits into a processor's cache."""

EVEN_PHASE = 0.003
"""Greatest phase (rad) that a pulse off its even place may make at the edge of the aperture, without resampling."""


@dataclass(frozen=True)
class _Filters:
    """What is multiplied into the data of every detector alike.

    Attributes:
        compensation: of motion, with the range window, (pulses, frequencies).
        resampling: to even steps; None: they are even.
        places: number of even places.
        range: from frequency to rows, for each Doppler: `before` of shape (length, frequencies).
        azimuth: matched filter of each row over Doppler, (rows, length).
        fold: Doppler spectra that fall together where columns are that many steps apart.
    """

    compensation: ComplexArray
    resampling: Resampling | None
    places: int
    range: ChirpZ
    azimuth: ComplexArray
    fold: int


def focus_stripmap(
    history: PhaseHistory, antenna: Array, sensor: Sensor, processing: Processing, grid: Grid
) -> ComplexArray:
    """Images of all detectors, (detectors, rows, cols); parameters and result as of `backprojection.backproject`.

    Raises:
        UserError: columns so close that the pulses do not sample them.
    """
    filters = _filters(history, antenna, sensor, processing, grid)
    image = np.empty((len(history.samples), *grid.shape), dtype=np.complex64)
    parts = [range(first, len(image), WORKERS) for first in range(min(WORKERS, len(image)))]
    with ThreadPoolExecutor(WORKERS) as pool:
        list(pool.map(lambda detectors: _focus(history.samples, filters, image, detectors), parts))
    edges = grid.points(np.array([0, grid.rows - 1])[:, None], np.arange(grid.cols)).reshape(-1, 3)
    complete = filled_apertures(edges, antenna, grid.col_direction, processing.angle).reshape(2, -1).all(axis=0)
    image[:, :, ~complete] = np.nan
    image[:, ~_within_window(history, antenna, sensor, processing, grid)] = np.nan
    return image


def _within_window(
    history: PhaseHistory, antenna: Array, sensor: Sensor, processing: Processing, grid: Grid
) -> npt.NDArray[np.bool_]:
    """Where a pixel is within the range window at the ends and in the middle of its aperture, (rows, cols)."""
    track = np.column_stack([antenna, history.reference_range])
    first_row = grid.points(0.0, np.arange(grid.cols))
    down = (grid.row_spacing * np.arange(grid.rows))[:, None]
    reach = processing.angle / 2 * float(np.linalg.norm(grid.points(grid.rows - 1.0, 0.0) - antenna.mean(axis=0)))
    within = np.ones(grid.shape, dtype=np.bool_)
    for ahead in (-reach, 0.0, reach):
        places = first_row @ grid.col_direction + ahead
        there = np.stack([np.interp(places, antenna @ grid.col_direction, axis) for axis in track.T], axis=-1)
        sight = first_row - there[:, :3]
        distance = np.sqrt(np.sum(sight**2, axis=-1) + down * (down + 2 * (sight @ grid.row_direction)))
        within &= np.abs(distance - there[:, 3]) <= sensor.range_window / 2
    return within


def _focus(samples: ComplexArray, filters: _Filters, image: ComplexArray, detectors: range) -> None:
    """Focus some detectors, one after the other."""
    rows, cols = image.shape[1:]
    frequencies, length = samples.shape[2], filters.azimuth.shape[1]
    along, across = Rows(ROWS_AT_ONCE, length), Rows(ROWS_AT_ONCE, filters.range.length)
    folded = Rows(ROWS_AT_ONCE, length // filters.fold)
    doppler = np.empty((length, frequencies), dtype=np.complex64)
    compressed = np.empty((rows, length), dtype=np.complex64)
    for detector in detectors:
        pulses = samples[detector] * filters.compensation
        if filters.resampling:
            pulses = filters.resampling.apply(pulses)
        for block in _blocks(frequencies):
            along.data[: block.stop - block.start, : filters.places] = pulses[:, block].T
            along.data[:, filters.places :] = 0
            along.forward()
            doppler[:, block] = along.data[: block.stop - block.start].T
        for block in _blocks(length):
            lines = across.data[: block.stop - block.start]
            np.multiply(doppler[block], filters.range.before[block], out=lines[:, :frequencies])
            across.data[:, frequencies:] = 0
            across.forward()
            lines *= filters.range.spectrum[block]
            across.backward()
            lines[:, :rows] *= filters.range.after[block]
            compressed[:, block] = lines[:, :rows].T
        for block in _blocks(rows):
            spectrum = compressed[block] * filters.azimuth[block]
            np.sum(
                spectrum.reshape(len(spectrum), filters.fold, -1), axis=1, out=folded.data[: block.stop - block.start]
            )
            folded.backward()
            image[detector, block] = folded.data[: block.stop - block.start, :cols]


def _blocks(count: int) -> list[slice]:
    return [slice(first, min(first + ROWS_AT_ONCE, count)) for first in range(0, count, ROWS_AT_ONCE)]


def _filters(history: PhaseHistory, antenna: Array, sensor: Sensor, processing: Processing, grid: Grid) -> _Filters:
    pulses, frequencies = history.samples.shape[1:]
    track = straight_track(antenna, grid.col_direction)
    fold = max(1, round(grid.col_spacing / track.spacing))
    step = grid.col_spacing / fold
    across = grid.points(np.arange(grid.rows), np.zeros(grid.rows)) - track.middle
    first_column = float(across[0] @ track.direction)
    across -= (across @ track.direction)[:, None] * track.direction
    distance = np.linalg.norm(across, axis=-1)
    middle = float(distance[0] + distance[-1]) / 2
    half_aperture = processing.angle * float(distance.max()) / 2
    if step > np.pi / (sensor.centre_wavenumber * processing.angle / 2) * (1 + 1e-9):
        raise UserError(
            f"Pulses are {step:.3g} m apart; an aperture of {processing.angle:.3g} rad needs one every "
            f"{np.pi / (sensor.centre_wavenumber * processing.angle / 2):.3g} m: raise the pulse repetition frequency."
        )
    # Motion compensation: every pulse as if sent from the straight track, for the middle range abeam of it.
    aim = track.middle + track.places[:, None] * track.direction + across[0] / distance[0] * middle
    delay = np.linalg.norm(aim - antenna, axis=-1) - history.reference_range
    wavenumber = sensor.centre_wavenumber + sensor.wavenumber_step * (np.arange(frequencies) - frequencies // 2)
    compensation = phasors(delay[:, None] * wavenumber)
    compensation *= (processing.range_weights(frequencies) / frequencies).astype(np.float32)
    # Even steps, on which columns fall, and as many as a transform without wrap-around takes.
    begin = track.places.min()
    places = int(np.ceil((track.places.max() - begin) / step - 1e-6)) + 1
    wanted = begin + step * np.arange(places)
    off = np.abs(wanted[:pulses] - track.places[: len(wanted)]).max() if places == pulses else np.inf
    even = off * sensor.centre_wavenumber * processing.angle / 2 < EVEN_PHASE
    length = fold * int(scipy.fft.next_fast_len(int(np.ceil((places + half_aperture / step) / fold))))
    doppler = 2 * np.pi * scipy.fft.fftfreq(length, step)
    # Two-dimensional spectrum of the middle range, less its phase without migration (stationary phase).
    root = np.sqrt(wavenumber**2 - doppler[:, None] ** 2)
    migration = -middle * doppler[:, None] ** 2 / (wavenumber + root)
    central = migration[:, frequencies // 2]
    stretch = sensor.centre_wavenumber / root[:, frequencies // 2]
    row_step = (distance[-1] - distance[0]) / max(1, grid.rows - 1)
    scaled = chirp_z(
        sensor.wavenumber_step * row_step * stretch, frequencies, frequencies // 2, grid.rows, (grid.rows - 1) / 2
    )
    scaled.before[...] *= phasors(migration)
    # By whole steps the replica is shifted in its spectrum, by the rest where it is made: its ends are sharp.
    whole = step * round((first_column - begin) / step)
    azimuth = _azimuth_filters(sensor, processing, distance, middle, step, length, begin + whole - first_column)
    azimuth *= phasors(doppler * whole - central)
    return _Filters(compensation, None if even else resampling(track.places, wanted), places, scaled, azimuth, fold)


def _azimuth_filters(
    sensor: Sensor, processing: Processing, distance: Array, middle: float, step: float, length: int, shift: float
) -> ComplexArray:
    """Spectra of the matched filters in azimuth for rows at `distance` (m), over the sum of their weights.

    Their samples are `shift` (m) off whole steps from the target.

    Made in time, with the weight that backprojection gives to each angle, so that both filters are the same.
    """
    place = step * length * scipy.fft.fftfreq(length) + shift
    slant = np.sqrt(distance[:, None] ** 2 + place**2)
    weight = processing.angle_weights(place / slant, step / slant)
    replica = phasors(-sensor.centre_wavenumber * (slant - middle))
    replica *= (weight / (weight.sum(axis=-1, keepdims=True) * length)).astype(np.float32)
    return np.asarray(scipy.fft.fft(replica, axis=-1, overwrite_x=True, workers=WORKERS)).conj()
