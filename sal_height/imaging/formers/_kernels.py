"""Loops of the image formers, compiled; a test compares each with its formula in NumPy.

Each does one thing over all pixels of a piece, so that the compiler can vectorise it.
"""

from __future__ import annotations

import math

import numpy as np

from sal_height.numeric import (
    C64,
    F32,
    F64,
    I32,
    TAPS,
    Bool,
    Index,
    compiled,
    cosine_and_sine,
    cosine_and_sine_of_part,
    tap_weights,
)

SURELY_WITHIN = 1 - 1e-6  # share of the range window within which rounding does not matter

LEAST_RUN = 64  # pixels that read the same samples, in the mean, from which on they are worth a loop of their own

PIXELS_AT_ONCE = 1024  # whose geometry a processor's fastest caches hold


@compiled
def add_pulses(
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
        profiles: of `dense_profiles`, real and imaginary parts apart, shape (pulses, dense samples, 2, detectors).
        taps: of `tap_polynomials`.
        taper: azimuth window over the processed angle in stripmap.
        scales: dense samples per m; dense sample of delay 0; turns per m; half the range window, m; processed angle,
            0 in spotlight; way from pulse to pulse, m.
        image: to add to, real and imaginary parts apart, shape (detectors, 2, pixels).
        weight: sum of the azimuth weights, to add to, shape (pixels,).
        valid: set False where a profile does not reach.
    """
    for first in range(0, along.size, PIXELS_AT_ONCE):
        part = slice(first, min(first + PIXELS_AT_ONCE, along.size))
        _add_pulses_to_part(
            points[0, part], points[1, part], points[2, part], along[part], track, profiles, taps, taper, scales,
            image[:, :, part], weight[part], valid[part],
        )  # fmt: skip


@compiled
def _add_pulses_to_part(
    px: F64,
    py: F64,
    pz: F64,
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
    """As `add_pulses`, for a few pixels, whose sums over the pulses are made in memory of their own.

    Runs are added along the pixels, and scattered pixels along the detectors.
    """
    count = along.size
    delay, gain = np.empty(count), np.empty(count, np.float32)
    sample, fraction = np.empty(count, np.int32), np.empty(count, np.float32)
    cosine, sine = np.empty(count, np.float32), np.empty(count, np.float32)
    sums, by_pixel = np.zeros(image.shape, np.float32), np.zeros((count, 2, len(image)), np.float32)
    scattered = False
    for pulse in range(track.shape[0]):
        x, y, z, reference, place, pulse_weight = track[pulse]
        _delays(px, py, pz, x, y, z, reference, delay)
        if scales[4] > 0:
            _angle_weights(delay, along, place, reference, scales[4], scales[5], taper, gain)
        else:
            gain[:] = pulse_weight
        _within(delay, gain, scales[3], weight, valid)
        _samples(delay, scales[0], scales[1], scales[3], sample, fraction)
        _phasors(delay, scales[2], gain, cosine, sine)
        changes = _changes(sample)
        if (changes + 1) * LEAST_RUN <= count:
            _add_runs(sample, changes, fraction, cosine, sine, profiles[pulse], taps, sums)
        elif len(sums) == 1:
            _add_one(sample, tap_weights(fraction, taps), cosine, sine, profiles[pulse], sums)
        else:
            _add_all(sample, tap_weights(fraction, taps), cosine, sine, profiles[pulse], by_pixel)
            scattered = True
    image += sums
    if scattered:
        for k in range(len(image)):
            image[k, 0] += by_pixel[:, 0, k]
            image[k, 1] += by_pixel[:, 1, k]


@compiled
def read_profiles(
    delay: F64, profiles: F32, taps: F32, per_metre: float, middle: int, half_window: float, values: F32
) -> None:
    """Read range profiles at some delays.

    Args:
        delay: m, shape (pulses, points).
        profiles: of `dense_profiles`, real and imaginary parts in turn, shape (pulses, dense samples, 2 detectors).
        taps: of `tap_polynomials`.
        per_metre: dense samples per m.
        middle: dense sample of delay 0.
        half_window: half the range window, m.
        values: to fill, real and imaginary parts in turn, shape (pulses, points, 2 detectors), without gaps: the
            compiler then vectorises over detectors.
    """
    pulses, points = delay.shape
    sample, fraction = np.empty(points, np.int32), np.empty(points, np.float32)
    for pulse in range(pulses):
        _samples(delay[pulse], per_metre, middle, half_window, sample, fraction)
        tap, profile = tap_weights(fraction, taps), profiles[pulse]
        for i in range(points):
            first, value = sample[i], values[pulse, i]
            a, b, c = profile[first], profile[first + 1], profile[first + 2]
            d, e, f = profile[first + 3], profile[first + 4], profile[first + 5]
            ta, tb, tc, td, te, tf = tap[0, i], tap[1, i], tap[2, i], tap[3, i], tap[4, i], tap[5, i]
            for k in range(value.size):
                value[k] = ta * a[k] + tb * b[k] + tc * c[k] + td * d[k] + te * e[k] + tf * f[k]


@compiled
def fill_replica(distance: F64, place: F64, near: Index, taper: F32, scales: F64, replica: C64) -> None:
    """Echo of a point along the track, by the weight that `Processing.angle_weights` gives to each angle.

    Args:
        distance: of the points from the track, m, shape (points,).
        place: of the pulses along the track, from abeam of the points, m, shape (pulses,).
        near: index of each pulse in the replica, shape (pulses,).
        taper: azimuth window over the processed angle.
        scales: processed angle, rad; way from pulse to pulse, m; turns per m; distance at which the phase is 0, m.
        replica: zeros to fill, shape (points, length); weights over their sum and the length.
    """
    angle, step, turns_per_metre, middle = scales
    slant, gain = np.empty(place.size), np.empty(place.size, np.float32)
    cosine, sine = np.empty(place.size, np.float32), np.empty(place.size, np.float32)
    for point in range(distance.size):
        for i in range(place.size):
            slant[i] = math.sqrt(distance[point] * distance[point] + place[i] * place[i])
        _angle_weights(slant, -place, 0.0, 0.0, angle, step, taper, gain)
        total = 0.0
        for i in range(place.size):
            total += gain[i]
            slant[i] = middle - slant[i]
        gain *= np.float32(1 / (total * replica.shape[1]))
        _phasors(slant, turns_per_metre, gain, cosine, sine)
        for i in range(place.size):
            replica[point, near[i]] = complex(cosine[i], sine[i])


@compiled
def fill_folded(spectra: C64, factors: C64, folded: C64) -> None:
    """Sum of the products of spectra and factors that are a whole number of lengths of `folded` apart.

    Args:
        spectra: shape (rows, length).
        factors: of the same shape.
        folded: to fill, shape (rows, part of the length).
    """
    part = folded.shape[1]
    for row in range(folded.shape[0]):
        found = folded[row]
        found[:] = 0
        for first in range(0, spectra.shape[1], part):
            spectrum, factor = spectra[row, first : first + part], factors[row, first : first + part]
            for i in range(part):
                found[i] += spectrum[i] * factor[i]


@compiled
def fill_turns(starts: F64, step: F64, track: F64, turns_per_metre: float, result: F32) -> None:
    """Weight times exp(j 2 pi turns) of the delay of every pixel in every pulse.

    Args:
        starts: first pixel of every row, m, shape (rows, 3).
        step: from pixel to pixel of a row, m, shape (3,).
        track: x, y, z of the antenna, reference range (m) and weight of the pulses, shape (5, pulses).
        turns_per_metre: of the phase, with the delay.
        result: to fill, real and imaginary parts in turn, shape (rows, columns, 2 pulses).
    """
    weight = track[4].astype(np.float32)
    turn, cosine, sine = np.empty_like(weight), np.empty_like(weight), np.empty_like(weight)  # parts of one: 6 x slower
    for row in range(result.shape[0]):
        for col in range(result.shape[1]):
            x, y, z = _point(starts[row], step, col)
            _turns(track, x, y, z, turns_per_metre, turn)
            _weighted_phasors(turn, weight, cosine, sine)
            pairs = result[row, col]
            for pulse in range(weight.size):
                pairs[2 * pulse] = cosine[pulse]
                pairs[2 * pulse + 1] = sine[pulse]


@compiled
def _point(start: F64, step: F64, count: float) -> tuple[float, float, float]:
    """A number of steps after the start."""
    return start[0] + count * step[0], start[1] + count * step[1], start[2] + count * step[2]


@compiled
def _turns(track: F64, px: float, py: float, pz: float, turns_per_metre: float, turn: F32) -> None:
    """Turns of the phase of a point in every pulse, less the whole ones."""
    x, y, z, reference = track[0], track[1], track[2], track[3]
    for i in range(turn.size):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        turns = (math.sqrt(dx * dx + dy * dy + dz * dz) - reference[i]) * turns_per_metre
        turn[i] = np.float32(turns - np.floor(turns + 0.5))


@compiled
def _weighted_phasors(turn: F32, weight: F32, cosine: F32, sine: F32) -> None:
    for i in range(turn.size):
        c, s = cosine_and_sine_of_part(turn[i])
        cosine[i], sine[i] = weight[i] * c, weight[i] * s


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
def keep_filled(starts: F64, step: F64, ends: F64, direction: F64, angle: float, valid: Bool) -> None:
    """Set `valid` False where the pulses do not fill the processed angle; as `backprojection.filled_apertures`.

    Apertures grow with range, that is from one end of a column to the other.

    Args:
        starts: first pixel of every row, m, shape (rows, 3).
        step: from pixel to pixel of a row, m, shape (3,).
        ends: antenna at the first and the last pulse, m, shape (2, 3).
        direction: unit vector of flight, shape (3,).
        angle: processed, rad.
        valid: shape (rows, columns).
    """
    for col in range(valid.shape[1]):
        nearest = _is_filled(starts[0], step, col, ends, direction, angle)
        farthest = _is_filled(starts[-1], step, col, ends, direction, angle)
        if nearest and farthest:
            continue
        for row in range(valid.shape[0]):
            some = nearest or farthest
            valid[row, col] &= some and _is_filled(starts[row], step, col, ends, direction, angle)


@compiled
def _is_filled(start: F64, step: F64, count: float, ends: F64, direction: F64, angle: float) -> bool:
    """True if the pulses fill the processed angle of the pixel a number of steps after the start of its row."""
    x, y, z = _point(start, step, count)
    first, last = _sine(x, y, z, ends[0], direction), _sine(x, y, z, ends[1], direction)
    return bool((min(first, last) <= -angle / 2) and (max(first, last) >= angle / 2))


@compiled
def _sine(x: float, y: float, z: float, antenna: F64, direction: F64) -> float:
    """Sine of the angle between abeam and the antenna, seen from a point."""
    dx, dy, dz = antenna[0] - x, antenna[1] - y, antenna[2] - z
    return (dx * direction[0] + dy * direction[1] + dz * direction[2]) / math.sqrt(dx * dx + dy * dy + dz * dz)


@compiled
def keep_reached(
    starts: F64, step: F64, direction: F64, track: F64, half_window: float, angle: float, spacing: float, valid: Bool
) -> None:
    """Set `valid` False where, in a pulse of its aperture, a pixel is beyond the range window; as `_within`.

    Range grows with the rows, so that they are looked at from both ends, until one is within the window everywhere.

    Args:
        starts: first pixel of every row, m, shape (rows, 3).
        step: from pixel to pixel of a row, m, shape (3,).
        direction: unit vector of flight, shape (3,).
        track: x, y, z of the antenna, reference range and place along the flight, m, shape (pulses, 5).
        half_window: half the range window, m.
        angle: processed, rad; 0 in spotlight.
        spacing: way from pulse to pulse, m.
        valid: shape (rows, columns).
    """
    for row in range(len(starts)):
        if row_is_reached(starts[row], step, direction, track, half_window, angle, spacing, valid[row]):
            break
    for row in range(len(starts) - 1, -1, -1):
        if row_is_reached(starts[row], step, direction, track, half_window, angle, spacing, valid[row]):
            break


@compiled
def row_is_reached(
    start: F64, step: F64, direction: F64, track: F64, half_window: float, angle: float, spacing: float, valid: Bool
) -> bool:
    """True if all pixels of a row are reached; sets `valid` False elsewhere. Arguments as of `keep_reached`."""
    all_reached, last = True, valid.size - 1.0
    square = step[0] * step[0] + step[1] * step[1] + step[2] * step[2]
    for pulse in range(track.shape[0]):
        reference = track[pulse, 3]
        # Along a row the distance is greatest at one of its ends, and least where the row is square to the sight.
        x, y, z = track[pulse, 0] - start[0], track[pulse, 1] - start[1], track[pulse, 2] - start[2]
        abeam = min(max((x * step[0] + y * step[1] + z * step[2]) / square, 0.0), last)
        longest = max(_distance(start, step, 0.0, track[pulse]), _distance(start, step, last, track[pulse])) - reference
        shortest = _distance(start, step, abeam, track[pulse]) - reference
        if max(longest, -shortest) <= SURELY_WITHIN * half_window:
            continue
        for col in range(valid.size):
            distance = _distance(start, step, col, track[pulse])
            x, y, z = _point(start, step, col)
            sine = (track[pulse, 4] - (x * direction[0] + y * direction[1] + z * direction[2])) / distance
            share = (angle / 2 - abs(sine)) * distance / spacing + 0.5
            if abs(distance - reference) > half_window and not (angle > 0 and share <= 0):
                valid[col] = all_reached = False
    return all_reached


@compiled
def _distance(start: F64, step: F64, count: float, antenna: F64) -> float:
    """Distance (m) of the antenna from the pixel a number of steps after the start of its row."""
    x, y, z = _point(start, step, count)
    dx, dy, dz = antenna[0] - x, antenna[1] - y, antenna[2] - z
    return math.sqrt(dx * dx + dy * dy + dz * dz)


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
def _changes(sample: I32) -> int:
    """Number of entries that differ from the one before."""
    number = 0
    for i in range(1, sample.size):
        number += sample[i] != sample[i - 1]
    return number


@compiled
def _add_runs(
    sample: I32, changes: int, fraction: F32, cosine: F32, sine: F32, profile: F32, taps: F32, image: F32
) -> None:
    """Add a pulse where many pixels in a row, at nearly the same range, read the same samples.

    There each profile is one polynomial of the fraction: the samples times the polynomials of their taps.
    """
    detectors = len(image)
    lines = profile.reshape(-1, 2 * detectors)
    polynomials = np.empty((taps.shape[1], 2 * detectors), np.float32)
    start = 0
    for change in range(changes + 1):
        stop = sample.size if change == changes else _end_of_run(sample, start)
        _fill_polynomials(lines[sample[start] : sample[start] + TAPS], taps, polynomials)
        for k in range(detectors):
            _add_run(
                polynomials[:, k], polynomials[:, detectors + k], fraction[start:stop], cosine[start:stop],
                sine[start:stop], image[k, 0, start:stop], image[k, 1, start:stop],
            )  # fmt: skip
        start = stop


@compiled
def _end_of_run(sample: I32, start: int) -> int:
    """The first entry after the start that differs from it; there is one."""
    stop = start + 1
    while sample[stop] == sample[start]:
        stop += 1
    return stop


@compiled
def _fill_polynomials(samples: F32, taps: F32, polynomials: F32) -> None:
    """Coefficients of rising powers of what the taps make of samples (taps, lines), shape (powers, lines)."""
    a, b, c, d, e, f = samples[0], samples[1], samples[2], samples[3], samples[4], samples[5]
    for power in range(len(polynomials)):
        ta, tb, tc = taps[0, power], taps[1, power], taps[2, power]
        td, te, tf = taps[3, power], taps[4, power], taps[5, power]
        line = polynomials[power]
        for k in range(line.size):
            line[k] = ta * a[k] + tb * b[k] + tc * c[k] + td * d[k] + te * e[k] + tf * f[k]


@compiled
def _add_run(p: F32, q: F32, fraction: F32, cosine: F32, sine: F32, real: F32, imaginary: F32) -> None:
    """Add p + j q, polynomials of the fraction, times cosine + j sine."""
    p0, p1, p2, p3, p4, p5, p6, p7 = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]
    q0, q1, q2, q3, q4, q5, q6, q7 = q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7]
    for i in range(fraction.size):
        t = fraction[i]
        a = p0 + t * (p1 + t * (p2 + t * (p3 + t * (p4 + t * (p5 + t * (p6 + t * p7))))))
        b = q0 + t * (q1 + t * (q2 + t * (q3 + t * (q4 + t * (q5 + t * (q6 + t * q7))))))
        real[i] += a * cosine[i] - b * sine[i]
        imaginary[i] += a * sine[i] + b * cosine[i]


@compiled
def _add_one(sample: I32, tap: F32, cosine: F32, sine: F32, profile: F32, image: F32) -> None:
    """Add a pulse of a single detector to scattered pixels: all taps written out."""
    flat, real, imaginary = profile.reshape(-1), image[0, 0], image[0, 1]
    for i in range(sample.size):
        p = flat[2 * sample[i] : 2 * (sample[i] + TAPS)]
        ta, tb, tc, td, te, tf = tap[0, i], tap[1, i], tap[2, i], tap[3, i], tap[4, i], tap[5, i]
        a = ta * p[0] + tb * p[2] + tc * p[4] + td * p[6] + te * p[8] + tf * p[10]
        b = ta * p[1] + tb * p[3] + tc * p[5] + td * p[7] + te * p[9] + tf * p[11]
        real[i] += a * cosine[i] - b * sine[i]
        imaginary[i] += a * sine[i] + b * cosine[i]


@compiled
def _add_all(sample: I32, tap: F32, cosine: F32, sine: F32, profile: F32, image: F32) -> None:
    """Add a pulse of many detectors to scattered pixels: interpolate all parts, then turn; (pixels, 2, detectors)."""
    detectors = image.shape[2]
    lines, totals = profile.reshape(-1, 2 * detectors), image.reshape(-1, 2 * detectors)
    value = np.empty(2 * detectors, np.float32)
    for i in range(sample.size):
        first = sample[i]
        a, b, c = lines[first], lines[first + 1], lines[first + 2]
        d, e, f = lines[first + 3], lines[first + 4], lines[first + 5]
        ta, tb, tc, td, te, tf = tap[0, i], tap[1, i], tap[2, i], tap[3, i], tap[4, i], tap[5, i]
        for k in range(2 * detectors):
            value[k] = ta * a[k] + tb * b[k] + tc * c[k] + td * d[k] + te * e[k] + tf * f[k]
        total, turn, lift = totals[i], cosine[i], sine[i]
        for k in range(detectors):
            total[k] += value[k] * turn - value[detectors + k] * lift
            total[detectors + k] += value[k] * lift + value[detectors + k] * turn
