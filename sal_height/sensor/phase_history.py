"""Phase history: what the receiver delivers, one array for all detectors of a dwell."""

from __future__ import annotations

from dataclasses import dataclass

from sal_height.numeric import C64, F64

NUFFT_TOLERANCE = 1e-7
"""Relative error of the non-uniform FFTs: below the rounding of the complex64 samples they make or read."""


@dataclass(frozen=True)
class PhaseHistory:
    """Phase history of one dwell.

    With waveform "spectrum", a point of amplitude A at distance R from the antenna contributes
    A exp(-j 4 pi f (R - reference_range) / c); for the others see sal_height_msgs/DetectorFrame.

    Attributes:
        stamp_ns: time of the first pulse, ns since the epoch.
        pulse_times: s after the stamp, shape (pulses,).
        reference_range: range to which each pulse's phase refers, m, shape (pulses,).
        samples: complex64, shape (detectors, pulses, samples).
    """

    stamp_ns: int
    pulse_times: F64
    reference_range: F64
    samples: C64
