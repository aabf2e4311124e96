"""Autofocus: the phase error that all detectors share, estimated from all of them together and removed from all alike.

An error of path length common to the detectors - atmosphere, vibration, navigation - turns the phase of a whole pulse.
Each detector and range cell tells what that pulse's phase did, so the maximum-likelihood phase-gradient kernel
(Wahl, Eichel, Ghiglia & Jakowatz, IEEE Trans. AES 30, 1994; Jakowatz & Wahl, JOSA A 10, 1993)

    phase(t+1) - phase(t) = arg of the sum over detectors and range cells of conj(g(t)) g(t+1)

adds over both. What g is depends on the scene:

* Speckle in a beam so narrow that neighbouring pulses see almost the same (lidar): g is the response at the beam's
  middle, with nothing windowed, and errors of any size can be followed. `phase_linking` then uses all pairs of pulses.
* Bright targets in a wide scene (radar): g is the response around each target, centred and windowed in azimuth, in
  iterations with shrinking windows.

All of it needs only the responses of pulses at points, so it holds for any trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import finufft
import numpy as np
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging.autofocus.phase_error import detrended, without_shift
from sal_height.imaging.autofocus.phase_linking import beam_coherence, covariances, link_phases, signal_modes
from sal_height.imaging.pixels import azimuth_resolution
from sal_height.numeric import C128, F64
from sal_height.sensor import NUFFT_TOLERANCE, PhaseHistory, Sensor

TRUSTED_ERROR = 0.5
"""Greatest standard error of a phase that is applied, rad: it leaves exp(-0.5^2) = 0.8 of a point's peak power."""

SHARPNESS_LOSS = 0.1
"""Greatest relative loss of sharpness by a correction: errors of 0.2 rad lose 0.04, the rest allows for speckle."""

BRIGHT_TARGET = 10**1.5
"""Power of a target over the median of the picture: 15 dB, which the brightest of 10^5 speckles does not reach."""

WINDOW_SHRINKS = 0.85
"""Ratio of the azimuth windows of successive iterations."""

NARROWEST_WINDOW = 5
"""Width of the last azimuth window, cells: a focused target and its first sidelobes."""

TARGET_ITERATIONS = 30
"""Maximum number of iterations of a round on targets."""

TARGET_ROUNDS = 5
"""Maximum number of rounds on targets, each from the widest window to the narrowest."""

TARGET_CHANGE = 0.05
"""Rms change of the phase (rad) below which the iterations of a round end, and the rounds."""


MOST_RESPONSES = 2**25
"""Greatest number of responses (detectors x points x pulses): 0.5 GB, of which four copies are held at a time."""

MOST_LINKED_PULSES = 1024
"""Greatest number of pulses whose phases are linked: their matrices take 0.3 GB and 6 s, growing with its third power.
"""


@dataclass(frozen=True)
class Focus:
    """A phase error that autofocus has estimated.

    Attributes:
        phase: estimated error, rad, shape (pulses,); 0 where there is nothing to focus on.
        method: "speckle", "targets", or "none" where there is nothing to focus on.
        standard_error: rms over the pulses that the estimate's own statistics predict, rad; infinite if "none".
        sharpness_gain: sum of squared powers in the picture after correction over that before.
        iterations: number of them.
        last_change: rms change of the phase in the last iteration, or in the last round on targets, rad.
    """

    phase: F64
    method: str
    standard_error: float
    sharpness_gain: float
    iterations: int
    last_change: float

    @property
    def trusted(self) -> bool:
        """Whether the phase should be applied: known to TRUSTED_ERROR, and the picture does not lose by it."""
        return self.standard_error <= TRUSTED_ERROR and self.sharpness_gain >= 1 - SHARPNESS_LOSS


def autofocus(history: PhaseHistory, antenna: F64, sensor: Sensor, patches: F64) -> Focus:
    """Estimate the phase error of a dwell; ask the result whether it is to be trusted.

    The band is used without a window: it has more independent range cells so, and sidelobes share the phase error.

    Args:
        history: of all detectors in a spotlight dwell.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength, frequencies, beams and noise power.
        patches: points (m) at whose azimuths the scene is looked at, shape (rows, patches, 3) (`patch_centres`).

    Raises:
        UserError: a stripmap sensor, or a dwell that is too large.
    """
    if sensor.mode != "spotlight":
        raise UserError(f"The sensor's mode is {sensor.mode}; autofocus needs spotlight, one aperture for all pixels.")
    if (count := sensor.detector_count * patches[..., 0].size * sensor.pulse_count) > MOST_RESPONSES:
        raise UserError(
            f"Autofocus would hold {count} responses of pulses at points of the image; at most {MOST_RESPONSES} are "
            "allowed, so set autofocus to false or form a smaller image."
        )
    if sensor.pulse_count > MOST_LINKED_PULSES and _links_phases(sensor, antenna):
        raise UserError(
            f"The dwell has {sensor.pulse_count} pulses, autofocus links the phases of at most {MOST_LINKED_PULSES} "
            "pulses of speckle; set autofocus to false or send shorter dwells."
        )
    responses = pulse_responses(history, antenna, sensor, np.ones(sensor.sample_count), patches.reshape(-1, 3))
    half = patch_half_width(sensor)
    focus = _nothing(sensor.pulse_count)
    if _links_phases(sensor, antenna):
        middle = len(patches) // 2, patches.shape[1] // 2
        lit = responses.reshape(len(responses), *patches.shape[:2], -1)[:, :, middle[1]]
        white = np.einsum("mn,npt->mpt", np.linalg.inv(np.linalg.cholesky(sensor.noise_covariance)), lit)
        noise = np.full(len(lit), sensor.sample_count)
        focus = focus_speckle(white, noise, beam_coherence(sensor, antenna, patches[middle]))
    if focus.standard_error > TRUSTED_ERROR:
        focus = focus_targets(responses, half)
    phase = without_shift(focus.phase)
    corrected = _turned(responses, phase)
    return replace(
        focus,
        phase=phase,
        sharpness_gain=_sharpness(corrected, half) / _sharpness(responses, half),
    )


