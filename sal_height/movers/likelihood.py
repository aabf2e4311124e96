"""Likelihood of the direction in which something was seen, from its spectrum along the flight.

In a strip each Doppler frequency of a target is the time at which the antenna saw it under one aspect, with the
beam's amplitude there. The radial velocity v_r of a mover adds the same to all its frequencies, so that its image shows
it under aspects that are v_r / v too small: the beam seems to look elsewhere. With the lag

    beta = v_r / v

the amplitude of bin k is that of the beam under the aspect alpha_k + beta (SAL paper, section 4).

A target is a cloud of scatterers: Gaussian amplitudes, spread along the flight with the rms width w about its centre,
of the power P. Bins k and l have the covariance

    C = 1 + P g_k g_l exp(-2 (pi w (f_k - f_l))^2)

with the beam's amplitudes g and background 1. A single point is w = 0, whose spectrum is the beam's amplitude; speckle
is a wide cloud, each bin by itself. Beyond its main lobe a beam is not known well: there each bin is by itself, or the
antenna sees nothing. The likelihood of beta is the greatest over P, w and these two: what two scatterers of a cell do
to their spectrum by interference is counted, and not taken for motion.

For a lag and a width the modes of C are the same whatever P is, and for all targets whose beam is the same. They and
the weights that they have for each P are computed once; a spectrum then costs two small products of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from sal_height.numeric import C128, F32, F64, Bool

WIDTHS = np.array([0.0, 0.15, 0.3, 0.6, 1.2, 2.4, 4.8, 9.6, 1e3])
"""Rms widths of the clouds in resolution cells; the widest leaves no two bins alike."""

POWERS = 10 ** (np.arange(-10, 41, 2) / 10)
"""Powers of the clouds, over the background."""

HELD = 16
"""Likelihoods that are kept for the next images, 10 MB each."""


@dataclass(frozen=True, eq=False)
class LagLikelihood:
    """Likelihoods of some lags, for targets at one elevation.

    Attributes:
        frequencies: of the bins in cycles per resolution cell, shape (bins,); only their differences count.
        gains: amplitude of the beam in each bin for each lag, shape (lags, bins).
        known: whether that is in the main lobe, same shape.
    """

    frequencies: F64
    gains: F64
    known: Bool

    @staticmethod
    def held(frequencies: F64, gains: F64, known: Bool) -> LagLikelihood:
        """That of these arguments, made once for all images that have the very same ones."""
        return _held(frequencies.tobytes(), gains.tobytes(), known.tobytes(), len(gains))

    @cached_property
    def _cases(self) -> tuple[F64, Bool]:
        """Gains of each lag, then of those lags whose beam has sidelobes, once more without them; where they are known.

        The lags of the latter are those that have an unknown bin, in their order.
        """
        beside = ~np.all(self.known, axis=-1)
        gains = np.concatenate([self.gains, np.where(self.known, self.gains, 0.0)[beside]])
        return gains, np.concatenate([self.known, self.known[beside]])

    @cached_property
    def _modes(self) -> tuple[F32, F32, F32, F32]:
        """What spectra are multiplied by.

        Returns:
            The modes of each case and width, shape (cases, widths, modes, bins); their powers in a cloud of power 1,
            shape (cases, widths, modes); one over the power that each has with the background for each power of the
            cloud, shape (cases, widths, powers, modes); and the sum over the modes of the logarithm of that power,
            shape (cases, widths, powers).
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
        """Logarithm of the likelihood of each lag, shape (targets, lags).

        Args:
            spectra: of targets about their centres, background 1, for each lag, shape (targets, lags, bins).
        """
        modes, _, weights, volumes = self._modes
        beside = ~np.all(self.known, axis=-1)
        both = np.concatenate([spectra.real, spectra.imag]).astype(np.float32)
        columns = np.moveaxis(np.concatenate([both, both[:, beside]], axis=1), 0, -1)
        amplitudes = modes @ columns[:, None]
        count = len(spectra)
        seen = amplitudes[..., :count] ** 2 + amplitudes[..., count:] ** 2
        misfits = np.min(weights @ seen + volumes[..., None], axis=(1, 2)).T.astype(np.float64)
        told, without = -misfits[:, : len(self.gains)], -misfits[:, len(self.gains) :]
        told[:, beside] = np.maximum(told[:, beside], without)
        return told

    def of_rows(self, spectra: C128, lag: int, covariances: F64) -> float:
        """Logarithm of the likelihood of clouds that are spread over range; its greatest.

        Args:
            spectra: of rows about the centre of a target, background 1, shape (bins, rows).
            lag: its number.
            covariances: of rows for some spreads of clouds of power 1, shape (spreads, rows, rows).
        """
        modes, powers, _, _ = self._modes
        beside = ~np.all(self.known, axis=-1)
        cases = [lag, len(self.known) + int(np.sum(beside[:lag]))] if beside[lag] else [lag]
        shares, parts = np.linalg.eigh(covariances)
        both = powers[cases, :, None, :, None] * np.maximum(shares, 0.0)[:, None, :]
        amplitudes = (modes[cases] @ spectra)[:, :, None] @ parts
        seen = np.abs(amplitudes) ** 2
        misfits = []
        for power in POWERS[::2]:
            with_background = 1 + power * both
            misfits.append(np.sum(np.log(with_background) + seen / with_background, axis=(-2, -1)).min())
        return -float(min(misfits))


@lru_cache(maxsize=HELD)
def _held(frequencies: bytes, gains: bytes, known: bytes, lags: int) -> LagLikelihood:
    return LagLikelihood(
        np.frombuffer(frequencies),
        np.frombuffer(gains).reshape(lags, -1),
        np.frombuffer(known, dtype=np.bool_).reshape(lags, -1),
    )
