"""Loop of the stripmap simulator, compiled; a test compares it with its formula in NumPy."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import C64, F32, I32, compiled


@compiled
def spread_echoes(first: I32, weights: F32, echoes: C64, response: F32, profile: F32) -> None:
    """Add the echoes of scatterers to the dense range profiles of all detectors.

    Args:
        first: row of each scatterer's first tap, shape (scatterers,).
        weights: of its taps, shape (taps, scatterers).
        echoes: amplitude and phase of its echo.
        response: of each detector to it, shape (scatterers, detectors).
        profile: to add to; real parts of all detectors, then imaginary parts, shape (rows, 2 * detectors).
    """
    detectors = response.shape[1]
    value = np.empty(2 * detectors, np.float32)
    for i in range(first.size):
        for k in range(detectors):
            value[k] = response[i, k] * echoes[i].real
            value[detectors + k] = response[i, k] * echoes[i].imag
        for j in range(weights.shape[0]):
            row, weight = profile[first[i] + j], weights[j, i]
            for k in range(2 * detectors):
                row[k] += weight * value[k]
