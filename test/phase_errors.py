"""Phase errors for tests: drawn with a given spectrum, and what an estimate leaves of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.imaging.autofocus.phase_error import detrended

Array = npt.NDArray[np.float64]

ATMOSPHERE = 8 / 3
"""Exponent of the power spectrum of the phase that Kolmogorov turbulence gives along a line."""

RECORD = 8
"""Length of the record, in apertures, that a power-law phase is cut from: it has periods longer than the aperture."""


def white_phase(pulses: int, rms: float, rng: np.random.Generator) -> Array:
    """Independent Gaussian phases, of the stated rms (rad) after `detrended`."""
    return _scaled(rng.standard_normal(pulses), rms)


def power_law_phase(pulses: int, rms: float, exponent: float, rng: np.random.Generator) -> Array:
    """Gaussian phases with the power spectrum frequency^-exponent, of the stated rms (rad) after `detrended`."""
    frequency = np.fft.rfftfreq(RECORD * pulses)[1:]
    noise = rng.standard_normal((2, len(frequency)))
    spectrum = np.concatenate([[0.0], (noise[0] + 1j * noise[1]) * frequency ** (-exponent / 2)])
    return _scaled(np.fft.irfft(spectrum, RECORD * pulses)[:pulses], rms)


def residual_phase(estimate: Array, truth: Array) -> Array:
    """What remains of the true phase error after correction with an estimate, rad.

    An image knows phases modulo 2 pi only, so they are compared as exp(j phase). The linear phase taken off is the one
    under which the remaining phasors add up best: where the response of a point would be looked for.
    """
    pulses = len(truth)
    phasors = np.exp(1j * (truth - estimate))
    finely = 64 * pulses
    shift = int(np.argmax(np.abs(np.fft.fft(phasors, finely))))
    aligned = phasors * np.exp(-2j * np.pi * shift / finely * np.arange(pulses))
    return detrended(np.angle(aligned * np.conj(aligned.sum())))


def _scaled(phase: Array, rms: float) -> Array:
    level = detrended(phase)
    return np.asarray(level * (rms / np.sqrt(np.mean(level**2))))


def lower_band(matrix: np.ndarray, lags: int) -> np.ndarray:
    """The diagonals from the main one to that `lags` below it, as those of `Coherence.inverse_band`."""
    return np.asfortranarray([np.pad(np.diagonal(matrix, -lag), (0, lag)) for lag in range(lags + 1)])
