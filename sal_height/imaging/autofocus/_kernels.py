"""Loops over responses, pairs of pulses and periodograms, compiled; a test compares each with its formula in NumPy."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import C128, F32, F64, I64, Complex, Index, compiled


@compiled
def fill_blocks(responses: Complex, blocks: Complex) -> None:
    """Copy the cells of responses in blocks, in the order in which the responses lie.

    Args:
        responses: shape (channels, pulses, cells).
        blocks: array to fill with as many cells as it holds, shape (blocks, channels, pulses, cells of a block).
    """
    count, channels, pulses, like = blocks.shape
    for channel in range(channels):
        for pulse in range(pulses):
            line = responses[channel, pulse]
            for block in range(count):
                for cell in range(like):
                    blocks[block, channel, pulse, cell] = line[block * like + cell]


@compiled
def invert_toeplitz(column: C128, inverse: C128) -> None:
    """Invert a positive definite Hermitian Toeplitz matrix, in a time that grows with the square of its size.

    Levinson's recursion gives the predictor of each pulse from those before it, and the formula of Gohberg and Semencul
    the inverse from that, along the diagonals (Golub and Van Loan, Matrix Computations, 2013, section 4.7).

    Args:
        column: first column of the matrix, shape (pulses,).
        inverse: array to fill with the diagonals of the inverse, from the main one down, shape (pulses, lags + 1): the
            element (t, d) is that of row t + d and column t; it must be 0 beyond the last row.
    """
    pulses, lags = inverse.shape[0], inverse.shape[1] - 1
    predictor, before = np.zeros(pulses, np.complex128), np.zeros(pulses, np.complex128)
    predictor[0], error = 1.0, column[0].real
    for order in range(1, pulses):
        miss = 0j
        for k in range(order):
            miss += column[order - k] * predictor[k]
        turn = -miss / error
        before[:order] = predictor[:order]
        for k in range(1, order + 1):
            predictor[k] += turn * before[order - k].conjugate()
        error *= 1 - (turn.real * turn.real + turn.imag * turn.imag)
    for d in range(lags + 1):
        inverse[0, d] = predictor[d] / error
    for t in range(1, pulses):
        # Rows and columns t of the product of the predictor with itself, less that of the reversed predictor.
        ahead, behind = predictor[t].conjugate() / error, predictor[pulses - t] / error
        for d in range(min(lags + 1, pulses - t)):
            last = predictor[pulses - t - d].conjugate()
            inverse[t, d] = inverse[t - 1, d] + predictor[t + d] * ahead - last * behind


@compiled
def subtract_products(inverse: C128, total: Complex, weighted: C128) -> None:
    """Subtract the products of the elements of two Hermitian matrices.

    Args:
        inverse: diagonals of the first one, shape (pulses, lags + 1), as those of `invert_toeplitz`.
        total: the second one, shape (pulses, pulses).
        weighted: diagonals to subtract from, as those of the first one.
    """
    pulses, lags = inverse.shape[0], inverse.shape[1] - 1
    for t in range(pulses):
        line, seen, result = inverse[t], total[t, t:], weighted[t]
        for d in range(min(lags + 1, pulses - t)):
            result[d] -= line[d] * seen[d].conjugate()


@compiled
def fill_information(column: C128, inverse: C128, information: F64) -> None:
    """Twice the real part of the products of a Hermitian Toeplitz matrix and the conjugate of its inverse.

    Args:
        column: first column of the matrix, shape (pulses,).
        inverse: diagonals of the inverse (`invert_toeplitz`), shape (pulses, lags + 1).
        information: array to fill, same shape.
    """
    for t in range(len(inverse)):
        line, result = inverse[t], information[t]
        for d in range(line.size):
            result[d] = 2 * (column[d].real * line[d].real + column[d].imag * line[d].imag)


@compiled
def fill_periodograms(spectra: Complex, power: F32) -> None:
    """Squared moduli of spectra over half their length, from the lowest frequency up.

    Args:
        spectra: in the order of an FFT of even length, shape (responses, azimuths).
        power: array to fill, same shape.
    """
    half = spectra.shape[1] // 2
    scale = np.float32(1 / half)
    for i in range(len(spectra)):
        spectrum, below, above = spectra[i], power[i, :half], power[i, half:]
        for a in range(half):
            one, other = spectrum[a], spectrum[half + a]
            above[a] = scale * (one.real * one.real + one.imag * one.imag)
            below[a] = scale * (other.real * other.real + other.imag * other.imag)


@compiled
def score_shifts(found: F32, snr: F64, spectrum: F64, bend: F64, scores: F64, slopes: F64) -> float:
    """Slopes of the likelihood of periodograms by a shift of the spectrum of the echo.

    Args:
        found: periodograms of responses, noise of power 1, shape (responses, azimuths).
        snr: signal-to-noise ratio of each response, shape (responses,).
        spectrum: spectrum of the echo, shape (azimuths,).
        bend: slope of its logarithm, per azimuth.
        scores: array to fill with the slope of each response, shape (responses,).
        slopes: zeros, to which the slope of each azimuth per brighter ground is added, shape (azimuths,).

    Returns:
        The information of all responses on the shift.
    """
    information = 0.0
    for i in range(len(found)):
        line, ratio, score, known = found[i], snr[i], 0.0, 0.0
        for a in range(line.size):
            even = 1 + ratio * spectrum[a]
            fraction = 1 - 1 / even
            slope = fraction * bend[a]
            score += (line[a] / even - 1) * slope
            known += slope * slope
            slopes[a] += fraction * slope
        scores[i] = score
        information += known
    return information


@compiled
def find_eigenvectors(matrices: Complex, block: Index, values: F64, vectors: C128) -> None:
    """Eigenvectors of Hermitian matrices for some of their eigenvalues, by inverse iteration.

    Two rounds reach the precision of the matrices, as the eigenvalues are known; vectors of one matrix are orthogonal.

    Args:
        matrices: shape (blocks, channels, channels).
        block: number of the matrix of each eigenvalue, in rising order, shape (vectors,).
        values: eigenvalues, greater than 0, shape (vectors,).
        vectors: array to fill with vectors of length 1, shape (vectors, channels).
    """
    channels = vectors.shape[1]
    factors, rows = np.empty((channels, channels), np.complex128), np.empty(channels, np.int64)
    for v in range(len(vectors)):
        factors[:] = matrices[block[v]]
        for m in range(channels):
            factors[m, m] -= values[v]
        _factorise(factors, 1e-12 * values[v], rows)
        vector = vectors[v]
        for m in range(channels):
            vector[m] = complex(1.0 / (m + 1), 1.0 / (m + 2))  # at right angles to no vector that matters
        for _ in range(2):
            _solve(factors, rows, vector)
            first = v
            while first > 0 and block[first - 1] == block[v]:
                first -= 1
                product = 0j
                for m in range(channels):
                    product += vectors[first, m].conjugate() * vector[m]
                for m in range(channels):
                    vector[m] -= product * vectors[first, m]
            power = 0.0
            for m in range(channels):
                power += vector[m].real * vector[m].real + vector[m].imag * vector[m].imag
            vector *= 1 / np.sqrt(power)


@compiled
def _factorise(matrix: C128, least: float, rows: I64) -> None:
    """Factors of a matrix, in its place, with pivots of `least` or more in the `rows` that are exchanged."""
    size = len(matrix)
    for k in range(size):
        rows[k], greatest = k, -1.0
        for m in range(k, size):
            power = matrix[m, k].real * matrix[m, k].real + matrix[m, k].imag * matrix[m, k].imag
            if power > greatest:
                rows[k], greatest = m, power
        for n in range(size):
            matrix[k, n], matrix[rows[k], n] = matrix[rows[k], n], matrix[k, n]
        if greatest < least * least:
            matrix[k, k] = least
        inverse = 1 / matrix[k, k]
        for m in range(k + 1, size):
            factor = matrix[m, k] * inverse
            matrix[m, k] = factor
            for n in range(k + 1, size):
                matrix[m, n] -= factor * matrix[k, n]


@compiled
def _solve(factors: C128, rows: I64, vector: C128) -> None:
    """The vector that the factorised matrix makes this one of, in its place."""
    size = vector.size
    for k in range(size):
        vector[k], vector[rows[k]] = vector[rows[k]], vector[k]
    for m in range(size):
        for n in range(m):
            vector[m] -= factors[m, n] * vector[n]
    for m in range(size - 1, -1, -1):
        for n in range(m + 1, size):
            vector[m] -= factors[m, n] * vector[n]
        vector[m] /= factors[m, m]
