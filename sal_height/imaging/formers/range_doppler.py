"""Fast stripmap image former: the range-Doppler algorithm (Cumming & Wong, Digital Processing of SAR Data, 2005).

Motion compensation to the middle of the image, and even steps along the track; azimuth FFT; in the two-dimensional
spectrum the exact migration and secondary compression of the middle range; range compression onto a scale that
stretches with Doppler, which corrects the migration of the other ranges; for each row the matched filter in azimuth;
inverse FFT.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.constants import speed_of_light
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from sal_height.errors import UserError
from sal_height.geometry import Grid
from sal_height.imaging.formers._kernels import fill_folded, fill_replica
from sal_height.imaging.formers.backprojection import blank_invalid
from sal_height.imaging.formers.straight_track import StraightTrack, resampling, straight_track
from sal_height.imaging.pixels import Processing
from sal_height.numeric import (
    C64,
    F64,
    LARGEST,
    CentredSums,
    ChirpZ,
    blocks,
    chirp_z,
    fast_length,
    in_threads,
    outer_phasors,
    rows_at_once,
    unit_phasors,
)
from sal_height.sensor import PhaseHistory, Sensor, processed_angle

WIDEST_SINE = 0.9
"""Sine of the angle off abeam up to which Dopplers are processed, at the lowest frequency of the band.

