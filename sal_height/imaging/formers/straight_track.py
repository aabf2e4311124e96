"""The assumption of the fast image formers, a straight track with pulses at even steps; and resampling to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from sal_height.numeric import F64

TAPS = 8  # pulses from which one at an even step is interpolated


@dataclass(frozen=True)
class StraightTrack:
    """The straight, even track nearest to an antenna's.

    Attributes:
        middle: mean of the antenna positions, m, shape (3,).
        direction: unit vector of flight, shape (3,).
        spacing: distance from pulse to pulse, m.
        places: true positions of the antenna along the track, from its middle, m, shape (pulses,).
    """

    middle: F64
    direction: F64
    spacing: float
    places: F64

    @property
    def even(self) -> F64:
        """Positions at even steps, m, shape (pulses,)."""
        return np.asarray((np.arange(len(self.places)) - (len(self.places) - 1) / 2) * self.spacing, dtype=np.float64)


def straight_track(antenna: F64, direction: F64) -> StraightTrack:
    """The even track along `direction` that is nearest to `antenna` (m, shape (pulses, 3)) by least squares."""
    middle = antenna.mean(axis=0)
    places = (antenna - middle) @ direction
    index = np.arange(len(places)) - (len(places) - 1) / 2
    return StraightTrack(middle, direction, float(index @ places / (index @ index)), places)


def resampling(places: F64, wanted: F64) -> csr_array:
    """Interpolation from pulses at `places` (m, increasing) to `wanted` (m), by a sinc under a Kaiser window.

    Beyond the first and the last pulse there is nothing: the samples there are 0.

    Returns:
        Sparse matrix, float32, shape (wanted, places).
    """
    position = np.interp(wanted, places, np.arange(len(places), dtype=np.float64), left=-np.inf, right=np.inf)
    within = np.isfinite(position)
    position[~within] = 0.0
    taps = min(TAPS, len(places))
    first = np.clip(np.floor(position).astype(np.int64) - TAPS // 2 + 1, 0, len(places) - taps)
    pulses = first[:, None] + np.arange(taps)
    offset = position[:, None] - pulses
    under = np.maximum(0.0, 1 - (offset / (TAPS / 2)) ** 2)
    shape = 6.2  # of the Kaiser window over them: 60 dB over half of the band that the pulses sample
    weights = np.sinc(offset) * np.i0(shape * np.sqrt(under)) / np.i0(shape) * (under > 0) * within[:, None]
    starts = taps * np.arange(len(wanted) + 1)
    return csr_array((weights.astype(np.float32).ravel(), pulses.ravel(), starts), shape=(len(wanted), len(places)))
