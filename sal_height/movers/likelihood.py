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
is a wide cloud, each bin by itself. Beyond its main lobe a beam is not known well: there each bin is by itself. The
likelihood of beta is the greatest over P and w: what two scatterers of a cell do to their spectrum by interference is
counted, and not taken for motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sal_height.numeric import C128, F64, Bool

WIDTHS = np.array([0.0, 0.15, 0.3, 0.6, 1.2, 2.4, 4.8, 9.6, 1e3])
"""Rms widths of the clouds in resolution cells; the widest leaves no two bins alike."""

POWERS = 10 ** (np.arange(-10, 21, 2) / 10)
"""Powers of the clouds, over the mean power of the bins."""


@dataclass(frozen=True, eq=False)
class LagLikelihood:
    """Likelihoods of some lags, for targets at one elevation.

    Attributes:
        frequencies: of the bins in cycles per resolution cell, from -1/2 to 1/2, shape (bins,).
        gains: amplitude of the beam in each bin for each lag, shape (lags, bins).
        known: whether that is in the main lobe, same shape.
    """

    frequencies: F64
    gains: F64
    known: Bool

    @cached_property
    def _modes(self) -> tuple[F64, F64]:
        """Powers of the independent parts of clouds of power 1, shape (lags, widths, bins), and these parts."""
        apart = self.frequencies[:, None] - self.frequencies
        together = (self.known[:, None, :, None] & self.known[:, None, None, :]) | (apart == 0)
        alike = np.where(together, np.exp(-2 * (np.pi * WIDTHS[:, None, None] * apart) ** 2), 0.0)
        powers, parts = np.linalg.eigh(self.gains[:, None, :, None] * alike * self.gains[:, None, None, :])
        return np.maximum(powers, 0.0), np.swapaxes(parts, -1, -2)

    def of(self, spectra: C128) -> F64:
        """Logarithm of the likelihood of each lag, shape (lags,).

        Args:
            spectra: of one target about its centre, background 1, for each lag, shape (lags, bins).
        """
        powers, parts = self._modes
        seen = np.abs((parts @ spectra[:, None, :, None])[..., 0]) ** 2
        cloud = np.mean(np.abs(spectra) ** 2, axis=-1)[:, None, None] * powers
        misfits = [np.sum(np.log1p(power * cloud) + seen / (1 + power * cloud), axis=-1) for power in POWERS]
        return -np.min(misfits, axis=(0, 2))
