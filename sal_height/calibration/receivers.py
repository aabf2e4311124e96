"""What the receiver of each channel does to the band, relative to the others, from images of whatever scene.

All channels see the same scatterers. So their cross-spectra over range, averaged over columns and dwells, differ from
frequency to frequency only by what the receivers do: S(k) = D(k) G D(k)^H + N, with D the diagonal matrix of their
responses, G the covariance of the channels' signals, which the scene and the beams make, and N the noise. Averages of
complex Gaussian signals have a Wishart distribution; Fisher scoring makes its likelihood greatest (Goodman, Ann. Math.
Stat. 34, 1963, has the distribution; Kay, Estimation Theory, 1993, section 15.7, the scores).

A response that all channels share cannot be found in this way; the spectrum of a point target shows it (PSF paper).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.fft

from sal_height.errors import NotDetermined
from sal_height.geometry import ApertureState, Grid, without_range_phase
from sal_height.numeric import C64, C128, F64, WORKERS
from sal_height.sensor import Sensor, with_powers

SPACING_TOLERANCE = 1e-6
"""Relative difference between the spacing of rows and the range resolution that is allowed."""

SIGNIFICANCE = 3.5
"""Echoes of so many standard errors are taken for real; of Gaussian noise, one in exp(3.5^2) = 200 000 is."""

AROUND = 8
"""Lags to each side whose median tells the noise of echoes."""

SCORINGS = 4
"""Steps of Fisher scoring; from responses of 3 dB each reduces the error tenfold."""


@dataclass(frozen=True)
class CrossSpectra:
    """Sums of the cross-spectra between channels, over the columns of images; sums of dwells are added.

    Attributes:
        power: sum of x x^H over columns, x the channels' spectra at a fast-time frequency, scaled to the mean power 1
            in every column, so that none counts more than others: complex128, shape (frequencies, channels, channels).
        noise: the same sum of the noise alone, at any frequency: complex128, shape (channels, channels).
        columns: that were summed; without those that are 0 or not finite.
    """

    power: C128
    noise: C128
    columns: int

    @classmethod
    def none(cls, channels: int, frequencies: int) -> Self:
        """Of no columns."""
        shape = channels, channels
        return cls(np.zeros((frequencies, *shape), np.complex128), np.zeros(shape, np.complex128), 0)

    def __add__(self, other: CrossSpectra) -> CrossSpectra:
        return CrossSpectra(self.power + other.power, self.noise + other.noise, self.columns + other.columns)


@dataclass(frozen=True)
class DifferentialResponse:
    """Responses of the channels' receivers relative to the median of all, and to their own mean over the band.

    Attributes:
        response: at the fast-time frequencies, complex128, shape (channels, frequencies); 1: like the others.
        sigma: standard error of a frequency's response, rms of its two parts together, were all lags kept: of each
            channel, shape (channels,).
    """

    response: C128
    sigma: F64


def unwound(slc: C64, grid: Grid, aperture: ApertureState, sensor: Sensor) -> C64:
    """Images whose spectrum along range is that over the fast-time frequencies, their middle one at 0.

    Args:
        slc: of all channels, unweighted in range, shape (channels, rows, cols).
        grid: pixels; rows a range cell apart.
        aperture: the images were made with.
        sensor: with waveform "spectrum".

    Returns:
        complex64, the rows that lie within the range window.

    Raises:
        NotDetermined: rows are not a range cell apart: the images are weighted or in another plane.
    """
    if abs(grid.row_spacing / sensor.range_resolution - 1) > SPACING_TOLERANCE:
        raise NotDetermined(
            f"Rows are {grid.row_spacing:.6g} m apart and range cells {sensor.range_resolution:.6g} m; receivers are "
            "calibrated on images with range_window rectangular in the slant plane, where both are equal."
        )
    turn = without_range_phase(np.ones(grid.shape, np.complex64), grid, aperture, 4 * np.pi / sensor.centre_wavenumber)
    return slc[:, : sensor.sample_count] * turn[: sensor.sample_count].astype(np.complex64)


def cross_spectra(pixels: C64, sensor: Sensor, noise_powers: F64) -> CrossSpectra:
    """Cross-spectra of the images of a dwell.

    Args:
        pixels: of all channels, as `unwound` makes them, shape (channels, rows, cols).
        sensor: with waveform "spectrum".
        noise_powers: E|n|^2 of a pixel of each channel.
    """
    brightness = sum(np.einsum("crk,crk->k", part, part) for part in (pixels.real, pixels.imag)) / len(pixels)
    lit = np.isfinite(brightness) & (brightness > 0)
    weights = np.zeros(len(brightness), dtype=np.float32)
    np.divide(1, np.sqrt(brightness), out=weights, where=lit)
    even = np.multiply(pixels, weights, out=np.zeros_like(pixels), where=lit)
    spectra = scipy.fft.fft(even, sensor.sample_count, axis=1, workers=WORKERS, overwrite_x=True)
    by_frequency = scipy.fft.fftshift(spectra, axes=1).transpose(1, 0, 2)
    power = by_frequency @ by_frequency.conj().transpose(0, 2, 1)
    noise = with_powers(sensor.noise_covariance, noise_powers) * np.sum(weights.astype(np.float64) ** 2)
    return CrossSpectra(power.astype(np.complex128), noise * pixels.shape[1], int(np.count_nonzero(lit)))


def differential_response(spectra: CrossSpectra) -> DifferentialResponse:
    """The receivers' responses that make these cross-spectra most likely.

    They are sums of echoes: of the Fourier coefficients of their logarithms over the band, those are kept that noise
    and speckle do not make (SIGNIFICANCE): by their standard error, which is that of even power over range, and by
    the others around, as uneven power makes more at some lags.

    Raises:
        NotDetermined: a channel's power is not above its noise, or there are fewer columns than twice the channels.
    """
    count, channels = spectra.power.shape[:2]
    if spectra.columns < 2 * channels:
        raise NotDetermined(
            f"There are {spectra.columns} columns of images; responses of {channels} channels need {2 * channels} or "
            "more."
        )
    measured, noise = spectra.power / spectra.columns, spectra.noise / spectra.columns
    signal = np.diag(measured.mean(axis=0) - noise).real
    dark = np.flatnonzero(~(signal > np.diag(noise).real * np.sqrt(2 / (spectra.columns * count)))).tolist()
    if dark:
        raise NotDetermined(
            f"The power of channels {dark} is not above their noise; every channel must see part of the scene."
        )
    logarithm = np.zeros((count, channels), dtype=np.complex128)
    for _ in range(SCORINGS):
        step, covariance = _scoring(measured, noise, np.exp(logarithm))
        logarithm += _without_gauge(step, signal)
    variance = _variance_beyond_mean(covariance) / spectra.columns
    echoes = _beyond_median(scipy.fft.ifft(logarithm, axis=0))
    real = np.abs(echoes) > SIGNIFICANCE * np.maximum(np.sqrt(variance / count), _rms_around(echoes))
    kept = scipy.fft.fft(np.where(real, echoes, 0), axis=0)
    return DifferentialResponse(np.exp(kept.T), np.sqrt(variance))


def _scoring(measured: C128, noise: C128, response: C128) -> tuple[C128, F64]:
    """A step of Fisher scoring of the logarithms of the responses, and their covariance in a single look.

    The spectra are taken as the responses found so far would have left them, and so is their noise; their mean over
    the band then tells the signals' covariance. With A the inverse of the covariance of both, G of the signals, and
    W = A (S - G - N) A, the derivatives of the log-likelihood of one look are 2 Re diag(G W) by the logarithm of an
    amplitude and -2 Im diag(G W) by a phase.
    """
    inverse = 1 / response
    both = inverse[:, :, None] * inverse[:, None, :].conj()
    clean = (measured - noise) * both
    signal = clean.mean(axis=0)
    weight = np.linalg.inv(signal + noise)
    weighted = np.einsum("cd,kde,ec->kc", signal @ weight, clean - signal, weight, optimize=True)
    scores = 2 * np.concatenate([weighted.real, -weighted.imag], axis=1)
    covariance = np.linalg.pinv(_information(signal, weight), rcond=1e-9, hermitian=True)
    step = scores @ covariance
    channels = len(weight)
    logarithms: C128 = step[:, :channels] + 1j * step[:, channels:]
    return logarithms, np.asarray(covariance, dtype=np.float64)


def _information(signal: C128, weight: C128) -> F64:
    """Fisher information of one look on the logarithms of the channels' amplitudes, then on their phases.

    tr(A dS A dS') with dS = E G + G E by an amplitude and j (E G - G E) by a phase, E picking a channel.
    """
    across = (signal @ weight) * (signal @ weight).T
    beside = (signal @ weight @ signal) * weight.T
    amplitudes = 2 * (across + beside).real
    phases = 2 * (beside - across).real
    mixed = -2 * across.imag + 2 * beside.imag
    return np.block([[amplitudes, mixed], [mixed.T, phases]])


def _without_gauge(logarithm: C128, signal: F64) -> C128:
    """Logarithms (frequencies, channels) relative to the channels' mean, weighted by their power, and to the band's."""
    relative = logarithm - (logarithm @ (signal / signal.sum()))[:, None]
    return relative - relative.mean(axis=0)


def _beyond_median(echoes: C128) -> C128:
    """Echoes (lags, channels) beyond those of the median channel: a fault of few channels is theirs alone."""
    return echoes - np.median(echoes.real, axis=1)[:, None] - 1j * np.median(echoes.imag, axis=1)[:, None]


def _rms_around(echoes: C128) -> F64:
    """Rms of the echoes (lags, channels) that noise makes: by the median of those around, which few real ones leave."""
    around = np.arange(len(echoes))[:, None] + np.arange(-AROUND, AROUND + 1)
    return np.sqrt(np.median(np.abs(echoes[around % len(echoes)]) ** 2, axis=1) / np.log(2))


def _variance_beyond_mean(covariance: F64) -> F64:
    """Variance of each channel's logarithm, both parts together, relative to the mean of the channels."""
    channels = len(covariance) // 2
    relative = np.eye(channels) - 1 / channels
    amplitudes = relative @ covariance[:channels, :channels] @ relative.T
    phases = relative @ covariance[channels:, channels:] @ relative.T
    return np.diag(amplitudes) + np.diag(phases)
