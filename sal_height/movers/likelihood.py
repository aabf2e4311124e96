"""Likelihood of a target's echoes in the channels, from its amplitudes in Doppler bins, or in dwells.

A target is received n = 1, 2, ... times, each time by the beam in another direction: in the Doppler bins of a strip, or
in spotlight dwells that overlap. With g_n the amplitude of the beam in the direction of the target and m_n the channels
combined by that beam, over noise and clutter of power 1,

    m_n = g_n a_n + noise.

Position, height and radial velocity of a mover are in g_n. A dwell shows it under the squint of its position. In a
strip a Doppler frequency is the time at which the antenna saw a target under one aspect; the radial velocity v_r of a
mover adds the same to all its frequencies, so that its image shows it under aspects that are v_r / v too small. With
the lag

    beta = v_r / v

the amplitude in bin n is that of the beam under the aspect alpha_n + beta (SAL paper, section 4).

A cloud of scatterers has Gaussian amplitudes a_n of the power P and the coherence A. With s_i the power of m along the
eigenvector i of g_k A_kl g_l, and q_i = P times its eigenvalue, the logarithm of the likelihood over that of noise and
clutter alone is (Kay, Fundamentals of Statistical Signal Processing II, 1998, section 5.3)

    ln L = sum over i of s_i q_i / (1 + q_i) - ln(1 + q_i).                                                          (1)

- In a strip a cloud has the rms width w along the flight about its centre, A_kl = exp(-2 (pi w (f_k - f_l))^2). A point
  is w = 0, whose spectrum is the beam's amplitude; speckle is a wide cloud, each bin by itself.
- The phase from dwell to dwell is unknown, and speckle differs from each to the next: A is the unit matrix.

A point that is as bright in every dwell, but for errors of the beam, has amplitudes of known power and unknown phase
(Kay, section 7.6):

    ln L = sum over n of |m_n|^2 - (|m_n|^2 + q_n) / v_n + ln I_0(2 sqrt(q_n) |m_n| / v_n) - ln v_n,                 (2)
    q_n = P g_n^2,  v_n = 1 + MODEL_ERROR q_n.

The likelihood is the greatest over P, w and these kinds, so that interference and fading are not mistaken for motion.
Beyond its main lobe a beam is not known well: there each bin is by itself, or the antenna sees nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import i0e

from sal_height.numeric import C128, F32, F64, Bool

MODEL_ERROR = 0.01
"""Power of the error of beam amplitudes, over their own."""

HYPOTHESES = 10.0
"""Number of lags, or squints, that can be separated.

