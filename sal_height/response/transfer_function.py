"""The transfer function of an imaging system from chips of point targets: a range and an azimuth response.

H(k_r, k_a) = R(k_r) A(k_a) (PSF paper, eq. 2.10; section 3, figures 4 to 15). Responses start at -1/2 cycle per
pixel, as `numpy.fft.fftshift` puts them; along arrays of two axes, range is first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from sal_height.errors import NotDetermined
from sal_height.numeric import C128, F64, ShortRepr
from sal_height.response.impulse import band_frequencies, peak_offset
from sal_height.response.point_targets import PointTarget

FLOOR = 0.05  # power of a response, over its greatest, below which bins hardly count in a division by it


@dataclass(frozen=True, eq=False)
class AxisTransfer(ShortRepr):
    """The response of a system along one axis.

    It is scaled and turned so that the response to a point has its peak in pixel 0, and the value 1 there: the mean of
    the response over its bins is 1. The phase therefore has no linear part.

    Attributes:
        response: response R or A from -1/2 cycle per pixel on, complex128, shape (count,).
        sigma: standard error of each bin (of the whole complex number), float64, shape (count,).
        disagreement: root of the mean square of the targets' deviations over what their clutter explains; 1 for targets
            that agree, NaN for fewer than two. Where it is greater, the sigma is greater by as much.
    """

    response: C128
    sigma: F64
    disagreement: float

    def without_clutter(self) -> C128:
        """The response with clutter removed from its point-spread function, pixel by pixel; shape (count,).

        Each pixel h counts by 1 - s^2 / |h|^2, or not at all where that is below 0, with s its standard error (Wiener's
        filter, with the measured power in place of the expected one). It removes most of the error of a response
        that is short in pixels; what is left errs alike in neighbouring bins, and sidelobes below s are gone.
        """
        pixels = scipy.fft.ifft(self.response)
        variance = np.sum(self.sigma**2) / len(self.sigma) ** 2
        power = np.abs(pixels) ** 2
        return centred(np.asarray(scipy.fft.fft(pixels * np.maximum(0, power - variance) / np.where(power, power, 1))))


@dataclass(frozen=True, eq=False)
class TransferFunction(ShortRepr):
    """Responses of a system along range and azimuth, from a number of `targets`."""

    range: AxisTransfer
    azimuth: AxisTransfer
    targets: int


def estimate_transfer_function(targets: Sequence[PointTarget]) -> TransferFunction:
    """Range and azimuth response with the least error that the clutter leaves.

    The clutter has passed through the same system as the targets, so that all bins of a chip's spectrum G have the same
    information on a target, be the response strong or weak there: R is the mean over k_a of G / A, and A that over k_r
    of G / R, where the other response is well over FLOOR. Under an even beam that is the paper's mean over k_a (figure
    10), the transform of the line through the peak, whose bins have the variance rows |R|^2 / (TCR mean |R|^2) at a
    target-to-clutter ratio TCR. Targets, of peak 1, count by that ratio: the reciprocal of their variance.

    Args:
        targets: targets with chips of one shape.

    Raises:
        NotDetermined: there is no target.
    """
    if not targets:
        raise NotDetermined("There is no point target; at least one is needed for the transfer function.")
    over_clutter = np.array([target.over_clutter for target in targets])
    spectra, shares = np.stack([target.spectrum for target in targets]), over_clutter / over_clutter.sum()
    mean = np.einsum("t,trc->rc", shares, spectra)
    in_range = _inverse(centred(mean.mean(axis=1)))
    in_azimuth = _inverse(centred(in_range @ mean))
    ranges = np.einsum("trc,c->tr", spectra, in_azimuth)
    range_response = centred(shares @ ranges)
    in_range = _inverse(range_response)
    azimuths = np.einsum("r,trc->tc", in_range, spectra)
    azimuth_response = centred(shares @ azimuths)
    rest = np.abs(spectra - range_response[:, None] * azimuth_response) ** 2
    left = np.einsum("t,trc->rc", shares, rest) / len(targets)
    return TransferFunction(
        _axis_response(range_response, ranges, shares, left @ np.abs(in_azimuth) ** 2),
        _axis_response(azimuth_response, azimuths, shares, np.abs(in_range) ** 2 @ left),
        len(targets),
    )


def centred(response: C128) -> C128:
    """A response whose point has its peak, of the value 1, in pixel 0, from one whose peak is not far from there.

    To the first order of the phase that removes a linear fit of it, with the weights |response|.

    Args:
        response: response whose peak is near pixel 0, shape (count,).
    """
    bins = band_frequencies(np.abs(scipy.fft.ifftshift(response)) ** 2)
    frequencies = scipy.fft.fftshift(bins) / len(bins)
    frequencies = frequencies - np.mean(frequencies)
    moved = response * np.exp(2j * np.pi * frequencies * peak_offset(response, frequencies))
    return moved / np.mean(moved)


def _inverse(response: C128) -> C128:
    """Weights of the bins of a spectrum that `response` is a factor of, for the mean of the other factor."""
    power = np.abs(response) ** 2
    weights = np.conj(response) / (power + FLOOR * power.max())
    return weights / (weights @ response)


def _axis_response(mean: C128, responses: C128, shares: F64, variance: F64) -> AxisTransfer:
    """A mean response with its standard errors, and the targets' disagreement on it (the ratio of Birge 1932).

    Args:
        mean: mean response, shape (bins,).
        responses: response of each target, shape (targets, bins).
        shares: weights of the targets in the mean, shape (targets,).
        variance: variance of the bins of the mean due to clutter, shape (bins,).
    """
    disagreement = float("nan")
    if len(responses) > 1:
        spread = shares @ np.abs(responses - mean) ** 2 / (len(responses) - 1)
        disagreement = float(np.sqrt(np.sum(spread) / np.sum(variance)))
    return AxisTransfer(mean, np.sqrt(variance) * np.fmax(disagreement, 1.0), disagreement)
