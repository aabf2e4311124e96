"""Phase linking: the maximum-likelihood phase of every pulse from a scene of speckle, by pairs of pulses.

The lit scene is narrower than the pulses' unambiguous azimuths, so its echo changes little from pulse to pulse: with a
fraction p(a) of its power from the azimuth a, whose waves are w(a), pulses have the covariance
R = snr sum over a of p(a) w(a) w(a)^H + 1. Any further difference is the phase error. With g = exp(j phase) *
speckle of covariance R, summed over channels and range cells,

    log likelihood = -sum over t, s of exp(j (phase_t - phase_s)) conj(g_t) R^-1(t, s) g_s

(Guarnieri & Tebaldini, IEEE Trans. GRS 46, 2008; for a single target in the middle it is the eigenvector method of
Jakowatz & Wahl, JOSA A 10, 1993). The phase gradient of neighbours is the start, and Fisher scoring leads to the
maximum; the Fisher information 2 (R o R^-1 - 1) per response gives its error. An antenna that has moved by its own
length sees other speckle, so R and the information are bands, and so is R^-1 but for the rest after many lengths:
pulses farther apart than `Coherence.lags` are not compared. Points that outshine the ground, and movers, are left out
(`which_fit`). The profile p(a) is at first that of the beam; then it is fitted to the responses,
and the phases are linked again, because the sidelobes, a beam that is round and not a product, and ground of uneven
brightness spread the echo otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.linalg
from numpy.lib.stride_tricks import sliding_window_view

from sal_height.imaging.autofocus._kernels import fill_blocks, find_eigenvectors, score_shifts, subtract_products
from sal_height.imaging.autofocus.coherence import Coherence, periodograms
from sal_height.imaging.autofocus.phase_error import PhaseInformation, phase_gradient
from sal_height.numeric import C128, F32, F64, Bool, Complex

MAIN_LOBE = 0.03  # least power of the beam over its greatest where the spectrum is evaluated
ORDERS = np.arange(1, 7)  # of the polynomials

LIKE_ROWS = 5  # range cells over which channels are correlated: terrain takes more to cross a beam


def uneven_trend(modes: Complex, snr: F64, coherence: Coherence) -> float:
    """Standard deviation of the trend from pulse to pulse by uneven ground, rad.

    Args:
        modes: responses without the phases of the pulses, in the middle of the beam, shape (responses, pulses), in the
            order of their range cells.
        snr: signal-to-noise ratio of each response, shape (responses,).
        coherence: coherence of the echo of even ground.
    """
    found, spectrum = periodograms(modes), coherence.spectrum
    scores, slopes = np.empty(len(snr)), np.zeros(len(spectrum))
    information = score_shifts(found, snr, spectrum, np.gradient(np.log(spectrum)), scores, slopes)
    # Uneven in some: by the shift of the beam by each (Huber's sandwich; periodograms are independent, Whittle 1953).
    blocks = 12  # of neighbouring range cells, each of which is assumed to be uneven in its own way
    by_blocks = np.sqrt(np.sum(np.bincount(np.arange(len(snr)) * blocks // len(snr), scores, blocks) ** 2))
    # Uneven in all alike: by the shift by ground that grows brighter along the flight.
    lobe = np.flatnonzero(coherence.profile >= MAIN_LOBE * coherence.profile.max())
    u = np.interp(np.arange(len(coherence.profile)), lobe[[0, -1]], [-1.0, 1.0])
    by_all = _brighter_by(found[:, lobe], snr, spectrum[lobe], u[lobe]) * (slopes @ u)
    return float(np.hypot(by_blocks, by_all) / information * 2 * np.pi / len(u))


def _brighter_by(found: F32, snr: F64, spectrum: F64, u: F64) -> float:
    """Standard deviation of c_1, by the higher orders."""
    # Responses far above noise count alike.
    weight = 1 / (1 + snr)
    brightness = (weight @ found - weight.sum()) / ((weight @ snr) * spectrum)
    shapes, by_power = np.polynomial.legendre.legvander(u, ORDERS[-1]), np.sqrt(spectrum)
    logarithm = np.log(np.maximum(brightness, 0.01))  # a spectrum does not show darker ground
    of_orders = np.linalg.lstsq(shapes * by_power[:, None], logarithm * by_power)[0][1:]
    of_step = (1 / (2 * ORDERS - 1) + 1 / (2 * ORDERS + 3)) / 4
    return float(np.sqrt(of_step[0] * np.mean(of_orders[1:] ** 2 / of_step[1:])))


@dataclass(frozen=True, eq=False)
class Speckle:
    """Responses of about the same signal-to-noise ratio.

    Attributes:
        members: the responses g, noise of power 1, shape (responses, pulses).
        total: sum over the responses of conj(g_t) g_s, shape (pulses, pulses).
        snr: power of the echo in a pulse, as is usual in the class.
    """

    members: Complex
    total: Complex
    snr: float


def signal_modes(responses: Complex, noise_covariance: F64 | C128) -> tuple[Complex, F64]:
    """Combinations of the channels that contain more than noise.

    A common phase leaves the covariance between the channels of LIKE_ROWS range cells as it is. Where noise is white,
    its eigenvectors whose values exceed those of noise alone (Marchenko & Pastur: (1 + sqrt(channels / samples))^2),
    and 0.1 of the strongest, are the channels' beams towards the scatterers there; the rest is left out, and so are the
    last cells if they are fewer.

    Args:
        responses: responses of the channels, shape (channels, cells, pulses).
        noise_covariance: noise covariance of the channels, shape (channels, channels).

    Returns:
        The combinations, noise of power 1, shape (modes, pulses), and the signal-to-noise ratio of each, (modes,).
    """
    channels, cells, pulses = responses.shape
    like, samples = min(LIKE_ROWS, cells), min(LIKE_ROWS, cells) * pulses
    blocks = np.empty((cells // like, channels, pulses, like), responses.dtype)
    fill_blocks(np.ascontiguousarray(responses.swapaxes(1, 2)), blocks)  # they lie so, pulse by pulse
    alike = blocks.reshape(-1, channels, samples)
    whitening = np.linalg.inv(np.linalg.cholesky(noise_covariance)).astype(responses.dtype)
    covariance = whitening @ (alike @ alike.conj().swapaxes(1, 2) / samples) @ whitening.conj().T
    values = np.linalg.eigvalsh(covariance)
    snr = values - 1
    noise_edge = (1 + np.sqrt(channels / samples)) ** 2
    # The margin is for few samples: a few hundred of noise exceed 1.1 times the edge in 1 % of the cells.
    seen = (values > 1.1 * noise_edge) & (snr >= 0.1 * snr[:, -1:])
    vectors = np.empty((np.count_nonzero(seen), channels), np.complex128)
    find_eigenvectors(covariance, np.nonzero(seen)[0], values[seen].astype(np.float64), vectors)
    strongest = seen[:, channels - seen.sum(axis=1).max(initial=0) :]  # values ascend
    weights = np.zeros((*strongest.shape, channels), responses.dtype)
    weights[strongest] = vectors.conj()
    combined = (weights @ whitening @ alike)[strongest]
    return combined.reshape(-1, pulses, like).swapaxes(1, 2).reshape(-1, pulses), np.repeat(snr[seen], like)


def speckle_classes(modes: Complex, snr: F64) -> list[Speckle]:
    """The modes in classes of signal-to-noise ratio.

    Classes are those of any responses, so that the inverses of their covariances serve others as well.
    """
    ratio = 2.0  # greatest to least signal-to-noise ratio of responses with one covariance
    steps, classes = np.floor(np.log(snr) / np.log(ratio)), []
    for step in np.unique(steps):
        members = modes[steps == step]
        classes.append(Speckle(members, members.conj().T @ members, float(ratio ** (step + 0.5))))
    return classes


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Logarithm of the likelihood of phases: sum over t, s of turn_t weighted(t, s) conj(turn_s), turn = exp(j phase).

    Attributes:
        weighted: Hermitian matrix of the sum, between pulses that are compared (`Coherence.inverse_band`).
        information: Fisher information on the phases.
    """

    weighted: C128
    information: PhaseInformation

    @classmethod
    def of(cls, classes: list[Speckle], coherence: Coherence) -> Self:
        """The likelihood for responses (`speckle_classes`) whose echo has this coherence between every two pulses."""
        information = sum(len(speckle.members) * coherence.information(speckle.snr) for speckle in classes)
        return cls(_weighted(classes, coherence), PhaseInformation.of(np.asarray(information)))

    def slope(self, phase: F64) -> F64:
        """Derivative by each phase, rad^-1."""
        turn = np.exp(1j * phase)
        seen = scipy.linalg.blas.zhbmv(len(self.weighted) - 1, 1.0, self.weighted, turn.conj(), lower=1)
        return np.asarray(-2 * (turn * seen).imag)

    def by_lags(self, phase: F64) -> C128:
        """Sums of turn_t weighted(t, s) conj(turn_s) over the pairs with the same lag t - s, from 0 on."""
        lags, pulses = len(self.weighted) - 1, len(phase)
        turn = np.exp(1j * phase)
        later = sliding_window_view(np.pad(turn, (0, lags)), pulses)
        return np.asarray(np.einsum("ds,ds,s->d", self.weighted, later, turn.conj()))


