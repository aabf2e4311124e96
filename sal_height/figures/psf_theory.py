"""Closed forms for the PSF paper's figures: responses of the synthetic tape, and their errors caused by clutter.

They share no code with the estimators: responses are made in pixels, from sums of sines and Taylor's coefficients, or
by quadrature; Fejer's kernel is applied over frequency.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault
from sal_height.numeric import C128, F64, frequencies

STEPS = 4096
"""Quadrature nodes over the band, and over the period of the swing."""


def taylor_coefficients(sidelobe_db: float, nbar: int) -> F64:
    """F_1 .. F_(nbar - 1) of the weights 1 + 2 sum F_m cos(2 pi m f / B) (Taylor, IRE Trans. AP 3, 1955)."""
    order, rank = np.arange(1, nbar), np.arange(1, nbar)
    a = np.arccosh(10 ** (sidelobe_db / 20)) / np.pi
    widening = nbar**2 / (a**2 + (nbar - 0.5) ** 2)
    zeros = widening * (a**2 + (rank - 0.5) ** 2)
    ratios = 1 - order[:, None] ** 2 / rank**2
    np.fill_diagonal(ratios, 1.0)
    above = np.prod(1 - order[:, None] ** 2 / zeros, axis=1)
    return (-1.0) ** (order + 1) * above / (2 * np.prod(ratios, axis=1))


def taylor_psf(distance: F64, fault: RangeFault) -> F64:
    """Point-spread function of the Taylor weights at distances (pixels), 1 at 0: a sum of displaced sincs."""
    across = fault.support * distance
    lobes = np.sinc(across)
    nbar = 5  # sidelobes of the tape's weights that fall off little, plus one
    for order, coefficient in enumerate(taylor_coefficients(fault.sidelobe_db, nbar), start=1):
        lobes = lobes + coefficient * (np.sinc(across - order) + np.sinc(across + order))
    return lobes


def range_psf(distance: F64, fault: RangeFault) -> C128:
    """Point-spread function along range at distances (pixels), 1 at 0: Taylor's and the paired echoes of the sawtooth.

    The n-th harmonic of a sawtooth of depth e, (-1)^(n + 1) 2 e / (pi n) sin(2 pi n P k) over the frequency k, makes
    echoes of the amplitude e / (pi n) at the distance n P to both sides, in quadrature with the sidelobes that are
    there without it.
    """
    echoes = np.zeros(np.shape(distance))
    for harmonic in range(1, 501):  # echoes decay with the number of the harmonic
        shift = harmonic * fault.teeth
        pair = taylor_psf(distance + shift, fault) - taylor_psf(distance - shift, fault)
        echoes += (-1) ** (harmonic + 1) / (np.pi * harmonic) * pair
    return taylor_psf(distance, fault) - 1j * fault.sawtooth * echoes


def azimuth_psf(distance: F64, fault: AzimuthFault) -> C128:
    """Point-spread function along azimuth at distances (pixels), 1 at 0, of a beam without swing; by quadrature."""
    f = (np.arange(STEPS) + 0.5) / STEPS - 0.5
    response = np.cos(np.pi * f) ** fault.taper * np.exp(1j * fault.quartic * (2 * f) ** 4)
    return np.exp(2j * np.pi * np.multiply.outer(distance, f)) @ response / response.sum()


def chip_transform(chip: C128) -> C128:
    """Spectrum, from -1/2 up, of pixels from -count / 2 up; shape (count,)."""
    return np.fft.fftshift(np.fft.fft(np.fft.ifftshift(chip)))


def chip_response(psf: C128) -> C128:
    """Response of a chip: the transform of its pixels, with its own peak, of the value 1, in pixel 0.

    The truncation by the chip moves the peak a little.

    Args:
        psf: point-spread function at pixels from -count / 2 up, shape (count,).
    """
    response = chip_transform(psf)

    def moved(shift: float) -> C128:
        return response * np.exp(2j * np.pi * frequencies(len(psf)) * shift)

    peak = minimize_scalar(lambda shift: -np.abs(np.mean(moved(shift))), bounds=(-0.5, 0.5), method="bounded")
    return moved(peak.x) / np.mean(moved(peak.x))


def through_fejer(power: F64, size: int) -> F64:
    """Mean periodogram of `size` pixels of speckle whose power spectrum is `power`: a mean over Fejer's kernel.

    Args:
        power: power spectrum at evenly spaced frequencies from -1/2 up, many more than `size`.
        size: number of pixels, and of frequencies of the periodogram.
    """
    apart = np.pi * (frequencies(size)[:, None] - frequencies(len(power)))
    at_peak = np.abs(np.sin(apart)) < 1e-12
    sines = np.where(at_peak, 1.0, np.sin(apart))
    kernel = np.where(at_peak, size, np.sin(size * apart) ** 2 / (size * sines**2))
    return kernel @ power / len(power)


def cosine_beam(size: int) -> F64:
    """Mean periodogram of `size` pixels of speckle under a beam cos(pi f), of mean 1: Fejer's kernel takes 1 / size."""
    return 1 + (1 - 1 / size) * np.cos(2 * np.pi * frequencies(size))


def swung_modulus(size: int, swing: float) -> F64:
    """Root of `cosine_beam` averaged over a sinusoidal swing of the beam, cycles per pixel; by quadrature."""
    pointing = swing * np.sin(2 * np.pi * (np.arange(STEPS) + 0.5) / STEPS)
    waves = np.cos(2 * np.pi * (frequencies(size)[:, None] - pointing))
    return np.mean(np.sqrt(np.maximum(1 + (1 - 1 / size) * waves, 0)), axis=1)


def relative_variance(response: C128, other: C128, over_clutter: float, floor: float) -> float:
    """Variance of the bins of a response over their power, of targets whose spectra are divided by the other response.

    Clutter in a chip of N x M pixels has N M |R|^2 |A|^2 / (mean |R|^2 mean |A|^2 TCR) in its bins, TCR summed over the
    targets. The weights of the bins of the other axis are proportional to q / A with q = |A|^2 / (|A|^2 + floor).
    Under an even beam this is rows / (TCR mean |R|^2).

    Args:
        response: response of mean 1.
        other: response of mean 1 along the other axis.
        over_clutter: power of the targets' peaks over the mean of the clutter, sum over the targets.
        floor: floor of the weights, over the greatest power.
    """
    power = np.abs(other) ** 2
    q = power / (power + floor * power.max())
    pixels = len(response) * len(other)
    ratio = np.sum(q**2) / np.sum(q) ** 2
    return float(pixels * ratio / (np.mean(np.abs(response) ** 2) * np.mean(power) * over_clutter))


def tied(response: C128) -> tuple[F64, F64]:
    """Remaining part of a unit variance over power, of the modulus and of the phase, after the peak has been tied.

    A response is scaled and turned to a mean of 1, and moved until its peak is in pixel 0. To first order that takes
    from its relative error r the mean of R r, and i g Im(mean of g R r) / mean(g^2 R), g being the frequency off the
    mean frequency.

    Returns:
        Variances of |R| and arg R over those of r, shape (count,) each: 1/2 without the tie.
    """
    count = len(response)
    g = frequencies(count) - np.mean(frequencies(count) * response).real
    spread = np.mean(g**2 * response).real
    errors = np.concatenate([np.eye(count), 1j * np.eye(count)])
    weighted = errors * response
    left = errors - weighted.mean(axis=1)[:, None] - 1j * g * np.mean(g * weighted, axis=1).imag[:, None] / spread
    return np.sum(left.real**2, axis=0) / 2, np.sum(left.imag**2, axis=0) / 2
