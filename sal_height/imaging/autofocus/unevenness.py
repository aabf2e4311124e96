"""How far uneven ground may move the Doppler centroid, from the periodograms of the echo.

What is uneven in some range cells and not in others shows in how far each of them would move it. What is uneven in all
of them alike shows in how unlike the beam their spectrum is. Ground that grows brighter along the flight moves the
centroid, and the spectrum hardly tells: the power of a beam that is nearly Gaussian, times exp(slope x azimuth), is the
same beam elsewhere. But ground is rarely brighter by a slope alone. Over the main lobe, -1 <= u <= 1, let the logarithm
of its brightness be a sum of Legendre's polynomials c_k P_k(u). For steps anywhere, as at the edge of a road or of a
shadow, c_k is (2 k + 1) / 2 times the integral of P_k from the step on, and has the variance

    (1 / (2 k - 1) + 1 / (2 k + 3)) / 4

for steps of variance 1. So c_2 to c_6, which hardly any shift of the beam makes, tell how large c_1 may be.
"""

from __future__ import annotations

import numpy as np

from sal_height.imaging.autofocus.coherence import Coherence, periodograms
from sal_height.numeric import F32, F64, Complex

BLOCKS = 12  # of neighbouring range cells, each of which is taken to be uneven in its own way
MAIN_LOBE = 0.03  # least power of the beam over its greatest where the spectrum is looked at
DARKEST = 0.01  # least brightness over that of even ground that a spectrum tells
ORDERS = np.arange(1, 7)  # of the polynomials


def uneven_trend(modes: Complex, snr: F64, coherence: Coherence) -> float:
    """Standard deviation of the trend from pulse to pulse by uneven ground, rad.

    Args:
        modes: responses without the phases of the pulses, in the middle of the beam, shape (responses, pulses), in the
            order of their range cells.
        snr: of each response, shape (responses,).
        coherence: of the echo of even ground.
    """
    found, even = periodograms(modes), 1 + np.outer(snr, coherence.spectrum)
    share = 1 - 1 / even  # of the echo in the power
    slope = share * np.gradient(np.log(coherence.spectrum))
    information = np.sum(slope**2)
    # Uneven in some: by what each would move the beam (Huber's sandwich; periodograms are independent, Whittle 1953).
    scores = np.sum((found / even - 1) * slope, axis=-1)
    by_blocks = np.sqrt(np.sum(np.bincount(np.arange(len(snr)) * BLOCKS // len(snr), scores, BLOCKS) ** 2))
    # Uneven in all alike: by what ground that grows brighter along the flight would move it.
    lobe = np.flatnonzero(coherence.profile >= MAIN_LOBE * coherence.profile.max())
    u = np.interp(np.arange(len(coherence.profile)), lobe[[0, -1]], [-1.0, 1.0])
    by_all = _brighter_by(found[:, lobe], snr, coherence.spectrum[lobe], u[lobe]) * np.sum(share * slope * u)
    return float(np.hypot(by_blocks, by_all) / information * 2 * np.pi / len(u))


def _brighter_by(found: F32, snr: F64, spectrum: F64, u: F64) -> float:
    """Standard deviation of c_1, by the orders that tell it."""
    # Responses far above noise count alike.
    weight = 1 / (1 + snr)
    brightness = (weight @ found - weight.sum()) / ((weight @ snr) * spectrum)
    shapes, by_power = np.polynomial.legendre.legvander(u, ORDERS[-1]), np.sqrt(spectrum)
    logarithm = np.log(np.maximum(brightness, DARKEST))
    of_orders = np.linalg.lstsq(shapes * by_power[:, None], logarithm * by_power)[0][1:]
    of_step = (1 / (2 * ORDERS - 1) + 1 / (2 * ORDERS + 3)) / 4
    return float(np.sqrt(of_step[0] * np.mean(of_orders[1:] ** 2 / of_step[1:])))
