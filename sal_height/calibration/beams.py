"""Width of the beams and complex gains of the detectors, from the scene itself or from a target of known elevation.

"The beam pattern must be well characterized" (SAL paper, section 3). A scatterer makes of look k the samples
A_k b + n of noise I, with b_m = g_m h((theta - theta_m) / w): h the described pattern, w its width factor and g_m what
the description of detector m has to be multiplied by. With the covariance R of the K looks and the unit vector
e = b / |b|, profiling out the amplitudes leaves the log-likelihood e^H R e of each pixel. The parameters
are ln w, ln |g_m| and arg g_m; every pixel has, besides, its own theta.

What is determined. One complex factor of all gains is not; here the means of ln |g_m| and of arg g_m are 0. Boresights
are taken as known: they are the ruler that angles, and so w, are measured with. A scatterer's elevation takes one of
the M - 1 ratios of amplitudes: two detectors say nothing of w and |g_m|, and of Gaussian beams a slope of ln |g_m| over
the array is a shift of all angles, and a parabola another width, whatever their number. Sinc and jinc differ from that
in their sidelobes: least known are the slope with eight detectors or more, and the parabola together with w with four.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.calibration.beam_likelihood import Normal, curve_of, with_known_angles, with_unknown_angles
from sal_height.elevation import (
    MISFIT_SHARE,
    OBJECTIVES,
    Covariance,
    Fit,
    HeightSettings,
    Looks,
    PeakSearch,
    PeakSearches,
    is_one_scatterer,
    search_guard,
)
from sal_height.errors import NotDetermined, UserError
from sal_height.numeric import C128, F64, Bool, Index

Equations = Callable[["BeamCalibration"], Normal]

LEAST_ENERGY = 50.0
"""Energy of a usable pixel's looks in all detectors, over the noise power of one sample."""

FIRST_MISFIT_SHARE = 0.15
"""Share of a pixel's power that may remain unexplained while the calibration is not known."""

LEAST_PIXELS = 20
"""Usable pixels for each parameter."""

UNDETERMINED = 0.05
"""Standard deviation of any combination of ln w, ln |g| and arg g (a unit vector) from which on it is not determined:
what a description is good for without calibration."""

SETTLED = 0.05
"""Step, in standard deviations, that is the last."""

MOST_STEPS = 25

MIXED = "The channels are mixtures of detectors; beams are calibrated of single detectors only."


@dataclass(frozen=True)
class BeamCalibration:
    """What the description of the beams has to be changed by; standard deviations are those of noise alone.

    Attributes:
        width_factor: w, by which all beams are wider than described, in elevation and azimuth.
        width_sigma: standard deviation of w; NaN: w was not looked for.
        gains: complex, of the channels over those described, with the mean 0 of ln |g| and of arg g, (channels,).
        gain_sigmas: standard deviations of ln |g|, (channels,); NaN: not looked for.
        phase_sigmas: standard deviations of arg g, rad, (channels,).
        pixels: number that was used.
        steps: after which it settled.
    """

    width_factor: float
    width_sigma: float
    gains: C128
    gain_sigmas: F64
    phase_sigmas: F64
    pixels: int
    steps: int

    @classmethod
    def none(cls, channels: int) -> Self:
        """Of beams that are as described."""
        unknown = np.full(channels, np.nan)
        return cls(1.0, np.nan, np.ones(channels, np.complex128), unknown, unknown, 0, 0)


def beams_with(beams: Beams, calibration: BeamCalibration) -> Beams:
    """The beams wider by the width factor, on the same boresights, of channels multiplied by the gains.

    Raises:
        UserError: the channels are mixtures of detectors, or of another number than the gains.
    """
    _check_channels(beams, len(calibration.gains))
    return beams.widened(calibration.width_factor).combined(np.diag(calibration.gains))


def calibrate_beams(looks: Looks, beams: Beams) -> BeamCalibration:
    """Width and gains from all pixels of one scatterer, bright enough and between the boresights.

    Fisher scoring with the corrected derivatives of the likelihood, at angles that are searched anew in each step. It
    starts from the beams as described, and finds the way from phases that are 30 degrees and amplitudes that are 2 dB
    wrong. Looks that differ in elevation count as one scatterer as long as they fit: on slopes they should lie in
    azimuth. Pixels must not share looks, or the standard deviations are too small.

    Args:
        looks: complex covariance of three or more channels of equal noise (`looks.windowed_looks` with `hermitian`).
        beams: of the channels, as described.

    Raises:
        NotDetermined: two detectors; too few pixels; or a combination of width and gains remains unknown, as of
            Gaussian beams, or where all pixels have one elevation.
        UserError: the channels are mixtures of detectors, or the covariance is real.
    """
    if beams.count < 3:
        raise NotDetermined(
            f"{beams.count} detectors do not tell width and amplitudes of the beams from the scene, whose elevations "
            "are unknown; that needs 3 or more, or a target of known elevation."
        )
    return _settle(_of_scene(looks, beams), beams, _all_parameters(beams.count))


