"""Real echoes: ALOS PALSAR over rain forest, from the data that tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light


def forest(shared_data: Callable[[str], Path]) -> tuple[np.ndarray, float]:
    """ALOS PALSAR over rain forest, range-compressed: (range, azimuth), and the share of frequencies in the band."""
    h5py = pytest.importorskip("h5py")
    (path,) = shared_data("alos_palsar").glob("ALPSRP*.h5")
    with h5py.File(path) as file:
        swath = file["science/LSAR/RRSD/swaths/frequencyA/txH"]
        table, codes = swath["rxH/BFPQLUT"][:], swath["rxH/HH"][:]
        slope, duration = float(swath["chirpSlope"][()]), float(swath["chirpDuration"][()])
        rate = speed_of_light / (2 * float(swath["slantRangeSpacing"][()]))
    raw = (table[codes["r"]] + 1j * table[codes["i"]]).astype(np.complex64)
    samples, size = round(duration * rate), raw.shape[1]
    chirp = np.exp(1j * np.pi * slope * ((np.arange(samples) - (samples - 1) / 2) / rate) ** 2)
    profiles = np.fft.ifft(np.fft.fft(raw, axis=1) * np.fft.fft(chirp, size).conj(), axis=1)
    return profiles[:, : size - samples].T, abs(slope) * duration / rate
