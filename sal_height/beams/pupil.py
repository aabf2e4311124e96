"""Beam patterns of the unit disc: the Fourier integral over the pupil, chord by chord.

A pupil point has coordinates (u, v) in aperture diameters, along the detector axis and beside it. For coherent
detection the transfer function is the pupil itself, times the transform of the detector: a detector of widths w_e and
w_a has

    h(e, a) = 1/P int int A(u, v) sinc(w_e u) sinc(w_a v) exp(-j 2 pi (u e + v a)) du dv,   P = int int A du dv.

Chords lie at u = sin(tau) / 2 with tau equally spaced. As a function of tau the integrand then has a period, and the
sum over N chords is exact but for its Fourier coefficients from number 2 N on. They are those of
exp(j K sin(tau)), the Bessel functions J_n(K), with K = pi times the offset to the farthest corner of the detector.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import roots_legendre

from sal_height.beams.apertures import SINC
from sal_height.beams.band_limited import Samples, interpolated
from sal_height.errors import UserError
from sal_height.numeric import C128, F64

Factors = Callable[[F64, int], npt.NDArray[Any]]
"""From n offsets (beamwidths) and a number of chords to one factor per chord: shape (n, factors)."""

Apodisation = Callable[[F64, F64], npt.ArrayLike]
"""Weighting A of the aperture at pupil coordinates (u, v), arrays of one shape; real or complex."""

APODISATION_NODES = 96
"""Chords, and points on each, that follow an apodisation at the least."""

LEAST_TOTAL = 1e-9
"""Integral of an apodisation over its greatest modulus that is still taken for something other than 0."""


@dataclass(frozen=True)
class ChordSum:
    """A function of two offsets in beamwidths: the sum over chords of the pupil of along(e) across(a).

    Attributes:
        along: factors along the detector axis.
        across: factors beside it.
        size: widths of the detector along its axis and beside it, beamwidths.
        dtype: of the values, float64 or complex128.
        least_chords: number of chords however small the offsets.
    """

    along: Factors
    across: Factors
    size: tuple[float, float]
    dtype: type[np.float64 | np.complex128] = np.float64
    least_chords: int = 0

    def __call__(self, e: npt.ArrayLike, a: npt.ArrayLike) -> Samples:
        """Values at `e` and `a`, which broadcast; within 1e-10."""
        return interpolated(self.samples, self.dtype, e, a)

    def samples(self, e: F64, a: F64) -> Samples:
        """Values at all combinations of `e` and `a`, shape (len(e), len(a)); within 1e-13."""
        corner = [np.max(np.abs(x)) + width / 2 for x, width in zip((e, a), self.size, strict=True)]
        chords = max(self.least_chords, chord_count(math.hypot(*corner)))
        return self.along(e, chords) @ self.across(a, chords).T


def chord_count(offset: float) -> int:
    """Chords for offsets of that many beamwidths: J_n(pi offset) is below 1e-14 from twice as many on.

    A multiple of 16, so that few different sets of nodes are made.
    """
    k = math.pi * offset
    return 16 * math.ceil((k + 8 * math.cbrt(k) + 20) / 32)


def chords(count: int) -> tuple[F64, F64, F64]:
    """Places u of the chords, their half lengths c, and weights that make an integral over u; shape (count,)."""
    tau = (np.arange(count) + 0.5) * np.pi / count - np.pi / 2
    c = np.cos(tau) / 2
    return np.sin(tau) / 2, c, c * np.pi / count


def jinc_sums(size: tuple[float, float]) -> tuple[ChordSum, ChordSum, ChordSum]:
    """The amplitude of a rectangular detector behind a circular aperture, its slope and its azimuth slope.

    The integral along a chord is closed: the mean over the detector of sin(2 pi c a) / (pi a). The pupil is even, so
    that one half of it does.
    """

    def half(count: int) -> tuple[F64, F64, F64]:
        u, c, weight = (part[count // 2 :] for part in chords(count))
        return u, c, 8 / np.pi * weight * np.sinc(size[0] * u)

    def along(e: F64, count: int) -> F64:
        u, _, weight = half(count)
        return weight * np.cos(2 * np.pi * u * e[:, None])

    def along_slope(e: F64, count: int) -> F64:
        u, _, weight = half(count)
        return -2 * np.pi * u * weight * np.sin(2 * np.pi * u * e[:, None])

    def across(a: F64, count: int) -> F64:
        chord = 2 * half(count)[1]
        return chord * SINC.mean(chord * a[:, None], chord * size[1])

    def across_slope(a: F64, count: int) -> F64:
        chord = 2 * half(count)[1]
        return chord**2 * SINC.mean_slope(chord * a[:, None], chord * size[1])

    return ChordSum(along, across, size), ChordSum(along_slope, across, size), ChordSum(along, across_slope, size)


def apodised_sums(apodisation: Apodisation, size: tuple[float, float]) -> tuple[ChordSum, ChordSum, ChordSum]:
    """The amplitude of a rectangular detector behind a weighted circular aperture, its slope and its azimuth slope.

    They are real where A(-u, -v) is the conjugate of A(u, v) but for a common factor, otherwise complex.

    Raises:
        UserError: the weighting is not finite, or its integral is 0.
    """
    weight, weighting = _weighting(apodisation, APODISATION_NODES)
    if not np.all(np.isfinite(weighting)):
        raise UserError("The apodisation is not finite all over the aperture; it must be.")
    total = np.sum(weight * weighting)
    if not abs(total) > LEAST_TOTAL * np.max(np.abs(weighting)):
        raise UserError("The integral of the apodisation over the aperture is 0; it must not be.")
    weighting = weighting / total
    hermitian = np.allclose(weighting, np.conj(weighting[::-1, ::-1]), rtol=0, atol=1e-12 * np.max(np.abs(weighting)))

    def sum_of(along_order: int, across_order: int) -> ChordSum:
        along, across = _along(size[0], along_order), _across(apodisation, complex(total), size[1], across_order)
        if hermitian:
            return ChordSum(_real_part(along, -1), _real_part(across, 1), size, np.float64, APODISATION_NODES)
        return ChordSum(along, across, size, np.complex128, APODISATION_NODES)

    return sum_of(0, 0), sum_of(1, 0), sum_of(0, 1)


def _along(width: float, order: int) -> Factors:
    """Transform along the detector axis; of its derivative of that order."""

    def along(e: F64, count: int) -> C128:
        u, _, weight = chords(count)
        return weight * np.sinc(width * u) * (-2j * np.pi * u) ** order * np.exp(-2j * np.pi * u * e[:, None])

    return along


def _across(apodisation: Apodisation, total: complex, width: float, order: int) -> Factors:
    """Transform along every chord of the weighting over `total`; of its derivative of that order."""

    def across(a: F64, count: int) -> C128:
        _, c, _ = chords(count)
        t, gauss = _legendre(count)
        v = c[:, None] * t
        weighting = c[:, None] * gauss * _weighting(apodisation, count)[1] / total
        weighting = weighting * np.sinc(width * v) * (-2j * np.pi * v) ** order
        pairs = zip(v, weighting, strict=True)
        return np.stack([np.exp(-2j * np.pi * a[:, None] * place) @ weight for place, weight in pairs], axis=-1)

    return across


def _real_part(factors: Factors, sign: int) -> Factors:
    """Real and imaginary part as factors of their own, the latter times `sign`: Re xy = Re x Re y - Im x Im y."""

    def parts(offset: F64, count: int) -> F64:
        values = factors(offset, count)
        return np.concatenate([values.real, sign * values.imag], axis=-1)

    return parts


def _weighting(apodisation: Apodisation, count: int) -> tuple[F64, C128]:
    """Weights of an integral over the disc, and A, at `count` points on each of `count` chords."""
    u, c, weight = chords(count)
    t, gauss = _legendre(count)
    v = c[:, None] * t
    values = np.asarray(apodisation(np.repeat(u[:, None], count, axis=1), v))
    return weight[:, None] * c[:, None] * gauss, np.broadcast_to(values, v.shape).astype(np.complex128)


@lru_cache(maxsize=32)
def _legendre(count: int) -> tuple[F64, F64]:
    """Gauss-Legendre nodes and weights on [-1, 1]."""
    nodes, weights = roots_legendre(count)
    return nodes, weights
