"""Echoes of all scatterers in a group of pulses: one non-uniform FFT over range frequency and pulse.

Within a group the range of a scatterer is rho + v q in the pulse q, apart from the common range and the curvature,
which depends on range (`pulse_groups`). The sum over scatterers of exp(-j k (rho + v q)), k = k_c + dk f, is the
adjoint of reading an image at the positions (rho, v): each echo is spread with the interpolator's kernel over bins of
range and range rate, and the transforms of the bins are divided by that of the kernel (type-1 non-uniform FFT). In the
product dk f v q, range migration, the pulse q counts as q (1 + f dk / k_c): the sum there is that at q, and its
derivative times the difference.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft

from sal_height.numeric import (
    C64,
    F32,
    F64,
    OVERSAMPLING,
    TAPS,
    Complex,
    in_parallel,
    kernel_transform,
    spectra_of_profiles,
    tap_polynomials,
    tap_weights,
    unit_phasors,
)
from sal_height.sensor import Sensor
from sal_height.simulation._kernels import mix_beams, place_echoes, spread_echoes
from sal_height.simulation.pulse_groups import PulseGroup

KERNEL = tap_polynomials()
"""The interpolator's kernel."""

Response = Callable[[list[int]], Complex | F32]
"""Response of all detectors to the scatterers in pulses of the dwell: shape (scatterers, pulses * detectors)."""


def for_each_group(fill: Callable[[PulseGroup], None], groups: list[PulseGroup], scatterers: int) -> None:
    """Fill the samples of all groups, in threads if there are scatterers enough."""

    def fill_some(part: slice) -> None:
        for group in groups[part]:
            fill(group)

    # A thread processes 20000 scatterers, each counted in every group, in a few milliseconds.
    in_parallel(fill_some, len(groups), least=-(-20_000 // scatterers))


def sum_of_echoes(
    sensor: Sensor, positions: F64, strengths: C64, response: Response, group: PulseGroup, reference_range: F64
) -> C64:
    """Noise-free phase history of every detector in the pulses of a group.

    Phases are reduced to a turn in float64; the rest is float32, whose digits suffice for the samples.

    Args:
        sensor: sensor with wavelength and frequencies.
        positions: positions of the scatterers, at rest, m, shape (3, scatterers).
        strengths: complex amplitudes of the scatterers, shape (scatterers,).
        response: response of the detectors in the pulses of the group's nodes.
        group: group of pulses.
        reference_range: reference range, m, shape (pulses of the group,).

    Returns:
        Shape (detectors, pulses, frequencies).
    """
    grid = _grid(sensor, positions, strengths, response, group)
    samples = [spectra_of_profiles(profiles) for profiles in _profiles(grid, group, sensor)]
    frequency = np.arange(sensor.sample_count) - sensor.sample_count // 2
    if group.migrates:
        stretch = frequency * (sensor.wavenumber_step / sensor.centre_wavenumber)
        samples[0] += samples[1] * (group.steps[:, None] * stretch).astype(np.float32)
    wavenumber = sensor.centre_wavenumber + sensor.wavenumber_step * frequency
    factor = unit_phasors(-(group.common - reference_range)[:, None] * wavenumber)
    if group.count > 1:
        signs = np.where(group.steps % 2, -1, 1)  # range rate 0 is in the middle of its bins
        factor *= (signs / kernel_transform(group.steps / _rate_bins(group))).astype(np.float32)[:, None]
    return np.asarray(samples[0] * factor)


def _rate_bins(group: PulseGroup) -> int:
    return OVERSAMPLING * int(scipy.fft.next_fast_len(group.count)) if group.count > 1 else 1


def _grid(sensor: Sensor, positions: F64, strengths: C64, response: Response, group: PulseGroup) -> C64:
    """Echoes over bins of range rate, and of range, node and detector."""
    dense, rates, count = OVERSAMPLING * sensor.sample_count, _rate_bins(group), len(strengths)
    turns = sensor.centre_wavenumber / (2 * np.pi)
    ends = np.array([[*group.antenna[end], group.common[end]] for end in group.ends])
    scales = np.array([turns, dense / sensor.range_window, turns * rates])
    echoes = np.empty(count, dtype=np.complex64)
    bins, fractions = np.empty((2, count), dtype=np.int32), np.empty((2, count), dtype=np.float32)
    periods = np.array([dense, rates], dtype=np.float64)
    place_echoes(positions, ends, group.steps[list(group.ends)], scales, periods, strengths, echoes, bins, fractions)
    bins += 1
    weights = tap_weights(fractions[0], KERNEL)
    if group.count > 1:
        rate_weights = tap_weights(fractions[1], KERNEL)
    else:
        bins[1], rate_weights = 0, np.ones((1, count), dtype=np.float32)
    amplitudes = response([group.pulses.start + int(node) for node in group.nodes])
    rows = rates + TAPS if group.count > 1 else 1
    grid = np.zeros((rows, (dense + TAPS) * amplitudes.shape[1] * 2), dtype=np.float32)
    spread_echoes(bins, weights, rate_weights, echoes, np.ascontiguousarray(amplitudes.real), grid)
    if np.iscomplexobj(amplitudes):
        spread_echoes(bins, weights, rate_weights, 1j * echoes, np.ascontiguousarray(amplitudes.imag), grid)
    return grid.view(np.complex64)


def _profiles(grid: C64, group: PulseGroup, sensor: Sensor) -> list[C64]:
    """Dense range profiles of the pulses, shape (pulses, range bins, detectors); the grid's memory is used up.

    From bins of range rate to pulses, with the beams between their nodes and the curvature of the ranges; then their
    derivative over the pulse, if the group migrates. The transform G(q) of the bins g is that of the echoes, A(q),
    times that of the kernel, K(q). So the derivative of A, times K, is that of G, which is the transform of
    -2 pi j (rate) g, less G times that of log K.
    """
    dense = OVERSAMPLING * sensor.sample_count
    if group.count == 1:
        return [grid.reshape(1, dense + TAPS, -1)]
    half, rates = TAPS // 2, _rate_bins(group)
    grids = [grid]
    if group.migrates:
        rate = (np.arange(len(grid)) - half) / rates - 0.5
        grids.append(grid * (-2j * np.pi * rate).astype(np.complex64)[:, None])
    ranges = np.asarray(np.arange(dense + TAPS) - half - dense // 2, np.float64) * (sensor.range_window / dense)
    curvature = unit_phasors(-sensor.centre_wavenumber * group.curvature(ranges).T)
    nodes, steps = group.interpolation.astype(np.float32), group.steps.astype(np.int64) % rates
    profiles = []
    for bins in grids:
        period = bins[half:-half]
        period[-half:] += bins[:half]
        period[:half] += bins[-half:]
        over_pulses = scipy.fft.fft(period, axis=0, overwrite_x=True).reshape(rates, dense + TAPS, -1)
        profiles.append(np.empty((group.count, dense + TAPS, over_pulses.shape[2] // len(nodes)), np.complex64))
        mix_beams(over_pulses, steps, nodes, curvature, profiles[-1])
    if group.migrates:
        step = 1e-3  # pulses, of the difference
        before, after = (kernel_transform((group.steps + side) / rates) for side in (-step, step))
        slope = np.log(after / before) / (2 * step)
        profiles[1] -= slope.astype(np.float32)[:, None, None] * profiles[0]
    return profiles
