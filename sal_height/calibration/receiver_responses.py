"""The frequency response of each channel's receiver relative to the others, from images of any scene.

All channels see the same scatterers. So their cross-spectra over range, averaged over columns and dwells, differ from
frequency to frequency only by the receivers: S(k) = D(k) G D(k)^H + N, with D the diagonal matrix of their responses,
G the covariance of the channels' signals, which depends on the scene and the beams, and N the noise. Averages of
complex Gaussian signals have a Wishart distribution (Goodman, Ann. Math. Stat. 34, 1963); its likelihood is maximised
by Fisher scoring (Kay, Estimation Theory, 1993, section 15.7, has the scores).

A common response of all channels cannot be estimated in this way; the spectrum of a point target shows it (PSF paper).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from sal_height.errors import NotDetermined
from sal_height.geometry import without_range_phase
from sal_height.imaging import Slc
from sal_height.numeric import C64, C128, F64, WORKERS
from sal_height.sensor import Sensor, with_powers


@dataclass(eq=False)
class CrossSpectra:
    """Sums of the cross-spectra between channels over the columns of images, to which dwells are added.

    Attributes:
        power: sum of x x^H over columns, x the channels' spectra at a fast-time frequency, scaled to the mean power 1
            in every column, so that all have equal weight: complex128, shape (frequencies, channels, channels).
        noise: sum of the noise alone, at any frequency: complex128, shape (channels, channels).
        columns: number of columns that were summed; those that are 0 or not finite are left out.
    """

    power: C128
    noise: C128
    columns: int

    def add(self, pixels: C64, sensor: Sensor, noise_powers: F64) -> None:
        """Add the images of a dwell.

        Args:
            pixels: images of all channels, as `remove_range_phase` returns them, shape (channels, rows, cols).
            sensor: sensor with waveform "spectrum".
            noise_powers: E|n|^2 of a pixel of each channel.
        """
        brightness = sum(np.einsum("crk,crk->k", part, part) for part in (pixels.real, pixels.imag)) / len(pixels)
        lit = np.isfinite(brightness) & (brightness > 0)
        weights = np.zeros(len(brightness), dtype=np.float32)
        np.divide(1, np.sqrt(brightness), out=weights, where=lit)
        even = np.multiply(pixels, weights, out=np.zeros_like(pixels), where=lit)
        spectra = scipy.fft.fft(even, sensor.sample_count, axis=1, workers=WORKERS, overwrite_x=True)
        by_frequency = scipy.fft.fftshift(spectra, axes=1).transpose(1, 0, 2)
        noise = with_powers(sensor.noise_covariance, noise_powers) * np.sum(weights.astype(np.float64) ** 2)
        self.power += by_frequency @ by_frequency.conj().transpose(0, 2, 1)
        self.noise += noise * pixels.shape[1]
        self.columns += int(np.count_nonzero(lit))


def remove_range_phase(slc: Slc, sensor: Sensor) -> C64:
    """Return images whose spectrum along range is that over the fast-time frequencies, their middle one at 0.

    Args:
        slc: images of all channels in the slant plane, unweighted in range.
        sensor: sensor with waveform "spectrum".

    Returns:
        The rows within the range window, complex64, shape (channels, rows, cols).

    Raises:
        NotDetermined: rows are not a range cell apart: the images are weighted or in another plane.
    """
    grid = slc.grid
    if abs(grid.row_spacing / sensor.range_resolution - 1) > 1e-6:
        raise NotDetermined(
            f"Rows are {grid.row_spacing:.6g} m apart and range cells {sensor.range_resolution:.6g} m; receivers are "
            "calibrated on images with range_window rectangular in the slant plane, where both are equal."
        )
    wavelength = 4 * np.pi / sensor.centre_wavenumber
    turn = without_range_phase(np.ones(grid.shape, np.complex64), grid, slc.aperture, wavelength)
    return slc.images[:, : sensor.sample_count] * turn[: sensor.sample_count].astype(np.complex64)


def differential_response(spectra: CrossSpectra, echo_significance: float) -> tuple[C128, F64]:
    """Return the receivers' responses that make these cross-spectra most likely.

    They are sums of echoes. Of the Fourier coefficients of their logarithms over the band, those are kept that are not
    due to noise and speckle: that exceed `echo_significance` times their standard error for uniform power over range,
    and the same number times the rms of their neighbours, as uneven power increases the error at some lags.

    Returns:
        The responses relative to the median of all channels and to their own mean over the band, complex128, shape
        (channels, frequencies); 1: like the others. Then the standard error of a frequency's response, rms of its two
        parts together, if all lags were kept, shape (channels,).

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
    for _ in range(4):  # from responses of 3 dB each step reduces the error tenfold
        step, covariance = _score(measured, noise, np.exp(logarithm))
        # One complex factor of all channels at a frequency, and of one at all frequencies, is not determined.
        relative = step - (step @ (signal / signal.sum()))[:, None]
        logarithm += relative - relative.mean(axis=0)
    variance = _variance_beyond_mean(covariance) / spectra.columns
    echoes = _beyond_median(scipy.fft.ifft(logarithm, axis=0))
    real = np.abs(echoes) > echo_significance * np.maximum(np.sqrt(variance / count), _rms_around(echoes))
    kept = scipy.fft.fft(np.where(real, echoes, 0), axis=0)
    return np.exp(kept.T), np.sqrt(variance)


def _score(measured: C128, noise: C128, response: C128) -> tuple[C128, F64]:
    """Return a step of Fisher scoring of the logarithms of the responses, and their covariance in a single look.

    The spectra and their noise are divided by the current responses; the mean over the band is then the signals'
    covariance. With A the inverse of the covariance of both, G of the signals, and
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
    """Return the Fisher information of one look on the logarithms of the channels' amplitudes, then on their phases.

    tr(A dS A dS') with dS = E G + G E by an amplitude and j (E G - G E) by a phase, E picking a channel.
    """
    across = (signal @ weight) * (signal @ weight).T
    direct = (signal @ weight @ signal) * weight.T
    amplitudes = 2 * (across + direct).real
    phases = 2 * (direct - across).real
    mixed = -2 * across.imag + 2 * direct.imag
    return np.block([[amplitudes, mixed], [mixed.T, phases]])


def _beyond_median(echoes: C128) -> C128:
    """Subtract the median channel from echoes (lags, channels), so that faults of a few channels affect only these."""
    return echoes - np.median(echoes.real, axis=1)[:, None] - 1j * np.median(echoes.imag, axis=1)[:, None]


def _rms_around(echoes: C128) -> F64:
    """Return the rms of echoes (lags, channels) of noise, from the median of 17, which is robust to a few real ones."""
    around = np.arange(len(echoes))[:, None] + np.arange(-8, 9)
    return np.sqrt(np.median(np.abs(echoes[around % len(echoes)]) ** 2, axis=1) / np.log(2))


def _variance_beyond_mean(covariance: F64) -> F64:
    """Return the variance of each channel's logarithm, both parts together, relative to the mean of the channels."""
    channels = len(covariance) // 2
    relative = np.eye(channels) - 1 / channels
    amplitudes = relative @ covariance[:channels, :channels] @ relative.T
    phases = relative @ covariance[channels:, channels:] @ relative.T
    return np.diag(amplitudes) + np.diag(phases)