Measured with pairs of points in one cell, which are at rest and are most often mistaken for movers."""

WIDTHS = np.array([0.0, 0.15, 0.3, 0.6, 1.2, 2.4, 4.8, 9.6, 1e3])
"""Rms widths of clouds in resolution cells; the widest makes all bins incoherent."""

POWERS = 10 ** (np.arange(-10, 41, 2) / 10)
"""Powers of targets in Doppler bins, over the background."""

POWERS_IN_DWELLS = 10 ** (np.arange(-6, 55, 3) / 10)
"""Powers of targets in dwells, over the background."""


def cloud_ratio(energy: F64, powers: F64, axis: int | tuple[int, ...]) -> F64:
    """Logarithm of the likelihood ratio of a cloud against noise and clutter, equation (1).

    Args:
        energy: power s of the amplitudes along each eigenvector, background 1; broadcasts with `powers`.
        powers: expected powers q of the cloud along these.
        axis: axes of the eigenvectors, over which the sum is taken.
    """
    return np.asarray(np.sum(energy * (powers / (1 + powers)) - np.log1p(powers), axis=axis))


def point_ratio(amplitude: F64, powers: F64) -> F64:
    """Logarithm of the likelihood ratio of a point of unknown phases against noise and clutter, equation (2).

    Args:
        amplitude: amplitudes |m_n|, background 1, shape (..., dwells).
        powers: expected powers q_n; broadcasts with that.

    Returns:
        Sum over dwells, shape (...).
    """
    square, variance = amplitude**2, 1 + MODEL_ERROR * powers
    # ln I_0(x) is x and the logarithm of i0e, which does not overflow.
    x = 2 * np.sqrt(powers) * amplitude / variance
    each = square - (square + powers) / variance + x + np.log(i0e(x) / variance)
    return np.asarray(np.sum(each, axis=-1))


def ratio_in_dwells(matched: F64, gains: F64, powers: F64 = POWERS_IN_DWELLS, points: bool = True) -> F64:
    """Logarithm of the likelihood ratio of a target in dwells, its greatest over powers and kinds.

    A target published as moving must be likelier even as speckle: bright speckle has among many points one that fits
    it by chance.

    Args:
        matched: amplitudes |m_n|, shape (..., dwells).
        gains: amplitude g_n of the beam over the background's; broadcasts to that shape.
        powers: powers P, of which the best counts.
        points: True if points count, too, and not only speckle.

    Returns:
        Shape (...); not less than 0, as there may be no target.
    """
    amplitude = np.abs(matched)
    q = np.multiply.outer(powers, gains**2)
    speckle = np.maximum(cloud_ratio(matched**2, q, -1).max(axis=0), 0.0)
    return np.maximum(point_ratio(amplitude, q).max(axis=0), speckle) if points else np.asarray(speckle)


def ratio_over_rows(matched: F64, gains: F64, fractions: F64) -> float:
    """Logarithm of the likelihood ratio of speckle in dwells that is spread over rows, its greatest over spreads.

    Args:
        matched: amplitudes |m_n| in each row, shape (dwells, rows).
        gains: amplitude g_n of the beam over the background's, shape (dwells,).
        fractions: fractions of the power in each row, shape (spreads, rows) or (spreads, dwells, rows).
    """
    square = matched**2
    powers = np.broadcast_to(fractions if fractions.ndim == 3 else fractions[:, None], (len(fractions), *square.shape))
    q = np.multiply.outer(POWERS_IN_DWELLS, powers * gains[:, None] ** 2)
    return max(0.0, float(np.max(cloud_ratio(square, q, (-2, -1)))))


@dataclass(frozen=True, eq=False)
class LagLikelihood:
    """Likelihoods of some lags in a strip, for targets at one elevation.

    For a lag and a width the eigenvectors are the same whatever P is, and for all targets whose beam is the same. They
    and the weights that they have for each P are computed once; a spectrum then costs two small products of matrices.

    Attributes:
        frequencies: frequencies of the bins in cycles per resolution cell, shape (bins,); only their differences count.
        gains: amplitude of the beam in each bin for each lag, shape (lags, bins).
        known: True where that is in the main lobe, same shape.
    """

    frequencies: F64
    gains: F64
    known: Bool

    @staticmethod
    def cached(frequencies: F64, gains: F64, known: Bool) -> LagLikelihood:
        """The likelihood of these arguments, made once for all images that have equal ones."""
        return _cached(frequencies.tobytes(), gains.tobytes(), known.tobytes(), len(gains))

    @cached_property
    def _with_sidelobes(self) -> Bool:
        """Lags with bins in sidelobes of the beam, shape (lags,)."""
        return ~np.all(self.known, axis=-1)

    @cached_property
    def _cases(self) -> tuple[F64, Bool]:
        """Gains, and where they are known: of all lags, then again of those with sidelobes, but with no gain there.

        Shape (cases, bins).
        """
        dark = np.where(self.known, self.gains, 0.0)[self._with_sidelobes]
        return np.concatenate([self.gains, dark]), np.concatenate([self.known, self.known[self._with_sidelobes]])

    @cached_property
    def _modes(self) -> tuple[F32, F32, F32, F32]:
        """Eigenvectors and eigenvalues of the clouds of power 1.

        Returns:
            Eigenvectors of each case and width, shape (cases, widths, modes, bins); eigenvalues, shape (cases, widths,
            modes); 1 / (1 + q) for each power of the cloud, shape (cases, widths, powers, modes); the sum over the
            modes of ln(1 + q), shape (cases, widths, powers).
        """
        gains, known = self._cases
        apart = self.frequencies[:, None] - self.frequencies
        together = (known[:, None, :, None] & known[:, None, None, :]) | (apart == 0)
        alike = np.where(together, np.exp(-2 * (np.pi * WIDTHS[:, None, None] * apart) ** 2), 0.0)
        powers, modes = np.linalg.eigh(gains[:, None, :, None] * alike * gains[:, None, None, :])
        powers = np.maximum(powers, 0.0)
        with_background = 1 + POWERS[:, None] * powers[:, :, None, :]
        volumes = np.sum(np.log(with_background), axis=-1)
        as_rows = np.ascontiguousarray(np.swapaxes(modes, -1, -2))
        found = (as_rows, powers, 1 / with_background, volumes)
        modes, powers, weights, volumes = (each.astype(np.float32) for each in found)
        return modes, powers, weights, volumes

    def of(self, spectra: C128) -> F64:
        """Logarithm of the likelihood of each lag without the term of the noise alone, shape (targets, lags).

        That term, the energy of the spectrum, makes it the ratio of equation (1).

        Args:
            spectra: spectra m of targets about their centres, background 1, for each lag, shape (targets, lags, bins).
        """
        modes, _, weights, volumes = self._modes
        both = np.concatenate([spectra.real, spectra.imag]).astype(np.float32)
        columns = np.moveaxis(np.concatenate([both, both[:, self._with_sidelobes]], axis=1), 0, -1)
        amplitudes = modes @ columns[:, None]
        count = len(spectra)
        energy = amplitudes[..., :count] ** 2 + amplitudes[..., count:] ** 2
        misfits = np.min(weights @ energy + volumes[..., None], axis=(1, 2)).T.astype(np.float64)
        likelihood, dark = -misfits[:, : len(self.gains)], -misfits[:, len(self.gains) :]
        likelihood[:, self._with_sidelobes] = np.maximum(likelihood[:, self._with_sidelobes], dark)
        return likelihood


@lru_cache(maxsize=32)  # for the next images; 10 MB each
def _cached(frequencies: bytes, gains: bytes, known: bytes, lags: int) -> LagLikelihood:
    return LagLikelihood(
        np.frombuffer(frequencies),
        np.frombuffer(gains).reshape(lags, -1),
        np.frombuffer(known, dtype=np.bool_).reshape(lags, -1),
    )
