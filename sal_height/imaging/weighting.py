"""Weighting of images: the windows over both bands, and the part of the beam that a stripmap image uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.numeric import F32, F64, window

TAPER_NODES = 1025  # of the tabulated azimuth window, which is interpolated linearly between them


@dataclass(frozen=True)
class Processing:
    """Weights of a compression; the same for every detector.

    Attributes:
        range_window: window over the bandwidth, a name of `windows.WINDOWS`.
        azimuth_window: window over the pulses of the aperture.
        angle: processed angle in stripmap, rad: a target's aperture is half of it to each side of abeam; 0 in
            spotlight, where all pulses are the aperture of every target.
    """

    range_window: str = "taylor"
    azimuth_window: str = "rectangular"
    angle: float = 0.0

    def range_weights(self, count: int) -> F64:
        """Weights of `count` frequencies, of mean 1."""
        return window(self.range_window, count)

    def azimuth_weights(self, pulses: int) -> F64:
        """Weights of the pulses of a spotlight aperture, of mean 1."""
        return window(self.azimuth_window, pulses)

    def angle_weights(self, sine: F64, spacing: F64) -> F64:
        """Weights of pulses in stripmap, that of a pulse across the edge of the aperture by its fraction within.

        Args:
            sine: sine of the angle between abeam and the antenna, seen from a target.
            spacing: spacing of neighbouring pulses, in that sine.
        """
        share = np.clip((self.angle / 2 - np.abs(sine)) / spacing + 0.5, 0.0, 1.0)
        taper, position = self.taper(), np.clip((sine / self.angle + 0.5) * (TAPER_NODES - 1), 0, TAPER_NODES - 1)
        node = np.minimum(position.astype(np.int32), TAPER_NODES - 2)
        return np.asarray(share * (taper[node] + (position - node) * (taper[node + 1] - taper[node])))

    def taper(self) -> F32:
        """The azimuth window over the processed angle, at TAPER_NODES even sines from end to end."""
        return window(self.azimuth_window, TAPER_NODES).astype(np.float32)
