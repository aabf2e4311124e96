"""Autofocus: the common phase error of all detectors, estimated from all of them together and removed from all alike.

An error of path length common to the detectors - atmosphere, vibration, navigation - turns the phase of a whole pulse.
Each detector and range cell measures the phase of that pulse, so the maximum-likelihood phase-gradient kernel
(Wahl, Eichel, Ghiglia & Jakowatz, IEEE Trans. AES 30, 1994; Jakowatz & Wahl, JOSA A 10, 1993)

    phase(t+1) - phase(t) = arg of the sum over detectors and range cells of conj(g(t)) g(t+1)

adds over both. The choice of g depends on the scene:

* Speckle in a beam so narrow that neighbouring pulses see almost the same (lidar): g is the response at the beam's
  middle, with nothing windowed, and errors of any size can be followed. `phase_linking` then compares pulses that are
  farther apart as well.
* Bright targets in a wide scene (radar): g is the response around each target, centred and windowed in azimuth, see
  `focus_targets`.

It needs only the responses of pulses at points, so it is valid for any trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import finufft
import numpy as np
import scipy.fft
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging.autofocus.coherence import Coherence, beam_coherence
from sal_height.imaging.autofocus.phase_error import detrended, is_smooth, phase_gradient, without_shift
from sal_height.imaging.autofocus.phase_linking import (
    Likelihood,
    find_trend,
    link_phases,
    signal_modes,
    speckle_classes,
    which_fit,
    with_fitted_profile,
)
from sal_height.imaging.pixels import azimuth_resolution
from sal_height.numeric import C64, C128, F64, Bool, Complex, outer_phasors
from sal_height.sensor import NUFFT_TOLERANCE, PhaseHistory, Sensor
from sal_height.settings import Settings, setting

NARROWEST_WINDOW = 5  # width of the last azimuth window, cells: a focused target and its first sidelobes
ITERATIONS = 30  # maximum number of iterations of a round
CHANGE = 0.05  # rms change of the phase (rad) below which the iterations of a round end, and the rounds
LIKE_ROWS = 8  # neighbouring range cells of one half, so that a target with its first sidelobes is seldom in both

MOST_RESPONSES = 2**25  # detectors x points x pulses: 0.5 GB, of which there are four copies at a time


def focus_targets(responses: Complex, half_width: int, brightness: float) -> tuple[F64, float]:
    """Phase error from bright targets, rad, shape (pulses,), and its standard error, rad.

    That is infinite where one of the halves has no target.

    Args:
        responses: responses of pulses at points, shape (detectors, rows, patches, pulses).
        half_width: number of azimuth cells to each side of a point in its picture.
        brightness: power of a target over the median of the pictures.
    """
    everything = _at_points(responses)
    phase, sharp = np.zeros(responses.shape[-1]), 0.0
    for _ in range(3):  # attempts, each with all rounds
        found = without_shift(_in_rounds(everything, phase, half_width, brightness))
        reached = sharpness(turned(everything, found), half_width)
        if reached <= sharp * 1.01:  # another attempt would not be worth its time
            break
        phase, sharp = found, reached
    first = _first_half(responses.shape[1])
    parts = everything, _at_points(responses[:, first]), _at_points(responses[:, ~first])
    of_all, one, other = (_refine(turned(part, phase), half_width, brightness) for part in parts)
    if of_all is None or one is None or other is None:
        return np.zeros(len(phase)), np.inf
    return phase + of_all, _rms(np.angle(np.exp(1j * (one - other)))) / 2


def sharpness(responses: Complex, half_width: int) -> float:
    """Mean over points of the sum of squared powers in a point's picture over the square of their sum; 1: no power.

    Args:
        responses: responses of pulses at points, shape (detectors, points, pulses).
        half_width: number of azimuth cells to each side of a point in its picture.
    """
    picture = _picture(responses, half_width)
    total = picture.sum(axis=-1)
    lit = total > 0
    if not np.any(lit):
        return 1.0
    return float(np.mean(np.sum(picture[lit] ** 2, axis=-1) / total[lit] ** 2))


def turned(responses: Complex, phase: F64) -> Complex:
    """Responses, shape (..., pulses), without a phase, rad, shape (pulses,)."""
    return responses * np.exp(-1j * phase).astype(responses.dtype)


def _at_points(responses: Complex) -> Complex:
    """Responses of rows and patches as those of points, shape (detectors, points, pulses)."""
    return responses.reshape(len(responses), -1, responses.shape[-1])


def _first_half(rows: int) -> Bool:
    """Mask of the range cells in the first of two halves: alternate blocks of LIKE_ROWS, of fewer if there are few."""
    block = max(1, min(LIKE_ROWS, rows // 4))
    return np.arange(rows) // block % 2 == 0


def _in_rounds(responses: Complex, start: F64, half_width: int, brightness: float) -> F64:
    """Phase error in rounds, until one finds nothing new: a blur wider than the pictures takes several."""
    phase = start.copy()
    for _ in range(5):  # rounds, each from the widest window to the narrowest
        found = _round(turned(responses, phase), half_width, brightness)
        phase += found
        if _rms(detrended(np.unwrap(found))) <= CHANGE:
            break
    return phase


def _round(responses: Complex, half_width: int, brightness: float) -> F64:
    """Phase error by phase-gradient autofocus, in windows that shrink; then by `_refine`; 0 without a target.

    Each iteration uses the present picture of every point, an FFT over its pulses, within `half_width` cells,
    takes those whose brightest cell is a target, moves that to the middle, and windows it in azimuth.
    """
    phase, width = np.zeros(responses.shape[-1]), 2.0 * half_width + 1
    for _ in range(ITERATIONS):
        if width <= NARROWEST_WINDOW:
            break
        targets = _centred_targets(turned(responses, phase), half_width, brightness)
        if not targets.shape[1]:
            return phase
        within = _windowed(targets, width)
        phase += detrended(phase_gradient(within / _outside(targets, within)))
        width = max(width * 0.85, NARROWEST_WINDOW)
    last = _refine(turned(responses, phase), half_width, brightness)
    return phase if last is None else phase + last


def _refine(responses: Complex, half_width: int, brightness: float) -> F64 | None:
    """Phase error of responses that are nearly in focus: each pulse against all others; None: there is no target.

    The others' estimate of a target is its response in the narrowest window less the pulse's own part in it. So phases
    that change from pulse to pulse are measured.
    """
    pulses = responses.shape[-1]
    own_part = (2 * (NARROWEST_WINDOW // 2) + 1) / pulses
    phase = np.zeros(pulses)
    for _ in range(ITERATIONS):
        targets = _centred_targets(turned(responses, phase), half_width, brightness)
        if not targets.shape[1]:
            return None
        within = _windowed(targets, NARROWEST_WINDOW)
        outside = _outside(targets, within)
        targets, within = targets / outside, within / outside
        others = within - own_part * targets
        step = detrended(np.angle(np.einsum("mpt,mpt->t", others.conj(), targets)))
        phase += step
        if _rms(step) <= CHANGE:
            break
    return phase


def _picture(responses: Complex, half_width: int) -> F64:
    """Power of the azimuth cells around points, summed over the detectors, shape (points, 2 half_width + 1)."""
    spectra = scipy.fft.fft(responses)
    power = np.sum(spectra.real**2 + spectra.imag**2, axis=0)
    return np.roll(power, half_width, axis=-1)[:, : 2 * half_width + 1]


def _centred_targets(responses: Complex, half_width: int, brightness: float) -> Complex:
    """Responses of the points whose picture contains a bright target, which a linear phase moves to the middle."""
    if not responses.shape[1]:
        return responses
    picture = _picture(responses, half_width)
    bright = picture.max(axis=-1) > brightness * np.median(picture)
    pulses = np.arange(responses.shape[-1])
    turn = -2j * np.pi / len(pulses) * pulses
    cell = picture[bright].argmax(axis=-1) - half_width
    targets = responses[:, bright] * np.exp(turn)[cell[:, None] * pulses % len(pulses)]
    within_cell = np.exp(turn[:, None] * (np.arange(-4, 5) / 8))  # positions that are tried for a target's peak
    at_peak = np.sum(np.abs(targets @ within_cell) ** 2, axis=0)
    return targets * within_cell.T[at_peak.argmax(axis=-1)]


def _windowed(responses: Complex, width: float) -> Complex:
    """The part of responses within `width` azimuth cells around the middle."""
    pulses = responses.shape[-1]
    near = np.abs(np.fft.fftfreq(pulses, 1 / pulses)) <= width / 2
    return np.fft.ifft(np.fft.fft(responses) * near)


def _outside(responses: Complex, within: Complex) -> F64:
    """Root mean square of the part of responses outside a window: noise, and structure that is no point's.

    Shape (points, 1): targets are weighted by its inverse.
    """
    outside, power = (np.mean(np.abs(part) ** 2, axis=(0, 2)) for part in (responses - within, responses))
    return np.sqrt(np.maximum(outside, 1e-6 * power))[:, None]  # some power is always assumed outside


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))


class AutofocusSettings(Settings):
    """Criteria for trusting autofocus, and parameters of its estimation."""

    autofocus_max_error_rad: float = setting(
        0.5,
        "greatest standard error of a phase that autofocus applies, in stripmap from one pulse to the next; 0.5 leaves "
        "0.8 of a point's peak power",
        unit="rad",
        minimum=0.0,
        maximum=3.0,
    )
    autofocus_max_blur: float = setting(
        0.1,
        "greatest relative loss of sharpness by a phase that autofocus applies; errors of 0.2 rad lose 0.04",
        minimum=0.0,
        maximum=1.0,
    )
    autofocus_target_db: float = setting(
        15.0,
        "power over the median of the image from which autofocus takes a pixel for a target; 10^5 speckles stay below",
        unit="dB",
        minimum=0.0,
        maximum=100.0,
    )
    autofocus_uneven_beamwidths: float = setting(
        0.005,
        "standard deviation, in beamwidths, by which ground of uneven brightness moves the Doppler centroid and the "
        "spectrum of the echo does not show it",
        minimum=0.0,
        maximum=1.0,
    )
    autofocus_max_pulses: int = setting(
        1024,
        "greatest number of pulses of speckle that autofocus links; memory grows with its square, time with its cube",
        minimum=2,
        maximum=8192,
    )


@dataclass(frozen=True, eq=False)
class Focus:
    """A phase error that autofocus has estimated.

    Attributes:
        phase: estimated error, rad, shape (pulses,); 0 if there is nothing to focus on.
        standard_error: rms over the pulses that the estimate's own statistics predict, rad; infinite if there is
            nothing to focus on.
        trusted: True if the phase should be applied: known well enough, and the image does not lose by it.
        trend: residual linear phase per pulse (Doppler centroid offset), rad.
        trend_error: standard error of the trend, rad; infinite if bright targets are focused, or nothing is.
    """

    phase: F64
    standard_error: float
    trusted: bool = False
    trend: float = 0.0
    trend_error: float = np.inf

    @property
    def finds_beams(self) -> bool:
        """True if the middle of the beams is known along the flight."""
        return self.trusted and bool(np.isfinite(self.trend_error))

    @property
    def is_smooth(self) -> bool:
        """True if the course of the phase is known, and not only modulo 2 pi."""
        return is_smooth(self.phase)


def autofocus(history: PhaseHistory, antenna: F64, sensor: Sensor, patches: F64, settings: AutofocusSettings) -> Focus:
    """Estimate the phase error of a dwell; the result states if it is to be trusted.

    The band is used without a window: it has more independent range cells so, and sidelobes have the same phase error.

    Args:
        history: phase history of all detectors in a spotlight dwell.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength, frequencies, beams and noise power.
        patches: points at whose azimuths the scene is focused, shape (rows, patches, 3) (`patch_centres`), m.
        settings: criteria for trust.

    Raises:
        UserError: a stripmap sensor (see `strip_phase`), or a dwell that is too large.
    """
    if sensor.mode != "spotlight":
        raise UserError(f"The sensor's mode is {sensor.mode}; dwells need spotlight, one aperture for all pixels.")
    if (count := sensor.detector_count * patches[..., 0].size * sensor.pulse_count) > MOST_RESPONSES:
        raise UserError(
            f"Autofocus would keep {count} responses of pulses at points of the image; at most {MOST_RESPONSES} are "
            "allowed, so set autofocus to never or form a smaller image."
        )
    on_speckle = is_for_speckle(sensor, antenna)
    if on_speckle and sensor.pulse_count > settings.autofocus_max_pulses:
        raise UserError(
            f"The dwell has {sensor.pulse_count} pulses, autofocus links the phases of at most "
            f"{settings.autofocus_max_pulses} pulses of speckle (autofocus_max_pulses); raise that, set autofocus to "
            "never, or send shorter dwells."
        )
    half = patch_half_width(sensor)
    focus = Focus(np.zeros(sensor.pulse_count), np.inf)
    if on_speckle:
        cells = cell_responses(history, antenna, sensor, patches.mean(axis=(0, 1)))
        focus, responses = focus_cells(cells, antenna, sensor)
        uneven = hidden_trend(sensor, antenna, settings)
        focus = replace(focus, trend_error=float(np.hypot(focus.trend_error, uneven)))
    if focus.standard_error > settings.autofocus_max_error_rad:
        responses = pulse_responses(history, antenna, sensor, np.ones(sensor.sample_count), patches.reshape(-1, 3))
        of_rows = responses.reshape(len(responses), *patches.shape[:2], -1)
        phase, error = focus_targets(of_rows, half, 10 ** (settings.autofocus_target_db / 10))
        # Positions of targets are known by the trend alone, and the course of a phase that is not smooth has no trend.
        tells_place = np.isfinite(error) and is_smooth(phase)
        focus = Focus(phase, error) if tells_place else Focus(np.zeros(len(phase)), np.inf)
    phase = without_shift(focus.phase)
    sharper = sharpness(turned(responses, phase), half) / sharpness(responses, half)
    known = focus.standard_error <= settings.autofocus_max_error_rad
    return replace(focus, phase=phase, trusted=known and sharper >= 1 - settings.autofocus_max_blur)


def focus_cells(cells: C64, antenna: F64, sensor: Sensor) -> tuple[Focus, Complex]:
    """Phase error from the speckle of range cells, and the responses that it is estimated from, (1, modes, pulses).

    Args:
        cells: responses of the cells at the beam's middle (`cell_responses`), shape (detectors, cells, pulses).
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength, frequencies, beams and noise power.
    """
    modes, snr = signal_modes(cells, sensor.sample_count * sensor.noise_covariance)
    coherence = beam_coherence(sensor, antenna)
    fits = which_fit(modes, snr, coherence)
    return focus_speckle(modes[fits], snr[fits], coherence), modes[None, fits]


def is_for_speckle(sensor: Sensor, antenna: F64) -> bool:
    """True if a dwell is focused on speckle: its noise is known, and all lit ground stays in its range cell.

    Args:
        sensor: wavelength, bandwidth, beams and noise power.
        antenna: position at each pulse, m, shape (pulses, 3).
    """
    half_beam = 2 * np.linalg.norm(antenna[-1] - antenna[0]) * sensor.beams.track_beamwidth / sensor.wavelength
    return bool(half_beam <= patch_half_width(sensor)) and min(sensor.noise_power) > 0


def hidden_trend(sensor: Sensor, antenna: F64, settings: AutofocusSettings) -> float:
    """Standard deviation, rad, of the trend from pulse to pulse by uneven ground that the spectrum does not show."""
    step = float(np.linalg.norm(antenna[-1] - antenna[0])) / (len(antenna) - 1)
    of_a_beam = 4 * np.pi / sensor.wavelength * step * sensor.beams.track_beamwidth
    return settings.autofocus_uneven_beamwidths * of_a_beam


def apply_phase(history: PhaseHistory, phase: F64) -> PhaseHistory:
    """The history with exp(-j phase) on all samples of every pulse; phase in rad, shape (pulses,)."""
    turn = np.exp(-1j * phase).astype(np.complex64)
    of_samples = np.repeat(turn[:, None], history.samples.shape[-1], axis=1)  # products of whole lines are faster
    return replace(history, samples=history.samples * of_samples)


def cell_responses(history: PhaseHistory, antenna: F64, sensor: Sensor, centre: F64) -> C64:
    """Contribution of each pulse to the range cells before and behind a point: `pulse_responses` by an FFT.

    The distance of cells is the same in all pulses, as for echoes that stay in their range cells; a phase that is the
    same in all pulses is left out. Shape (detectors, cells, pulses), in the order of range, all cells of the range
    window.

    Args:
        history: phase history of all detectors in a dwell.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength and frequencies.
        centre: point, m, shape (3,); or one for each pulse, shape (pulses, 3).
    """
    delay = np.linalg.norm(centre - antenna, axis=-1) - history.reference_range
    half = sensor.sample_count // 2
    number = np.arange(sensor.sample_count, dtype=np.float64)
    frequency = np.asarray(sensor.centre_wavenumber + sensor.wavenumber_step * (number - half), np.float64)
    in_order = np.exp(
        -2j * np.pi / sensor.sample_count * half * number
    )  # the nearest cell first, not that of the point
    towards = outer_phasors(delay, frequency) * in_order.astype(np.complex64)
    return scipy.fft.ifft(history.samples * towards, norm="forward", overwrite_x=True).swapaxes(1, 2)


def pulse_responses(history: PhaseHistory, antenna: F64, sensor: Sensor, weights: F64, points: F64) -> C128:
    """Contribution of each pulse to points: backprojection without the sum over pulses.

    response(p, t) = sum over frequencies of w(f) samples(t, f) exp(+j 4 pi f (|p - antenna| - reference) / c)

    Args:
        history: phase history of all detectors in a dwell.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength and frequencies.
        weights: range window w of mean 1, shape (frequencies,).
        points: positions, m, shape (points, 3).

    Returns:
        Shape (detectors, points, pulses); 0 where a point is outside the range window.
    """
    detectors, pulses, _ = history.samples.shape
    responses = np.empty((detectors, len(points), pulses), dtype=np.complex128)
    for pulse, (position, reference) in enumerate(zip(antenna, history.reference_range, strict=True)):
        delay = np.linalg.norm(points - position, axis=-1) - reference
        spectrum = np.ascontiguousarray(history.samples[:, pulse] * weights)
        profile = finufft.nufft1d2(sensor.wavenumber_step * delay, spectrum, isign=1, eps=NUFFT_TOLERANCE, nthreads=1)
        inside = np.abs(delay) <= sensor.range_window / 2
        responses[..., pulse] = profile * (inside * np.exp(1j * sensor.centre_wavenumber * delay))
    return responses


def focus_speckle(modes: Complex, snr: F64, by_beam: Coherence) -> Focus:
    """Phase error from all lit ground: gradient of neighbours, then pulses farther apart, twice.

    Args:
        modes: modes of the channels' responses at the beam's middle in every range cell (`signal_modes`).
        snr: signal-to-noise ratio of each mode.
        by_beam: coherence of even ground (`beam_coherence`).
    """
    if not len(modes):
        return Focus(np.zeros(modes.shape[-1]), np.inf)
    classes = speckle_classes(modes, snr)
    likelihood = Likelihood.of(classes, by_beam)
    phase = link_phases(likelihood, phase_gradient(modes))
    # A fitted profile takes some noise for echo: the phases gain by it, but the error that it predicts is too small.
    fitted = with_fitted_profile(by_beam, classes, phase)
    phase = without_shift(link_phases(Likelihood.of(classes, fitted), phase))
    trend, trend_error = find_trend(modes, snr, by_beam, likelihood, phase)
    return Focus(phase, likelihood.information.variance**0.5, trend=trend, trend_error=trend_error)


def patch_half_width(sensor: Sensor) -> int:
    """Azimuth cells to each side of a point within which a target stays in the point's range cell: carrier / bandwidth.

    At most the number that the pulses can resolve.
    """
    return min(int(speed_of_light / (sensor.wavelength * sensor.bandwidth)), (sensor.pulse_count - 1) // 2)


def patch_centres(sensor: Sensor, aperture: ApertureState, grid: Grid) -> F64:
    """Points for `autofocus`: a row of patches for every range cell of an image, side by side across its columns.

    They are in m, shape (rows, patches, 3).
    """
    sight = grid.middle - aperture.position
    slant_range = float(np.linalg.norm(sight))
    row_step = sensor.range_resolution / abs(float(grid.row_direction @ sight) / slant_range)
    width = 2 * patch_half_width(sensor) * azimuth_resolution(sensor, aperture, slant_range)
    rows = _spread(grid.rows, max(1, round(grid.rows * grid.row_spacing / row_step)))
    patches = _spread(grid.cols, int(np.ceil(grid.cols * grid.col_spacing / width)))
    return grid.points(rows[:, None], patches)


def _spread(pixels: int, count: int) -> F64:
    """Middles of `count` equal parts of a row of pixels, as fractional indices."""
    return (np.arange(count) + 0.5) * pixels / count - 0.5
