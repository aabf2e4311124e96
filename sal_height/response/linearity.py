"""Test of superposition: a linear system responds to bright targets as it does to speckle.

The PSF paper compares |R| of targets (figure 10) with that of speckle (figure 24) by eye, finds a shallower sawtooth
on a higher pedestal in speckle, and concludes that the system is not linear. But a linear one shows the same:
sub-images of speckle convolve |R|^2 with Fejer's kernel, and noise lifts it. Noise has passed the weights of the
processor, which may look like the response or not at all. The test avoids it where its shape is not known, and takes
it away where it is:

    P_1 = c F(|R_target|^2)                  neighbouring lines
    P_0 - n F(noise) = c F(|R_target|^2)     each line with itself

F convolves with Fejer's kernel. P_s is the mean over the lines i of Re X_{i+s}(f) X_i(f)*, with X the spectrum over
range of a line of a sub-image. Neighbouring lines have the speckle in common as far as the antenna is narrower than the
sampling, and no noise that is white along azimuth. The test fits c by generalised least squares, and asks whether what
is left over in the band is larger than the errors of the two routes. For speckle they follow from Isserlis' theorem:
with T_d the cross-spectrum (`speckle_spectra.cross_spectrum`) of lines at the distance d, of L lines,

    cov P_s = sum over d of Re(T_d T_d* + T_{d+s} T_{d-s}*) / (2 L).

Those of R_target, independent complex Gaussian numbers of variance sigma^2 in its bins, go through the quadratic forms
T_k = R^H B_k R that the convolved spectrum is made of:

    bias tr(B_k S), covariance 2 Re(R^H B_j S B_k R) + tr(B_j S B_k S), with S = diag(sigma^2).

A chip of N pixels cuts the response off. At lags below N / 2 only products of two echoes are lost, none of an echo and
the peak, so that no longer ones are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from sal_height.errors import NotDetermined
from sal_height.numeric import C128, F64, ShortRepr, frequencies
from sal_height.response.speckle_spectra import SpeckleSpectra, cross_spectrum, fejer_power


@dataclass(frozen=True, eq=False)
class ShapedNoise(ShortRepr):
    """Receiver noise, white before the processor: the covariance of its pixels, over that at lag 0.

    Attributes:
        range: covariance at lags from 0 up in range; beyond the last it is 0.
        azimuth: covariance at lags along azimuth, likewise.
    """

    range: C128
    azimuth: C128

    @classmethod
    def weighted(cls, range_weights: F64, azimuth_weights: F64, steps: tuple[float, float]) -> ShapedNoise:
        """The noise that a compression with these weights leaves.

        A window over a band makes noise of its square as spectrum; the covariance is the transform of that.

        Args:
            range_weights: weights at evenly spaced frequencies of the band.
            azimuth_weights: weights at even steps over the aperture.
            steps: spacing of rows and of columns, over the resolution without weights.
        """
        lags = np.arange(64)  # the pixels of a sub-image

        def covariance(weights: F64, step: float) -> C128:
            power = weights**2 / np.sum(weights**2)
            place = (np.arange(len(weights)) - (len(weights) - 1) / 2) / len(weights)
            return np.asarray(np.exp(2j * np.pi * step * np.outer(lags, place)) @ power)

        return cls(covariance(range_weights, steps[0]), covariance(azimuth_weights, steps[1]))

    @classmethod
    def pooled(cls, noises: Sequence[ShapedNoise]) -> ShapedNoise:
        """Noise of images that are measured together: the mean of their covariances."""
        return cls(*(np.mean([getattr(one, axis) for one in noises], axis=0) for axis in ("range", "azimuth")))


@dataclass(frozen=True, eq=False)
class KnownNoise:
    """Receiver noise in speckle: its shape, and its fraction of the mean power of the pixels."""

    shape: ShapedNoise
    share: float


@dataclass(frozen=True)
class Superposition:
    """Comparison of the responses to targets and to speckle.

    Attributes:
        p_value: probability of this residual or a larger one, if the system is linear.
        chi_square: square of the residual over its covariance.
        freedom: degrees of freedom of chi_square.
        share: factor c over the mean power of speckle: that of lines and their like, or of lines and their neighbours.
    """

    p_value: float
    chi_square: float
    freedom: int
    share: float


@dataclass(frozen=True, eq=False)
class _Lines:
    """Products P_s of lines of speckle, without noise.

    Attributes:
        power: product P_s at the frequencies of a sub-image of the same number of pixels.
        apart: number s of lines between the two of a product.
        signal: cross-spectrum of a line that responds as the targets do, at 2 M frequencies, M the rows of a tile.
        noise: contribution of noise to `signal`.
        across: covariances along azimuth of speckle and of noise at lags from 0 up, shape (2, columns of a tile).
        count: number of lines.
    """

    power: F64
    apart: int
    signal: C128
    noise: C128
    across: C128
    count: int

    @property
    def covariance(self) -> F64:
        """Covariance of P_s."""
        cols, more = self.across.shape[1], self.apart
        lags = np.pad(np.concatenate([self.across[:, :0:-1].conj(), self.across], axis=1), ((0, 0), (more, more)))
        ahead, middle, behind = (lags[:, first:][:, : 2 * cols - 1] for first in (2 * more, more, 0))
        share = 1 - np.abs(np.arange(1 - cols, cols)) / cols
        products = (middle * share) @ middle.conj().T + (ahead * share) @ behind.conj().T
        spectra = np.stack([self.signal, self.noise])
        total = np.einsum("pq,pij,qij->ij", products, spectra, spectra.conj(), optimize=True).real
        through = _fewer_lags(len(self.signal) // 2, len(self.power))
        return np.asarray(through @ total @ through.T / (2 * self.count * (1 - more / cols)))


def superposition(
    target: C128, target_error: F64, speckle: SpeckleSpectra, noise: KnownNoise | None = None
) -> Superposition:
    """Compare the range response to targets with that to speckle.

    Args:
        target: response R of targets at N frequencies from -1/2 up, from chips of N pixels. Spectra are compared at the
            resolution of N / 2 pixels, or of the M of a sub-image if they are fewer.
        target_error: standard error of each, as a complex number: the root of the mean |error|^2; the error's real and
            imaginary parts alike, and independent between bins.
        speckle: spectra of speckle.
        noise: noise in the speckle; None: unknown, but white along azimuth.

    Raises:
        NotDetermined: too few frequencies are usable, or speckle cannot be separated from noise.
    """
    size = min(len(speckle.range.covariance), len(target) // 2)
    scale = np.sqrt(np.mean(np.abs(target) ** 2))
    response, errors = _target_covariance(target / scale, (target_error / scale) ** 2, size)
    shape = fejer_power(response)
    lines = _neighbours(response, speckle) if noise is None else _own(response, speckle, noise)
    # Below 3 % the truncation of a chip and the ends of a sub-image outweigh the response.
    kept = shape > 0.03 * shape.max(initial=0.0)
    kept[:1] &= not speckle.range.spur
    shape, power = shape[kept], lines.power[kept]
    amplitude, own, of_target = power.sum() / shape.sum(), lines.covariance[np.ix_(kept, kept)], errors[kept][:, kept]
    for _ in range(4):  # as the error depends on what is fitted
        whitener = _whitener(own + amplitude**2 * of_target)
        if len(whitener) < 4:
            raise NotDetermined(
                f"The test of superposition has {len(whitener)} independent frequencies of {size}; 4 are needed."
            )
        seen, expected = whitener @ power, whitener @ shape
        amplitude = float(expected @ seen / (expected @ expected))
    chi_square = float(np.sum((seen - amplitude * expected) ** 2))
    freedom = len(whitener) - 1
    return Superposition(float(chdtrc(freedom, chi_square)), chi_square, freedom, amplitude * response[0].real)


def _neighbours(response: C128, speckle: SpeckleSpectra) -> _Lines:
    """Products of neighbouring lines. The noise in their errors is the part of the lines that is not the response."""
    if speckle.pointing is None:
        raise NotDetermined(
            "Neighbouring pixels along azimuth do not correlate, and the shape of receiver noise is not known, so that "
            "it cannot be separated from speckle; finer sampling along azimuth or a bag that states the weights "
            "is needed."
        )
    rows, across = len(speckle.range.covariance), speckle.azimuth.covariance
    signal = _line(response, rows)
    other = cross_spectrum(speckle.range.covariance, 2 * rows) - signal
    turned = across * np.exp(-1j * np.angle(across[1]) * np.arange(len(across)))
    white = np.arange(len(across)) == 0
    power = fejer_power(speckle.neighbours[: len(response)])
    return _Lines(power, 1, signal, other, np.stack([turned, white]), speckle.range.lines)


def _own(response: C128, speckle: SpeckleSpectra, noise: KnownNoise) -> _Lines:
    """Products of lines with themselves, less known noise."""
    rows, across = len(speckle.range.covariance), speckle.azimuth.covariance
    along, shape = _first(noise.shape.azimuth, len(across)), _first(noise.shape.range, rows)
    left = speckle.range.covariance - noise.share * shape
    covariances = np.stack([across - noise.share * along, noise.share * along])
    signal, other = _line(response, rows), cross_spectrum(shape, 2 * rows)
    return _Lines(fejer_power(left[: len(response)]), 0, signal, other, covariances, speckle.range.lines)


def _line(response: C128, rows: int) -> C128:
    """Cross-spectrum of a line of speckle of this covariance and mean power 1, at 2 `rows` frequencies."""
    return cross_spectrum(_first(response / response[0].real, rows), 2 * rows)


def _first(covariance: C128, count: int) -> C128:
    """A covariance at lags 0 to count - 1."""
    return np.pad(covariance, (0, max(0, count - len(covariance))))[:count]


def _fewer_lags(rows: int, count: int) -> F64:
    """Matrix from periodograms of `rows` pixels at 2 rows frequencies to those of `count`; (count, 2 rows).

    Covariances are multiplied by the triangle of the latter over that of the former.
    """
    lag = np.arange(1 - count, count)
    weight = (1 - np.abs(lag) / count) / (1 - np.abs(lag) / rows)
    here, there = (np.exp(-2j * np.pi * np.outer(frequencies(number), lag)) for number in (count, 2 * rows))
    return np.asarray(((here * weight) @ there.conj().T).real / (2 * rows))


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
    covariance = np.correlate(chip, chip, "full")[bins - 1 :][:size]
    error = np.exp(2j * np.pi * np.outer(lag, frequencies(bins))) @ variance / bins**2
    return covariance - (bins - lag) * error, np.asarray(2 * linear.real)


def _whitener(covariance: F64) -> F64:
    """Matrix that makes errors of this covariance independent and of variance 1.

    Directions whose variance is less than 5 % of a bin's own, neighbours being alike, are left out.
    """
    error = np.sqrt(np.diag(covariance))
    variance, direction = np.linalg.eigh(covariance / np.outer(error, error))
    kept = variance > 0.05
    return np.asarray((direction[:, kept] / np.sqrt(variance[kept])).T / error)
