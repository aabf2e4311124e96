"""What the fast image formers take for granted, a straight track with pulses at even steps; and how to get there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.imaging.formers._kernels import interpolate_pulses
from sal_height.numeric import C64, F32, F64, I64

TAPS = 8
"""Pulses from which one at an even step is interpolated."""

SHAPE = 6.2
"""Of the Kaiser window over them: 60 dB over half of the band that the pulses sample."""


@dataclass(frozen=True)
class StraightTrack:
    """The straight, even track nearest to an antenna's.

    Attributes:
        middle: mean of the antenna positions, m, shape (3,).
        direction: unit vector of flight, shape (3,).
        spacing: way from pulse to pulse, m.
        places: of the antenna along the track, from its middle, as they were, m, shape (pulses,).
    """

    middle: F64
    direction: F64
    spacing: float
    places: F64

    @property
    def even(self) -> F64:
        """Places at even steps, m, shape (pulses,)."""
        return np.asarray((np.arange(len(self.places)) - (len(self.places) - 1) / 2) * self.spacing, dtype=np.float64)


def straight_track(antenna: F64, direction: F64) -> StraightTrack:
    """The even track along `direction` that is nearest to `antenna` (m, shape (pulses, 3)) by least squares."""
    middle = antenna.mean(axis=0)
    places = (antenna - middle) @ direction
    index = np.arange(len(places)) - (len(places) - 1) / 2
    return StraightTrack(middle, direction, float(index @ places / (index @ index)), places)


@dataclass(frozen=True)
class Resampling:
    """Interpolation between pulses, the same for all detectors and frequencies.

    Attributes:
        first: index of the first of TAPS pulses, for each place, shape (places,).
        weights: of them, float32, shape (places, TAPS).
    """

    first: I64
    weights: F32

    def apply(self, samples: C64) -> C64:
        """Samples of one detector at the pulses, (pulses, frequencies), at the places: (places, frequencies)."""
        result = np.empty((len(self.first), samples.shape[1]), dtype=np.complex64)
        interpolate_pulses(samples.view(np.float32), self.first, self.weights, result.view(np.float32))
        return result


def resampling(places: F64, wanted: F64) -> Resampling:
    """Interpolation from pulses at `places` (m, increasing) to `wanted` (m), by a sinc under a Kaiser window.

    Beyond the first and the last pulse there is nothing: the samples there are 0.
    """
    position = np.interp(wanted, places, np.arange(len(places), dtype=np.float64), left=-np.inf, right=np.inf)
    beyond = ~np.isfinite(position)
    position[beyond] = 0.0
    first = np.clip(np.floor(position).astype(np.int64) - TAPS // 2 + 1, 0, max(0, len(places) - TAPS))
    offset = position[:, None] - first[:, None] - np.arange(TAPS)
    under = np.maximum(0.0, 1 - (offset / (TAPS / 2)) ** 2)
    weights = np.sinc(offset) * np.i0(SHAPE * np.sqrt(under)) / np.i0(SHAPE) * (under > 0)
    weights[beyond] = 0.0
    return Resampling(first, weights.astype(np.float32))
