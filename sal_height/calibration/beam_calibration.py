"""Width of the beams and complex gains of the detectors, from the scene itself or from a target of known elevation.

"The beam pattern must be well characterized" (SAL paper, section 3). A detector receives g_m h((theta - theta_m) / w):
h is the described pattern, w its width factor, and g_m what the description of detector m has to be multiplied by. The
parameters ln w, ln |g_m| and arg g_m maximise the likelihood below; in addition, every pixel has its own elevation
theta.

One complex factor of all gains is not determined; here the means of ln |g_m| and of arg g_m are 0. Boresights are
assumed to be known: angles, and so w, are measured against them. The elevation of a scatterer uses up one of the M - 1
ratios of amplitudes: two detectors determine neither w nor |g_m|. With Gaussian beams, whatever their number, a slope
of ln |g_m| over the array is a shift of all angles, and a parabola another width. Sinc and jinc differ from that in
their sidelobes: least known are the slope with eight detectors or more, and the parabola together with w with four.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from sal_height.beams import Beams
from sal_height.calibration.calibration import DEFAULTS, CalibrationSettings
from sal_height.elevation import (
    OBJECTIVES,
    Covariance,
    Fit,
    HeightSettings,
    Looks,
    PeakSearch,
    PeakSearches,
    Pixels,
    is_explained,
    search_guard,
)
from sal_height.errors import NotDetermined
from sal_height.numeric import C64, C128, F64, Index, ShortRepr

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


@dataclass(frozen=True, eq=False)
class BeamCalibration(ShortRepr):
    """Corrections of the description of the beams, with standard deviations.

    Attributes:
        width_factor: w, width of all beams over that described, in elevation and azimuth.
        width_sigma: standard deviation of w; NaN: w was not estimated.
        gains: complex gains of the channels over those described, with the mean 0 of ln |g| and of arg g, (channels,).
        gain_sigmas: standard deviations of ln |g|, (channels,); NaN: not estimated.
        phase_sigmas: standard deviations of arg g, rad, (channels,).
        pixels: number of pixels used.
        steps: number of steps until the estimate settled.
    """

    width_factor: float
    width_sigma: float
    gains: C128
    gain_sigmas: F64
    phase_sigmas: F64
    pixels: int
    steps: int

    @classmethod
    def as_described(cls, channels: int) -> Self:
        """The calibration of beams that are as described."""
        unknown = np.full(channels, np.nan)
        return cls(1.0, np.nan, np.ones(channels, np.complex128), unknown, unknown, 0, 0)


Sums = Callable[[BeamCalibration], Normal]
"""The sums over pixels that determine the next step from a calibration."""


def calibrate_beams(looks: Looks, beams: Beams, settings: CalibrationSettings = DEFAULTS) -> BeamCalibration:
    """Estimate width and gains from all pixels of one scatterer, bright enough and between the boresights.

    Fisher scoring with the corrected derivatives of the likelihood, at elevations that are searched again in each step.
    It starts from the beams as described, and converges from phases that are 30 degrees and amplitudes that are 2 dB
    wrong. Looks that differ in elevation count as one scatterer as long as they fit: on slopes they should be taken in
    azimuth. Rows may have common speckle, by the response in range or by layover: standard deviations are the greater
    of those of independent pixels and those that differences between columns show. Columns must not have looks in
    common, or the standard deviations are too small. Of two detectors only the phases are estimated.

    Args:
        looks: complex covariance of single detectors with equal noise (`windowed_looks` with `hermitian`).
        beams: beams of the channels, as described.
        settings: criteria for pixels, and the greatest error of the result.

    Raises:
        NotDetermined: too few pixels; or a combination of width and gains remains unknown, as of Gaussian beams, or
            where all pixels have one elevation.
    """
    basis = _all_parameters(beams.count) if beams.count > 2 else _phases(beams.count)
    return _settle(
        lambda found: _sum_over_scene(found, looks, beams, settings),
        BeamCalibration.as_described(beams.count),
        basis,
        settings,
    )


def calibrate_on_target(
    samples: C128,
    beams: Beams,
    elevation: F64,
    squint: F64,
    noise_power: float,
    settings: CalibrationSettings = DEFAULTS,
) -> BeamCalibration:
    """Estimate width and gains from a scatterer, such as a reflector, that was seen at known elevations.

    If the elevations do not determine the width, as a single one, the gains alone are estimated.

    Args:
        samples: samples of the target at each position, shape (positions, channels).
        beams: beams of the channels, single detectors, as described.
        elevation: elevation of the target, rad, shape (positions,).
        squint: squint of the target, rad, shape (positions,).
        noise_power: E|n|^2 of a sample in every channel.
        settings: greatest error of the result.

    Raises:
        NotDetermined: a detector does not see the target, or the target is too weak.
    """
    covariance = (samples[:, :, None] * samples[:, None].conj()).astype(np.complex64)
    one_look = np.ones(len(samples))

    def sums(found: BeamCalibration) -> Normal:
        curve = curve_of(beams.widened(found.width_factor), np.abs(found.gains), elevation, squint)
        return with_known_angles(curve, covariance * _undo_phases(found.gains, noise_power), one_look)

    gains = _first_gains(covariance, beams.response(elevation, squint))
    start = replace(BeamCalibration.as_described(beams.count), gains=gains)
    try:
        return _settle(sums, start, _all_parameters(beams.count), settings)
    except NotDetermined:
        return _settle(sums, start, _gains(beams.count), settings)


def _settle(sums: Sums, start: BeamCalibration, basis: F64, settings: CalibrationSettings) -> BeamCalibration:
    """Estimate the parameters by Fisher scoring, within the `basis` (parameters, free ones), until they settle."""
    found, channels, most_steps = start, len(start.gains), 25
    for step in range(1, most_steps + 1):
        normal = sums(found)
        change, sigma = _solve(normal, basis, settings.max_uncertainty)
        change *= min(1.0, 6 / step)  # shorter later on: pixels that hardly fit may leave and return in turn
        settled = step > 2 and np.all(np.abs(change) <= 0.05 * sigma)
        sigma = np.where(sigma > 0, sigma, np.nan)  # of parameters that are not free
        width = found.width_factor * float(np.exp(change[0]))
        found = BeamCalibration(
            width_factor=width,
            width_sigma=float(width * sigma[0]),
            gains=found.gains * np.exp(change[1 : channels + 1] + 1j * change[channels + 1 :]),
            gain_sigmas=sigma[1 : channels + 1],
            phase_sigmas=sigma[channels + 1 :],
            pixels=normal.pixels,
            steps=step,
        )
        if settled:
            return found
    raise NotDetermined(
        f"Width and gains of the beams have not settled in {most_steps} steps; that needs pixels at elevations that "
        "differ, one scatterer in each, and a description that is near enough."
    )


def _solve(normal: Normal, basis: F64, max_uncertainty: float) -> tuple[F64, F64]:
    """Return the change of the parameters, and its standard deviations.

    Raises:
        NotDetermined: a combination of parameters remains unknown.
    """
    values, vectors = np.linalg.eigh(basis.T @ normal.information @ basis)
    deviation = 1 / np.sqrt(values[0]) if values[0] > 1e-12 * values[-1] else np.inf
    if not deviation <= max_uncertainty:
        raise NotDetermined(
            f"Pixels ({normal.pixels}) determine a combination of width and gains of the beams within "
            f"{100 * deviation:.3g} % only; to bring that to {100 * max_uncertainty:g} %, more or brighter ones at "
            "other elevations, or a bright target at several known elevations, are needed."
        )
    inverse = basis @ ((vectors / values) @ vectors.T) @ basis.T
    between = normal.variance if normal.between is None else normal.between
    variances = [np.diag(inverse @ variance @ inverse) for variance in (normal.variance, between)]
    return inverse @ normal.score, np.sqrt(np.maximum(*variances))


def _all_parameters(channels: int) -> F64:
    """Return the basis of all parameters but one complex factor of all gains, in the order ln w, ln |g_m|, arg g_m."""
    return np.hstack([np.eye(2 * channels + 1, 1), _gains(channels)])


def _gains(channels: int) -> F64:
    """Return the basis of gains but for that factor: amplitudes, then phases."""
    return np.hstack([np.roll(_phases(channels), channels + 1, axis=0), _phases(channels)])


def _phases(channels: int) -> F64:
    """Return the basis of phases of the mean 0."""
    differences = np.linalg.svd(np.ones((1, channels)))[2][1:].T
    return np.vstack([np.zeros((channels + 1, channels - 1)), differences])


def _undo_phases(gains: C128, noise_power: float) -> C64:
    """Return factors that remove the phases of gains from a covariance, and divide it by the noise."""
    phases = gains / np.abs(gains)
    return (phases.conj()[:, None] * phases / noise_power).astype(np.complex64)


def _sum_over_scene(found: BeamCalibration, looks: Looks, beams: Beams, settings: CalibrationSettings) -> Normal:
    """Sum over the usable pixels of a scene, at the most likely elevations with the current calibration."""
    wide, amplitudes, squint = beams.widened(found.width_factor), np.abs(found.gains), looks.squint
    undone = _undo_phases(found.gains, looks.receiver_noise)
    searches = PeakSearches.over(wide.scaled(amplitudes), OBJECTIVES["normalised"], search_guard(beams))
    misfit = settings.misfit_fraction if found.steps > 1 else settings.first_misfit_fraction
    rules = HeightSettings(misfit_fraction=misfit)
    (first, last), channels = beams.span, beams.count
    of_blocks: dict[tuple[int, int], tuple[Normal, Index]] = {}

    def work(search: PeakSearch, here: Pixels) -> None:
        pixels = looks.covariance[here] * undone
        count, finite, across = looks.count[here], looks.finite[here], squint[here[1]]
        elevation = search.peaks(pixels).elevation
        explained = search.fit(pixels, elevation)[0]
        left = np.trace(pixels, axis1=1, axis2=2).real - explained
        usable = finite & is_explained(Fit(explained, left, (channels - 1) * count - 0.5, channels), rules)
        usable &= (explained - count >= settings.min_energy) & (elevation >= first) & (elevation <= last)
        curve = curve_of(wide, amplitudes, elevation[usable], across[usable])
        block = int(here[0][0]), int(here[1][0])
        of_blocks[block] = with_unknown_angles(curve, pixels[usable], count[usable]), here[1][usable]

    searches.each(squint, looks.covariance.shape[0], work)
    # Floating-point sums depend on their order, which must not be that in which threads finish.
    parts, columns = zip(*(of_blocks[block] for block in sorted(of_blocks)), strict=True)
    total = Normal.joined(parts)
    needed = settings.pixels_per_parameter * (2 * channels + 1)
    if total.pixels < needed:
        raise NotDetermined(
            f"{total.pixels} pixels show one scatterer between the boresights with an energy of "
            f"{settings.min_energy:g} noise powers or more; {needed} are needed."
        )
    return total._replace(between=variance_between(total.scores, np.concatenate(columns)))


def _first_gains(covariance: C64, response: F64) -> C128:
    """Return the gains to start from: the strongest eigenvector of the covariances, matched to the beams and summed."""
    matched = np.einsum("pm,pmn,pn->mn", response.conj(), covariance, response)
    seen = np.sum(np.abs(response) ** 2, axis=0)
    if not np.all(seen > 0):
        raise NotDetermined("A detector does not see the target at any of its positions; all detectors must.")
    gains = np.linalg.eigh(matched)[1][:, -1] / seen
    amplitude, phase = np.log(np.abs(gains)), np.angle(gains * gains[0].conj())
    return np.exp(amplitude - np.mean(amplitude) + 1j * (phase - np.mean(phase)))
