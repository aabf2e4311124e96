"""Coherence of the echo between the pulses of a flight, by the directions of the beam's power."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import as_strided

from sal_height.numeric import C128, F32, F64, Complex
from sal_height.sensor import Sensor

Array = TypeVar("Array", F64, C128, Complex)

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
    _inverses: dict[float, C128] = field(default_factory=dict, repr=False)
    _inverse_bands: dict[float, C128] = field(default_factory=dict, repr=False)
    _informations: dict[float, F64] = field(default_factory=dict, repr=False)

    @cached_property
    def matrix(self) -> C128:
        """Shape (pulses, pulses)."""
        return (self.waves * self.profile) @ self.waves.conj().T

    @cached_property
    def lags(self) -> int:
        """Greatest distance of compared pulses: an antenna that has moved by its length sees other speckle."""
        alike = np.flatnonzero(np.abs(self.matrix[:, 0]) >= 0.1)[-1] + 1
        compared = 16  # greatest distance of compared pulses, over that of coherent ones, by the pulses between them
        return min(compared * int(alike), len(self.matrix) - 1)

    @cached_property
    def spectrum(self) -> F64:
        """Mean of the echo's periodograms (`periodograms`), shape (azimuths,): the profile as sharp as they show it."""
        shown: F64 = np.sum(self.waves.conj() * (self.matrix @ self.waves), axis=0).real / len(self.waves)
        return shown

    @cached_property
    def _modes(self) -> tuple[F64, C128]:
        """Eigenvalues and eigenvectors of the matrix."""
        values, vectors = np.linalg.eigh(self.matrix)
        return values, vectors

    def covariance(self, snr: float) -> C128:
        """Covariance of an echo of power `snr` with noise of power 1."""
        return snr * self.matrix + np.eye(len(self.matrix))

    def inverse_covariance(self, snr: float) -> C128:
        """The inverse of `covariance`, made once for each `snr`."""
        if snr not in self._inverses:
            values, vectors = self._modes
            self._inverses[snr] = (vectors / (1 + snr * values)) @ vectors.conj().T
        return self._inverses[snr]

    def inverse_band(self, snr: float) -> C128:
        """The inverse of `covariance` between pulses that are compared (`lower_band`), made once for each `snr`."""
        if snr not in self._inverse_bands:
            self._inverse_bands[snr] = lower_band(self.inverse_covariance(snr), self.lags)
        return self._inverse_bands[snr]

    def information(self, snr: float) -> F64:
        """Fisher information of one response on the phases (`lower_band`), made once for each `snr`."""
        if snr not in self._informations:
            information = 2 * (lower_band(self.covariance(snr), self.lags) * self.inverse_band(snr).conj()).real
            information[0] -= 2
            self._informations[snr] = information
        return self._informations[snr]


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


def lower_band(matrix: Array, lags: int) -> Array:
    """The diagonals of a square matrix, from the main one to that `lags` below it, shape (lags + 1, rows).

    As the banded routines of LAPACK have them: element (d, t) is that of row t + d and column t; 0 beyond the last row.
    """
    rows = len(matrix)
    padded = np.zeros((rows + lags, rows), matrix.dtype)
    padded[:rows] = matrix
    down, right = padded.strides
    return np.asfortranarray(as_strided(padded, (lags + 1, rows), (down, down + right)))


def periodograms(responses: Complex) -> F32:
    """Power of responses, shape (responses, pulses), from each azimuth (`half_turns`): 1 for noise of power 1."""
    pulses = responses.shape[-1]
    seen = scipy.fft.fft(responses, 2 * pulses)
    power: F32 = (seen.real**2 + seen.imag**2) / pulses
    return np.fft.fftshift(power, axes=-1)


def half_turns(pulses: int) -> F64:
    """All azimuths that pulses can resolve, half a resolution cell from one to the next, shape (2 pulses,).

    Stated as half turns by which the phase of the echo grows from pulse to pulse, from -1 to 1; 0 is the middle.
    """
    return np.arange(2 * pulses) / pulses - 1


def azimuth_waves(pulses: int) -> C128:
    """Waves from these azimuths, shape (pulses, 2 pulses)."""
    return np.exp(1j * np.pi * np.arange(pulses)[:, None] * half_turns(pulses))
