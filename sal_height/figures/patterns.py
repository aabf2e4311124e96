"""Figures 3, 4, 8 and 9 of the SAL paper: a pair of detectors over elevation, and elevation over its discriminant.

Figures 8 and 9 have detectors of DETECTOR_SIZE behind a circular aperture, on an axis turned by psi from elevation; an
edge of the beam is half a beamwidth from its centre.

Closed forms are integrals over aperture and detectors by Gauss-Legendre quadrature, without the code that estimators
use. Patterns of an aperture contain no more than half a cycle per beamwidth, so that a few nodes are exact to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.optimize.elementwise import find_root
from scipy.special import j1

from sal_height.beams import GAUSSIAN_WIDTH, Beams, detector_pattern, pattern_named
from sal_height.elevation import discriminant, invert
from sal_height.figures.curve import Curve, exact_curve
from sal_height.figures.unit_arrays import array_of
from sal_height.numeric import F64

Amplitude = Callable[[F64, F64], F64]
Amplitudes = Callable[[F64], tuple[F64, F64]]

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


def passed_over(pair: ReferencePair, centre: float) -> Amplitudes:
    """Amplitudes, by elevation, of lower and upper detector averaged over a beamwidth of azimuth around `centre`."""
    azimuth, weights = nodes_between(centre - 0.5, centre + 0.5, DETECTOR_NODES)

    def amplitudes(elevation: F64) -> tuple[F64, F64]:
        lower, upper = pair.lower_and_upper(elevation[..., None], azimuth)
        return lower @ weights, upper @ weights

    return amplitudes


def elevations_with(amplitudes: Amplitudes, mu: F64) -> F64:
    """Elevations near the middle whose discriminant (upper - lower) / (upper + lower) is `mu`; inf if not found."""

    def excess(elevation: F64, mu: F64) -> F64:
        lower, upper = amplitudes(elevation)
        return (upper - lower) / (upper + lower) - mu

    reach = 0.95  # beamwidths from the middle, where the discriminant is 0.9 or more
    ends = np.full_like(mu, -reach), np.full_like(mu, reach)
    found = find_root(excess, ends, args=(mu,), tolerances={"xatol": 1e-13, "xrtol": 0.0})
    return np.where(found.success, found.x, np.inf)


ELEVATIONS = np.linspace(-1, 1, 81)
"""Elevations that are drawn, beamwidths."""

FROM_PUPIL = {"gaussian": gaussian_from_pupil, "sinc": sinc_from_pupil, "jinc": jinc_from_pupil}

DETECTOR_SIZE = (0.6, 1.2)
"""Size of the detectors in figure 4 in elevation and azimuth, beamwidths; they touch."""


def fig3() -> Iterator[Curve]:
    """Point detectors half a beamwidth apart behind three apertures, with integrals over those apertures."""
    pitch = 0.5
    for colour, (name, cut) in enumerate(FROM_PUPIL.items()):
        reference = ReferencePair(lambda e, _a, cut=cut: cut(e), pitch, 0.0)  # type: ignore[misc]
        pair = array_of((pattern_named(name),), 2, pitch)
        yield from _curves(name, colour, pair, reference)


def fig4() -> Iterator[Curve]:
    """Points and detectors of some size behind a circular aperture, with integrals over aperture and detectors."""
    pitch = DETECTOR_SIZE[0]
    point = ReferencePair(lambda e, _a: jinc_from_pupil(e), pitch, 0.0)
    yield from _curves("point detectors", 0, array_of((pattern_named("jinc"),), 2, pitch), point)
    sized = ReferencePair(seen_by(jinc, DETECTOR_SIZE), pitch, 0.0)
    pair = array_of((detector_pattern("jinc", DETECTOR_SIZE),), 2, pitch)
    yield from _curves("0.6 x 1.2 detectors", 1, pair, sized)


def _curves(case: str, colour: int, pair: Beams, reference: ReferencePair) -> Iterator[Curve]:
    """Sum, difference and discriminant of a pair, as the estimators have it and as the reference has it."""
    lower, upper = np.moveaxis(pair.response(ELEVATIONS, 0.0), -1, 0)
    reference_lower, reference_upper = reference.lower_and_upper(ELEVATIONS, 0.0)
    ratio = (reference_upper - reference_lower) / (reference_upper + reference_lower)
    for quantity, kind, style, value, closed_form in (
        ("amplitude", "sum", "-", upper + lower, reference_upper + reference_lower),
        ("amplitude", "difference", "--", upper - lower, reference_upper - reference_lower),
        ("discriminant", "", "-", discriminant(pair, ELEVATIONS, 0.0), ratio),
    ):
        name = f"{kind}, {case}" if kind else case
        yield exact_curve(quantity, name, ELEVATIONS, value, closed_form, style, colour)


RATIOS = np.linspace(-0.9, 0.9, 37)
"""Discriminants at which elevations are drawn."""

ROTATIONS_DEG = (0, 15)
"""Rotations psi of the detector axis, degrees."""

AZIMUTHS = {"beam centre": 0.0, "upper beam edge": 0.5, "lower beam edge": -0.5}
"""Along-track angle of a target in spotlight, and of the Doppler centroid processed in stripmap; beamwidths."""


def fig8() -> Iterator[Curve]:
    """Compute figure 8: in spotlight the target keeps its position in the beam."""
    for rotation in ROTATIONS_DEG:
        pair, reference = _pair(rotation), _reference(rotation)
        for place, azimuth in AZIMUTHS.items():
            amplitudes = partial(reference.lower_and_upper, azimuth=azimuth)
            yield _curve(f"psi {rotation} deg, {place}", pair, azimuth, amplitudes)


def fig9() -> Iterator[Curve]:
    """Compute figure 9: in stripmap targets pass through the beam, half a beamwidth to each side."""
    for rotation in ROTATIONS_DEG:
        pair, reference = _pair(rotation), _reference(rotation)
        for place, centroid in AZIMUTHS.items():
            # 16 nodes of the mean over the passing beam suffice, because the patterns vary slowly.
            passing = pair.averaged(*nodes_between(centroid - 0.5, centroid + 0.5, 16))
            yield _curve(f"psi {rotation} deg, centroid at {place}", passing, 0.0, passed_over(reference, centroid))


def _pair(rotation_deg: float) -> Beams:
    patterns = (detector_pattern("jinc", DETECTOR_SIZE),)
    return array_of(patterns, 2, DETECTOR_SIZE[0], math.radians(rotation_deg))


def _reference(rotation_deg: float) -> ReferencePair:
    return ReferencePair(seen_by(jinc, DETECTOR_SIZE), DETECTOR_SIZE[0], math.radians(rotation_deg))


def _curve(case: str, pair: Beams, squint: float, amplitudes: Amplitudes) -> Curve:
    """Compute elevation over the discriminant by the exact inversion, which the estimators tabulate."""
    elevation = invert(pair, RATIOS, squint).elevation
    style, colour = "--" if "edge" in case else "-", 0 if pair.rotation == 0 else 3
    return exact_curve("elevation", case, RATIOS, elevation, elevations_with(amplitudes, RATIOS), style, colour)
