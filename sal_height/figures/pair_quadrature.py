"""Amplitudes of a pair of detectors by quadrature, without the code that estimators use.

Quadrature is Gauss and Legendre's. Patterns of an aperture contain no more than half a cycle per beamwidth, so that a
few nodes are exact to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize.elementwise import find_root
from scipy.special import j1

from sal_height.beams import GAUSSIAN_WIDTH
from sal_height.numeric import F64

Amplitude = Callable[[F64, F64], F64]

PUPIL_NODES = 64
"""Quadrature nodes of integrals over an aperture."""

DETECTOR_NODES = 14
"""Quadrature nodes of integrals over a detector's width and over an aperture's aspects."""


def nodes_between(low: float, high: float, count: int) -> tuple[F64, F64]:
    """Nodes and weights (sum 1) whose weighted sum is the mean between `low` and `high`; shapes (count,)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (low + high) / 2 + (high - low) / 2 * nodes, weights / 2


def sinc_from_pupil(e: F64) -> F64:
    """Cut of the square aperture's pattern at `e` beamwidths: mean of exp(2 pi j u e) over its side."""
    u, weights = nodes_between(-0.5, 0.5, PUPIL_NODES)
    return np.cos(2 * np.pi * e[..., None] * u) @ weights


def jinc_from_pupil(e: F64) -> F64:
    """Cut of the circular aperture's pattern: its chords sqrt(1/4 - u^2) weight exp(2 pi j u e); u = 1/2 sin tau."""
    tau, weights = nodes_between(-np.pi / 2, np.pi / 2, PUPIL_NODES)
    return 2 * np.cos(np.pi * e[..., None] * np.sin(tau)) @ (weights * np.cos(tau) ** 2)


def gaussian_from_pupil(e: F64) -> F64:
    """Cut of the pattern of a Gaussian aperture field, exp(-2 (pi w u)^2), in effect of no edge; trapezoids."""
    width = 1 / (2 * np.pi * GAUSSIAN_WIDTH)
    u = np.linspace(-10, 10, 401) * width
    field = np.exp(-((u / width) ** 2) / 2)
    return np.cos(2 * np.pi * e[..., None] * u) @ (field / field.sum())


def jinc(e: F64, a: F64) -> F64:
    """Pattern of the circular aperture, 2 J1(pi r) / (pi r), for r > 0."""
    x = np.pi * np.hypot(e, a)
    return 2 * j1(x) / x


@dataclass(frozen=True)
class ReferencePair:
    """Two detectors around 0; all angles in beamwidths.

    Attributes:
        amplitude: amplitude of a detector as a function of the offsets along and across its axis.
        pitch: pitch of the detectors.
        rotation: angle of their axis from elevation towards the direction of flight, rad.
    """

    amplitude: Amplitude
    pitch: float
    rotation: float

    def lower_and_upper(self, elevation: F64, azimuth: npt.ArrayLike) -> tuple[F64, F64]:
        """Amplitudes of the lower and the upper detector; the angles broadcast."""
        azimuth = np.asarray(azimuth)
        along = elevation * math.cos(self.rotation) + azimuth * math.sin(self.rotation)
        beside = azimuth * math.cos(self.rotation) - elevation * math.sin(self.rotation)
        return self.amplitude(along + self.pitch / 2, beside), self.amplitude(along - self.pitch / 2, beside)


def seen_by(point: Amplitude, size: tuple[float, float]) -> Amplitude:
    """The amplitude of a detector of `size` (along and across its axis): the mean of `point` over its area."""
    along, along_weights = nodes_between(-size[0] / 2, size[0] / 2, DETECTOR_NODES)
    beside, beside_weights = nodes_between(-size[1] / 2, size[1] / 2, DETECTOR_NODES)

    def amplitude(e: F64, a: F64) -> F64:
        values = point(e[..., None, None] + along[:, None], np.asarray(a)[..., None, None] + beside)
        return np.einsum("...ij,i,j->...", values, along_weights, beside_weights)

    return amplitude


def passed_over(pair: ReferencePair, centre: float) -> Callable[[F64], tuple[F64, F64]]:
    """Amplitudes, by elevation, of lower and upper detector averaged over a beamwidth of azimuth around `centre`."""
    azimuth, weights = nodes_between(centre - 0.5, centre + 0.5, DETECTOR_NODES)

    def amplitudes(elevation: F64) -> tuple[F64, F64]:
        lower, upper = pair.lower_and_upper(elevation[..., None], azimuth)
        return lower @ weights, upper @ weights

    return amplitudes


def elevations_with(amplitudes: Callable[[F64], tuple[F64, F64]], mu: F64) -> F64:
    """Elevations near the middle whose discriminant (upper - lower) / (upper + lower) is `mu`; inf if not found."""

    def excess(elevation: F64, mu: F64) -> F64:
        lower, upper = amplitudes(elevation)
        return (upper - lower) / (upper + lower) - mu

    reach = 0.95  # beamwidths from the middle, where the discriminant is 0.9 or more
    ends = np.full_like(mu, -reach), np.full_like(mu, reach)
    found = find_root(excess, ends, args=(mu,), tolerances={"xatol": 1e-13, "xrtol": 0.0})
    return np.where(found.success, found.x, np.inf)