def calibrate_phases(looks: Looks, beams: Beams) -> BeamCalibration:
    """Phases of the gains alone, of two detectors or more; arguments and errors otherwise as of `calibrate_beams`."""
    return _settle(_of_scene(looks, beams), beams, _phases(beams.count))


def calibrate_on_target(
    covariance: Covariance, count: npt.ArrayLike, beams: Beams, elevation: F64, squint: F64, noise_power: float
) -> BeamCalibration:
    """Width and gains from a scan: a scatterer, as a reference target, seen at several known elevations.

    Args:
        covariance: sum over looks of z z^H for each position, complex, shape (positions, channels, channels).
        count: number of looks, broadcasts with (positions,).
        beams: of the channels, as described.
        elevation: of the target, rad, shape (positions,).
        squint: of the target, rad, shape (positions,).
        noise_power: E|n|^2 of one look in every channel.

    Raises:
        NotDetermined: a detector does not see the target, or all positions are alike (`calibrate_gains_on_target`).
        UserError: the channels are mixtures of detectors, or the covariance is real.
    """
    target = _of_target(covariance, count, beams, elevation, squint, noise_power)
    return _settle(target, beams, _all_parameters(beams.count), _first_gains(covariance, beams, elevation, squint))


def calibrate_gains_on_target(
    covariance: Covariance, count: npt.ArrayLike, beams: Beams, elevation: F64, squint: F64, noise_power: float
) -> BeamCalibration:
    """Gains alone, for which one position is enough; arguments and errors otherwise as of `calibrate_on_target`."""
    target = _of_target(covariance, count, beams, elevation, squint, noise_power)
    return _settle(target, beams, _gains(beams.count), _first_gains(covariance, beams, elevation, squint))


def _settle(equations: Equations, beams: Beams, basis: F64, gains: C128 | None = None) -> BeamCalibration:
    """Fisher scoring within the `basis` of the parameters, (parameters, free ones), from given gains or none."""
    calibration = BeamCalibration.none(beams.count)
    if gains is not None:
        calibration = replace(calibration, gains=gains)
    for step in range(1, MOST_STEPS + 1):
        normal = equations(calibration)
        change, covariance = _solve(normal, basis)
        calibration = _changed(calibration, change, covariance, normal.pixels, step)
        free = np.diag(covariance) > 0
        if step > 2 and np.all(np.abs(change[free]) < SETTLED * np.sqrt(np.diag(covariance)[free])):
            return calibration
    raise NotDetermined(
        f"Width and gains of the beams have not settled in {MOST_STEPS} steps; that needs pixels at elevations that "
        "differ, one scatterer in each, and a description that is near enough."
    )


def _solve(normal: Normal, basis: F64) -> tuple[F64, F64]:
    """Change of the parameters, and its covariance.

    Raises:
        NotDetermined: a combination of parameters remains unknown.
    """
    information = basis.T @ normal.information @ basis
    values, vectors = np.linalg.eigh(information)
    deviation = 1 / np.sqrt(values[0]) if values[0] > 1e-12 * values[-1] else np.inf
    if not deviation <= UNDETERMINED:
        raise NotDetermined(
            f"Pixels ({normal.pixels}) tell a combination of width and gains of the beams within "
            f"{100 * deviation:.3g} % only; to bring that to {100 * UNDETERMINED:g} %, more or brighter ones at other "
            "elevations, or a bright target at several known elevations, are needed."
        )
    inverse = basis @ ((vectors / values) @ vectors.T) @ basis.T
    return inverse @ normal.score, inverse @ normal.variance @ inverse


def _changed(before: BeamCalibration, change: F64, covariance: F64, pixels: int, step: int) -> BeamCalibration:
    """The calibration after a step; standard deviations of 0 are of what is not looked for."""
    channels = len(before.gains)
    sigma = np.sqrt(np.diag(covariance))
    sigma[sigma == 0] = np.nan
    amplitude, phase = change[1 : channels + 1], change[channels + 1 :]
    width = before.width_factor * float(np.exp(change[0]))
    return BeamCalibration(
        width_factor=width,
        width_sigma=float(width * sigma[0]),
        gains=before.gains * np.exp(amplitude + 1j * phase),
        gain_sigmas=sigma[1 : channels + 1],
        phase_sigmas=sigma[channels + 1 :],
        pixels=pixels,
        steps=step,
    )


def _all_parameters(channels: int) -> F64:
    """Basis of the parameters but for one complex factor of all gains."""
    return np.hstack([np.eye(2 * channels + 1, 1), _gains(channels)])


def _gains(channels: int) -> F64:
    """Basis of gains but for that factor: amplitudes, then phases."""
    return np.hstack([np.roll(_phases(channels), channels + 1, axis=0), _phases(channels)])


def _phases(channels: int) -> F64:
    """Basis of phases of the mean 0."""
    differences = np.linalg.svd(np.ones((1, channels)))[2][1:].T
    return np.vstack([np.zeros((channels + 1, channels - 1)), differences])