def _weighted(classes: list[Speckle], coherence: Coherence) -> C128:
    """Products of responses that measure the phase differences of compared pulses, shape (lags + 1, pulses)."""
    found = np.zeros((coherence.lags + 1, len(coherence.column)), np.complex128, order="F")
    for speckle in classes:
        subtract_products(coherence.inverse_band(speckle.snr).T, speckle.total, found.T)
    return found


def link_phases(likelihood: Likelihood, start: F64) -> F64:
    """Phases of maximum likelihood by Fisher scoring, rad; their mean and linear trend are those of the start.

    Args:
        likelihood: likelihood of the phases, without information on mean and linear trend, so that steps have neither.
        start: first estimate, rad, shape (pulses,).
    """
    phase = start.copy()
    longest_step = 1.0  # rad: far from the maximum the likelihood is no parabola
    for _ in range(50):
        step = likelihood.information.solve(likelihood.slope(phase))
        step *= longest_step / max(np.abs(step).max(), longest_step)
        phase += step
        if np.sqrt(np.mean(step**2)) < 1e-2:
            break
    return phase


def which_fit(modes: Complex, snr: F64, coherence: Coherence) -> Bool:
    """Mask of responses that can be of ground in the beam, shape (responses,); others are of points or movers.

    A point that outshines the ground is more likely in the beam with phases that keep it in the middle, out of focus.
    The phase gradient of the others, with equal weights, is accurate enough: the periodogram of a
    response over that of the ground is then, on average, about one, and more where the beam is not as stated; that of
    an echo from outside the beam, where a moving car appears, is more by its signal-to-noise ratio.

    Args:
        modes: responses, shape (responses, pulses).
        snr: signal-to-noise ratio of each response, shape (responses,).
        coherence: coherence of the echo of even ground.
    """
    if not len(modes):
        return np.zeros(0, dtype=np.bool_)
    ground = snr <= 8.0 * np.median(snr)  # others are of points
    alike = modes[ground] / np.sqrt(snr[ground])[:, None]
    level = modes * np.exp(-1j * phase_gradient(alike)).astype(modes.dtype)
    misfit = np.mean(periodograms(level) / (1 + np.outer(snr, coherence.spectrum)), axis=-1)
    return np.asarray(ground & (misfit <= 5.0 * np.median(misfit)))  # that of ground stays below 4, others move


