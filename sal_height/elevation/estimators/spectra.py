"""Elevation by the spectra of a pixel's covariance: Capon's method and MUSIC.

Capon: the direction with the greatest output power of a minimum-variance beamformer. The beamformer that passes a
scatterer with the unit response u = a / |a| undistorted and suppresses everything else has the output power 1 / (u^H
R^-1 u) (Capon, Proceedings of the IEEE 57, 1969; Lombardini and Montanari, IEEE Trans. Aerospace and Electronic
Systems 38, 2002, for several scatterers in a SAR pixel). The unit response is needed because detectors near the ends
of the array receive less power of a scatterer: with a itself, Capon's maximum would be there. To be invertible with
few looks K, the mean covariance R / K is loaded with some noise powers (Carlson, IEEE Trans. AES 24, 1988). Much
loading gives maximum likelihood, little a noisier estimate that separates scatterers better.

MUSIC: the direction whose response lies nearest to the strongest eigenvectors of the covariance. The eigenvectors of
the `order` greatest eigenvalues span the signal subspace, the others E_n the noise subspace; the peak is that of 1 /
(u^H E_n E_n^H u) (Schmidt, IEEE Trans. Antennas and Propagation 34, 1986). Of order 1 its asymptotic variance is the
stochastic Cramer-Rao bound (Stoica and Nehorai, IEEE Trans. Acoustics, Speech and Signal Processing 37, 1989, eq. 3.12
for one source), as is that of maximum likelihood.

Neither searches for a second scatterer. A weak one within the resolution leaves the pixel with a single peak and
displaces it. The tests of maximum likelihood decide which pixels hold a single surface (`layover.models.resolve`); the
others have no height, unless parameter `layover` is false. Then the power along the slope of the response shows by how
much Capon's peak is displaced (`misfit_factor`).
"""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, noise_limit, sidelobe_limit
from sal_height.elevation.array.likelihood import SinglePeaks, estimate_of, peaks_by_spectrum
from sal_height.elevation.layover.extended import free_looks
from sal_height.elevation.layover.models import resolve, where_single
from sal_height.elevation.layover.single import LayoverSettings, PixelNoise
from sal_height.elevation.layover.two_channels import in_two_channels
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.errors import UserError
from sal_height.numeric import F64
from sal_height.sensor import MAX_DETECTORS
from sal_height.settings import setting


class CaponSettings(LayoverSettings):
    """Settings of Capon's method."""

    # With 16 detectors and 16 looks the standard deviation is 5 % above that of maximum likelihood (24 % with 0.1,
    # 0.2 % with 10), and a second scatterer half a beamwidth away, 3 dB weaker, displaces the median estimate by 0.04
    # beamwidths instead of 0.14.
    loading: float = setting(
        1.0,
        "power added to the diagonal of the mean covariance before it is inverted; more of it lowers the noise of the "
        "estimate, less of it separates scatterers better",
        unit="noise powers",
        minimum=1e-3,
        maximum=1e3,
    )


def capon_elevation(looks: Looks, beams: Beams, settings: CaponSettings) -> ElevationEstimate:
    """Elevation of the peak of Capon's spectrum.

    Sigma is that of maximum likelihood with `deviation_factor` times the noise; without tests for several scatterers,
    times `misfit_factor`, too. Arguments and errors as in `ml_elevation`.
    """

    def spectrum(covariance: Covariance, count: F64) -> Covariance:
        mean = covariance / (count * looks.receiver_noise)[:, None, None]
        return -np.linalg.inv(mean + (settings.loading * np.eye(beams.count)).astype(covariance.dtype))

    peaks = peaks_by_spectrum(spectrum, looks, beams, settings)
    deviation = deviation_factor(looks.count, beams, settings.loading)
    if beams.count > 2 and not settings.layover:
        deviation = deviation * misfit_factor(peaks, looks, beams, settings)
    return _estimate(peaks, deviation, looks, beams, settings)


