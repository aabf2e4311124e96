"""How far uneven ground may move the Doppler centroid, from how unlike the beam the spectrum of the echo is.

Ground that grows brighter along the flight moves the centroid, and the spectrum hardly tells: the power of a beam that
is nearly Gaussian, times exp(slope x azimuth), is the same beam elsewhere. But ground is rarely brighter by a slope
alone. Over the main lobe, -1 <= u <= 1, let the logarithm of its brightness be a sum of Legendre's polynomials
c_k P_k(u). For steps anywhere, as at the edge of a road or of a shadow, c_k is (2 k + 1) / 2 times the integral of P_k
from the step on, and has the variance

    (1 / (2 k - 1) + 1 / (2 k + 3)) / 4

for steps of variance 1. So c_2 to c_6, which hardly any shift of the beam makes, tell how large c_1 may be.
"""

from __future__ import annotations

import numpy as np

from sal_height.imaging.autofocus.coherence import Coherence
from sal_height.numeric import F64, Complex

MAIN_LOBE = 0.1  # least power of the beam over its greatest where the spectrum is looked at
DARKEST = 0.01  # least brightness over that of even ground that a spectrum tells
ORDERS = np.arange(1, 7)  # of the polynomials


def uneven_trend(modes: Complex, snr: F64, coherence: Coherence) -> float:
    """Standard deviation of the trend from pulse to pulse by uneven ground, rad.

    Args:
        modes: responses without the phases of the pulses, in the middle of the beam, shape (responses, pulses).
        snr: of each response, shape (responses,).
        coherence: of the echo of even ground.
    """
    lobe = coherence.profile >= MAIN_LOBE * coherence.profile.max()
    profile = coherence.profile[lobe]
    logarithm = np.log(_brightness(modes, snr, coherence.waves[:, lobe], coherence.spectrum[lobe]))
    u, by_power = np.linspace(-1.0, 1.0, len(profile)), np.sqrt(profile)
    shapes = np.polynomial.legendre.legvander(u, ORDERS[-1])
    found = np.linalg.lstsq(shapes * by_power[:, None], logarithm * by_power)[0][1:]
    of_step = (1 / (2 * ORDERS - 1) + 1 / (2 * ORDERS + 3)) / 4
    slope = np.sqrt(of_step[0] * np.mean(found[1:] ** 2 / of_step[1:]))
    # A shift by one azimuth changes the logarithm of the beam by its derivative, the trend by 2 pi / azimuths.
    derivative = np.gradient(np.log(profile))
    shift = slope * abs(np.sum(profile * u * derivative)) / np.sum(profile * derivative**2)
    return float(shift * 2 * np.pi / len(coherence.profile))


def _brightness(modes: Complex, snr: F64, waves: Complex, even: F64) -> F64:
    """Power of the echo from azimuths over that of even ground; responses far above noise count alike."""
    weight = 1 / (1 + snr)
    power = weight @ np.abs(modes @ waves.conj().astype(modes.dtype)) ** 2
    return np.maximum((power - len(waves) * weight.sum()) / ((weight @ snr) * even), DARKEST)