def _of_scene(looks: Looks, beams: Beams) -> Equations:
    """Sums over the usable pixels of a scene, at the angles that are likeliest with a calibration."""
    _check_channels(beams, looks.covariance.shape[-1])
    _check_complex(looks.covariance[slice(0, 1), slice(0, 1)])
    squint = looks.squint

    def equations(calibration: BeamCalibration) -> Normal:
        phases = calibration.gains / np.abs(calibration.gains)
        wide = beams.widened(calibration.width_factor)
        amplitudes = wide.scaled(np.abs(calibration.gains))
        searches = PeakSearches.over(amplitudes, squint, OBJECTIVES["normalised"], search_guard(beams))
        share = MISFIT_SHARE if calibration.steps > 1 else FIRST_MISFIT_SHARE
        of_blocks: dict[tuple[int, int], Normal] = {}

        def work(search: PeakSearch, rows: slice, cols: Index) -> None:
            pixels = looks.covariance[rows, cols].reshape(-1, beams.count, beams.count)
            pixels = pixels * (phases.conj()[:, None] * phases / looks.noise_power).astype(np.complex64)
            elevation = search.peaks(pixels).elevation
            across = np.broadcast_to(squint[cols], looks.count[rows, cols].shape).reshape(-1)
            of_pixel = (looks.count[rows, cols].reshape(-1), looks.finite[rows, cols].reshape(-1))
            explained = search.fit(pixels, elevation)[0]
            usable = of_pixel[1] & _usable(pixels, explained, of_pixel[0], elevation, beams, share)
            curve = curve_of(wide, np.abs(calibration.gains), elevation[usable], across[usable])
            block = (rows.start, int(cols[0]))
            of_blocks[block] = with_unknown_angles(curve, pixels[usable], of_pixel[0][usable])

        searches.each(squint, looks.covariance.shape[0], work)
        # Floating-point sums depend on their order, so that it must not be the one in which threads finish.
        total = sum((of_blocks[block] for block in sorted(of_blocks)), start=Normal.zero(beams.count))
        if total.pixels < LEAST_PIXELS * (2 * beams.count + 1):
            raise NotDetermined(
                f"{total.pixels} pixels show one scatterer between the boresights with an energy of {LEAST_ENERGY:g} "
                f"noise powers or more; {LEAST_PIXELS * (2 * beams.count + 1)} are needed."
            )
        return total

    return equations


def _of_target(
    covariance: Covariance, count: npt.ArrayLike, beams: Beams, elevation: F64, squint: F64, noise_power: float
) -> Equations:
    """Sums over the positions of a target at known angles."""
    _check_channels(beams, covariance.shape[-1])
    _check_complex(covariance)
    looks = np.broadcast_to(np.asarray(count, dtype=np.float64), elevation.shape)

    def equations(calibration: BeamCalibration) -> Normal:
        phases = calibration.gains / np.abs(calibration.gains)
        pixels = covariance * (phases.conj()[:, None] * phases / noise_power).astype(np.complex64)
        wide = beams.widened(calibration.width_factor)
        return with_known_angles(curve_of(wide, np.abs(calibration.gains), elevation, squint), pixels, looks)

    return equations


def _first_gains(covariance: Covariance, beams: Beams, elevation: F64, squint: F64) -> C128:
    """Gains to start from: the strongest eigenvector of the covariances, matched to the beams and summed."""
    response = beams.response(elevation, squint)
    matched = np.einsum("pm,pmn,pn->mn", response.conj(), covariance, response)
    seen = np.sum(np.abs(response) ** 2, axis=0)
    if not np.all(seen > 0):
        raise NotDetermined("A detector does not see the target at any of its positions; all detectors must.")
    gains = np.linalg.eigh(matched)[1][:, -1] / seen
    amplitude, phase = np.log(np.abs(gains)), np.angle(gains * gains[0].conj())
    return np.exp(amplitude - np.mean(amplitude) + 1j * (phase - np.mean(phase)))


def _usable(pixels: Covariance, explained: F64, count: F64, elevation: F64, beams: Beams, share: float) -> Bool:
    """Pixels of one scatterer (`is_one_scatterer`), bright enough and between the boresights."""
    first, last = beams.span
    left = np.trace(pixels, axis1=1, axis2=2).real - explained
    one = is_one_scatterer(
        Fit(explained, left, (beams.count - 1) * count - 0.5, beams.count), HeightSettings(misfit_share=share)
    )
    return one & (explained - count >= LEAST_ENERGY) & (elevation >= first) & (elevation <= last)


def _check_channels(beams: Beams, channels: int) -> None:
    if beams.matrix is not None:
        raise UserError(MIXED)
    if beams.count != channels:
        raise UserError(f"There are {channels} channels and beams of {beams.count} detectors; each needs its own.")


def _check_complex(covariance: Covariance) -> None:
    if not np.iscomplexobj(covariance):
        raise UserError("The covariance is real; gains need a complex one (looks with hermitian=True).")
