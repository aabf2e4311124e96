"""Noise of the sum-difference discriminator in closed form, and what a hybrid before the receivers gains.

Of one accumulated pulse train, Sigma = S + n and Delta = gamma S + n' (relief paper, eq. 8 and 9); x is the
signal-to-noise power ratio in Sigma. Means and laws are those of `noise_theory`: of coherent sums of N pulses
`steady_mean` and `SteadyLaw` at N x, or `SteadyMlLaw` for the maximum likelihood; of sums of N pulses' products
`steady_looks_mean`; of a mean of N pulses' ratios `steady_mean` at x.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def discriminator_variance(gamma: npt.ArrayLike, energy: npt.ArrayLike, noise_powers: tuple[float, float]) -> Array:
    """Variance of gamma to first order in the noise: (N_Delta + gamma^2 N_Sigma) / (2 E); broadcasts.

    (1 + gamma^2) / (2 x) for equal noise and the signal-to-noise ratio x in Sigma. That of `ratio` and of the exact
    maximum likelihood alike. Of one look at a steady target, second order adds the share (1 + 2 gamma^2) /
    (x + x gamma^2) to that of `ratio`, and twice as much to that of the maximum likelihood; neither has a variance in
    the strict sense, as the tails beyond that order say.

    Args:
        gamma: modulus of Delta / Sigma without noise.
        energy: of the signal in Sigma, over all looks.
        noise_powers: of Sigma and Delta.
    """
    gamma, energy = np.asarray(gamma), np.asarray(energy)
    return np.asarray((noise_powers[1] + gamma**2 * noise_powers[0]) / (2 * energy))


def products_variance(
    gamma: npt.ArrayLike, energy: npt.ArrayLike, count: npt.ArrayLike, noise_powers: tuple[float, float]
) -> Array:
    """Variance of the maximum likelihood estimate of gamma from products summed over many looks or pulses; broadcasts.

    `discriminator_variance` times 1 + K / (E/N_Sigma + gamma^2 E/N_Delta). The second term is what it costs that the
    amplitudes of the K looks, or the phases of the K pulses, are not known: 1 / (x + x gamma^2) for equal noise and the
    signal-to-noise ratio x of each. It is the Cramer-Rao bound for Gaussian amplitudes (`bounds.stochastic_crb`).

    Args:
        gamma: modulus of Delta / Sigma without noise.
        energy: E of the signal in Sigma, over all looks.
        count: of looks or pulses, K.
        noise_powers: of Sigma and Delta.
    """
    over_noise = np.asarray(energy) * (1 / noise_powers[0] + np.asarray(gamma) ** 2 / noise_powers[1])
    return np.asarray(discriminator_variance(gamma, energy, noise_powers) * (1 + np.asarray(count) / over_noise))


def hybrid_gain(coupling: npt.ArrayLike, loss: npt.ArrayLike) -> Array:
    """Gain in signal-to-noise power ratio of a hybrid before the receivers against sums after them: 2 c^2 / L.

    The hybrid makes c (upper + lower) / sqrt(L) and c (upper - lower) / sqrt(L), and the same receivers follow. With
    c = 1 / sqrt(2) and no loss it is unitary and gains nothing: it only turns the two channels, and equal independent
    noise stays what it is. The gain of 2 that the relief paper's eq. 3 implies (c = 1) asks for twice the power that
    the two beams deliver.

    Args:
        coupling: c, amplitude ratio.
        loss: L, power ratio, 1 or more.
    """
    return np.asarray(2 * np.asarray(coupling) ** 2 / np.asarray(loss))
