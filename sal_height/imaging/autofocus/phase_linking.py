"""Phase linking: the maximum-likelihood phase of every pulse from a scene of speckle, all pairs of pulses together.

The scene that the beam lights is narrower than what the pulses could tell apart, so its echo changes little from pulse
to pulse, in a way that the beam's pattern determines: pulses t and s have the known coherence Gamma(t, s). What they
differ in besides is the phase error. With g = exp(j phase) * speckle of covariance snr Gamma + 1, summed over detectors
and range cells,

    log likelihood = -sum over t, s of exp(j (phase_t - phase_s)) conj(g_t) (snr Gamma + 1)^-1 (t, s) g_s

(Guarnieri & Tebaldini, IEEE Trans. GRS 46, 2008; for a single target in the middle, Gamma = 1, it is the eigenvector
method of Jakowatz & Wahl, JOSA A 10, 1993). The phase gradient of neighbours is the start, and Fisher scoring leads to
the maximum; the Fisher information 2 (Gamma' o Gamma'^-1 - 1) per range cell also tells how well it is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from sal_height.numeric import C128, F64
from sal_height.sensor import Sensor

LIT_BEAMWIDTHS = 1.0
"""Extent of the lit scene to each side of the beam's middle, in beamwidths.

The simulated spotlight scene has it, too (`simulation.flight.SCENE_BEAMWIDTHS`). The main lobe of a circular aperture
reaches 1.22; on a scene that wide, this model leaves 0.11 rad rms at 20 dB, and one of the same width 0.10 rad.
"""

WEAKEST_MODE = 0.1
"""Least share of the strongest mode's signal-to-noise ratio in a range cell: weaker ones, what the others leave of a
beam that is round and not a product, are not spread in azimuth like the beam."""

LIKE_ROWS = 5
"""Range cells over which the covariance between detectors is averaged: terrain takes more to cross a beam."""

NOISE_MARGIN = 1.1
"""Factor on the greatest eigenvalue of noise, which holds for many samples: for a few hundred, noise exceeds it so in
less than a hundredth of the range cells."""

CLASS_RATIO = 2.0
"""Ratio of the greatest to the least signal-to-noise ratio of responses that share one covariance."""

ITERATIONS = 50
"""Maximum number of steps of Fisher scoring."""

CONVERGED = 1e-4
"""Rms change of the phases (rad) below which Fisher scoring has converged."""

LONGEST_STEP = 1.0
"""Greatest change of a phase in one iteration, rad: far from the maximum the likelihood is not a parabola."""


@dataclass(frozen=True)
class Covariance:
    """Sample covariance of responses of about the same signal-to-noise ratio.

    Attributes:
        total: sum over the responses of g_t conj(g_s), noise of power 1, shape (pulses, pulses).
        snr: mean power of the signal in a pulse.
        count: number of responses.
    """

    total: C128
    snr: float
    count: int


@dataclass(frozen=True)
class LinkedPhases:
    """Result of `link_phases`.

    Attributes:
        phase: rad, shape (pulses,).
        standard_error: rms over the pulses that the Fisher information predicts, mean and linear trend apart, rad.
        iterations: number of them.
        last_change: rms of the last one, rad.
    """

    phase: F64
    standard_error: float
    iterations: int
    last_change: float


def beam_coherence(sensor: Sensor, antenna: F64, centre: F64) -> C128:
    """Coherence of the responses at a point in the middle of the beam, between every two pulses.

    Speckle on a line through `centre` along the flight, weighted with the power pattern of the beam.

    Args:
        sensor: wavelength and beams.
        antenna: position at each pulse, m, shape (pulses, 3).
        centre: the point, m, shape (3,).

    Returns:
        Shape (pulses, pulses), 1 on the diagonal.
    """
    flight = antenna[-1] - antenna[0]
    slant_range = np.linalg.norm(centre - antenna.mean(axis=0))
    cells = 2 * np.linalg.norm(flight) * sensor.beams.track_beamwidth / sensor.wavelength
    offset = np.linspace(-LIT_BEAMWIDTHS, LIT_BEAMWIDTHS, 16 * int(np.ceil(cells)) + 1)
    power = np.abs(sensor.beams.patterns[0].amplitude(np.zeros_like(offset), offset)) ** 2
    along = offset * sensor.beams.track_beamwidth * slant_range
    points = centre + along[:, None] * (flight / np.linalg.norm(flight))
    farther = np.linalg.norm(points - antenna[:, None], axis=-1) - np.linalg.norm(centre - antenna, axis=-1)[:, None]
    waves = np.sqrt(power / power.sum()) * np.exp(-1j * sensor.centre_wavenumber * farther)
    return waves @ waves.conj().T


def signal_modes(responses: C128, noise_power: F64) -> tuple[C128, F64]:
    """Combinations of the detectors that hold more than noise.

    A common phase leaves the covariance between the detectors of a range cell as it is. Its eigenvectors whose values
    exceed those of noise alone (Marchenko & Pastur: (1 + sqrt(detectors / samples))^2), and WEAKEST_MODE, are the
    detectors' beams towards what lies there; the rest is left out.

    Args:
        responses: shape (detectors, points, pulses).
        noise_power: of each detector's responses, greater than 0, shape (detectors,).

    Returns:
        The combinations, noise of power 1, shape (modes, pulses), and the signal-to-noise ratio of each, (modes,).
    """
    detectors, _, pulses = responses.shape
    white = responses / np.sqrt(noise_power)[:, None, None]
    between = uniform_filter1d(np.einsum("mpt,npt->pmn", white, white.conj()) / pulses, LIKE_ROWS, axis=0)
    values, vectors = np.linalg.eigh(between)
    combined = np.einsum("pmk,mpt->pkt", vectors.conj(), white)
    snr = values - 1
    noise_edge = (1 + np.sqrt(detectors / (LIKE_ROWS * pulses))) ** 2
    seen = (values > NOISE_MARGIN * noise_edge) & (snr >= WEAKEST_MODE * snr[:, -1:])
    return combined[seen], snr[seen]


def covariances(modes: C128, snr: F64) -> list[Covariance]:
    """Sample covariances of the modes, in classes of signal-to-noise ratio."""
    steps = np.floor(np.log(snr) / np.log(CLASS_RATIO))
    classes = [steps == step for step in np.unique(steps)]
    return [Covariance(modes[c].T @ modes[c].conj(), float(snr[c].mean()), int(c.sum())) for c in classes]


def link_phases(samples: list[Covariance], coherence: C128, start: F64) -> LinkedPhases:
    """Phases of maximum likelihood by Fisher scoring; their mean and linear trend are those of the start.

    Args:
        samples: covariances of the responses (`covariances`).
        coherence: Gamma (`beam_coherence`).
        start: first estimate, rad, shape (pulses,).
    """
    phase, change, iteration = start.copy(), np.inf, 0
    weighted, information = _weighted(samples, coherence)
    variance = _inverse_without_trend(information)
    while change > CONVERGED and iteration < ITERATIONS:
        turn = np.exp(1j * phase)
        score = 2 * (weighted * turn[:, None] * turn.conj()).imag.sum(axis=0)
        step = variance @ score
        step *= LONGEST_STEP / max(np.abs(step).max(), LONGEST_STEP)
        phase += step
        change, iteration = float(np.sqrt(np.mean(step**2))), iteration + 1
    return LinkedPhases(phase, float(np.sqrt(np.mean(np.diag(variance)))), iteration, change)


def _weighted(samples: list[Covariance], coherence: C128) -> tuple[C128, F64]:
    """Sum over all responses of -conj(g_t) (snr Gamma + 1)^-1 g_s, and their Fisher information."""
    identity = np.eye(len(coherence))
    weighted, information = np.zeros_like(coherence), np.zeros(coherence.shape)
    for sample in samples:
        covariance = sample.snr * coherence + identity
        inverse = np.linalg.inv(covariance)
        weighted -= inverse * sample.total.T
        information += 2 * sample.count * ((covariance * inverse.T).real - identity)
    return weighted, information


def _inverse_without_trend(information: F64) -> F64:
    """Inverse on the phases without mean and linear trend, 0 on those two."""
    pulses = len(information)
    trend = np.stack([np.ones(pulses), np.linspace(-1.0, 1.0, pulses)], axis=1)
    rest = np.linalg.qr(trend, mode="complete")[0][:, 2:]
    return rest @ np.linalg.inv(rest.T @ information @ rest) @ rest.T
