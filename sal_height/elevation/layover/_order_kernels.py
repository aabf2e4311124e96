"""Compiled loops of the probability of models: fractions of the models among neighbours, and small matrices.

Each has a twin in plain NumPy in the tests. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

import numpy as np

from sal_height.elevation.array._beside_kernels import Numbers
from sal_height.elevation.layover._several_kernels import eliminate, invert_positive
from sal_height.numeric import F64, Index, compiled, inlined


@compiled
def learn_from_neighbours(
    evidence: F64,
    here: tuple[Index, Index],
    dwell_cols: int,
    prior: F64,
    reach: int,
    steps: int,
    found: F64,
    fractions: F64,
) -> None:
    """See `order.log_probabilities`.

    Args:
        evidence: log-evidence of every model of some pixels, shape (pixels, models).
        here: rows and columns of the pixels, row by row.
        dwell_cols: columns of each of the images that are side by side.
        prior: probability of each model, the local ones last.
        reach: pixels to each side that count.
        steps: number of steps of the EM algorithm.
        found: logarithm of the probabilities, same shape as `evidence`; changed.
        fractions: fractions of the local models in all pixels of the image, 0 at first, shape (rows, cols, local
            models); changed.
    """
    (rows, cols), (height, width, kinds) = here, fractions.shape
    first, around, own_prior, lines = len(prior) - kinds, np.empty(kinds), prior.copy(), np.empty(width * kinds)
    by_row = fractions.reshape(height, width * kinds)
    total = prior[first:].sum()
    usual = prior[first:] / total
    for _ in range(steps):
        for i in range(len(rows)):
            single = 0.0
            for k in range(first):
                single += np.exp(found[i, k])
            for k in range(kinds):
                fractions[rows[i], cols[i], k] = 0.0 if single > 0.5 else np.exp(found[i, first + k])
        for i in range(len(rows)):
            if i == 0 or rows[i] != rows[i - 1]:
                lines[:] = 0
                for r in range(max(rows[i] - reach, 0), min(rows[i] + reach + 1, height)):
                    _add(by_row[r], lines)
            around[:] = usual - fractions[rows[i], cols[i]]
            first_col = cols[i] // dwell_cols * dwell_cols
            for c in range(max(cols[i] - reach, first_col), min(cols[i] + reach + 1, first_col + dwell_cols)):
                for k in range(kinds):
                    around[k] += lines[c * kinds + k]
            own_prior[first:] = around * (total / around.sum())
            weigh(evidence[i], own_prior, found[i])


@inlined
def _add(numbers: F64, sums: F64) -> None:
    for n in range(sums.size):
        sums[n] += numbers[n]


@compiled
def weigh(evidence: F64, prior: F64, found: F64) -> None:
    """Logarithms of probabilities by Bayes' rule, from the logarithms of the evidence and from the prior."""
    for k in range(found.size):
        found[k] = evidence[k] + np.log(prior[k])
    highest, total = found.max(), 0.0
    for k in range(found.size):
        total += np.exp(found[k] - highest)
    for k in range(found.size):
        found[k] -= highest + np.log(total)


@compiled
def weigh_priors(
    turning: Numbers, inverses: Numbers, powers: F64, information: F64, looks: F64, ranges: F64, volumes: F64
) -> None:
    """Logarithms of the fractions of the prior that looks of several scatterers leave, (pixels,); see `order`.

    If the amplitudes are independent and have the powers P, the information on the elevations is

        F = 2 K Re{(D^H (I - P_U) D) * known^T},    known = P (P + (U^H U)^-1)^-1 P

    Args:
        turning: D^H (I - P_U) D, (pixels, S, S).
        inverses: (U^H U)^-1, (pixels, S, S).
        powers: P of each scatterer, (pixels, S).
        information: information on the logarithms of the powers, (pixels, S, S).
        looks: K, (pixels,).
        ranges: ranges of the elevations and of the logarithms of the powers, within which they are uniform, (2,).
        volumes: logarithms to fill in.
    """
    count = powers.shape[1]
    certain, scaled = np.empty((count, count), inverses.dtype), np.empty((2, count, count))
    by_elevation, by_power = ranges[0] * ranges[0] / (2 * np.pi), ranges[1] * ranges[1] / (2 * np.pi)
    for i in range(len(powers)):
        for s in range(count):
            for r in range(count):
                certain[s, r] = inverses[i, s, r]
            certain[s, s] += powers[i, s]
        invert_positive(certain, count)
        for s in range(count):
            for r in range(count):
                known = powers[i, r] * certain[r, s] * powers[i, s]
                scaled[0, s, r] = by_elevation * 2 * looks[i] * (turning[i, s, r] * known).real
                scaled[1, s, r] = by_power * information[i, s, r]
            scaled[0, s, s] += 1
            scaled[1, s, s] += 1
        volumes[i] = -0.5 * (invert_positive(scaled[0], count) + invert_positive(scaled[1], count))


@compiled
def invert_diagonals(matrices: F64, diagonals: F64) -> None:
    """Diagonals (pixels, n) of the inverses of matrices (pixels, n, n), which are overwritten; -1 if not positive.

    A matrix is positive if all pivots of its elimination are.
    """
    count = matrices.shape[1]
    for i in range(len(matrices)):
        matrix, positive = matrices[i], True
        for k in range(count):
            positive = matrix[k, k] > 0
            if not positive:
                break
            eliminate(matrix, k, count)
        for k in range(count):
            diagonals[i, k] = matrix[k, k] if positive else -1.0
