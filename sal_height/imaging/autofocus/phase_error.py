"""Phase errors common to all detectors: the part of an estimate that may be corrected.

A phase error is an array of shape (pulses,) in rad. Its mean cannot be seen in an image and its linear trend is a shift
in azimuth; neither is counted as an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
import scipy.linalg

from sal_height.numeric import F64, Complex

SMOOTH_STEP = 1.0  # rms step from pulse to pulse, rad, up to which a phase can be unwrapped: pi is three times as much


def detrended(phase: F64) -> F64:
    """The phase without its mean and its linear trend: the least-squares line, every pulse counting the same."""
    time = np.linspace(-1.0, 1.0, len(phase))
    level = phase - phase.mean()
    return level - time * (time @ level) / (time @ time)


@dataclass(frozen=True, eq=False)
class PhaseInformation:
    """Fisher information on phases whose mean and linear trend are known, ready to be solved.

    With A the information on all phases, C the mean and the trend, and Y = A^-1 C, it has the inverse
    A^-1 - Y (C^T Y)^-1 Y^T (Lagrange's multipliers).

    Attributes:
        factor: Cholesky factor of A, banded.
        known: mean and trend C, orthonormal, shape (pulses, 2).
        multipliers: product Y (C^T Y)^-1, shape (pulses, 2).
    """

    factor: F64
    known: F64
    multipliers: F64

    @classmethod
    def of(cls, information: F64) -> Self:
        """The solver for the information on all phases, rad^-2, in the form of `Coherence.information`."""
        lags, pulses = len(information) - 1, information.shape[-1]
        # A common phase of all pulses changes nothing; pairs that are not compared must not make it look known.
        on_all = scipy.linalg.blas.dsbmv(lags, 1.0, information, np.ones(pulses), lower=1)
        level = information.copy(order="F")
        level[0] += 1e-9 * information[0].max() - on_all  # the mean counts as faintly known, for the factorisation
        factor = scipy.linalg.cholesky_banded(level, lower=True, overwrite_ab=True, check_finite=False)
        known = _mean_and_trend(pulses)
        towards = scipy.linalg.cho_solve_banded((factor, True), known, check_finite=False)
        return cls(factor, known, towards @ np.linalg.inv(known.T @ towards))

    def solve(self, slopes: F64) -> F64:
        """The inverse times slopes of the likelihood, shape (pulses,) or (pulses, columns)."""
        found = scipy.linalg.cho_solve_banded((self.factor, True), slopes, check_finite=False)
        return np.asarray(found - self.multipliers @ (self.known.T @ found))

    @property
    def variance(self) -> float:
        """Variance of the phases (mean over the pulses), rad^2."""
        return float(np.mean(self.solve(np.eye(len(self.known))).diagonal()))


@lru_cache(maxsize=4)
def _mean_and_trend(pulses: int) -> F64:
    """Orthonormal mean and linear trend, shape (pulses, 2)."""
    return np.linalg.qr(np.stack([np.ones(pulses), np.linspace(-1.0, 1.0, pulses)], axis=1))[0]


def without_shift(phase: F64) -> F64:
    """The phase, unwrapped, without its mean and any shift, which cannot or must not be corrected.

    A linear trend moves the image along the flight, which navigation knows better than an image does. Where the phase
    steps by more than SMOOTH_STEP (rms), its course is known only modulo 2 pi, and so it has no trend: there only the
    mean is removed, and the image stays at the middle of the beams.
    """
    if is_smooth(phase):
        return detrended(np.unwrap(phase - _mean_step(phase) * np.arange(len(phase))))
    course = np.unwrap(phase)
    return course - course.mean()


def is_smooth(phase: F64) -> bool:
    """True if steps from pulse to pulse differ so little that the course of a phase, and not only its value, is known.

    A trend, whatever its size, is not part of the difference.
    """
    steps = np.angle(np.exp(1j * (np.diff(phase) - _mean_step(phase))))
    return bool(np.sqrt(np.mean(steps**2)) <= SMOOTH_STEP)


def turns_slowly(phase: F64) -> bool:
    """True if steps from pulse to pulse, whatever their size, change so little that they are known."""
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
