"""Real echoes: ALOS PALSAR over rain forest, from the data that tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.constants import speed_of_light


class Echoes(NamedTuple):
    """Raw echoes, (pulses, samples), complex64, and what their file says of pulse and receiver.

    Attributes:
        raw: samples.
        slope: rate of the chirp, Hz/s.
        duration: duration of the pulse, s.
        rate: sampling rate, Hz.
        carrier: carrier frequency, Hz.
    """

    raw: np.ndarray
    slope: float
    duration: float
    rate: float
    carrier: float


def forest_echoes(shared_data: Callable[[str], Path]) -> Echoes:
    """ALOS PALSAR over rain forest, as received."""
    h5py = pytest.importorskip("h5py")
    (path,) = shared_data("alos_palsar").glob("ALPSRP*.h5")
    with h5py.File(path) as file:
        swath = file["science/LSAR/RRSD/swaths/frequencyA/txH"]
        table, codes = swath["rxH/BFPQLUT"][:], swath["rxH/HH"][:]
        slope, duration, spacing, carrier = (
            float(swath[name][()]) for name in ("chirpSlope", "chirpDuration", "slantRangeSpacing", "centerFrequency")
        )
    raw = (table[codes["r"]] + 1j * table[codes["i"]]).astype(np.complex64)
    return Echoes(raw, slope, duration, speed_of_light / (2 * spacing), carrier)


def forest(shared_data: Callable[[str], Path]) -> tuple[np.ndarray, float]:
    """The same echoes, range-compressed: (range, azimuth), and the fraction of frequencies in the band."""
    raw, slope, duration, rate, _ = forest_echoes(shared_data)
    samples, size = round(duration * rate), raw.shape[1]
    chirp = np.exp(1j * np.pi * slope * ((np.arange(samples) - (samples - 1) / 2) / rate) ** 2)
    profiles = np.fft.ifft(np.fft.fft(raw, axis=1) * np.fft.fft(chirp, size).conj(), axis=1)
    return profiles[:, : size - samples].T, abs(slope) * duration / rate
