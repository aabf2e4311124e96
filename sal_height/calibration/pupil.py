"""Aberrations of the common pupil, from the scene itself, by the likelihood that calibrates beams.

Parameters are the coefficients c_k of `beams.ZERNIKE`, in waves rms, ln w, and ln |g_m| and arg g_m of the channels;
in addition, every pixel has its own elevation. They maximise the likelihood of `beam_calibration`, with Gaussian priors
of the mean 0: undetermined parameters stay 0, with the standard error of the prior.

Determined are: even terms (defocus, astigmatism, spherical), which change the phases between detectors as the target
moves through their beams; their signs show in that. From powers alone they would not: h and its conjugate have the same
power, which changes by c^2 only. Images seen from one squint determine the mean of the phase over each chord of the
pupil across the detector axis: defocus and astigmatism then differ in their second order only, and oblique astigmatism
and coma off the axis not at all. Their standard errors state this, and the beams at this squint do not depend on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from sal_height.beams import ZERNIKE, Beams, aberrated_derivatives
from sal_height.calibration.beam_calibration import DIFFERENCE, curve_of
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
from sal_height.numeric import C128, F64, Bool


@dataclass(frozen=True, eq=False)
class PupilCalibration:
    """Aberrations of the pupil, and the goodness of fit of beams with them.

    Attributes:
        coefficients: coefficients of the terms of ZERNIKE in their order, waves rms.
        sigma: standard errors of the coefficients, that of the prior where pixels do not determine them, waves rms.
        width_factor: w, width of all beams over that described.
        gains: complex gains of the channels over those described, with the mean 0 of ln |g| and of arg g, (channels,).
        pixels: number of pixels used.
        misfit: power that one scatterer leaves in these pixels over that of the noise in the same degrees of freedom.
        p_value: probability of such a misfit or a greater one, if the beams are right and the pixels one scatterer.
        steps: number of steps until the estimate settled.
    """

    coefficients: F64
    sigma: F64
    width_factor: float
    gains: C128
    pixels: int
    misfit: float
    p_value: float
    steps: int


@dataclass(frozen=True)
class _Sums:
    """Sums over pixels that a step needs: score, information, variance of the score, and the misfit."""

    score: F64
    information: F64
    variance: F64
    pixels: int
    left: float
    freedom: float


def calibrate_pupil(looks: Looks, beams: Beams, settings: CalibrationSettings = DEFAULTS) -> PupilCalibration:
    """Estimate aberrations and gains from all pixels that look like one scatterer, bright enough, inside the array.

    The criterion for one scatterer is lenient in the first steps and strict later (`misfit_fraction`).

    Args:
        looks: looks with complex covariances, of detectors of equal noise.
        beams: beams of the detectors, as described; circular apertures.
        settings: criteria for pixels, and the prior of the coefficients.

    Raises:
        NotDetermined: fewer than three detectors, channels that mix them, too few pixels, or no convergence.
        UserError: the apertures are not circular.
    """
    if beams.matrix is not None or beams.count < 3:
        raise NotDetermined(
            f"The pupil needs the amplitudes of three or more single detectors; there are {beams.count} channels"
            f"{' that mix detectors' if beams.matrix is not None else ''}."
        )
    terms, channels = len(ZERNIKE), beams.count
    # After beams have been calibrated, ln w, ln |g| and arg g have errors of about 0.1.
    prior = np.concatenate([np.full(terms, settings.pupil_prior_waves), np.full(1 + 2 * channels, 0.1)])
    values, most_steps = np.zeros(len(prior)), 20
    for step in range(1, most_steps + 1):
        misfit = max(settings.misfit_fraction, 0.5**step)  # while the beams are wrong, single scatterers fit badly, too
        sums = _sum_over_scene(values, looks, beams, settings, misfit)
        change, sigma = _step(sums, values, prior)
        longest_step = 0.03  # of a coefficient, in waves: beyond it the field is not linear
        values = values + change * min(1.0, longest_step / np.max(np.abs(change[:terms])))
        if misfit == settings.misfit_fraction and np.all(np.abs(change[:terms]) <= 0.1 * sigma[:terms]):
            gains = values[terms + 1 :].reshape(2, channels)
            gains = gains - gains.mean(axis=1, keepdims=True)
            return PupilCalibration(
                coefficients=values[:terms],
                sigma=sigma[:terms],
                width_factor=float(np.exp(values[terms])),
                gains=np.exp(gains[0] + 1j * gains[1]),
                pixels=sums.pixels,
                misfit=sums.left / sums.freedom,
                p_value=float(chdtrc(2 * sums.freedom, 2 * sums.left)),
                steps=step,
            )
    raise NotDetermined(
        f"The aberrations of the pupil have not settled in {most_steps} steps; that needs pixels of one scatterer at "
        "elevations that differ, and aberrations well below a quarter of a wave."
    )


def _step(sums: _Sums, values: F64, prior: F64) -> tuple[F64, F64]:
    """Change of the parameters in the next step, and their standard errors.

    Combinations of parameters that pixels do not determine three times better than the prior stay unchanged.
    """
    strength, directions = np.linalg.eigh(prior[:, None] * sums.information * prior)
    known = strength > 9
    basis = prior[:, None] * directions
    inverse = (basis[:, known] / (1 + strength[known])) @ basis[:, known].T
    change = inverse @ (sums.score - values / prior**2)
    variance = inverse @ (sums.variance + np.diag(prior**-2.0)) @ inverse + basis[:, ~known] @ basis[:, ~known].T
    return change, np.sqrt(np.diag(variance))


def _sum_over_scene(values: F64, looks: Looks, beams: Beams, settings: CalibrationSettings, misfit: float) -> _Sums:
    """Sum over the usable pixels of a scene, at the most likely elevations with the current parameters."""
    terms, channels = len(ZERNIKE), beams.count
    coefficients = tuple(values[:terms].tolist())
    gains = np.exp(values[terms + 1 :][:channels] + 1j * values[terms + 1 + channels :])
    wide = beams.widened(float(np.exp(values[terms])))
    seen = wide.aberrated(coefficients).scaled(gains)
    derivatives = [
        [term.scaled(one.gain) for term in aberrated_derivatives(coefficients, one.size)] for one in beams.patterns
    ]
    bends = [wide.patterned(patterns).scaled(gains) for patterns in zip(*derivatives, strict=True)]
    searches = PeakSearches.over(seen, OBJECTIVES["normalised"], search_guard(beams))
    of_blocks: dict[tuple[int, int], _Sums] = {}

    def work(search: PeakSearch, here: Pixels) -> None:
        pixels, count = looks.covariance[here] / looks.receiver_noise, looks.count[here]
        squint = looks.squint[here[1]]
        elevation = search.peaks(pixels).elevation
        usable, left = _usable(search, pixels, count, elevation, beams, settings, misfit)
        usable &= looks.finite[here]
        basis = _derivatives(seen, bends, elevation[usable], squint[usable])
        freedom = float(np.sum((channels - 1) * count[usable] - 0.5))
        score, information, variance = _normal(
            seen, basis, elevation[usable], squint[usable], pixels[usable], count[usable]
        )
        left_over = float(np.sum(left[usable]))
        of_blocks[int(here[0][0]), int(here[1][0])] = _Sums(
            score, information, variance, int(np.sum(usable)), left_over, freedom
        )

    searches.each(looks.squint, looks.covariance.shape[0], work)
    parts = [of_blocks[block] for block in sorted(of_blocks)]  # in an order that threads do not change
    total = _Sums(*(sum(getattr(part, name) for part in parts) for name in _Sums.__dataclass_fields__))
    needed = settings.pixels_per_parameter * len(values)
    if total.pixels < needed:
        raise NotDetermined(
            f"Only {total.pixels} pixels show one scatterer between the boresights with an energy of "
            f"{settings.min_energy:g} noise powers or more; the pupil needs {needed}."
        )
    return total


def _usable(
    search: PeakSearch,
    pixels: Covariance,
    count: F64,
    elevation: F64,
    beams: Beams,
    settings: CalibrationSettings,
    misfit: float,
) -> tuple[Bool, F64]:
    """Select pixels of one scatterer that is bright enough, with the power that it leaves in each."""
    explained = search.fit(pixels, elevation)[0]
    left = np.trace(pixels, axis1=1, axis2=2).real - explained
    rules = HeightSettings(misfit_fraction=misfit)
    usable = is_explained(Fit(explained, left, (beams.count - 1) * count - 0.5, beams.count), rules)
    first, last = beams.span
    usable &= (explained - count >= settings.min_energy) & (elevation >= first) & (elevation <= last)
    return usable, left


def _derivatives(seen: Beams, bends: list[Beams], elevation: F64, squint: F64) -> C128:
    """Derivatives of the channels' amplitudes by the parameters, shape (pixels, channels, parameters)."""
    own = seen.response(elevation, squint)[..., None] * np.eye(seen.count)
    narrow, wide = (seen.widened(1 + sign * DIFFERENCE).response(elevation, squint) for sign in (-1, 1))
    wider = (wide - narrow)[..., None] / (2 * DIFFERENCE)
    bent = np.stack([bend.response(elevation, squint) for bend in bends], axis=-1)
    return np.concatenate([bent, wider, own, 1j * own], axis=-1)


def _normal(
    seen: Beams, basis: C128, elevation: F64, squint: F64, pixels: Covariance, count: F64
) -> tuple[F64, F64, F64]:
    """Score, information and variance of the score, as `beam_calibration.with_unknown_angles` has them."""
    curve = curve_of(seen, np.ones(seen.count), elevation, squint)
    norm = np.linalg.norm(seen.response(elevation, squint), axis=-1)
    output = np.einsum("pmn,pn->pm", pixels, curve.unit)
    explained = np.einsum("pm,pm->p", curve.unit.conj(), output).real
    change = basis / norm[:, None, None]
    change = change - np.einsum("pm,pmk->pk", curve.unit.conj(), change)[:, None] * curve.unit[..., None]
    change = change - np.einsum("pm,pmk->pk", curve.tangent.conj(), change).real[:, None] * curve.tangent[..., None]
    score = np.einsum("pm,pmk->k", (2 * output + curve.curvature / 2).conj(), change, optimize=True).real
    information, variance = (
        2 * np.einsum("p,pmk,pml->kl", weight, change.conj(), change, optimize=True).real
        for weight in (explained - count, explained)
    )
    return score, information, variance
