"""Compiled loops over pixels: choice of the pair, and tables of inverse discriminants; tests have twins."""

from __future__ import annotations

from sal_height.numeric import C64, F32, F64, I64, U8, Index, compiled_with_nan

INSIDE, BELOW, ABOVE, NOT_FINITE, NO_DOMAIN, UNKNOWN = range(6)


@compiled_with_nan
def invert_cubic(wanted: float, rise: float, start: float, end: float) -> tuple[float, float]:
    """Argument from 0 to 1 at which a cubic from 0 to `rise` with these end slopes is `wanted`, and the slope there.

    By Newton's method within a shrinking bracket. The slope is at least 1e-9 of that of the chord.
    """
    low, high, t = 0.0, 1.0, min(max(wanted / rise, 0.0), 1.0)
    for _ in range(40):  # as many bisections leave 1e-12
        value = t * t * (3 - 2 * t) * rise + t * (1 - t) * ((1 - t) * start - t * end) - wanted
        slope = 6 * t * (1 - t) * rise + (1 - t) * (1 - 3 * t) * start + t * (3 * t - 2) * end
        if value > 0:
            high = t
        else:
            low = t
        moved = t - value / slope if slope > 0 else -1.0
        if not low <= moved <= high:
            moved = (low + high) / 2
        settled = abs(moved - t) < 1e-5  # another step would be about 1e-9
        t = moved
        if settled:
            break
    return t, max(6 * t * (1 - t) * rise + (1 - t) * (1 - 3 * t) * start + t * (3 * t - 2) * end, 1e-9 * rise)


@compiled_with_nan
def look_up(
    mu: F64, pair: Index, cells: tuple[I64, F64], table: tuple[F64, F64, F64], kind: U8, found: F64, reason: U8
) -> None:
    """See `inverse_table.InverseTable.look_up`.

    Args:
        mu: discriminants, shape (rows, cols).
        pair: number of the pair of each, same shape.
        cells: number of the cell of each column's squint, shape (cols,), and weights of the squints around, (cols, n).
        table: `mu`, `values` and `ends` of the table.
        kind: kind of its cells, as there.
        found: array of NaN to fill with elevation, slope, |Sigma|^2 and Im(Delta / Sigma), shape (4, rows, cols).
        reason: reasons to fill in, (rows, cols).
    """
    nodes, values, ends = table
    number, weights = cells
    last = nodes.shape[2] - 1
    for r in range(mu.shape[0]):
        for c in range(mu.shape[1]):
            wanted, p, cell = mu[r, c], pair[r, c], number[c]
            if not -1e300 < wanted < 1e300:
                reason[r, c] = NOT_FINITE
                continue
            if kind[p, cell] != INSIDE:
                reason[r, c] = kind[p, cell]
                continue
            least, most = 0.0, 0.0
            for k in range(weights.shape[1]):
                least += weights[c, k] * ends[p, cell + k, 0]
                most += weights[c, k] * ends[p, cell + k, 1]
            if wanted < least or wanted > most:
                reason[r, c] = BELOW if wanted < least else ABOVE
                continue
            reason[r, c] = INSIDE
            # The fraction of the domain's values is constant from squint to squint, as the ends of domains move.
            fraction = (wanted - least) / (most - least)
            elevation, turn, real, imaginary, ratio = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(weights.shape[1]):
                line, value, weight = nodes[p, cell + k], values[p, cell + k], weights[c, k]
                span = line[last] - line[0]
                target = line[0] + fraction * span
                low, high = 0, last
                while high - low > 1:
                    middle = (low + high) // 2
                    if line[middle] <= target:
                        low = middle
                    else:
                        high = middle
                a, b = value[low], value[high]
                step = b[0] - a[0]
                t, steepness = invert_cubic(target - line[low], line[high] - line[low], a[1] * step, b[1] * step)
                rise, start, end = t * t * (3 - 2 * t), t * (1 - t) * (1 - t) * step, t * t * (t - 1) * step
                elevation += weight * (a[0] + t * step)
                real += weight * (a[2] + rise * (b[2] - a[2]) + start * a[3] + end * b[3])
                imaginary += weight * (a[4] + rise * (b[4] - a[4]) + start * a[5] + end * b[5])
                ratio += weight * (a[6] + rise * (b[6] - a[6]) + start * a[7] + end * b[7])
                turn += weight * span * step / steepness
            found[0, r, c], found[1, r, c] = elevation, (most - least) / turn
            found[2, r, c], found[3, r, c] = real * real + imaginary * imaginary, ratio


@compiled_with_nan
def find_strongest_pairs(covariance: F32 | C64, pair: Index, found: F64) -> None:
    """See `pairs.strongest_pairs`; a real covariance is the real part of a complex one.

    Args:
        covariance: shape (rows, cols, M, M).
        pair: numbers of the lower detector to fill in, shape (rows, cols).
        found: sums over looks to fill in: |l|^2, |u|^2, and real and imaginary part of l u*, shape (4, rows, cols).
    """
    for r in range(covariance.shape[0]):
        for c in range(covariance.shape[1]):
            matrix = covariance[r, c]
            best, most = 0, 0.0
            for m in range(len(matrix) - 1):
                power = float(matrix[m, m].real) + float(matrix[m + 1, m + 1].real) + 2 * float(matrix[m, m + 1].real)
                if m == 0 or power > most:
                    best, most = m, power
            pair[r, c] = best
            product = matrix[best, best + 1]
            found[0, r, c] = matrix[best, best].real
            found[1, r, c] = matrix[best + 1, best + 1].real
            found[2, r, c], found[3, r, c] = product.real, product.imag
