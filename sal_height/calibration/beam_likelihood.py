"""Likelihood of the width of the beams and of the detectors' gains, given the covariance of a pixel.

The samples of a scatterer in look k are A_k b + n, with noise n of covariance I and b_m = g_m h((theta - theta_m) / w).
With the covariance R of the looks and e = b / |b|, profiling out the A_k leaves the log-likelihood e^H R e. Parameters
are ln w, ln |g_m| and arg g_m, in this order. Changes of e along e, and for unknown angles along de/dtheta, make no
difference to first order: only the part of de that is orthogonal to them counts.

At its peak over theta the likelihood's derivatives have a mean that more pixels do not reduce (Neyman and Scott,
Econometrica 16, 1948): the curve e(theta) is bent, so that an error along it ends nearer to the data on its inner side.
With n the part of d^2e/dtheta^2 orthogonal to the curve over |de/dtheta|^2, that mean is -Re(n^H de) / 2 for a change
de of the curve, whatever energy and number of the looks. Ground that fills a pixel has a spread of elevations, of
variance s^2 along the curve, and energy E: it biases e in the opposite direction, by E s^2 Re(n^H de). Both show in the
power along the tangent t = de/dtheta / |de/dtheta|, whose mean is t^H R t = K - 1/2 + E s^2 with K looks: the sum of
the two means is Re(n^H de) (t^H R t - K), which is subtracted. The rest decreases with the energy.

Sums are those of einsum, not of BLAS, whose threads would block those that work on other pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation import Covariance
from sal_height.numeric import C128, F64, Index

DIFFERENCE = 1e-3  # half step of differences, in beamwidths and relative widths: derivatives are right within 1e-5


class Normal(NamedTuple):
    """Sums over pixels that a step needs; parameters in the order ln w, ln |g_m|, arg g_m.

    Attributes:
        scores: derivatives of each pixel's log-likelihood, mean 0 at the truth, shape (pixels, parameters).
        information: minus the mean of the second derivatives of their sum, (parameters, parameters).
        variance: covariance of the sum of the scores, if these differ by the noise of each pixel only.
        between: covariance of the sum as estimated from the scores (`variance_between`); None: not estimated.
    """

    scores: F64
    information: F64
    variance: F64
    between: F64 | None = None

    @classmethod
    def joined(cls, parts: Sequence[Normal]) -> Self:
        """The sums over the pixels of several parts."""
        scores, information, variance, _ = zip(*parts, strict=True)
        return cls(np.concatenate(scores), np.sum(information, axis=0), np.sum(variance, axis=0))

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return len(self.scores)

    @property
    def score(self) -> F64:
        """Sum of the scores, shape (parameters,)."""
        return np.sum(self.scores, axis=0)


def variance_between(scores: F64, group: Index) -> F64:
    """Covariance of the sum of scores that are independent between groups, whatever they have in common within one.

    With s_c the sum over group c of C it is C / (C - 1) sum_c s_c s_c^T (Liang and Zeger, Biometrika 73, 1986): errors
    of the model, such as power from neighbouring pixels and layover, count as they are. 0 for a single group.

    Args:
        scores: scores of the pixels, with the mean 0, shape (pixels, parameters).
        group: number of the group of each pixel, shape (pixels,).
    """
    groups, of_pixel = np.unique(group, return_inverse=True)
    sums = np.zeros((len(groups), scores.shape[1]))
    np.add.at(sums, of_pixel, scores)
    return np.einsum("ci,cj->ij", sums, sums) * (len(groups) / max(1, len(groups) - 1))


@dataclass(frozen=True, eq=False)
class ResponseCurve:
    """The unit vectors e of some pixels and their derivatives, of shape (pixels, channels) and orthogonal to e.

    Attributes:
        unit: e.
        wider: de / dln w.
        tangent: de / dtheta, of length 1.
        curvature: part of d^2e/dtheta^2 orthogonal to the tangent, over |de/dtheta|^2.
    """

    unit: C128
    wider: C128
    tangent: C128
    curvature: C128


def curve_of(beams: Beams, gains: F64, elevation: F64, squint: F64) -> ResponseCurve:
    """Return the curve at some pixels' elevations and squints (rad, (pixels,)), of beams times `gains` (channels,)."""
    beamwidth = beams.beamwidth
    narrow, wide = (beams.widened(1 + sign * DIFFERENCE).response(elevation, squint) for sign in (-1, 1))
    before, after = (beams.slope(elevation + sign * DIFFERENCE * beamwidth, squint) for sign in (-1, 1))
    response = gains * beams.response(elevation, squint).astype(np.complex128)
    norm = np.linalg.norm(response, axis=-1, keepdims=True)
    unit = response / norm
    slope, bend, wider = (
        gains * change / norm
        for change in (
            (after + before) * beamwidth / 2,
            (after - before) * beamwidth / (2 * DIFFERENCE),
            (wide - narrow) / (2 * DIFFERENCE),
        )
    )
    drift = _inner(unit, slope)
    slope = slope - drift * unit
    speed = np.linalg.norm(slope, axis=-1, keepdims=True)
    tangent = slope / speed
    bend = _without(bend - 2 * drift * slope, unit) / speed**2
    return ResponseCurve(unit, _without(wider, unit), tangent, bend - _inner(tangent, bend).real * tangent)


