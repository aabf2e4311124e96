"""The response of a point in range, from the window over the band."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sal_height.numeric import F64, window

WINDOW_SAMPLES = 256
"""Of the band, from which the response in range is computed."""

PLACES = np.linspace(-24, 24, 1921)
"""Rows off a target for which its response is tabulated."""


def point_response(name: str, spacing: float, rows: F64) -> F64:
    """Amplitude of a point so many rows away, 1 in the middle.

    Args:
        name: of the window over the band, of `windows.WINDOWS`.
        spacing: of rows in range resolutions.
        rows: off the point, of any shape.
    """
    return np.interp(rows, PLACES, _tabulated(name, round(spacing, 3)))


@lru_cache(maxsize=8)
def _tabulated(name: str, spacing: float) -> F64:
    """The response at PLACES."""
    weights = window(name, WINDOW_SAMPLES)
    turns = (np.arange(WINDOW_SAMPLES) - (WINDOW_SAMPLES - 1) / 2) / WINDOW_SAMPLES * spacing
    return np.asarray(np.cos(2 * np.pi * PLACES[:, None] * turns) @ weights / np.sum(weights))
