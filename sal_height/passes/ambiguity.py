"""Heights that the passes confuse: sidelobes of a sparse array.

With phases phi_p of a point at an offset x from the true one, the fraction of its power that a point there explains
is |sum_p exp(j (phi_p(x) - phi_p(0)))|^2 / M^2. Passes at even distances have grating lobes of 1; uneven ones have
sidelobes, which noise can raise above the peak.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.numeric import F64
from sal_height.passes.array import Steering

FALSE_PEAK = 0.5
"""Least fraction of the power of a sidelobe that may be mistaken for the height of a point."""


@dataclass(frozen=True, eq=False)
class Ambiguity:
    """Properties of the array response of the passes.

    Attributes:
        resolution: height over which the phases of the outermost passes turn once against each other, m.
        width: width of the main lobe at half its power, m of height.
        sidelobe: largest fraction of the power of a point at another height within `reach`.
        at: height of that sidelobe over the point, m.
        first_false: nearest height with a sidelobe of FALSE_PEAK or more, infinite without one within `reach`, m.
        reach: largest height to each side, m.
        offsets: heights of the response, shape (n,), m.
        response: fraction of the power there, shape (n,).
    """

    resolution: float
    width: float
    sidelobe: float
    at: float
    first_false: float
    reach: float
    offsets: F64
    response: F64


def ambiguity_of(steering: Steering, climb: float, reach: float) -> Ambiguity:
    """The array response over heights.

    Args:
        steering: phases of the passes.
        climb: height for a rad of elevation, m.
        reach: largest height to each side, m.
    """
    beamwidth = steering.beamwidth * climb
    step = 0.02  # beamwidths
    offsets = np.arange(0.0, reach / beamwidth + step, step)
    slopes = steering.slope(0.0)
    response = np.abs(np.exp(1j * np.multiply.outer(offsets, slopes)).mean(axis=-1)) ** 2
    half = float(np.interp(-0.5, -response[: _first_rise(response)], offsets[: _first_rise(response)]))
    beyond = _first_rise(response)
    peaks = beyond + np.flatnonzero(
        (response[beyond:-1] >= response[beyond - 1 : -2]) & (response[beyond:-1] > response[beyond + 1 :])
    )
    greatest = peaks[np.argmax(response[peaks])] if len(peaks) else len(response) - 1
    false = peaks[response[peaks] >= FALSE_PEAK]
    both = np.concatenate([-offsets[:0:-1], offsets]) * beamwidth
    return Ambiguity(
        resolution=beamwidth,
        width=2 * half * beamwidth,
        sidelobe=float(response[greatest]),
        at=float(offsets[greatest] * beamwidth),
        first_false=float(offsets[false[0]] * beamwidth) if len(false) else np.inf,
        reach=reach,
        offsets=both,
        response=np.concatenate([response[:0:-1], response]),
    )


def _first_rise(response: F64) -> int:
    """Number of the node behind which the response rises for the first time."""
    rises = np.flatnonzero(np.diff(response) > 0)
    return int(rises[0]) + 1 if len(rises) else len(response) - 1
