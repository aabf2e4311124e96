"""Phase history: the samples of all detectors in one dwell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.numeric import C64, F64

NUFFT_TOLERANCE = 1e-7
"""Relative error of the non-uniform FFTs: less than the rounding of complex64 samples."""


@dataclass(frozen=True, eq=False)
class PhaseHistory:
    """Phase history of one dwell.

    With waveform "spectrum", a point of amplitude A at distance R from the antenna contributes
    A exp(-j 4 pi f (R - reference_range) / c); for the others see sal_height_msgs/ChannelFrame.

    Attributes:
        stamp_ns: time of the first pulse, ns since the epoch.
        pulse_times: times of the pulses after the stamp, shape (pulses,), s.
        reference_range: range to which each pulse's phase refers, shape (pulses,), m.
        samples: complex64, shape (detectors, pulses, samples).
        saturated_share: fraction of clipped samples in the dwell of each pulse (`receivers.saturated_shares`), shape
            (channels, pulses); None: not counted.
    """

    stamp_ns: int
    pulse_times: F64
    reference_range: F64
    samples: C64
    saturated_share: F64 | None = None

    @property
    def stamp_of_last_pulse_ns(self) -> int:
        """Time of the last pulse, ns since the epoch."""
        return self.stamp_ns + round(float(self.pulse_times[-1]) * 1e9)

    def pulses(self, which: slice) -> PhaseHistory:
        """The phase history of some of the pulses; times count from the same stamp."""
        return PhaseHistory(
            self.stamp_ns,
            self.pulse_times[which],
            self.reference_range[which],
            self.samples[:, which],
            None if self.saturated_share is None else self.saturated_share[:, which],
        )

    @property
    def shares(self) -> F64:
        """Fractions of clipped samples, shape (channels, pulses); NaN where they were not counted."""
        return np.full(self.samples.shape[:2], np.nan) if self.saturated_share is None else self.saturated_share
