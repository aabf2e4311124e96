"""The compiled loop of the stripmap simulator against its formula in NumPy."""

from __future__ import annotations

import numpy as np
from helpers import circular

from sal_height.simulation._kernels import spread_echoes


def test_echoes_are_spread_over_their_taps() -> None:
    """profile[first + tap, detector] += weight[tap] response[detector] echo, for every scatterer."""
    rng, rows, taps, detectors, count = np.random.default_rng(110), 50, 6, 3, 40
    first = rng.integers(0, rows - taps, count).astype(np.int32)
    weights = rng.uniform(0, 1, (taps, count)).astype(np.float32)
    echoes = circular(rng, (count,)).astype(np.complex64)
    response = rng.uniform(-1, 1, (count, detectors)).astype(np.float32)
    profile = np.zeros((rows, 2 * detectors), np.float32)
    spread_echoes(first, weights, echoes, response, profile)
    expected = np.zeros((rows, detectors), complex)
    np.add.at(expected, first + np.arange(taps)[:, None], weights[..., None] * (response * echoes[:, None]))
    np.testing.assert_allclose(profile[:, :detectors] + 1j * profile[:, detectors:], expected, atol=1e-5)
