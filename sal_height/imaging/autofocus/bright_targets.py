"""Autofocus on bright targets: phase-gradient autofocus of a wide scene, with its error by comparing two halves of it.

The response around each target is centred and windowed in azimuth, in iterations with shrinking windows (Wahl, Eichel,
Ghiglia & Jakowatz, IEEE Trans. AES 30, 1994). Targets are weighted by the power outside of their windows: noise, and
structure that is no point's. Without that, iterations end at phases which make one point of the few scatterers of the
brightest target, and double images of others.

The iterations start again from their result, with targets at the positions by navigation, as long as the pictures of
all range cells, bright or not, get sharper. From there each of two halves of the range cells is focused by itself:
their difference is the error, including that by the structure of targets.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from sal_height.imaging.autofocus.phase_error import detrended, phase_gradient, without_shift
from sal_height.numeric import F64, Bool, Complex

NARROWEST_WINDOW = 5  # width of the last azimuth window, cells: a focused target and its first sidelobes
ITERATIONS = 30  # maximum number of iterations of a round
CHANGE = 0.05  # rms change of the phase (rad) below which the iterations of a round end, and the rounds
LIKE_ROWS = 8  # neighbouring range cells of one half, so that a target with its first sidelobes is seldom in both


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
    power = np.sum(np.abs(scipy.fft.fft(responses)) ** 2, axis=0)
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
