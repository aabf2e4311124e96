"""Arrays of an instrument whose beamwidth is 1 rad, looking at 0: their angles are in beamwidths."""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams, Pattern


def array_of(patterns: tuple[Pattern, ...], detectors: int, pitch: float, rotation: float = 0.0) -> Beams:
    """Beams of `detectors`, `pitch` beamwidths apart around 0, on an axis turned by `rotation` (rad).

    Args:
        patterns: pattern of every detector, or the one common to all.
        detectors: number of detectors.
        pitch: pitch of their boresights, beamwidths.
        rotation: angle of the detector axis from elevation towards the direction of flight, rad.
    """
    boresights = (np.arange(detectors, dtype=np.float64) - (detectors - 1) / 2) * pitch
    return Beams(patterns, boresights, 1.0, rotation)
