"""Whitening of a sensor's channels: channels of independent noise, as close to the single beams as possible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import polar

from sal_height.errors import UserError
from sal_height.numeric import C128, F64, ShortRepr


@dataclass(frozen=True, eq=False)
class Channels(ShortRepr):
    """Linear combinations of a sensor's channels with independent noise, for an estimator.

    Attributes:
        transform: matrix that multiplies the sensor's channels (`looks.windowed_looks`).
        matrix: matrix from the detectors to the new channels (`Beams.combined`).
        noise_powers: E|n|^2 of a sample of each new channel.
    """

    transform: C128
    matrix: F64 | C128
    noise_powers: F64


def whitened_channels(noise_covariance: C128, channel_matrix: C128) -> Channels:
    """Return channels of equal and independent noise that are as close to the single beams as possible.

    A sensor's channels are M times the beams, with noise of covariance N. With the polar decomposition
    N^(-1/2) M = U P (U unitary, P Hermitian and positive), T = sqrt(power) U^H N^(-1/2) gives channels of independent
    noise of that power that are sqrt(power) P times the beams: of all whitening transforms, T is the one closest to the
    beams. It undoes a lossless hybrid, and it removes the phases of complex calibration constants, so that real beams
    stay real.

    The power is detectors / trace(M^H N^-1 M): the squares of the beams' gains have the mean 1, and a noisy detector
    has little weight in CNRs, too. Without a channel matrix and with independent noise, the power is the harmonic mean
    of the noise powers, and T multiplies each channel by sqrt(power / its noise power).

    Args:
        noise_covariance: N, E n n^H of the channels, shape (channels, channels).
        channel_matrix: M, invertible, shape (channels, detectors), as many.

    Raises:
        UserError: a noise power is not known (0), negative or not finite, or the covariance is not positive definite.
    """
    powers = np.diag(noise_covariance).real
    if not np.all(np.isfinite(powers) & (powers > 0)):
        raise UserError(
            f"The channels' noise powers are {powers.tolist()}; all must be known, finite and greater than 0."
        )
    values, vectors = np.linalg.eigh(noise_covariance)
    if not values[0] > 0:
        raise UserError("The covariance of the channels' noise is not positive definite; it must be.")
    inverse_root = (vectors / np.sqrt(values)) @ vectors.conj().T
    unitary, positive = polar(inverse_root @ channel_matrix)
    power = len(channel_matrix) / float(np.sum(np.abs(positive) ** 2))
    transform = np.sqrt(power) * (unitary.conj().T @ inverse_root)
    return Channels(transform, transform @ channel_matrix, np.full(len(channel_matrix), power))


def with_powers(noise_covariance: C128, powers: F64) -> C128:
    """Return the covariance of noise that has these powers and the correlations of `noise_covariance`.

    Linear processing that is the same for all channels does not change correlations, so that the noise of images
    follows from that of the phase history. Correlations with a channel of unknown power (0) are 0.

    Args:
        noise_covariance: shape (channels, channels).
        powers: E|n|^2, shape (channels,).
    """
    before = np.diag(noise_covariance).real
    gains = np.sqrt(np.divide(powers, before, out=np.zeros(len(powers)), where=(before > 0) & (powers > 0)))
    scaled = gains[:, None] * noise_covariance * gains
    np.fill_diagonal(scaled, powers)
    return scaled


MATRIX_ROUNDING = 1e-6  # relative difference allowed between a channel matrix and a hybrid's: rounding of float32


def sum_difference_channels(noise_covariance: C128, channel_matrix: C128) -> Channels:
    """Return Sigma = upper + lower and Delta = upper - lower from a sensor's channels, for `sum_difference_elevation`.

    The matrix of these `Channels` is diagonal, with the gains of the lower and the upper beam.

    Args:
        noise_covariance: E n n^H of the channels, shape (2, 2).
        channel_matrix: the channels from the beams (lower, upper), shape (2, 2): see `separated_gains`.

    Raises:
        UserError: the matrix forms no sum and difference, or the noise of Sigma and Delta is correlated, because
            unlike receivers precede the hybrid. The estimators for the whole array accept any noise.
    """
    channels, beams = separated_gains(channel_matrix)
    transform = np.diag(1 / channels)
    noise = transform @ noise_covariance @ transform.conj().T
    sum_noise, difference_noise = (float(power) for power in np.diag(noise).real)
    correlation = abs(noise[0, 1]) / max(np.sqrt(abs(sum_noise * difference_noise)), np.finfo(np.float64).tiny)
    if not correlation <= MATRIX_ROUNDING:
        raise UserError(
            f"The noise of Sigma and Delta has a correlation of {correlation:.3g}; their discriminator needs "
            "independent noise, so use an estimator for the whole array."
        )
    return Channels(transform, np.eye(2) * beams, np.array([sum_noise, difference_noise]))


def separated_gains(matrix: C128) -> tuple[C128, F64 | C128]:
    """Split the matrix of a sensor that forms sum and difference into gains of its channels and of its beams.

    Its channels are matrix @ (lower, upper) with matrix = diag(channels) [[1, 1], [-1, 1]] diag(beams). Channel gains
    are those of receivers or couplings of the hybrid; beam gains are those of everything before the hybrid.

    Args:
        matrix: channels from beams, shape (2, 2).

    Returns:
        Gains of (Sigma, Delta) and of (lower, upper); the mean power of the latter is 1, and they are real
        where they can be.

    Raises:
        UserError: the matrix is not such a product, or channel 0 is not the sum.
    """
    matrix = np.asarray(matrix, dtype=np.complex128)
    a, b, c, d = matrix.ravel() if matrix.shape == (2, 2) and np.all(np.isfinite(matrix)) else np.zeros(4)
    separable = abs(a * d + b * c) <= MATRIX_ROUNDING * max(abs(a * d), abs(b * c))
    if not (separable and (a * np.conj(b)).real > 0 and abs(d) > 0):
        raise UserError(
            f"The channel matrix {matrix.tolist()} forms no sum and difference of two beams; it must be "
            "diag(channel gains) [[1, 1], [-1, 1]] diag(beam gains), with gains that add in channel 0."
        )
    direction = matrix[0].sum() / abs(matrix[0].sum())
    sum_gain = direction * np.sqrt(np.mean(np.abs(matrix[0]) ** 2))
    beams = matrix[0] / sum_gain
    real = np.all(np.abs(beams.imag) <= MATRIX_ROUNDING)
    return np.array([sum_gain, matrix[1, 1] / beams[1]]), beams.real if real else beams
