"""Phase errors common to all detectors: what of an estimate may be corrected.

A phase error is an array of shape (pulses,) in rad. Its mean cannot be seen in an image and its linear trend is a shift
in azimuth; neither is counted as an error.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64

SMOOTH_STEP = 1.0  # rms step from pulse to pulse, rad, up to which a phase can be unwrapped: pi is three times as much


def detrended(phase: F64) -> F64:
    """The phase without its mean and its linear trend: the least-squares line, every pulse counting the same."""
    time = np.linspace(-1.0, 1.0, len(phase))
    level = phase - phase.mean()
    return level - time * (time @ level) / (time @ time)


def without_shift(phase: F64) -> F64:
    """The phase, unwrapped, without what cannot or must not be corrected: its mean, and a shift where it has one.

    A linear trend moves the image along the flight, which navigation knows better than an image does. Where the phase
    steps by more than SMOOTH_STEP (rms), its course is known only modulo 2 pi, and so is no trend of it: there only the
    mean is removed, and the image stays where the middle of the beams puts it.
    """
    course = np.unwrap(phase)
    smooth = np.sqrt(np.mean(np.diff(course) ** 2)) <= SMOOTH_STEP
    return detrended(course) if smooth else course - course.mean()
