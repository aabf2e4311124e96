"""Coherence of the echo between the pulses of a flight, by the directions of the beam's power."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import scipy.fft
import scipy.linalg

from sal_height.imaging.autofocus._kernels import fill_information, fill_periodograms, invert_toeplitz
from sal_height.numeric import C64, C128, F32, F64, Complex
from sal_height.sensor import Sensor

STEP_DIGITS = 0.01  # relative difference of the steps from pulse to pulse that have the same coherence


@dataclass(frozen=True, eq=False)
class Coherence:
    """Coherence of the echo between every two pulses; 1 on the diagonal if the profile's sum is 1.

    Attributes:
        waves: waves from each azimuth, shape (pulses, azimuths).
        profile: fraction of the power from each azimuth, shape (azimuths,).
    """

    waves: C128
    profile: F64
    _inverse_bands: dict[float, C128] = field(default_factory=dict, repr=False)
    _informations: dict[float, F64] = field(default_factory=dict, repr=False)
    _filters: dict[float, tuple[C64, F64]] = field(default_factory=dict, repr=False)

    @cached_property
    def column(self) -> C128:
        """First column of the matrix, shape (pulses,): the coherence by the distance of the pulses."""
        return (self.waves * self.profile) @ self.waves[0].conj()

    @cached_property
    def matrix(self) -> C128:
        """Shape (pulses, pulses)."""
        return np.asarray(scipy.linalg.toeplitz(self.column))

    @cached_property
    def lags(self) -> int:
        """Greatest distance of compared pulses: an antenna that has moved by its length sees other speckle."""
        alike = np.flatnonzero(np.abs(self.column) >= 0.1)[-1] + 1
        compared = 16  # greatest distance of compared pulses, over that of coherent ones, by the pulses between them
        return min(compared * int(alike), len(self.column) - 1)

    @cached_property
    def spectrum(self) -> F64:
        """Mean of the echo's periodograms (`periodograms`), shape (azimuths,): the profile as sharp as they show it."""
        shown: F64 = np.sum(self.waves.conj() * (self.matrix @ self.waves), axis=0).real / len(self.waves)
        return shown

    def covariance(self, snr: float) -> C128:
        """Covariance of an echo of power `snr` with noise of power 1."""
        return snr * self.matrix + np.eye(len(self.matrix))

    def inverse_band(self, snr: float) -> C128:
        """The inverse of `covariance` between pulses that are compared, made once for each `snr`.

        It has the diagonals from the main one to that `lags` below it, shape (lags + 1, pulses), as the banded routines
        of LAPACK have them: element (d, t) is that of row t + d and column t; 0 beyond the last row.
        """
        if snr not in self._inverse_bands:
            diagonals = np.zeros((len(self.column), self.lags + 1), np.complex128)
            invert_toeplitz(self._noisy(snr), diagonals)
            self._inverse_bands[snr] = diagonals.T
        return self._inverse_bands[snr]

    def information(self, snr: float) -> F64:
        """Fisher information of one response on the phases, as `inverse_band`, made once for each `snr`."""
        if snr not in self._informations:
            information = np.empty((len(self.column), self.lags + 1))
            fill_information(self._noisy(snr), self.inverse_band(snr).T, information)
            information[:, 0] -= 2
            self._informations[snr] = information.T
        return self._informations[snr]

    def filters(self, snr: float) -> tuple[C64, F64]:
        """Filters of responses for the echo from each azimuth, and their gain, made once for each `snr`.

        Returns:
            The conjugate of R^-1 w for the covariance R and the waves w, shape (pulses, azimuths), and w^H R^-1 w,
            shape (azimuths,).
        """
        if snr not in self._filters:
            weights = np.linalg.solve(self.covariance(snr), self.waves)
            gain = np.sum(self.waves.conj() * weights, axis=0).real
            self._filters[snr] = weights.conj().astype(np.complex64), gain
        return self._filters[snr]

    def _noisy(self, snr: float) -> C128:
        """First column of `covariance`."""
        column = snr * self.column
        column[0] += 1
        return column


def beam_coherence(sensor: Sensor, antenna: F64) -> Coherence:
    """Coherence of even ground in the beam, between the positions of the antenna (m, shape (pulses, 3)).

    Positions are assumed to be evenly spaced on a line, and steps from pulse to pulse that differ by less than
    STEP_DIGITS to be equal, so that dwells of a flight use one result.
    """
    way = float(np.linalg.norm(antenna[-1] - antenna[0])) / (len(antenna) - 1)
    return _beam_coherence(sensor, len(antenna), round(math.log(way) / STEP_DIGITS))


@lru_cache(maxsize=2)
def _beam_coherence(sensor: Sensor, pulses: int, step: int) -> Coherence:
    """The same, of ways from pulse to pulse whose logarithm is `step` times STEP_DIGITS."""
    way = math.exp(step * STEP_DIGITS)
    azimuths = half_turns(pulses)
    angle = azimuths * sensor.wavelength / (4 * way)  # at which the phase turns by that from pulse to pulse
    beamwidths = angle / sensor.beams.track_beamwidth
    power = np.abs(sensor.beams.patterns[0].amplitude(np.zeros_like(beamwidths), beamwidths)) ** 2
    power += 1e-3 * power.max()  # so that the profile may grow where the beam has a null
    return Coherence(azimuth_waves(pulses), power / power.sum())


def periodograms(responses: Complex) -> F32:
    """Power of responses, shape (responses, pulses), from each azimuth (`half_turns`): 1 for noise of power 1."""
    seen = scipy.fft.fft(responses, 2 * responses.shape[-1])
    power = np.empty(seen.shape, np.float32)
    fill_periodograms(seen, power)
    return power


def half_turns(pulses: int) -> F64:
    """All azimuths that pulses can resolve, half a resolution cell from one to the next, shape (2 pulses,).

    Stated as half turns by which the phase of the echo grows from pulse to pulse, from -1 to 1; 0 is the middle.
    """
    return np.arange(2 * pulses) / pulses - 1


def azimuth_waves(pulses: int) -> C128:
    """Waves from these azimuths, shape (pulses, 2 pulses)."""
    return np.exp(1j * np.pi * np.arange(pulses)[:, None] * half_turns(pulses))
