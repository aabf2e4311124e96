"""Does the system respond to bright targets as it does to speckle? If it is linear it must: superposition.

The PSF paper compares |R| of targets (figure 10) with that of speckle (figure 24) by eye, finds a shallower sawtooth
on a higher pedestal in speckle, and concludes that the system is not linear. But a linear one shows the same:
sub-images of speckle convolve |R|^2 with Fejer's kernel, and noise lifts it. The test allows for both,

    P = c (|R_target|^2 convolved with Fejer's kernel) + n,

fits c and n by generalised least squares, and asks whether what is left over is larger than the errors of the two.
Those of the mean periodogram P are `speckle_spectra.periodogram_covariance`, summed over the distances of lines that
correlate; those of R_target, independent complex Gaussian numbers of variance sigma^2 in its bins, go through the
quadratic forms T_k = R^H B_k R that the convolved spectrum is made of:

    bias tr(B_k S), covariance 2 Re(R^H B_j S B_k R) + tr(B_j S B_k S), with S = diag(sigma^2).

A chip cuts the response off. What lies beyond it is taken for a random continuation of its ends, an error like others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz
from scipy.special import chdtrc

from sal_height.errors import NotDetermined
from sal_height.numeric import C128, F64, frequencies
from sal_height.response.speckle_spectra import SpeckleSpectra, cross_spectrum, fejer_power


@dataclass(frozen=True)
class Superposition:
    """How the responses to targets and to speckle compare.

    Attributes:
        p_value: probability of as large a residual or a larger one, if the system is linear.
        chi_square: the residual squared, over its covariance.
        freedom: degrees of freedom of it.
        scale: c, power of the fitted response over the mean power of speckle.
        noise: n, power of white noise over the mean power of speckle.
    """

    p_value: float
    chi_square: float
    freedom: int
    scale: float
    noise: float


def superposition(target: C128, target_error: F64, speckle: SpeckleSpectra) -> Superposition:
    """Compare the range response to targets with that to speckle.

    Args:
        target: R of targets at N frequencies from -1/2 up, N at least the pixels M of a sub-image: from chips of N
            pixels. The longer they are, the more is known of the echoes that speckle shows.
        target_error: standard error of each, as a complex number: the root of the mean |error|^2; the error's real and
            imaginary parts alike, and independent between bins.
        speckle: spectra of speckle.

    Raises:
        NotDetermined: too few frequencies tell something.
    """
    axis, size = speckle.range, len(speckle.range.covariance)
    scale = np.sqrt(np.mean(np.abs(target) ** 2))
    forms, target_covariance = _target_covariance(target / scale, (target_error / scale) ** 2, size)
    shape = fejer_power(forms)
    kept = np.arange(size) != 0 if axis.spur else np.ones(size, dtype=bool)
    design = np.stack([shape, np.ones(size)], axis=1)[kept]
    amplitude, noise = 1.0 / shape.mean(), 0.0
    for _ in range(4):  # as the errors depend on what is fitted
        covariance = _speckle_covariance(amplitude * forms, noise, speckle) + amplitude**2 * target_covariance
        whitener = _whitener(covariance[np.ix_(kept, kept)])
        if len(whitener) < 4:
            raise NotDetermined(
                f"The test of superposition has {len(whitener)} independent frequencies of {size}; 4 are needed."
            )
        fit, *_ = np.linalg.lstsq(whitener @ design, whitener @ axis.power[kept], rcond=None)
        amplitude, noise = float(fit[0]), float(fit[1])
    chi_square = float(np.sum((whitener @ (axis.power[kept] - design @ fit)) ** 2))
    freedom = len(whitener) - 2
    return Superposition(float(chdtrc(freedom, chi_square)), chi_square, freedom, amplitude, noise)


def _target_covariance(target: C128, variance: F64, size: int) -> tuple[C128, F64]:
    """Covariance that speckle would have with the response of the targets, and the errors of its periodogram.

    The covariance at lag l is sum over n of h(n + l) h(n)*, less what errors alone have there, (N - l) times their
    covariance in a pixel. The linear part of the errors is taken at the measured response, where it contains on average
    twice the quadratic one, and stands for both.

    Returns:
        Covariance at lags 0 to M - 1, and the covariance of the convolved spectrum's M numbers, shape (M, M).
    """
    bins, lag = len(target), np.arange(size)
    place = np.arange(-bins, bins)
    first = bins - bins // 2
    waves = np.exp(2j * np.pi * np.outer(place[first:][:bins], frequencies(bins))) / bins
    chip = waves @ target
    response = np.pad(chip, (first, bins // 2))
    kernel = np.maximum(0, 1 - np.abs(place[:, None] - place) / size)
    turned = np.exp(2j * np.pi * np.outer(frequencies(size), place))
    slopes = turned * ((turned.conj() * response) @ kernel)
    inside = slopes[:, first:][:, :bins] @ waves.conj() * np.sqrt(variance)
    linear = inside.conj() @ inside.T
    for outside in (slopes[:, :first], slopes[:, first + bins :]):
        linear += outside.conj() @ _beyond(chip, outside.shape[1]) @ outside.T
    covariance = np.correlate(chip, chip, "full")[bins - 1 :][:size]
    error = np.exp(2j * np.pi * np.outer(lag, frequencies(bins))) @ variance / bins**2
    return covariance - (bins - lag) * error, np.asarray(2 * linear.real)


def _beyond(chip: C128, count: int) -> C128:
    """Covariance of `count` pixels of the response beyond its chip: that of a quarter of it at each end."""
    length = len(chip) // 4
    ends = (chip[:length], chip[-length:])
    echo = np.mean([np.correlate(end, end, "full")[length - 1 :] / length for end in ends], axis=0)
    lags = np.pad(echo, (0, count))[:count]
    return toeplitz(lags, lags.conj())


def _speckle_covariance(signal: C128, noise: float, speckle: SpeckleSpectra) -> F64:
    """Covariance of the mean periodogram of speckle with this covariance over range, and white noise.

    Lines at a distance d have the signal in common as far as a(d) says, the covariance over azimuth, and no noise.
    """
    size, across = len(signal), speckle.azimuth.covariance
    triangle = 1 - np.arange(len(across)) / len(across)
    alike = 2 * np.sum((triangle * np.abs(across) ** 2)[1:]) / signal[0].real ** 2
    spectrum = cross_spectrum(signal, size)
    own = np.abs(spectrum + noise * np.eye(size)) ** 2
    return (own + alike * np.abs(spectrum) ** 2) / speckle.range.lines


def _whitener(covariance: F64) -> F64:
    """Matrix that makes errors of this covariance independent and of variance 1.

    Directions whose variance is less than 5 % of a bin's own, neighbours being alike, are left out.
    """
    error = np.sqrt(np.diag(covariance))
    variance, direction = np.linalg.eigh(covariance / np.outer(error, error))
    kept = variance > 0.05
    return np.asarray((direction[:, kept] / np.sqrt(variance[kept])).T / error)