def with_known_angles(curve: ResponseCurve, pixels: Covariance, count: F64) -> Normal:
    """Sum over pixels of known elevation (covariance over noise power, (pixels, M, M), of `count` looks)."""
    explained, left = _residual(curve, pixels)
    geometry = _gram(curve, explained), _gram(curve, explained - count)
    return Normal(_products(2 * left, curve).real, 2 * geometry[1], 2 * geometry[0])


def with_unknown_angles(curve: ResponseCurve, pixels: Covariance, count: F64) -> Normal:
    """Sum over pixels at their most likely elevations: the part of changes along the curve makes no difference."""
    explained, left = _residual(curve, pixels)
    left = left - _inner(curve.tangent, left).real * curve.tangent
    along = _products(curve.tangent, curve).real
    variance, information = (
        2 * (_gram(curve, weight) - _square(along, weight)) for weight in (explained, explained - count)
    )
    spread = _inner(curve.tangent, _times(pixels, curve.tangent)).real - count[:, None]
    return Normal(_products(2 * left - spread * curve.curvature, curve).real, information, variance)


def _residual(curve: ResponseCurve, pixels: Covariance) -> tuple[F64, C128]:
    """Return the power that is explained, e^H R e, (pixels,), and R e without its part along e, (pixels, channels)."""
    output = _times(pixels, curve.unit)
    explained = _inner(curve.unit, output).real
    return explained[:, 0], output - explained * curve.unit


def _times(pixels: Covariance, vector: C128) -> C128:
    """Return R v of each pixel, shape (pixels, channels)."""
    return np.einsum("pmn,pn->pm", pixels, vector.astype(pixels.dtype)).astype(np.complex128)


def _products(direction: C128, curve: ResponseCurve) -> C128:
    """Return direction^H db/|b| for each parameter, shape (pixels, parameters).

    With a `direction` orthogonal to e its real part is Re(direction^H de).
    """
    each = direction.conj() * curve.unit
    return np.concatenate([np.sum(direction.conj() * curve.wider, axis=-1, keepdims=True), each, 1j * each], axis=-1)


def _gram(curve: ResponseCurve, weight: F64) -> F64:
    """Return the weighted sum over pixels of Re(de^H de) for all pairs of parameters, de without its part along e."""
    channels = curve.unit.shape[1]
    amplitudes, phases = slice(1, channels + 1), slice(channels + 1, None)
    total = np.zeros((2 * channels + 1, 2 * channels + 1))
    own = np.diag(np.einsum("p,pm->m", weight, np.abs(curve.unit) ** 2))
    crossed = np.einsum("p,pm,pm->m", weight, curve.wider.conj(), curve.unit)
    total[0, 0] = np.sum(weight * np.sum(np.abs(curve.wider) ** 2, axis=-1))
    total[amplitudes, amplitudes] = total[phases, phases] = own
    total[0, amplitudes] = total[amplitudes, 0] = crossed.real
    total[0, phases] = total[phases, 0] = -crossed.imag
    along = _products(curve.unit, curve)
    return total - _square(along.real, weight) - _square(along.imag, weight)


def _square(values: F64, weight: F64) -> F64:
    """Return the weighted sum over pixels of v v^T, from v of the shape (pixels, parameters)."""
    return np.einsum("pi,pj->ij", values, values * weight[:, None])


def _inner(a: C128, b: C128) -> C128:
    """Return a^H b of each pixel, shape (pixels, 1)."""
    return np.sum(a.conj() * b, axis=-1, keepdims=True)


def _without(vector: C128, unit: C128) -> C128:
    """Return the vectors' part orthogonal to unit vectors."""
    return vector - _inner(unit, vector) * unit