def misfit_factor(peaks: SinglePeaks, looks: Looks, beams: Beams, settings: CaponSettings) -> F64:
    """Standard deviation of an estimate where a pixel has more than one scatterer, over that of noise alone.

    With the derivative s_k of the response along its slope in look k, the estimate is off by sum_k Re(A_k* s_k) over
    sum_k |A_k|^2 D / |a|^2. Whatever the cause of s_k, if its phase is not that of A_k, the real part has half of its
    power, so that the variance grows by the power along the slope over that of noise, of which K - 1/2 complex
    dimensions are left (the variance of a misspecified likelihood: White, Econometrica 50, 1982). Power that noise,
    beams and level ground rarely exceed leaves the factor at 1. A single look does not show the part in phase, which
    moves the peak as another elevation does.

    Args:
        peaks: likelihood at the estimates.
        looks: covariance of the pixels.
        beams: beams of the channels.
        settings: rates of false alarms.
    """
    noise, free = PixelNoise.of(peaks, looks, beams), np.maximum(free_looks(looks.count), 0.5)
    over = peaks.along_slope / (noise.raised * noise.along_slope)
    rare = noise_limit(free, settings.false_alarm_rate) + sidelobe_limit(looks.leaked, settings.sidelobe_rate)
    return np.sqrt(np.where(over > rare, over / free, 1.0))


def deviation_factor(count: F64, beams: Beams, loading: float) -> F64:
    """Standard deviation of Capon's estimate over that of maximum likelihood, for a number of looks of any shape.

    Close to a strong scatterer Capon's method is least squares weighted with the inverse of (W + loading), W the noise
    covariance measured across the scatterer's response. From the noise along its slope it subtracts what the n = K - 1
    looks predict of it from the other q = M - 2 dimensions (twice as many looks if the beams are real), and adds the
    noise of this prediction: the variance grows by the sum of x / (x + loading)^2 / n over the eigenvalues x of W in
    these dimensions, which follow Marchenko and Pastur's law of ratio q / n (Mathematics of the USSR-Sbornik 1, 1967).
    """
    others = beams.count - 2
    samples = (count - 1) * (1 if beams.is_complex else 2)
    excess = samples * (1 + loading) - others
    root = np.sqrt(excess**2 + 4 * samples * others * loading)
    return np.sqrt(0.5 + 0.5 * np.divide(excess + 2 * others, root, where=root > 0, out=np.ones_like(root)))


class MusicSettings(LayoverSettings):
    """Settings of MUSIC."""

    order: int = setting(
        1, "dimensions of the signal subspace; fewer than there are detectors", minimum=1, maximum=MAX_DETECTORS - 1
    )


def music_elevation(looks: Looks, beams: Beams, settings: MusicSettings) -> ElevationEstimate:
    """Elevation of the highest peak of MUSIC's spectrum in every pixel.

    Of order 2 a second scatterer close by displaces it less, but a single one is estimated with more noise: sigma is
    that of maximum likelihood over sqrt(1 - (order - 1) / (M - 1)), because the additional eigenvectors take order - 1
    of the M - 1 dimensions in which the response can turn. Arguments as in `ml_elevation`.

    Raises:
        UserError: the order is not less than the number of detectors; or as in `ml_elevation`.
    """
    order, count = settings.order, beams.count
    if order >= count:
        raise UserError(f"The order of MUSIC is {order} with {count} detectors; it must be less than that.")

    def spectrum(covariance: Covariance, _count: F64) -> Covariance:
        signal = np.linalg.eigh(covariance)[1][:, :, -order:]
        return signal @ np.swapaxes(signal.conj(), 1, 2)

    peaks = peaks_by_spectrum(spectrum, looks, beams, settings)
    return _estimate(peaks, 1 / np.sqrt(1 - (order - 1) / (count - 1)), looks, beams, settings)


def _estimate(
    peaks: SinglePeaks, deviation: F64 | float, looks: Looks, beams: Beams, settings: LayoverSettings
) -> ElevationEstimate:
    """The peaks of a spectrum where there is a single surface, and the sigma of their elevations.

    Noise moves them by `deviation` times as much as a peak of maximum likelihood; the spread of surfaces moves both
    alike. The sigma of a fitted surface is that of its middle, from which the peak is some distance away: sigma
    contains both.
    """
    estimate = estimate_of(peaks, looks, beams, settings)
    estimate = estimate.with_sigma(estimate.sigma * deviation)
    if beams.count == 2:
        return in_two_channels(estimate, peaks, looks, beams, settings)
    judged = resolve(estimate, peaks, looks, beams, settings) if settings.layover else estimate
    return where_single(judged, estimate.elevation, np.hypot(judged.sigma, estimate.elevation - judged.elevation))
