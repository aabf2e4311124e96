"""Loops of the simulator, compiled; a test compares each with its formula in NumPy."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import C64, F32, F64, I32, I64, compiled, cosine_and_sine, inlined

SMALL = 0.05
"""Tangent up to which angles are taken from a series."""


@compiled
def place_echoes(
    positions: F64,
    ends: F64,
    steps: F64,
    scales: F64,
    periods: F64,
    strengths: C64,
    echoes: C64,
    bins: I32,
    fractions: F32,
) -> None:
    """Turn the echo of each scatterer by its range, and place it in range and in range rate.

    Args:
        positions: m, shape (3, scatterers).
        ends: two positions of the antenna, m, and the range there that is taken off, m: shape (2, 4).
        steps: the pulses at which it is there; alike: range rates are 0.
        scales: phase in turns per m; bins of range per m; bins of range rate per m and pulse.
        periods: numbers of bins, in range and in range rate, both even; range 0 and range rate 0 are in the middle.
        strengths: amplitude of the scatterers.
        echoes: result, with the phase of the range at step 0, shape (scatterers,).
        bins: result, the bin before each place, shape (2, scatterers).
        fractions: result, how far each place is past it, shape (2, scatterers).
    """
    per_step = 0.0 if steps[1] == steps[0] else 1 / (steps[1] - steps[0])
    east, north, up = positions[0], positions[1], positions[2]
    range_bin, rate_bin, range_fraction, rate_fraction = bins[0], bins[1], fractions[0], fractions[1]
    x, y, z, taken = ends[0, 0], ends[0, 1], ends[0, 2], ends[0, 3]
    later_x, later_y, later_z, later_taken = ends[1, 0], ends[1, 1], ends[1, 2], ends[1, 3]
    for i in range(east.size):
        first = np.sqrt((east[i] - x) ** 2 + (north[i] - y) ** 2 + (up[i] - z) ** 2) - taken
        last = np.sqrt((east[i] - later_x) ** 2 + (north[i] - later_y) ** 2 + (up[i] - later_z) ** 2) - later_taken
        rate = (last - first) * per_step
        delay = first - rate * steps[0]
        cosine, sine = cosine_and_sine(-scales[0] * delay)
        echoes[i] = strengths[i] * np.complex64(complex(cosine, sine))
        place = delay * scales[1] / periods[0] + 0.5
        place = (place - np.floor(place)) * periods[0]
        range_bin[i] = np.int32(place)
        range_fraction[i] = np.float32(place - np.floor(place))
        place = rate * scales[2] / periods[1] + 0.5
        place = (place - np.floor(place)) * periods[1]
        rate_bin[i] = np.int32(place)
        rate_fraction[i] = np.float32(place - np.floor(place))


@compiled
def spread_echoes(bins: I32, weights: F32, rate_weights: F32, echoes: C64, response: F32, grid: F32) -> None:
    """Add the echoes of scatterers, in all columns, to bins of range rate and of range.

    Args:
        bins: first bin of range and of range rate of each scatterer, shape (2, scatterers).
        weights: of the bins of range from there on, shape (taps, scatterers).
        rate_weights: of the bins of range rate, shape (rate taps, scatterers): one, or an even number.
        echoes: amplitude and phase.
        response: of each column to the scatterer, shape (scatterers, columns).
        grid: to add to, shape (rate bins, range bins * columns * 2): real and imaginary part of each column in turn.
    """
    taps, columns = weights.shape[0], response.shape[1]
    width = 2 * columns
    value = np.empty(width, np.float32)
    block = np.empty(taps * width, np.float32)
    for i in range(echoes.size):
        real, imaginary, responses = echoes[i].real, echoes[i].imag, response[i]
        for k in range(columns):
            value[2 * k] = responses[k] * real
            value[2 * k + 1] = responses[k] * imaginary
        start = bins[0, i] * width
        if rate_weights.shape[0] == 1:
            for j in range(taps):
                row, weight = grid[0, start + j * width : start + (j + 1) * width], weights[j, i]
                for k in range(row.size):
                    row[k] += weight * value[k]
            continue
        for j in range(taps):
            weight, first = weights[j, i], j * width
            for k in range(width):
                block[first + k] = weight * value[k]
        for j in range(0, rate_weights.shape[0], 2):  # two rows for each reading of the block
            row, weight = grid[bins[1, i] + j, start : start + taps * width], rate_weights[j, i]
            next_row, next_weight = grid[bins[1, i] + j + 1, start : start + taps * width], rate_weights[j + 1, i]
            for k in range(row.size):
                row[k] += weight * block[k]
                next_row[k] += next_weight * block[k]


@compiled
def angles_in(positions: F64, antenna: F64, axes: F64, elevation: F64, squint: F64) -> None:
    """Angles, rad, under which points are seen from the antenna.

    Args:
        positions: m, shape (3, points).
        antenna: m, shape (3,).
        axes: unit vectors ahead, outwards and down, shape (3, 3).
        elevation: result, from down towards outwards, shape (points,).
        squint: result, from the plane of both towards ahead, shape (points,).
    """
    east, north, up = positions[0], positions[1], positions[2]
    greatest, lowest = 0.0, 1.0
    for i in range(east.size):
        x, y, z = east[i] - antenna[0], north[i] - antenna[1], up[i] - antenna[2]
        outwards = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
        down = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
        ahead = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
        e, s = outwards / down, ahead / np.sqrt(outwards * outwards + down * down)
        greatest, lowest = max(greatest, e * e, s * s), min(lowest, down)
        elevation[i], squint[i] = arctangent(e), arctangent(s)
    if greatest < SMALL**2 and lowest > 0:
        return
    for i in range(east.size):
        x, y, z = east[i] - antenna[0], north[i] - antenna[1], up[i] - antenna[2]
        outwards = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
        down = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
        ahead = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
        elevation[i] = np.arctan2(outwards, down)
        squint[i] = np.arctan2(ahead, np.sqrt(outwards * outwards + down * down))


@inlined
def arctangent(t: float) -> float:
    """Arc tangent of numbers below SMALL by its series, within 1e-14."""
    q = t * t
    return t * (1 - q * (1 / 3 - q * (1 / 5 - q * (1 / 7 - q * (1 / 9 - q / 11)))))


@compiled
def read_lattice(table: F32, spacing: float, middle: I64, offset: F64, squint: F64, first: int, result: F32) -> None:
    """Read a table on nodes in two angles at many places, by Lagrange's cubic of the 4 x 4 nodes around each.

    Args:
        table: shape (rows, cols * columns): the columns of each node side by side.
        spacing: of the nodes, rad.
        middle: row and col of the node at 0, shape (2,).
        offset: angle along the rows of each place, rad, shape (places,); two nodes or more off the table's ends.
        squint: angle along the cols, alike.
        first: where in the rows of the result the columns begin.
        result: shape (places, first + columns or more).
    """
    columns = table.shape[1] // (2 * middle[1] + 1)
    mixed = np.empty(4 * columns, np.float32)
    per_angle = 1 / spacing
    for i in range(offset.size):
        place, beside = offset[i] * per_angle, squint[i] * per_angle
        node, col = np.floor(place), np.floor(beside)
        row, start = int(node) + middle[0] - 1, (int(col) + middle[1] - 1) * columns
        p, q, r, s = cubic_weights(np.float32(place - node))
        above, here = table[row, start : start + 4 * columns], table[row + 1, start : start + 4 * columns]
        below, beyond = table[row + 2, start : start + 4 * columns], table[row + 3, start : start + 4 * columns]
        for k in range(mixed.size):
            mixed[k] = p * above[k] + q * here[k] + r * below[k] + s * beyond[k]
        p, q, r, s = cubic_weights(np.float32(beside - col))
        there = result[i, first : first + columns]
        for k in range(columns):
            there[k] = p * mixed[k] + q * mixed[columns + k] + r * mixed[2 * columns + k] + s * mixed[3 * columns + k]


@inlined
def cubic_weights(t: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights in Lagrange's cubic of the nodes at -1, 0, 1 and 2, at a place from 0 to 1."""
    a, b, c = t + np.float32(1), t - np.float32(1), t - np.float32(2)
    return (
        t * b * c * np.float32(-1 / 6),
        a * b * c * np.float32(1 / 2),
        a * t * c * np.float32(-1 / 2),
        a * t * b * np.float32(1 / 6),
    )


@compiled
def mix_beams(rates: C64, steps: I64, nodes: F32, phasors: C64, result: C64) -> None:
    """Range profiles of pulses from those of the beams in their nodes.

    Args:
        rates: transform over the bins of range rate, shape (rates, range bins, nodes * detectors).
        steps: row of each pulse in it, shape (pulses,).
        nodes: weights of the nodes in each pulse, shape (nodes, pulses).
        phasors: factor of each pulse and range, shape (pulses, range bins).
        result: shape (pulses, range bins, detectors).
    """
    detectors = result.shape[2]
    for pulse in range(result.shape[0]):
        for place in range(result.shape[1]):
            source, there, factor = rates[steps[pulse], place], result[pulse, place], phasors[pulse, place]
            weight = nodes[0, pulse] * factor
            for k in range(detectors):
                there[k] = weight * source[k]
            for node in range(1, nodes.shape[0]):
                weight, first = nodes[node, pulse] * factor, node * detectors
                for k in range(detectors):
                    there[k] += weight * source[first + k]
