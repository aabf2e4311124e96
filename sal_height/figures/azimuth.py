"""Figures 8 and 9 of the SAL paper: elevation over the discriminant along the flight, in spotlight and in stripmap.

Detectors of 0.6 x 1.2 beamwidths that touch, behind a circular aperture, on an axis turned by psi from elevation. An
edge of the beam is half a beamwidth from its centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from sal_height.beams import Beams, detector_pattern
from sal_height.elevation import invert
from sal_height.figures.curve import Curve, exact_curve
from sal_height.figures.pair_quadrature import (
    ReferencePair,
    elevations_with,
    jinc,
    nodes_between,
    passed_over,
    seen_by,
)
from sal_height.figures.patterns import DETECTOR_SIZE
from sal_height.figures.unit_arrays import array_of
from sal_height.numeric import F64

Amplitudes = Callable[[F64], tuple[F64, F64]]

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
