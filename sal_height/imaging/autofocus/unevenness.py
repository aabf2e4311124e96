"""Error of the Doppler centroid by uneven ground, from the periodograms of the echo.

Unevenness of some range cells and not of others shows in the shift of the centroid by each of them. Unevenness of all
of them alike shows in the deviation of their spectrum from the beam. Ground that grows brighter along the flight moves
the centroid with little change of the spectrum: the power of a beam that is nearly Gaussian, times exp(slope x
azimuth), is the same beam elsewhere. But ground is rarely brighter by a slope alone. Over the main lobe, -1 <= u <= 1,
let the logarithm of its brightness be a sum of Legendre's polynomials c_k P_k(u). For steps anywhere, as at the edge of
a road or of a shadow, c_k is (2 k + 1) / 2 times the integral of P_k from the step on, and has the variance

    (1 / (2 k - 1) + 1 / (2 k + 3)) / 4

for steps of variance 1. So c_2 to c_6, which a shift of the beam hardly changes, give the magnitude of c_1.
"""

from __future__ import annotations

import numpy as np

from sal_height.imaging.autofocus.coherence import Coherence, periodograms
from sal_height.numeric import F32, F64, Complex

MAIN_LOBE = 0.03  # least power of the beam over its greatest where the spectrum is evaluated
ORDERS = np.arange(1, 7)  # of the polynomials


def uneven_trend(modes: Complex, snr: F64, coherence: Coherence) -> float:
    """Standard deviation of the trend from pulse to pulse by uneven ground, rad.

    Args:
        modes: responses without the phases of the pulses, in the middle of the beam, shape (responses, pulses), in the
            order of their range cells.
        snr: signal-to-noise ratio of each response, shape (responses,).
        coherence: coherence of the echo of even ground.
    """
    found, even = periodograms(modes), 1 + np.outer(snr, coherence.spectrum)
    share = 1 - 1 / even  # of the echo in the power
    slope = share * np.gradient(np.log(coherence.spectrum))
    information = np.sum(slope**2)
    # Uneven in some: by the shift of the beam by each (Huber's sandwich; periodograms are independent, Whittle 1953).
    scores = np.sum((found / even - 1) * slope, axis=-1)
    blocks = 12  # of neighbouring range cells, each of which is assumed to be uneven in its own way
    by_blocks = np.sqrt(np.sum(np.bincount(np.arange(len(snr)) * blocks // len(snr), scores, blocks) ** 2))
    # Uneven in all alike: by the shift by ground that grows brighter along the flight.
    lobe = np.flatnonzero(coherence.profile >= MAIN_LOBE * coherence.profile.max())
    u = np.interp(np.arange(len(coherence.profile)), lobe[[0, -1]], [-1.0, 1.0])
    by_all = _brighter_by(found[:, lobe], snr, coherence.spectrum[lobe], u[lobe]) * np.sum(share * slope * u)
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
