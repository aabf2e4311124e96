"""The response of a point in range, from the window over the band."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sal_height.numeric import F64, window

PLACES = np.linspace(-24, 24, 1921)
"""Distances from a target for which its response is tabulated, rows."""


def point_response(name: str, spacing: float, rows: F64) -> F64:
    """Amplitude of a point at distances from it, 1 in the middle.

    Args:
        name: name of the window over the band, of `windows.WINDOWS`.
        spacing: spacing of rows, range resolutions.
        rows: distances from the point, any shape, rows.
    """
    return np.interp(rows, PLACES, _tabulated(name, round(spacing, 3)))


@lru_cache(maxsize=8)
def _tabulated(name: str, spacing: float) -> F64:
    """The response at PLACES."""
    samples = 256  # of the band
    weights = window(name, samples)
    turns = (np.arange(samples) - (samples - 1) / 2) / samples * spacing
    return np.asarray(np.cos(2 * np.pi * PLACES[:, None] * turns) @ weights / np.sum(weights))
