"""Effect of a random phase of the pulses on the image of an aperture, averaged over many apertures.

A trend of the phase moves the image along the flight: by range over speed times a velocity along the line of sight of
the trend times wavelength / 4 pi. The rest of a phase, of the standard deviation s, spreads 1 - exp(-s^2) of the energy
of each target over other pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import simpson
from scipy.special import spherical_jn

from sal_height.numeric import F64


@dataclass(frozen=True)
class AperturePhase:
    """A phase over an aperture.

    Attributes:
        trend: rms slope over time by least squares, rad/s.
        rest: rms without mean and trend, rad.
    """

    trend: float
    rest: float

    @property
    def spread_share(self) -> float:
        """Fraction of the energy of a target that is not in its pixel."""
        return -float(np.expm1(-(self.rest**2)))


def phase_of_line(amplitude: float, omega: float, duration: float) -> AperturePhase:
    """Phase of a sinusoid of random phase, such as a vibration.

    Over an aperture of the duration T, exp(j omega t) has the coefficients (2 k + 1) j^k j_k(omega T / 2) in Legendre's
    polynomials (Abramowitz & Stegun, 10.1.47), whose mean squares are 1 / (2 k + 1).

    Args:
        amplitude: amplitude of the sinusoid, rad.
        omega: angular frequency, rad/s.
        duration: duration of the aperture, s.
    """
    mean, trend = (float(spherical_jn(order, omega * duration / 2)) for order in (0, 1))
    rest = max(0.0, 1 - mean**2 - 3 * trend**2)
    return AperturePhase(abs(amplitude * 3 * trend) * 2 / duration / np.sqrt(2), amplitude * np.sqrt(rest / 2))


def phase_of_structure(structure: Callable[[F64], F64], duration: float) -> AperturePhase:
    """Phase with stationary increments, from its structure function D.

    The least-squares trend is the sum of the phase weighted by w(t) = 12 t / T^3 over |t| < T / 2. The weights have the
    sum 0, so that its variance is -1/2 of the double integral of w(t) w(s) D(|t - s|), and the variance about the mean
    is half the mean of D over all pairs.

    Args:
        structure: mean squared difference of the phases (rad^2) as a function of the time between them (s).
        duration: duration T of the aperture, s.
    """
    # Nodes are dense at short lags, where structure functions of lasers bend.
    node = np.linspace(0.0, 1.0, 40_001)
    lag = node**3
    of_pairs = structure(lag * duration) * 3 * node**2
    rest = 0.5 - lag
    weights = rest**3 / 3 + lag * rest**2 / 2 + 1 / 24 - lag / 8  # autocorrelation of w, over 144 / T^3
    trend2 = max(0.0, -144 / duration**2 * float(simpson(weights * of_pairs, x=node)))
    about_mean = float(simpson((1 - lag) * of_pairs, x=node))
    return AperturePhase(float(np.sqrt(trend2)), float(np.sqrt(max(0.0, about_mean - trend2 * duration**2 / 12))))


def sum_of_phases(phases: Iterable[AperturePhase]) -> AperturePhase:
    """Phase of the sum of independent phases."""
    found = list(phases)
    return AperturePhase(
        float(np.sqrt(sum(one.trend**2 for one in found))), float(np.sqrt(sum(one.rest**2 for one in found)))
    )
