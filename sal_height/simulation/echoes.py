"""Echoes of all scatterers in a group of pulses: one non-uniform FFT over range frequency and pulse.

Within a group the range of a scatterer is rho + v q in the pulse q, apart from the common range and the curvature,
which depends on range (`pulse_groups`). The sum over scatterers of exp(-j k (rho + v q)), k = k_c + dk f, is the
adjoint of reading an image at the positions (rho, v): each echo is spread with the interpolator's kernel over bins of
range and range rate, and the transforms of the bins are divided by that of the kernel (type-1 non-uniform FFT). In the
product dk f v q, range migration, the pulse q counts as q (1 + f dk / k_c): the sum there is that at q, and its
derivative times the difference.

Responses of the beams to many scatterers at a time are read from a table over a lattice of directions. The amplitude of
a beam is the spectrum of an aperture, so that it is smooth on the scale of a beamwidth. Nodes lie at multiples of a
fixed spacing, and a value depends on the 4 x 4 nodes around its direction alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import scipy.fft

from sal_height.beams import Beams
from sal_height.numeric import (
    C64,
    F32,
    F64,
    OVERSAMPLING,
    TAPS,
    Bool,
    Complex,
    in_parallel,
    kernel_transform,
    spectra_of_profiles,
    tap_polynomials,
    tap_weights,
    unit_phasors,
)
from sal_height.sensor import Sensor
from sal_height.simulation._kernels import mix_beams, place_echoes, read_lattice, spread_echoes
from sal_height.simulation.pulse_groups import PulseGroup

NODES_PER_BEAMWIDTH = 20
"""Nodes of the table in a beamwidth: Lagrange's cubics are then off by at most 9/384 (pi / 20)^4 = 1.4e-5 per axis."""

LEAST_REACH, MOST_REACH = 32, 512
"""Nodes to each side of the middle of a table, and powers of 2 between, so that the dwells of a flight use one table.

The responses to scatterers farther off, by more than 25 beamwidths, are computed one by one.
"""


def response_of(beams: Beams, offset: F64, squint: F64) -> F32 | C64:
    """Response of every detector, float32 or complex64, shape (scatterers, detectors).

    Within 4e-5 of the peak of `Beams.response`, which is evaluated where the table is less accurate: beyond its
    ends, and at the edge of a measured beam, beyond which nothing is received. Scatterers that are seen in several
    directions, shape (directions, scatterers), have the detectors of each in turn: (scatterers, directions *
    detectors).

    Args:
        beams: beams of the detectors.
        offset: elevation from the middle of the axis, rad, shape (scatterers,).
        squint: squint, rad, same shape.
    """
    spacing = min(beams.beamwidth, beams.beamwidth_beside) / NODES_PER_BEAMWIDTH
    offset, squint = (np.atleast_2d(np.ascontiguousarray(angle, dtype=np.float64)) for angle in (offset, squint))
    widest = [max(float(angle.max()), -float(angle.min())) for angle in (offset, squint)]
    rows, cols = (_reach(angle / spacing) for angle in widest)
    parts, rough = _table(beams, spacing, rows, cols)
    inside = (MOST_REACH - 3) * spacing
    near = [np.clip(angle, -inside, inside) if max(widest) > inside else angle for angle in (offset, squint)]
    read = [np.empty((offset.shape[1], len(offset) * beams.count), np.float32) for _ in parts]
    for table, values in zip(parts, read, strict=True):
        for number in range(len(offset)):
            first = number * beams.count
            read_lattice(table, spacing, np.array([rows, cols]), near[0][number], near[1][number], first, values)
    response = read[0] if len(read) == 1 else read[0] + 1j * read[1]
    if max(widest) > inside or np.any(rough):
        node = [np.floor(angle / spacing).astype(np.intp) for angle in near]
        asked = (np.maximum(np.abs(offset), np.abs(squint)) > inside) | rough[node[0] + rows - 1, node[1] + cols - 1]
        direction, there = np.nonzero(asked)
        exact = beams.response(offset[direction, there] + beams.axis_middle, squint[direction, there])
        response.reshape(offset.shape[1], len(offset), -1)[there, direction] = exact
    return response


def _reach(nodes: float) -> int:
    """Nodes to each side of 0 of a table that has at least these nodes and two more."""
    return min(MOST_REACH, LEAST_REACH * 2 ** math.ceil(max(0.0, math.log2((nodes + 2) / LEAST_REACH))))


@lru_cache(maxsize=8)
def _table(beams: Beams, spacing: float, rows: int, cols: int) -> tuple[list[F32], Bool]:
    """Responses on nodes to `rows` in elevation and `cols` in squint, and a mask of those too rough to be interpolated.

    Real and, if they are complex, imaginary parts have the shape (rows, cols * detectors); `rough` is
    the mask for the 4 x 4 nodes that start at each.
    """
    row, col = (np.arange(-reach, reach + 1, dtype=np.float64) for reach in (rows, cols))
    values = beams.response(row[:, None] * spacing + beams.axis_middle, col * spacing)
    halves = np.array([-1, 9, 9, -1]) / 16
    along = np.lib.stride_tricks.sliding_window_view(values, (4, 4), axis=(0, 1))
    middle = np.einsum("rckij,i,j->rck", along, halves, halves)
    exact = beams.response((row[1:-2, None] + 0.5) * spacing + beams.axis_middle, (col[1:-2] + 0.5) * spacing)
    rough = np.any(np.abs(middle - exact) > 4e-5 * np.abs(values).max(), axis=-1)
    parts = [values.real, values.imag] if np.iscomplexobj(values) else [values]
    return [np.ascontiguousarray(part.reshape(len(row), -1), dtype=np.float32) for part in parts], rough


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
