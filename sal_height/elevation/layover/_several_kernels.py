"""Compiled loops of the search for several scatterers in a pixel.

Each has a twin in plain NumPy in the tests. Matrices are real or complex, as the beams are; positions are in steps of
the table of unit responses, `SearchTables.unit_pieces`. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sal_height.elevation.array._beside_kernels import LEAST_RESIDUE, Numbers, inner, multiply, unit_at
from sal_height.elevation.array._kernels import TABLE_STEPS
from sal_height.numeric import F32, F64, Index, compiled

LEAST_SEPARATION = 0.5 * TABLE_STEPS  # least distance of two scatterers, 0.1 beamwidths: far below the resolution
REACH = 0.5 * TABLE_STEPS  # greatest step of the climb: half a step of the grid
LEAST_POWER = 2.0  # of a scatterer in the whole array, noise powers: weaker ones are never distinct from noise


@compiled
def search_beside(
    matrices: Numbers,
    squints: Index,
    values: F32,
    start: F64,
    least: F64,
    tables: tuple[Numbers, Numbers],
    found: tuple[F64, F64, F64],
) -> None:
    """The scatterers that together explain most: one more than given, where that is worth a climb.

    The climb starts from the given scatterers and the node of the grid that explains most in addition, which suits a
    weak scatterer near a strong one. Where alternating projection (Ziskind and Wax, IEEE Trans. Acoustics, Speech and
    Signal Processing 36, 1988) moves one of these to another node, as it may if their power is the same, the climb
    starts again from there.

    Args:
        matrices: R, (pixels, M, M), double precision.
        squints: number of the squint of each pixel, (pixels,).
        values: u_j^H R u_j, (pixels, nodes).
        start: positions of one scatterer less, (pixels, S - 1).
        least: power that the best node must explain in addition to be worth a climb, (pixels,).
        tables: unit responses at the nodes of the grid, (squints, M, nodes), and the pieces of their tables.
        found: arrays to fill with the positions, (pixels, S), the power that they explain, 0 without a climb, and that
            of the best additional node, (pixels,).
    """
    positions, explained, gains = found
    count = positions.shape[1]
    other = np.empty(count)
    for i in range(len(matrices)):
        matrix, own, position = matrices[i], values[i], positions[i]
        units, pieces = tables[0][squints[i]], tables[1][squints[i]]
        position[: count - 1] = start[i]
        node, gain = best_node(matrix, own, units, pieces, position[: count - 1])
        position[count - 1], explained[i], gains[i] = TABLE_STEPS * node, 0.0, gain
        if gain < least[i]:
            continue
        explained[i] = climb_together(matrix, position, pieces)
        other[:] = position
        if alternate(matrix, own, units, pieces, other):
            height = climb_together(matrix, other, pieces)
            if height > explained[i]:
                position[:] = other
                explained[i] = height


@compiled
def alternate(matrix: Numbers, own: F32, units: Numbers, pieces: Numbers, position: F64) -> bool:
    """Move each scatterer in turn to the node that explains most in addition to the others; True if one has moved.

    A scatterer within a step of that node stays.
    """
    count, moved = position.size, False
    others = np.empty(count - 1)
    for turn in range(2 * count):  # each scatterer twice
        changed = turn % count
        if turn == count and not moved:
            break
        row = 0
        for s in range(count):
            if s != changed:
                others[row] = position[s]
                row += 1
        best = float(TABLE_STEPS * best_node(matrix, own, units, pieces, others)[0])
        if abs(best - position[changed]) > TABLE_STEPS:
            position[changed], moved = best, True
    return moved


@compiled
def best_node(matrix: Numbers, own: F32, units: Numbers, pieces: Numbers, position: F64) -> tuple[int, float]:
    """Node of the grid that explains most in addition to scatterers at `position`, and that power.

    `own` is u_j^H R u_j.
    """
    count, (size, nodes), kind = position.size, units.shape, matrix.dtype
    basis, outputs, unused = np.empty((count, size), kind), np.empty((count, size), kind), np.empty(size, kind)
    factor, inside = np.zeros((count, count), kind), np.empty((count, count), kind)
    for s in range(count):
        unit_at(position[s], pieces, outputs[s], unused)
    orthonormalise(outputs, basis, factor)
    for s in range(count):
        multiply(matrix, basis[s], outputs[s])
    for s in range(count):
        for r in range(count):
            inside[s, r] = inner(basis[s], outputs[r])
    overlap, cross = np.zeros((count, nodes), kind), np.zeros((count, nodes), kind)
    for s in range(count):
        project(units, basis[s], overlap[s])
        project(units, outputs[s], cross[s])
    best, at = -1.0, 0
    for j in range(nodes):
        beyond, residue = float(own[j]), 1.0
        for s in range(count):
            residue -= (overlap[s, j] * np.conj(overlap[s, j])).real
            beyond -= 2 * (np.conj(overlap[s, j]) * cross[s, j]).real
            for r in range(count):
                beyond += (overlap[s, j] * inside[s, r] * np.conj(overlap[r, j])).real
        if residue > LEAST_RESIDUE and beyond > best * residue:
            best, at = beyond / residue, j
    return at, best


@compiled
def project(units: Numbers, vector: Numbers, products: Numbers) -> None:
    """Add to `products` those of all units, (M, nodes), conjugated, with a vector."""
    for m in range(vector.size):
        row, number = units[m], vector[m]
        for j in range(products.size):
            products[j] += np.conj(row[j]) * number


@compiled
def climb_together(matrix: Numbers, position: F64, pieces: Numbers) -> float:
    """Climb from positions to the peak of the explained power f = tr(P R) near them; returns its height.

    Gauss-Newton steps with the expected curvature for these amplitudes. A step after which f is not higher is undone,
    and the next is a quarter of it at most.
    """
    count, last, size = position.size, float(len(pieces)), len(matrix)
    trial, step, next_step = position.copy(), np.zeros(count), np.zeros(count)
    work = (
        np.empty((4, count, size), matrix.dtype),
        np.empty((3, count, count), matrix.dtype),
        np.empty(size, matrix.dtype),
    )
    height, reach = newton_step(matrix, position, pieces, step, work), REACH
    for _ in range(12):
        longest = 0.0
        for s in range(count):
            step[s] = min(max(step[s], -reach), reach)
            longest = max(longest, abs(step[s]))
            trial[s] = min(max(position[s] + step[s], 0.0), last)
        if longest < 3e-4:  # steps of the table: 1e-5 beamwidths
            break
        trial_height = newton_step(matrix, trial, pieces, next_step, work) if are_apart(trial) else -1.0
        if trial_height > height:
            position[:] = trial
            step[:] = next_step
            height = trial_height
        else:
            reach = longest / 4
    return height


@compiled
def are_apart(position: F64) -> bool:
    for s in range(position.size):
        for r in range(s):
            if abs(position[s] - position[r]) < LEAST_SEPARATION:
                return False
    return True


@compiled
def newton_step(
    matrix: Numbers, position: F64, pieces: Numbers, step: F64, work: tuple[Numbers, Numbers, Numbers]
) -> float:
    """Explained power of scatterers at `position`, and the Gauss-Newton step from there, (S,).

    With the unit responses A = Q T (orthonormal Q, triangular T), f = tr(Q^H R Q), the fitted amplitudes have the sums
    of products T^-1 Q^H R Q T^-H, and the gradient is twice the real diagonal of T^-1 Q^H R (I - Q Q^H) A'. `work`
    has arrays of shapes (4, S, M), (3, S, S) and (M,).
    """
    count, (vectors, squares, output) = position.size, work
    units, slopes, basis, fitted = vectors[0], vectors[1], vectors[2], vectors[3]
    factor, inverse, amplitudes = squares[0], squares[1], squares[2]
    for s in range(count):
        unit_at(position[s], pieces, units[s], slopes[s])
    orthonormalise(units, basis, factor)
    height = fit_amplitudes(matrix, basis, (factor, inverse, output), fitted, amplitudes)
    for s in range(count):
        for r in range(count):
            subtract_multiple(basis[r], inner(basis[r], slopes[s]), slopes[s])
    curvature, gradient, trace = np.empty((count, count)), np.empty(count), 0.0
    for s in range(count):
        gradient[s] = inner(fitted[s], slopes[s]).real
        for r in range(count):
            curvature[s, r] = (inner(slopes[s], slopes[r]) * amplitudes[r, s]).real
        trace += curvature[s, s]
    for s in range(count):
        curvature[s, s] += 1e-9 * trace  # so that it can be inverted
    solve(curvature, gradient, step)
    return height


@compiled
def weigh_together(
    matrices: Numbers,
    squints: Index,
    positions: F64,
    tables: tuple[Numbers, F32],
    found: tuple[F64, F64, F64, Numbers, Numbers, Numbers, Numbers, Numbers],
) -> None:
    """Products of unit responses U, their slopes and R for scatterers at known positions, (pixels, S).

    `squints` are the numbers of the pixels' squints, and `tables` the pieces of unit responses and of |a|^2 at all
    squints. `found` is filled with the power that they explain, (pixels,); |a|^2, and the power along the slopes' parts
    perpendicular to U, (pixels, S); U^H U; its inverse; U^H R U; the sums of products of the fitted amplitudes; and
    those of the slopes' parts perpendicular to U, per step of the table squared, all (pixels, S, S).
    """
    explained, powers, along, grams, inverses, seen, fitted, turning = found
    count, size, kind = positions.shape[1], matrices.shape[1], matrices.dtype
    vectors, squares, output = np.empty((4, count, size), kind), np.empty((2, count, count), kind), np.empty(size, kind)
    units, slopes, basis, rows = vectors[0], vectors[1], vectors[2], vectors[3]
    factor, inverse = squares[0], squares[1]
    for i in range(len(matrices)):
        pieces, power = tables[0][squints[i]], tables[1][squints[i]]
        for s in range(count):
            node = min(int(positions[i, s]), len(power) - 1)
            t = positions[i, s] - node
            powers[i, s] = power[node, 0] + t * (power[node, 1] + t * (power[node, 2] + t * power[node, 3]))
            unit_at(positions[i, s], pieces, units[s], slopes[s])
        orthonormalise(units, basis, factor)
        explained[i] = fit_amplitudes(matrices[i], basis, (factor, inverse, output), rows, fitted[i])
        square(inverse, inverses[i])
        for r in range(count):
            multiply(matrices[i], units[r], output)
            for s in range(count):
                grams[i, s, r] = inner(units[s], units[r])
                seen[i, s, r] = inner(units[s], output)
        for s in range(count):
            for r in range(count):
                subtract_multiple(basis[r], inner(basis[r], slopes[s]), slopes[s])
        for s in range(count):
            for r in range(count):
                turning[i, s, r] = inner(slopes[s], slopes[r])
            multiply(matrices[i], slopes[s], output)
            along[i, s] = inner(slopes[s], output).real / max(turning[i, s, s].real, 1e-300)


@compiled
def maximise_powers(grams: Numbers, seen: Numbers, looks: F64, powers: F64, found: tuple[F64, F64]) -> None:
    """See `several.fit_powers`; `powers` (pixels, S) is the start, and is replaced by the result.

    `found` is filled with the log-likelihood, (pixels,), and the information, (pixels, S, S).
    """
    likelihoods, informations = found
    steps = 4  # the powers start from moments and are right to first order in the noise
    count, kind = powers.shape[1], grams.dtype
    squares, damped = np.empty((4, count, count), kind), np.empty((count, count))
    noise, signal, shared, both = squares[0], squares[1], squares[2], squares[3]
    gradient, move = np.empty(count), np.empty(count)
    for i in range(len(grams)):
        power, information = powers[i], informations[i]
        for step in range(steps + 1):
            for s in range(count):
                power[s] = max(power[s], LEAST_POWER)
            for s in range(count):
                for r in range(count):
                    root = np.sqrt(power[s] * power[r])
                    noise[s, r], signal[s, r] = grams[i, s, r] * root, seen[i, s, r] * root
                noise[s, s] += 1
            logarithm = invert_positive(noise, count)
            product(noise, signal, both, count)
            product(both, noise, shared, count)
            likelihoods[i] = -looks[i] * logarithm
            for s in range(count):
                likelihoods[i] += both[s, s].real
                # X N = I - N with X = B U^H U B.
                gradient[s] = shared[s, s].real - looks[i] * (1 - noise[s, s].real)
                for r in range(count):
                    part = -noise[s, r] + (1.0 if s == r else 0.0)
                    information[s, r] = looks[i] * (part * np.conj(part)).real
                    damped[s, r] = information[s, r]
                damped[s, s] += 1e-6 * looks[i]  # so that it can be inverted
            if step < steps:
                solve(damped, gradient, move)
                for s in range(count):
                    power[s] *= np.exp(min(max(move[s], -1.0), 1.0))


@compiled
def fit_amplitudes(
    matrix: Numbers,
    basis: Numbers,
    parts: tuple[Numbers, Numbers, Numbers],
    fitted: Numbers,
    amplitudes: Numbers,
) -> float:
    """Rows of A^+ R, conjugated, and A^+ R A^+H, for A = `basis` @ factor; returns tr(Q^H R Q).

    `parts` are the factor, and work arrays (S, S) and (M,).
    """
    (factor, inverse, output), (count, size) = parts, basis.shape
    invert_triangular(factor, inverse)
    height = 0.0
    for s in range(count):
        for m in range(size):
            fitted[s, m] = 0
    for r in range(count):
        multiply(matrix, basis[r], output)
        height += inner(basis[r], output).real
        for s in range(r + 1):
            subtract_multiple(output, -np.conj(inverse[s, r]), fitted[s])
    for s in range(count):
        for r in range(count):
            amplitudes[s, r] = 0
            for q in range(r, count):
                amplitudes[s, r] += inner(fitted[s], basis[q]) * np.conj(inverse[r, q])
    return height


@compiled
def square(factor: Numbers, result: Numbers) -> None:
    """The product of an upper triangular matrix with its adjoint."""
    count = len(factor)
    for s in range(count):
        for r in range(count):
            result[s, r] = factor[s, count - 1] * np.conj(factor[r, count - 1])
            for q in range(max(s, r), count - 1):
                result[s, r] += factor[s, q] * np.conj(factor[r, q])


@compiled
def subtract_multiple(vector: Numbers, factor: Any, rest: Numbers) -> None:
    """Subtract a multiple of a vector."""
    for m in range(rest.size):
        rest[m] -= factor * vector[m]


@compiled
def solve(matrix: F64, right: F64, solution: F64) -> None:
    """Solve matrix @ solution = right by elimination without exchange, for a positive matrix of a few rows."""
    count = right.size
    for s in range(count):
        for r in range(s + 1, count):
            factor = matrix[r, s] / matrix[s, s]
            for c in range(s, count):
                matrix[r, c] -= factor * matrix[s, c]
            right[r] -= factor * right[s]
    for s in range(count - 1, -1, -1):
        solution[s] = right[s]
        for c in range(s + 1, count):
            solution[s] -= matrix[s, c] * solution[c]
        solution[s] /= matrix[s, s]


@compiled
def orthonormalise(vectors: Numbers, basis: Numbers, factor: Numbers) -> None:
    """Orthonormal `basis` (S, M) and upper triangular `factor` (S, S) with vectors[s] = sum_r factor[r, s] basis[r]."""
    for s in range(len(vectors)):
        for m in range(vectors.shape[1]):
            basis[s, m] = vectors[s, m]
        for r in range(s):
            factor[r, s] = inner(basis[r], basis[s])
            factor[s, r] = 0
            subtract_multiple(basis[r], factor[r, s], basis[s])
        norm = np.sqrt(inner(basis[s], basis[s]).real)
        factor[s, s] = norm
        for m in range(vectors.shape[1]):
            basis[s, m] /= norm


@compiled
def invert_triangular(factor: Numbers, inverse: Numbers) -> None:
    """The inverse of an upper triangular matrix."""
    for c in range(len(factor)):
        inverse[c, c] = 1 / factor[c, c]
        for s in range(c + 1, len(factor)):
            inverse[s, c] = 0
        for s in range(c - 1, -1, -1):
            inverse[s, c] = 0
            for r in range(s + 1, c + 1):
                inverse[s, c] -= factor[s, r] * inverse[r, c] / factor[s, s]


@compiled
def invert_positive(matrix: Numbers, count: int) -> float:
    """Invert the first rows and columns of a positive matrix in place; returns the logarithm of their determinant."""
    logarithm = 0.0
    for k in range(count):
        logarithm += np.log(matrix[k, k].real)
        eliminate(matrix, k, count)
    return logarithm


@compiled
def eliminate(matrix: Numbers, k: int, count: int) -> None:
    """Step of the inversion of the first rows and columns of a matrix in place, with its k-th pivot."""
    pivot = matrix[k, k].real
    matrix[k, k] = 1
    for j in range(count):
        matrix[k, j] /= pivot
    for i in range(count):
        if i != k:
            factor = matrix[i, k]
            matrix[i, k] = 0
            for j in range(count):
                matrix[i, j] -= factor * matrix[k, j]


@compiled
def product(left: Numbers, right: Numbers, result: Numbers, count: int) -> None:
    """The product of the first rows and columns of two matrices."""
    for i in range(count):
        for j in range(count):
            result[i, j] = 0
        for k in range(count):
            factor = left[i, k]
            for j in range(count):
                result[i, j] += factor * right[k, j]
