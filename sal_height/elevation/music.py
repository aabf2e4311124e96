"""Elevation by MUSIC: the direction whose response lies nearest to the strongest eigenvectors of the covariance.

The eigenvectors of the `order` greatest eigenvalues span the signal subspace, the others E_n the noise subspace; the
peak is that of 1 / (u^H E_n E_n^H u) with the unit response u = a / |a| (Schmidt, IEEE Trans. Antennas and Propagation
34, 1986). Of order 1 its asymptotic variance is the stochastic Cramer-Rao bound (Stoica and Nehorai, IEEE Trans.
Acoustics, Speech and Signal Processing 37, 1989, eq. 3.12 for one source), as is that of maximum likelihood.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.estimate import ElevationEstimate
from sal_height.elevation.likelihood import DEFAULT_ARRAY_RULES, ArrayRules, estimate_at_peak
from sal_height.elevation.looks import Covariance, Looks
from sal_height.errors import UserError
from sal_height.numeric import F64


def music_elevation(
    looks: Looks,
    beams: Beams,
    squint: F64,
    noise_power: float,
    min_cnr: float,
    order: int = 1,
    rules: ArrayRules = DEFAULT_ARRAY_RULES,
) -> ElevationEstimate:
    """Elevation of the highest peak of MUSIC's spectrum in every pixel.

    Of order 2 a second scatterer close by displaces it less, but a single one is estimated with more noise: sigma is
    that of maximum likelihood over sqrt(1 - (order - 1) / (M - 1)), because the additional eigenvectors take so many
    of the M - 1 dimensions in which the response can turn.

    Args:
        looks: covariance of M channels in each pixel.
        beams: of the M detectors.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in every channel.
        min_cnr: pixels below this power ratio are LOW_CNR.
        order: dimensions of the signal subspace, from 1 to M - 1.
        rules: of validity.

    Raises:
        UserError: the order is out of range; or as in `ml_elevation`.
    """
    if not 1 <= order < max(beams.count, 2):
        raise UserError(
            f"The order of MUSIC is {order} with {beams.count} detectors; it must be 1 or more and less than that."
        )

    def spectrum(covariance: Covariance, _count: F64) -> Covariance:
        signal = np.linalg.eigh(covariance)[1][:, :, -order:]
        return signal @ np.swapaxes(signal.conj(), 1, 2)

    estimate = estimate_at_peak(spectrum, looks, beams, squint, noise_power, min_cnr, rules)
    return replace(estimate, sigma=estimate.sigma / np.sqrt(1 - (order - 1) / (beams.count - 1)))