def find_trend(
    modes: Complex, snr: F64, coherence: Coherence, likelihood: Likelihood, phase: F64
) -> tuple[float, float]:
    """Residual linear phase per pulse (Doppler centroid offset), and its standard error, rad.

    The likelihood of `phase` and a trend s, s t: a sum over the lags d between pulses of exp(-j s d) times the
    products of the responses. Its error is that by ground of uneven brightness (`uneven_trend`), which moves the
    maximum more than speckle does.

    Args:
        modes: responses, shape (responses, pulses), in the order of their range cells.
        snr: signal-to-noise ratio of each response, shape (responses,).
        coherence: coherence of the echo of even ground (`beam_coherence`).
        likelihood: likelihood of the phases of these responses by that coherence.
        phase: phase of the pulses without the trend, rad, shape (pulses,).
    """
    pulses = modes.shape[-1]
    by_lags = likelihood.by_lags(phase)
    lag = np.arange(len(by_lags))
    trends = 16 * pulses  # at which the likelihood is evaluated
    likeliest = int(np.argmax(np.fft.hfft(by_lags.conj(), trends)))
    trend = float(2 * np.pi * np.fft.fftfreq(trends)[likeliest])
    for _ in range(2):  # Newton: the grid is within a hundredth of the beam
        turned = by_lags * np.exp(1j * trend * lag)
        trend -= float(np.sum(lag * turned.imag) / np.sum(lag**2 * turned.real))
    level = modes * np.exp(-1j * (phase + trend * np.arange(pulses))).astype(modes.dtype)
    return trend, uneven_trend(level, snr, coherence)


def with_fitted_profile(coherence: Coherence, classes: list[Speckle], phase: F64) -> Coherence:
    """The coherence of a profile of greater likelihood, the phases (rad, shape (pulses,)) given.

    One step p <- p (w^H R^-1 S R^-1 w) / (n w^H R^-1 w) towards the maximum, its fixed point: S is the sum over n
    responses, and the classes add to numerator and denominator by their signal-to-noise ratio. More steps fit noise.
    """
    turn = np.exp(-1j * phase).astype(np.complex64)
    found, expected = np.zeros((2, len(coherence.profile)))
    for speckle in classes:
        filters, gain = coherence.filters(speckle.snr)
        seen = (speckle.members * turn) @ filters
        found += speckle.snr * np.sum(seen.real**2 + seen.imag**2, axis=0)
        expected += speckle.snr * len(speckle.members) * gain
    return Coherence(coherence.waves, coherence.profile * found / expected)