Beyond 1 waves are evanescent and migration has no real value. Pulses closer than a quarter of the wavelength sample
such Dopplers too; no antenna sends there, so their filters are 0.
"""


@dataclass(frozen=True)
class Filters:
    """Filters for the data of every detector.

    Attributes:
        compensation: compensation of motion, with the range window, a factor of shape (pulses, frequencies).
        resampling: matrix from pulses to even steps; None: they are even.
        range: transform from frequency to rows, for each Doppler or one for all.
        compensated: product of that transform and the compensation, if all Dopplers share one and pulses are even;
            else None.
        azimuth: matched filter of each row over Doppler, (rows, length).
        fold: number of Doppler spectra that coincide, equal to that of steps between columns.
    """

    compensation: C64
    resampling: csr_array | None
    range: ChirpZ | CentredSums
    compensated: ChirpZ | CentredSums | None
    azimuth: C64
    fold: int


def focus_stripmap(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Images of all detectors, (detectors, rows, cols); parameters and result as of `backprojection.backproject`.

    Raises:
        UserError: pulses so far apart that they do not sample the processed aperture.
    """
    filters = filters_of(history, antenna, sensor, processing, grid)
    image = np.empty((len(history.samples), *grid.shape), dtype=np.complex64)

    def focus(detectors: slice) -> None:
        for samples, made in zip(history.samples[detectors], image[detectors], strict=True):
            _focus(samples, filters, made)

    in_threads(focus, blocks(len(image), max(1, 2**19 // history.samples[0].size)))  # fewer are not worth a thread
    blank_invalid(image, history, antenna, sensor, processing, grid)
    return image


def _focus(samples: C64, filters: Filters, image: C64) -> None:
    """Focus one detector."""
    (rows, cols), length = image.shape, filters.azimuth.shape[1]
    range_is_first = filters.range.is_common
    compressed = _range_first(samples, filters) if range_is_first else _doppler_first(samples, filters)
    for block in blocks(rows, rows_at_once(length)):
        doppler = scipy.fft.fft(compressed[block], length) if range_is_first else compressed[block]
        spectra = np.empty((block.stop - block.start, length // filters.fold), dtype=np.complex64)
        fill_folded(doppler, filters.azimuth[block], spectra)
        image[block] = scipy.fft.ifft(spectra, norm="forward", overwrite_x=True)[:, :cols]


def _range_first(samples: C64, filters: Filters) -> C64:
    """The rows of every even step along the track, (rows, steps), if range does not depend on Doppler."""
    if filters.compensated:
        pulses, to_rows = samples, filters.compensated
    else:
        pulses, to_rows = _resampled(samples * filters.compensation, filters), filters.range
    compressed = np.empty((len(filters.azimuth), len(pulses)), dtype=np.complex64)
    to_rows.fill_columns(pulses, compressed)
    return compressed


def _doppler_first(samples: C64, filters: Filters) -> C64:
    """Doppler spectra of the rows, (rows, length), from the range spectra of every Doppler."""
    frequencies, (rows, length) = samples.shape[1], filters.azimuth.shape
    doppler = np.empty((length, frequencies), dtype=np.complex64)
    compressed = np.empty((rows, length), dtype=np.complex64)
    for block in blocks(frequencies, rows_at_once(length)):
        pulses = _resampled(samples[:, block] * filters.compensation[:, block], filters)
        doppler[:, block] = scipy.fft.fft(pulses, length, axis=0)
    filters.range.fill_columns(doppler, compressed)
    return compressed


def _resampled(pulses: C64, filters: Filters) -> C64:
    """Pulses at even steps, from shape (pulses, numbers) to (steps, numbers)."""
    if filters.resampling is None:
        return pulses
    return np.asarray(filters.resampling @ pulses.view(np.float32)).view(np.complex64)


@dataclass(frozen=True, eq=False)
class _Layout:
    """Rows of the image, even steps along the track, and their Dopplers.

    Attributes:
        track: straight track nearest to the antenna's.
        step: distance between even steps, on which columns fall, m.
        fold: number of steps from column to column.
        abeam: vector from the track to the first row, square to the track, m, shape (3,).
        distance: distance of each row from the track, m, shape (rows,).
        first_column: position of the first column along the track, m.
        places: positions of the even steps along the track, m, shape (steps,).
        doppler: Dopplers of a transform in which only columns that have no whole aperture wrap around, in the order of
            an FFT, rad/m, shape (length,).
    """

    track: StraightTrack
    step: float
    fold: int
    abeam: F64
    distance: F64
    first_column: float
    places: F64
    doppler: F64

    @property
    def middle(self) -> float:
        """Distance (m) in the middle of the rows."""
        return float(self.distance[0] + self.distance[-1]) / 2


def filters_of(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> Filters:
    """Filters of all stages.

    Raises:
        UserError: pulses so far apart that they do not sample the processed aperture.
    """
    layout = _lay_out(antenna, sensor, processing, grid)
    frequencies = history.samples.shape[2]
    wavenumber = sensor.centre_wavenumber + sensor.wavenumber_step * (np.arange(frequencies) - frequencies // 2)
    widest = WIDEST_SINE * wavenumber[0]
    doppler = np.clip(layout.doppler, -widest, widest)
    azimuth = _azimuth_filters(sensor, processing, layout)
    azimuth[:, doppler != layout.doppler] = 0
    compensation = _motion_compensation(history, antenna, processing, wavenumber, layout)
    to_rows, is_even = (
        _range_transform(sensor, processing, wavenumber, layout, doppler),
        _is_even(sensor, processing, layout),
    )
    return Filters(
        compensation=compensation,
        resampling=None if is_even else resampling(layout.track.places, layout.places),
        range=to_rows,
        compensated=to_rows.times(compensation) if is_even and to_rows.is_common else None,
        azimuth=azimuth,
        fold=layout.fold,
    )


def _lay_out(antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> _Layout:
    track = straight_track(antenna, grid.col_direction)
    # Steps may be 1.02 times the pulse spacing: coarser ones would make ambiguities.
    fold = max(1, int(np.ceil(grid.col_spacing / (1.02 * track.spacing))))
    step = grid.col_spacing / fold
    widest_step = np.pi / (sensor.centre_wavenumber * processing.angle / 2)
    if step > widest_step * (1 + 1e-9):
        raise UserError(
            f"Pulses are {step:.3g} m apart; an aperture of {processing.angle:.3g} rad needs one every "
            f"{widest_step:.3g} m: raise the pulse repetition frequency."
        )
    across = grid.points(np.arange(grid.rows), np.zeros(grid.rows)) - track.middle
    first_column = float(across[0] @ track.direction)
    across -= (across @ track.direction)[:, None] * track.direction
    distance = np.linalg.norm(across, axis=-1)
    steps = int(np.ceil((track.places.max() - track.places.min()) / step - 1e-6)) + 1
    places = track.places.min() + step * np.arange(steps)
    length = fold * fast_length(max(grid.cols, -(-steps // fold)))
    doppler = 2 * np.pi * scipy.fft.fftfreq(length, step)
    return _Layout(track, step, fold, across[0], distance, first_column, places, doppler)


def _motion_compensation(
    history: PhaseHistory, antenna: F64, processing: Processing, wavenumber: F64, layout: _Layout
) -> C64:
    """Turn every pulse as if sent from the straight track, for the middle range abeam of it; with the range window."""
    track = layout.track
    abeam = layout.abeam / layout.distance[0] * layout.middle
    aim = track.middle + track.places[:, None] * track.direction + abeam
    delay = np.linalg.norm(aim - antenna, axis=-1) - history.reference_range
    compensation = outer_phasors(delay, wavenumber)
    compensation *= (processing.range_weights(len(wavenumber)) / len(wavenumber)).astype(np.float32)
    return compensation


def _is_even(sensor: Sensor, processing: Processing, layout: _Layout) -> bool:
    """True if pulses are so near to even steps that they need not be resampled."""
    pulses, steps = layout.track.places, layout.places
    edge = sensor.centre_wavenumber * processing.angle / 2
    # 0.003 rad of a pulse off its even position, at the edge of the aperture, are allowed.
    return len(pulses) == len(steps) and bool(np.abs(steps - pulses).max() * edge < 0.003)


def _range_transform(
    sensor: Sensor, processing: Processing, wavenumber: F64, layout: _Layout, doppler: F64
) -> ChirpZ | CentredSums:
    """Transform from frequencies to rows for each Doppler, or one for all if those processed hardly differ.

    It removes the migration and secondary compression of the middle range (stationary phase), and stretches range
    with Doppler, which corrects the migration of the other ranges.
    """
    rows, frequencies, central = len(layout.distance), len(wavenumber), sensor.centre_wavenumber
    row_step = (layout.distance[-1] - layout.distance[0]) / max(1, rows - 1)
    stretch = central / np.sqrt(central**2 - doppler**2)
    scale = sensor.wavenumber_step * row_step * stretch
    processed = np.abs(doppler) <= central * processing.angle / 2
    # Phase (rad) by which Dopplers may differ, in migration or scale of range, and be treated alike.
    small_phase = 0.001
    if np.ptp(scale[processed]) * frequencies / 2 * rows / 2 < small_phase:
        scale = scale[:1]
    edges = _migration(layout.middle, doppler[processed], wavenumber[[0, -1]], central)
    still = bool(np.abs(edges).max() < small_phase)
    if still and len(scale) == 1 and frequencies * rows <= LARGEST:
        return CentredSums.of(float(scale[0]), frequencies, rows)
    scaled = chirp_z(scale, frequencies, frequencies // 2, rows, (rows - 1) / 2)
    if still:
        return scaled
    before = scaled.before * unit_phasors(_migration(layout.middle, doppler, wavenumber, central))
    return ChirpZ(before, scaled.spectrum, scaled.after)


def _migration(distance: float, doppler: F64, wavenumber: F64, central: float) -> F64:
    """Phase (rad) of the matched filter of migration at `distance` (m), less that at the `central` wavenumber.

    Shape (doppler, wavenumber); all of them in rad/m.
    """
    square = doppler[:, None] ** 2
    phase = square / (wavenumber + np.sqrt(wavenumber**2 - square)) - square / (central + np.sqrt(central**2 - square))
    return -distance * phase


def _azimuth_filters(sensor: Sensor, processing: Processing, layout: _Layout) -> C64:
    """Spectra of the matched filters in azimuth of all rows, over the sum of their weights, shape (rows, length).

    Made in time, with the weight that backprojection gives to each angle, so that both filters are the same. They lead
    from the first step to the first column: by whole steps the replica is shifted in its spectrum, by the rest in time,
    because its ends are sharp.
    """
    step, distance, length = layout.step, layout.distance, len(layout.doppler)
    begin = layout.track.places.min()
    whole = step * round((layout.first_column - begin) / step)
    place = step * length * scipy.fft.fftfreq(length) + (begin + whole - layout.first_column)
    near = np.flatnonzero(np.abs(place) <= processing.angle / 2 * distance.max() * 1.01 + step)
    scales = np.array([processing.angle, step, sensor.centre_wavenumber / (2 * np.pi), layout.middle])
    taper, shift = processing.taper(), unit_phasors(layout.doppler * whole)
    spectra = np.empty((len(distance), length), dtype=np.complex64)

    def fill(block: slice) -> None:
        replica = np.zeros((block.stop - block.start, length), dtype=np.complex64)
        fill_replica(distance[block], place[near], near, taper, scales, replica)
        found = scipy.fft.fft(replica, overwrite_x=True)
        np.multiply(np.conjugate(found, out=found), shift, out=spectra[block])

    in_threads(fill, blocks(len(distance), rows_at_once(length)))
    return spectra


def keeps_sidelobes(antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> bool:
    """True if sidelobes far along the track have the positions of backprojection, or are too low to matter.

    They are corrected for the migration of their own position, not of their target, and the azimuth window is that of
    the middle frequency at all others. Both matter where targets migrate by cells: with a rectangular window, or in a
    band that is wide for its carrier. Measured against backprojection on targets that migrate by 0.5 to 6 cells, with
    tapered windows: -42 to -48 dB in a band of 0.03 of the carrier, -34 to -39 dB of 0.1.
    """
    farthest = float(np.linalg.norm(grid.points(grid.rows - 1, (grid.cols - 1) / 2) - antenna.mean(axis=0)))
    migration = farthest * (1 / np.cos(processing.angle / 2) - 1)
    strong = processing.azimuth_window == "rectangular" or sensor.bandwidth > 0.05 * speed_of_light / sensor.wavelength
    return bool(migration <= 0.2 * sensor.range_resolution) or not strong


def expected_error(antenna: F64, sensor: Sensor, grid: Grid) -> float:
    """Power of the difference to backprojection over that of the image, by geometry; the worst of 25 pixels.

    It is a mean over 128 to 256 pulses: errors that are random from pulse to pulse are then known to a fifth, 1 dB. As
    of `specan.expected_error`: the residual motion of the pulses in a pixel's aperture, and the offsets of rows from
    even steps of range, and of pulses from even steps of the track. Sidelobes far along the track, which are elsewhere
    where targets migrate by cells, add -40 dB if the azimuth window has low ones and -25 dB if it is rectangular.
    Infinite where the processed angle reaches beyond WIDEST_SINE.
    """
    angle = processed_angle(sensor)
    lowest = sensor.centre_wavenumber - sensor.wavenumber_step * (sensor.sample_count // 2)
    if sensor.centre_wavenumber * angle / 2 > WIDEST_SINE * lowest:
        return np.inf
    track = straight_track(antenna, grid.col_direction)
    rows, cols = (np.linspace(0, n - 1, 5) for n in grid.shape)
    pixels = grid.points(rows[:, None], cols)[:, :, None]
    across = grid.points(np.array([0, *rows, grid.rows - 1]), np.zeros(7)) - track.middle
    across -= (across @ track.direction)[:, None] * track.direction
    first, *distance, last = np.linalg.norm(across, axis=-1)
    middle = (first + last) / 2
    some = slice(None, None, max(1, len(antenna) // 128))
    sent_from, places = antenna[some], track.places[some]
    aim = track.middle + places[:, None] * track.direction + across[0] / first * middle
    seen = cdist(pixels.reshape(-1, 3), sent_from).reshape(5, 5, -1)
    along = (pixels - track.middle) @ track.direction - places
    straight = np.sqrt(np.square(distance)[:, None, None] + along**2)
    left = seen - (np.linalg.norm(aim - sent_from, axis=-1) - middle) - straight
    off = np.array(distance) - np.linspace(first, last, 5)
    error = (sensor.centre_wavenumber * left) ** 2
    error += (np.pi / sensor.range_resolution * (left + off[:, None, None])) ** 2 / 3
    within = np.abs(along) <= angle / 2 * seen
    count = np.maximum(1, np.sum(within, axis=-1, keepdims=True))
    # Even steps weigh a pulse by its distance to the next; backprojection weighs all pulses alike.
    steps = np.gradient(track.places)[some] * np.ones_like(seen)
    mean_step = np.sum(steps * within, axis=-1, keepdims=True) / count
    error += (steps / np.where(mean_step, mean_step, np.inf) - 1) ** 2
    return float(np.max(np.sum(error * within, axis=-1, keepdims=True) / count))
