"""Time-domain backprojection: exact for any trajectory and any pixels; the reference for the fast image formers."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sal_height.geometry import Grid
from sal_height.imaging.weighting import Processing
from sal_height.numeric import (
    C64,
    F32,
    F64,
    I32,
    OVERSAMPLING,
    TAPS,
    WORKERS,
    Bool,
    compiled,
    cosine_and_sine,
    dense_profiles,
    tap_polynomials,
    tap_weights,
)
from sal_height.sensor import PhaseHistory, Sensor

PULSES_AT_ONCE = 16
"""Pulses whose dense profiles are held at a time: a few megabytes."""

PIXELS_OF_IMAGE = 3 * 2**15
"""Pixels that are summed up at a time, over all pulses: bounds the memory beside history and image."""

PIXELS_AT_ONCE = 4096
"""Pixels whose geometry is held at a time: what fits into a processor's cache."""


def backproject(history: PhaseHistory, antenna: F64, sensor: Sensor, processing: Processing, grid: Grid) -> C64:
    """Images of all detectors at the pixels of `grid`, (detectors, rows, cols); see `backproject_points`."""
    image = np.empty((len(history.samples), *grid.shape), dtype=np.complex64)
    rows = max(1, PIXELS_OF_IMAGE // grid.cols)
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
        history: of all detectors in a dwell, as fast-time frequencies.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength and frequencies.
        processing: windows, and the processed angle in stripmap.
        points: positions, m, shape (points, 3).
        direction: unit vector of flight, shape (3,); matters in stripmap only.

    Returns:
        Complex64, shape (detectors, points); NaN where a point leaves the range window in some pulse, and in stripmap
        where the pulses do not fill the processed angle.
    """
    along = points @ direction
    points = np.ascontiguousarray(points.T)
    detectors, pulses, frequencies = history.samples.shape
    image = np.zeros((points.shape[1], 2, detectors), dtype=np.float32)
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
    size = int(np.clip(math.ceil(points.shape[1] / WORKERS), 64, PIXELS_AT_ONCE))
    pieces = [slice(first, first + size) for first in range(0, points.shape[1], size)]
    with ThreadPoolExecutor(WORKERS) as pool:
        for first in range(0, pulses, PULSES_AT_ONCE):
            block = slice(first, first + PULSES_AT_ONCE)
            profiles = dense_profiles(history.samples[:, block], range_weights)

            def add(piece: slice, profiles: F32 = profiles, block: slice = block) -> None:
                _add_pulses(
                    points[:, piece].copy(), along[piece], track[block], profiles, taps, taper, scales,
                    image[piece], weight[piece], valid[piece],
                )  # fmt: skip

            list(pool.map(add, pieces))
    valid &= (weight > 0) & filled_apertures(points.T, antenna, direction, processing.angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        image /= np.where(valid, weight * frequencies, np.nan)[:, None, None].astype(np.float32)
    return _as_complex(image)


def filled_apertures(points: F64, antenna: F64, direction: F64, angle: float) -> Bool:
    """Whether the pulses reach from end to end of the processed angle of each point; (points,)."""
    ends = [
        (position - points) @ direction / np.linalg.norm(position - points, axis=-1) for position in antenna[[0, -1]]
    ]
    return np.asarray((np.minimum(*ends) <= -angle / 2) & (np.maximum(*ends) >= angle / 2)) if angle else np.array(True)


def valid_pixels(history: PhaseHistory, antenna: F64, sensor: Sensor, angle: float, grid: Grid) -> Bool:
    """Where `backproject` gives values and not NaN, (rows, cols), for the processed `angle` (rad; 0 in spotlight).

    Range grows with the rows, so that they are looked at from both ends, until one is within the window everywhere.
    """
    valid = np.ones(grid.shape, dtype=np.bool_)
    direction, cols = grid.col_direction, np.arange(grid.cols)
    if angle:
        first, last = (
            filled_apertures(grid.points(np.full(grid.cols, row), cols), antenna, direction, angle)
            for row in (0, grid.rows - 1)
        )
        valid &= first & last
        partly = np.flatnonzero(first != last)
        points = grid.points(np.arange(grid.rows)[:, None], partly).reshape(-1, 3)
        valid[:, partly] = filled_apertures(points, antenna, direction, angle).reshape(grid.rows, -1)
    track = np.column_stack([antenna, history.reference_range, antenna @ direction])
    spacing = abs(float((antenna[-1] - antenna[0]) @ direction)) / max(1, len(antenna) - 1)
    for rows in (range(grid.rows), reversed(range(grid.rows))):
        for row in rows:
            points, reached = grid.points(np.full(grid.cols, row), cols), np.ones(grid.cols, dtype=np.bool_)
            _reach(points.T.copy(), points @ direction, track, sensor.range_window / 2, angle, spacing, reached)
            if reached.all():
                break
            valid[row] &= reached
    return valid


def _as_complex(image: F32) -> C64:
    """(pixels, 2, detectors) reals to (detectors, pixels) complex."""
    result = np.empty((image.shape[2], image.shape[0]), dtype=np.complex64)
    result.real, result.imag = image[:, 0].T, image[:, 1].T
    return result


# The loops below are compiled. Each does one thing over all pixels of a piece, so that the compiler can vectorise it.


@compiled
def _add_pulses(
    points: F64,
    along: F64,
    track: F64,
    profiles: F32,
    taps: F32,
    taper: F32,
    scales: F64,
    image: F32,
    weight: F64,
    valid: Bool,
) -> None:
    """Add pulses to the image at some pixels.

    Args:
        points: x, y, z of the pixels, m, shape (3, pixels).
        along: place of the pixels along the flight, m, shape (pixels,).
        track: x, y, z of the antenna, reference range, place along the flight (m) and weight, shape (pulses, 6).
        profiles: of `dense_profiles`.
        taps: of `tap_polynomials`.
        taper: azimuth window over the processed angle in stripmap.
        scales: dense samples per m; dense sample of delay 0; turns per m; half the range window, m; processed angle,
            0 in spotlight; way from pulse to pulse, m.
        image: to add to, shape (pixels, 2, detectors).
        weight: sum of the azimuth weights, to add to, shape (pixels,).
        valid: set False where a profile does not reach.
    """
    count = points.shape[1]
    delay, gain = np.empty(count), np.empty(count, np.float32)
    sample, fraction = np.empty(count, np.int32), np.empty(count, np.float32)
    cosine, sine = np.empty(count, np.float32), np.empty(count, np.float32)
    for pulse in range(track.shape[0]):
        x, y, z, reference, place, pulse_weight = track[pulse]
        _delays(points[0], points[1], points[2], x, y, z, reference, delay)
        if scales[4] > 0:
            _angle_weights(delay, along, place, reference, scales[4], scales[5], taper, gain)
        else:
            gain[:] = pulse_weight
        _within(delay, gain, scales[3], weight, valid)
        _samples(delay, scales[0], scales[1], scales[3], sample, fraction)
        _phasors(delay, scales[2], gain, cosine, sine)
        tap = tap_weights(fraction, taps)
        if image.shape[2] == 1:
            _add_one(sample, tap, cosine, sine, profiles[pulse], image)
        else:
            _add_all(sample, tap, cosine, sine, profiles[pulse], image)


@compiled
def _delays(px: F64, py: F64, pz: F64, x: float, y: float, z: float, reference: float, delay: F64) -> None:
    for i in range(delay.size):
        dx, dy, dz = px[i] - x, py[i] - y, pz[i] - z
        delay[i] = math.sqrt(dx * dx + dy * dy + dz * dz) - reference


@compiled
def _angle_weights(
    delay: F64,
    along: F64,
    place: float,
    reference: float,
    angle: float,
    spacing: float,
    taper: F32,
    gain: F32,
) -> None:
    """As `Processing.angle_weights`, for the pulse at `place` along the flight."""
    last = taper.size - 1
    for i in range(delay.size):
        distance = delay[i] + reference
        sine = (place - along[i]) / distance
        position = min(max((sine / angle + 0.5) * last, 0.0), float(last))
        node = min(int(position), last - 1)
        part = np.float32(position - node)
        share = min(max((angle / 2 - abs(sine)) * distance / spacing + 0.5, 0.0), 1.0)
        gain[i] = np.float32(share) * (taper[node] + part * (taper[node + 1] - taper[node]))


@compiled
def _within(delay: F64, gain: F32, half_window: float, weight: F64, valid: Bool) -> None:
    for i in range(delay.size):
        weight[i] += gain[i]
        valid[i] &= (abs(delay[i]) <= half_window) or (gain[i] == 0)


@compiled
def _reach(
    points: F64, along: F64, track: F64, half_window: float, angle: float, spacing: float, reached: Bool
) -> None:
    """Set `reached` False where, in a pulse of its aperture, a point is beyond the range window; as `_within`."""
    delay = np.empty(along.size)
    for pulse in range(track.shape[0]):
        x, y, z, reference, place = track[pulse]
        _delays(points[0], points[1], points[2], x, y, z, reference, delay)
        for i in range(delay.size):
            distance = delay[i] + reference
            share = (angle / 2 - abs((place - along[i]) / distance)) * distance / spacing + 0.5
            reached[i] &= (abs(delay[i]) <= half_window) or (angle > 0 and share <= 0)


@compiled
def _samples(delay: F64, per_metre: float, middle: float, half_window: float, sample: I32, fraction: F32) -> None:
    """Index of the first tap, and the fraction of a sample by which the delay lies past its sample."""
    for i in range(delay.size):
        position = min(max(delay[i], -half_window), half_window) * per_metre + middle
        before = min(np.floor(position), 2 * middle - 1)  # the end of the window is the last sample's, not one beyond
        sample[i] = np.int32(before) + 1
        fraction[i] = np.float32(position - before)


@compiled
def _phasors(delay: F64, turns_per_metre: float, gain: F32, cosine: F32, sine: F32) -> None:
    for i in range(delay.size):
        c, s = cosine_and_sine(delay[i] * turns_per_metre)
        cosine[i], sine[i] = gain[i] * c, gain[i] * s


@compiled
def _add_one(sample: I32, tap: F32, cosine: F32, sine: F32, profile: F32, image: F32) -> None:
    """Add a pulse of a single detector."""
    for i in range(sample.size):
        first = sample[i]
        real, imaginary = np.float32(0), np.float32(0)
        for j in range(TAPS):
            real += tap[j, i] * profile[first + j, 0, 0]
            imaginary += tap[j, i] * profile[first + j, 1, 0]
        image[i, 0, 0] += real * cosine[i] - imaginary * sine[i]
        image[i, 1, 0] += real * sine[i] + imaginary * cosine[i]


@compiled
def _add_all(sample: I32, tap: F32, cosine: F32, sine: F32, profile: F32, image: F32) -> None:
    """Add a pulse of many detectors: first interpolate all real and imaginary parts, then turn them."""
    detectors = image.shape[2]
    flat_profile, flat_image = profile.reshape(-1, 2 * detectors), image.reshape(-1, 2 * detectors)
    value = np.empty(2 * detectors, np.float32)
    for i in range(sample.size):
        first = sample[i]
        a, b, c = flat_profile[first], flat_profile[first + 1], flat_profile[first + 2]
        d, e, f = flat_profile[first + 3], flat_profile[first + 4], flat_profile[first + 5]
        ta, tb, tc, td, te, tf = tap[0, i], tap[1, i], tap[2, i], tap[3, i], tap[4, i], tap[5, i]
        for k in range(2 * detectors):
            value[k] = ta * a[k] + tb * b[k] + tc * c[k] + td * d[k] + te * e[k] + tf * f[k]
        total, turn, lift = flat_image[i], cosine[i], sine[i]
        for k in range(detectors):
            total[k] += value[k] * turn - value[detectors + k] * lift
            total[detectors + k] += value[k] * lift + value[detectors + k] * turn
