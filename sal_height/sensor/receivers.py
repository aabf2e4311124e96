"""Receivers that saturate: clipping, and the fraction of clipped samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.numeric import C64, F64
from sal_height.sensor.phase_history import PhaseHistory
from sal_height.sensor.sensor import Sensor

MAX_SHARE = 8e-4
"""Greatest fraction of clipped real and imaginary parts: the distortion of Gaussian samples is then -40 dB.

By Bussgang's theorem, which the tests evaluate."""


def clipped(samples: C64, full_scale: float) -> C64:
    """Clip the real and imaginary parts of samples at `full_scale`; return them unchanged if it is not known (0)."""
    if not full_scale:
        return samples
    limit = np.float32(full_scale)
    return np.clip(np.ascontiguousarray(samples).view(np.float32), -limit, limit).view(np.complex64)


def saturated_shares(samples: C64, sensor: Sensor) -> F64:
    """Fraction of real and imaginary parts at or beyond full scale in the receivers of each channel, shape (channels,).

    With receivers before the channel matrix, that is inverted first; a channel has the greatest fraction of its
    receivers. NaN where the full scale is not known.

    Args:
        samples: samples of all channels as the sensor delivers them, shape (channels, pulses, samples).
        sensor: sensor that delivers them.
    """
    if not sensor.full_scale:
        return np.full(len(samples), np.nan)
    # A clipped number has this relative error after a channel matrix was inverted in single precision.
    limit = np.float32(sensor.full_scale * (1 - 1e-5))
    if sensor.matrix_in_antenna or not sensor.channel_matrix:
        return _shares(samples, limit)
    receivers = np.tensordot(np.linalg.inv(sensor.mixing).astype(np.complex64), samples, axes=1)
    return np.max(_shares(receivers, limit) * (sensor.mixing != 0), axis=1)


def count_saturated(history: PhaseHistory, sensor: Sensor) -> PhaseHistory:
    """The phase history of a dwell, as the sensor delivers it, with its `saturated_share`."""
    shares = saturated_shares(history.samples, sensor)
    return replace(history, saturated_share=np.repeat(shares[:, None], len(history.pulse_times), axis=1))


def _shares(samples: C64, limit: np.float32) -> F64:
    parts = (np.ascontiguousarray(frame).view(np.float32) for frame in samples)
    return np.array([np.mean(np.abs(part) >= limit) for part in parts])