def apply_phase(history: PhaseHistory, phase: F64) -> PhaseHistory:
    """The history with exp(-j phase) on every pulse, the same for every detector and frequency.

    Args:
        history: of all detectors.
        phase: rad, shape (pulses,).
    """
    turn = np.exp(-1j * phase).astype(np.complex64)
    return replace(history, samples=history.samples * turn[:, None])


def pulse_responses(history: PhaseHistory, antenna: F64, sensor: Sensor, weights: F64, points: F64) -> C128:
    """What each pulse contributes to points: backprojection without the sum over pulses.

    response(p, t) = sum over frequencies of w(f) samples(t, f) exp(+j 4 pi f (|p - antenna| - reference) / c)

    Args:
        history: of all detectors in a dwell.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: wavelength and frequencies.
        weights: range window w of mean 1, shape (frequencies,).
        points: m, shape (points, 3).

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


def phase_gradient(responses: C128) -> F64:
    """Phase error by the maximum-likelihood kernel of neighbouring pulses, integrated from 0, rad, shape (pulses,).

    Args:
        responses: of detectors and range cells, shape (..., pulses).
    """
    steps = np.angle(_neighbour_products(responses))
    return np.concatenate([[0.0], np.cumsum(steps)])


def focus_speckle(responses: C128, noise_power: F64, coherence: C128) -> Focus:
    """Phase error from all that the beam lights: gradient of neighbours, then all pairs of pulses.

    Args:
        responses: at the beam's middle in every range cell, shape (detectors, rows, pulses).
        noise_power: of each detector's responses, shape (detectors,).
        coherence: that speckle in the beam would have, shape (pulses, pulses).
    """
    modes, snr = signal_modes(responses, noise_power)
    if not len(modes):
        return _nothing(responses.shape[-1])
    linked = link_phases(covariances(modes, snr), coherence, phase_gradient(modes))
    return Focus(linked.phase, "speckle", linked.standard_error, np.nan, linked.iterations, linked.last_change)


def focus_targets(responses: C128, half_width: int) -> Focus:
    """Phase error from bright targets: phase-gradient autofocus on the pictures around points.

    In rounds, each from wide to narrow windows, until one finds nothing new: a blur that is wider than the pictures
    takes several. What the last round still found counts as error.

    Args:
        responses: shape (detectors, points, pulses).
        half_width: azimuth cells to each side of a point that its picture shows.
    """
    phase, change, error, iterations, rounds = np.zeros(responses.shape[-1]), np.inf, np.inf, 0, 0
    while change > TARGET_CHANGE and rounds < TARGET_ROUNDS:
        found, error, count = _round(_turned(responses, phase), half_width)
        if not count:
            return _nothing(len(phase))
        phase += found
        change, iterations, rounds = _rms(detrended(np.unwrap(found))), iterations + count, rounds + 1
    return Focus(phase, "targets", float(np.hypot(error, change)), np.nan, iterations, change)


def _round(responses: C128, half_width: int) -> tuple[F64, float, int]:
    """Phase error, its standard error, rad, and the number of iterations; that is 0 where there is no target.

    Each iteration looks at the present picture of every point, an FFT over its pulses, within `half_width` cells,
    takes those whose brightest cell is a target, moves that to the middle, and windows it in azimuth. While the window
    shrinks, the gradient follows what the window holds; in the narrowest, each pulse is held against all others, so
    that phases are seen which change from pulse to pulse.
    """
    phase, change, error, iteration = np.zeros(responses.shape[-1]), np.inf, np.inf, 0
    width = float(2 * half_width + 1)
    while change > TARGET_CHANGE and iteration < TARGET_ITERATIONS:
        targets = _centred_targets(_turned(responses, phase), half_width)
        if not targets.shape[1]:
            return phase, np.inf, 0
        if width > NARROWEST_WINDOW:
            step = detrended(phase_gradient(_windowed(targets, width)))
            width = max(width * WINDOW_SHRINKS, NARROWEST_WINDOW)
        else:
            against_others, error = _against_others(targets)
            step = detrended(against_others)
            change = _rms(step)
        phase += step
        iteration += 1
    return phase, error, iteration


def patch_half_width(sensor: Sensor) -> int:
    """Azimuth cells to each side of a point within which a target stays in the point's range cell: carrier / bandwidth.

    At most as many as the pulses can tell apart.
    """
    return min(int(speed_of_light / (sensor.wavelength * sensor.bandwidth)), (sensor.pulse_count - 1) // 2)


def patch_centres(sensor: Sensor, aperture: ApertureState, grid: Grid) -> F64:
    """Points for `autofocus`: a row of patches for every range cell of an image, side by side across its columns.

    Args:
        sensor: wavelength and bandwidth.
        aperture: state of the platform.
        grid: the image.

    Returns:
        m, shape (rows, patches, 3).
    """
    sight = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2) - aperture.position
    slant_range = float(np.linalg.norm(sight))
    row_step = sensor.range_resolution / abs(float(grid.row_direction @ sight) / slant_range)
    width = 2 * patch_half_width(sensor) * azimuth_resolution(sensor, aperture, slant_range)
    rows = _spread(grid.rows, max(1, round(grid.rows * grid.row_spacing / row_step)))
    patches = _spread(grid.cols, int(np.ceil(grid.cols * grid.col_spacing / width)))
    return grid.points(rows[:, None], patches)


def _spread(pixels: int, count: int) -> F64:
    """Middles of `count` equal parts of a row of pixels, as fractional indices."""
    return (np.arange(count) + 0.5) * pixels / count - 0.5


def _links_phases(sensor: Sensor, antenna: F64) -> bool:
    """Whether all that the beam lights stays in its range cell during the dwell, and the noise is known."""
    half_beam = 2 * np.linalg.norm(antenna[-1] - antenna[0]) * sensor.beams.track_beamwidth / sensor.wavelength
    return bool(half_beam <= patch_half_width(sensor)) and min(sensor.noise_power) > 0


def _nothing(pulses: int) -> Focus:
    return Focus(np.zeros(pulses), "none", np.inf, 1.0, 0, 0.0)


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _turned(responses: C128, phase: F64) -> C128:
    return responses * np.exp(-1j * phase)


def _neighbour_products(responses: C128) -> C128:
    """Sum over all but the pulses of conj(g(t)) g(t+1), shape (pulses - 1,)."""
    flat = responses.reshape(-1, responses.shape[-1])
    return np.einsum("gt,gt->t", flat[:, :-1].conj(), flat[:, 1:])


def _picture(responses: C128, half_width: int) -> F64:
    """Power of the azimuth cells around points, summed over the detectors, shape (points, 2 half_width + 1)."""
    power = np.sum(np.abs(np.fft.fft(responses)) ** 2, axis=0)
    return np.roll(power, half_width, axis=-1)[:, : 2 * half_width + 1]


def _sharpness(responses: C128, half_width: int) -> float:
    """Sum of squared powers over the square of their sum; 1 for nothing at all."""
    picture = _picture(responses, half_width)
    if not np.any(picture):
        return 1.0
    return float(np.sum(picture**2) / np.sum(picture) ** 2)


def _centred_targets(responses: C128, half_width: int) -> C128:
    """Responses of the points whose picture holds a bright target, which a linear phase moves to the middle."""
    picture = _picture(responses, half_width)
    bright = picture.max(axis=-1) > BRIGHT_TARGET * np.median(picture)
    cell = picture[bright].argmax(axis=-1) - half_width
    pulses = responses.shape[-1]
    return responses[:, bright] * np.exp(-2j * np.pi / pulses * cell[:, None] * np.arange(pulses))


def _windowed(responses: C128, width: float) -> C128:
    """Responses of what lies within `width` azimuth cells around the middle."""
    pulses = responses.shape[-1]
    near = np.abs(np.fft.fftfreq(pulses, 1 / pulses)) <= width / 2
    return np.fft.ifft(np.fft.fft(responses) * near)


def _against_others(targets: C128) -> tuple[F64, float]:
    """Phase of each pulse against what the others say of the targets, and its standard error (rms), rad.

    The others' say is the response in the narrowest window less the pulse's own share in it. The products with it
    scatter from target to target; that of their imaginary parts, over the sum of their real parts, is the error.
    """
    pulses = targets.shape[-1]
    own_share = (2 * (NARROWEST_WINDOW // 2) + 1) / pulses
    others = _windowed(targets, NARROWEST_WINDOW) - own_share * targets
    product = np.einsum("mpt,mpt->pt", others.conj(), targets)
    total = product.sum(axis=0)
    phase = np.angle(total)
    across = (product * np.exp(-1j * phase)).imag
    return phase, _rms(np.sqrt(np.sum(across**2, axis=0)) / np.abs(total))
