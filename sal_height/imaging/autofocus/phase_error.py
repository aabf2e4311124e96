"""Phase errors common to all detectors: what of an estimate may be corrected.

A phase error is an array of shape (pulses,) in rad. Its mean cannot be seen in an image and its linear trend is a shift
in azimuth; neither is counted as an error.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sal_height.numeric import F64, Complex

FIRMLY = 1e6  # over the information on a phase, with which mean and trend count as known
SMOOTH_STEP = 1.0  # rms step from pulse to pulse, rad, up to which a phase can be unwrapped: pi is three times as much


def detrended(phase: F64) -> F64:
    """The phase without its mean and its linear trend: the least-squares line, every pulse counting the same."""
    time = np.linspace(-1.0, 1.0, len(phase))
    level = phase - phase.mean()
    return level - time * (time @ level) / (time @ time)


def with_shift_known(information: F64) -> F64:
    """Information on phases, rad^-2, as if their mean and their linear trend were known."""
    known = _mean_and_trend(len(information))
    firmly: F64 = information + FIRMLY * information.diagonal().max() * known @ known.T
    return firmly


def phase_variance(information: F64) -> float:
    """Variance of phases (mean over the pulses, mean and linear trend apart) by the information on them, rad^2."""
    return float(np.mean(np.linalg.inv(with_shift_known(information)).diagonal()))


@lru_cache(maxsize=4)
def _mean_and_trend(pulses: int) -> F64:
    """Orthonormal mean and linear trend, shape (pulses, 2)."""
    return np.linalg.qr(np.stack([np.ones(pulses), np.linspace(-1.0, 1.0, pulses)], axis=1))[0]


def without_shift(phase: F64) -> F64:
    """The phase, unwrapped, without what cannot or must not be corrected: its mean, and a shift where it has one.

    A linear trend moves the image along the flight, which navigation knows better than an image does. Where the phase
    steps by more than SMOOTH_STEP (rms), its course is known only modulo 2 pi, and so is no trend of it: there only the
    mean is removed, and the image stays where the middle of the beams puts it.
    """
    if is_smooth(phase):
        return detrended(np.unwrap(phase - _mean_step(phase) * np.arange(len(phase))))
    course = np.unwrap(phase)
    return course - course.mean()


def is_smooth(phase: F64) -> bool:
    """Whether steps from pulse to pulse differ so little that the course of a phase, and not only its value, is known.

    A trend, whatever its size, is none of the difference.
    """
    steps = np.angle(np.exp(1j * (np.diff(phase) - _mean_step(phase))))
    return bool(np.sqrt(np.mean(steps**2)) <= SMOOTH_STEP)


def turns_slowly(phase: F64) -> bool:
    """Whether steps from pulse to pulse, however large, change so little from one to the next that they can be told."""
    changes = np.angle(np.exp(1j * np.diff(phase, 2)))
    return bool(np.sqrt(np.mean(changes**2)) <= SMOOTH_STEP)


def course_of(phase: F64) -> tuple[F64, float]:
    """A phase that turns slowly, whole turns put in, without mean and trend; and its trend from pulse to pulse, rad.

    The trend is known modulo 2 pi, and given within half a turn.
    """
    steps = np.unwrap(np.diff(phase))
    course = np.concatenate([[0.0], np.cumsum(steps)])
    left, time = detrended(course), np.arange(len(phase)) - (len(phase) - 1) / 2
    trend = float(time @ course / (time @ time))
    return left, trend - 2 * np.pi * round(trend / (2 * np.pi))


def phase_gradient(responses: Complex) -> F64:
    """Phase error by the maximum-likelihood kernel of neighbouring pulses, integrated from 0, rad, shape (pulses,).

    The responses of detectors and range cells have the shape (..., pulses).
    """
    flat = responses.reshape(-1, responses.shape[-1])
    products = np.einsum("gt,gt->t", flat[:, :-1].conj(), flat[:, 1:])
    return np.concatenate([[0.0], np.cumsum(np.angle(products))])


def _mean_step(phase: F64) -> float:
    """Mean step from pulse to pulse, in the middle of those modulo 2 pi."""
    return float(np.angle(np.sum(np.exp(1j * np.diff(phase)))))
