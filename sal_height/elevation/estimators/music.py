"""Elevation by MUSIC: the direction whose response lies nearest to the strongest eigenvectors of the covariance.

The eigenvectors of the `order` greatest eigenvalues span the signal subspace, the others E_n the noise subspace; the
peak is that of 1 / (u^H E_n E_n^H u) with the unit response u = a / |a| (Schmidt, IEEE Trans. Antennas and Propagation
34, 1986). Of order 1 its asymptotic variance is the stochastic Cramer-Rao bound (Stoica and Nehorai, IEEE Trans.
Acoustics, Speech and Signal Processing 37, 1989, eq. 3.12 for one source), as is that of maximum likelihood.
"""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate
from sal_height.elevation.array.likelihood import ArraySettings, estimate_of, peaks_by_spectrum
from sal_height.elevation.layover.two_channels import in_two_channels
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.errors import UserError
from sal_height.numeric import F64
from sal_height.sensor import MAX_DETECTORS
from sal_height.settings import setting


class MusicSettings(ArraySettings):
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
    estimate = estimate_of(peaks, looks, beams, settings)
    estimate = estimate.with_sigma(estimate.sigma / np.sqrt(1 - (order - 1) / (count - 1)))
    return in_two_channels(estimate, peaks, looks, beams, settings) if count == 2 else estimate
