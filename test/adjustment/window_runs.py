"""Dwells that a window adjusts one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sal_height.adjustment import AdjustmentWindow, ObservedDwell
from sal_height.adjustment.observed import pose_jacobian
from sal_height.numeric import F64


@dataclass(frozen=True)
class WindowRun:
    """Displacement of each dwell when it arrived, m, shape (dwells, 3), its covariance, and the most dwells kept."""

    shifts: F64
    covariances: F64
    kept: int


def run_through(window: AdjustmentWindow, dwells: Sequence[ObservedDwell]) -> WindowRun:
    shifts, covariances, kept = [], [], 0
    for dwell in dwells:
        off, jacobian = window.add(dwell), pose_jacobian(dwell.middle, dwell)
        shifts.append(jacobian @ off.error)
        covariances.append(jacobian @ off.covariance @ jacobian.T)
        kept = max(kept, window.dwells)
    return WindowRun(np.array(shifts), np.array(covariances), kept)
