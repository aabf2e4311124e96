"""Compiled loops over samples and the looks of pixels: their power, and the channels' covariance.

Each has a twin in plain NumPy in the tests. An axis is described by the first sample of pixel 0, the step from pixel to
pixel and the weights of the looks.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import C64, F32, F64, Bool, Index, compiled, inlined

LOOKS_AT_ONCE = 4
"""Number of looks whose outer products are added at a time: as many as stay in registers."""

EXPONENT = np.uint32(0x7F800000)
"""Bits of the exponent of a float32, all set if it is infinite or NaN, which compiled loops cannot test otherwise."""


@compiled
def sum_powers(numbers: F32, weights: F32, first: int, power: F32) -> None:
    """Weighted sum over channels of |g|^2, for samples from row `first`; -1 where it is infinite or NaN."""
    bits = power.view(np.uint32)
    for r in range(len(power)):
        line = power[r]
        line[:] = 0
        for m in range(len(numbers)):
            here, weight = numbers[m, first + r], weights[m]
            for c in range(line.size):
                line[c] += weight * (here[2 * c] * here[2 * c] + here[2 * c + 1] * here[2 * c + 1])
        for c in range(line.size):
            if (bits[r, c] & EXPONENT) == EXPONENT:
                line[c] = -1


@compiled
def sum_covariances(
    numbers: F32,
    gains: C64,
    pixels: tuple[Index, Index],
    down: tuple[int, int, F32],
    across: tuple[int, int, F32],
    scale: F32,
    parts: F32,
) -> None:
    """See `SlcCovariance`; `parts` has the real part and, where wanted, the imaginary part: (pixels, 1 or 2, M, M)."""
    (top, row_step, row_weights), (left, col_step, col_weights) = down, across
    channels, rows, twice = numbers.shape
    most = row_weights.size * col_weights.size + LOOKS_AT_ONCE
    x, y = np.empty((most, channels), np.float32), np.empty((most, channels), np.float32)
    weight = np.empty(col_weights.size, np.float32)
    for i in range(len(parts)):
        row, col = pixels[0][i], pixels[1][i]
        start, side, count = top + row * row_step, left + col * col_step, 0
        first, last = max(side, 0), min(side + col_weights.size, twice // 2)
        if scale[row, col] > 0:
            for r in range(max(start, 0), min(start + row_weights.size, rows)):
                for c in range(first, last):
                    weight[c - first] = np.sqrt(scale[row, col] * row_weights[r - start] * col_weights[c - side])
                for m in range(channels):
                    line, g, h = numbers[m, r, 2 * first : 2 * last], gains[m].real, gains[m].imag
                    for c in range(last - first):
                        real, imaginary = weight[c] * line[2 * c], weight[c] * line[2 * c + 1]
                        x[count + c, m] = g * real - h * imaginary
                        y[count + c, m] = g * imaginary + h * real
                count += last - first
        _sum_outer_products(x, y, count, parts[i])


@compiled
def sum_samples(numbers: F32, parts: F32) -> None:
    """See `covariance`; numbers of shape (pixels, looks, 2 M), `parts` as in `sum_covariances`."""
    looks, channels = numbers.shape[1], numbers.shape[2] // 2
    x = np.empty((looks + LOOKS_AT_ONCE, channels), np.float32)
    y = np.empty_like(x)
    for i in range(len(numbers)):
        for k in range(looks):
            for m in range(channels):
                x[k, m] = numbers[i, k, 2 * m]
                y[k, m] = numbers[i, k, 2 * m + 1]
        _sum_outer_products(x, y, looks, parts[i])


@inlined
def _sum_outer_products(x: F32, y: F32, count: int, parts: F32) -> None:
    """Sum of g g^H over `count` samples g = x + j y, as parts (1 or 2, M, M); spare rows of x and y are overwritten."""
    padded = max(1, -(-count // LOOKS_AT_ONCE)) * LOOKS_AT_ONCE
    for k in range(count, padded):
        for m in range(x.shape[1]):
            x[k, m] = 0
            y[k, m] = 0
    for k in range(0, padded, LOOKS_AT_ONCE):
        _add_four(x, y, np.float32(1), x, y, k, parts[0])
        if len(parts) == 2:
            _add_four(y, x, np.float32(-1), x, y, k, parts[1])


@inlined
def _add_four(p: F32, q: F32, sign: np.float32, x: F32, y: F32, k: int, result: F32) -> None:
    """Add p x^T + sign q y^T of the four samples from `k` to `result` (M, M), which the first four overwrite."""
    x0, x1, x2, x3, y0, y1, y2, y3 = x[k], x[k + 1], x[k + 2], x[k + 3], y[k], y[k + 1], y[k + 2], y[k + 3]
    for m in range(len(result)):
        row = result[m]
        p0, p1, p2, p3 = p[k, m], p[k + 1, m], p[k + 2, m], p[k + 3, m]
        q0, q1, q2, q3 = sign * q[k, m], sign * q[k + 1, m], sign * q[k + 2, m], sign * q[k + 3, m]
        for n in range(row.size):
            before = row[n] if k > 0 else np.float32(0)
            first = p0 * x0[n] + p1 * x1[n] + p2 * x2[n] + p3 * x3[n]
            row[n] = before + first + q0 * y0[n] + q1 * y1[n] + q2 * y2[n] + q3 * y3[n]


@compiled
def sum_down(first: Index, weights: F64, samples: F64, sums: F64) -> None:
    """See `look_windows.Bands.down`."""
    for i in range(len(sums)):
        line = sums[i]
        line[:] = 0
        count = weights.shape[1]
        for k in range(0, count - 3, 4):
            w, s = weights[i, k : k + 4], samples[first[i] + k : first[i] + k + 4]
            w0, w1, w2, w3, s0, s1, s2, s3 = w[0], w[1], w[2], w[3], s[0], s[1], s[2], s[3]
            for c in range(line.size):
                line[c] += w0 * s0[c] + w1 * s1[c] + w2 * s2[c] + w3 * s3[c]
        for k in range(count // 4 * 4, count):
            weight, sample = weights[i, k], samples[first[i] + k]
            for c in range(line.size):
                line[c] += weight * sample[c]


@compiled
def sum_across(first: Index, weights: F64, samples: F64, sums: F64) -> None:
    """See `look_windows.Bands.across`."""
    for r in range(len(sums)):
        line = samples[r]
        for i in range(len(first)):
            weight, start, total = weights[i], first[i], 0.0
            for k in range(weight.size):
                total += weight[k] * line[start + k]
            sums[r, i] = total


@compiled
def find_edges(power: F64, contrast: F64, noise: F64, apart: tuple[int, int], edge: Bool) -> None:
    """See `looks.is_edge_of_shadow`; beyond an edge the image is continued by its edge."""
    rows, cols = power.shape
    for r in range(rows):
        before, after = max(r - apart[0], 0), min(r + apart[0], rows - 1)
        for c in range(cols):
            left, right = power[r, max(c - apart[1], 0)], power[r, min(c + apart[1], cols - 1)]
            brightest = max(left, right, power[before, c], power[after, c])
            darkest = min(left, right, power[before, c], power[after, c])
            edge[r, c] = brightest - noise[r, c] > contrast[r, c] * (darkest + noise[r, c])


@compiled
def add_pulls(position: F64, power: F64, pulled: F64, fractions: F64, table: F64) -> None:
    """Add to `pulled` the sum over n of fractions[n] power p^2 of the pixels n + 1 rows before and after.

    Args:
        position: elevation in steps of the table, shape (rows, cols).
        power: power of each pixel, same shape.
        pulled: sums to add to, same shape; changed.
        fractions: fraction of the energy by distance in rows, from 1.
        table: p^2 over the difference of elevation, which is 0 in its middle.
    """
    rows, middle = len(position), len(table) // 2
    for c in range(position.shape[1]):
        for r in range(rows):
            total = 0.0
            for n in range(min(fractions.size, rows - 1)):
                for side in (-1, 1):
                    other = r + side * (n + 1)
                    # Beyond an edge: the mirrored pixel, with its elevation mirrored about that of the edge.
                    edge = min(max(other, 0), rows - 1)
                    mirror = 2 * edge - other
                    there = 2 * position[edge, c] - position[mirror, c]
                    node = min(max(there - position[r, c] + middle, 0), table.size - 1)
                    total += fractions[n] * power[mirror, c] * table[int(node + 0.5)]
            pulled[r, c] += total
