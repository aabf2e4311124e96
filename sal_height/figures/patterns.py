"""Figures 3 and 4 of the SAL paper: sum and difference of a pair and their ratio, over elevation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sal_height.beams import Beams, detector_pattern, pattern_named
from sal_height.elevation import discriminant
from sal_height.figures.curve import Curve, exact_curve
from sal_height.figures.pair_quadrature import (
    ReferencePair,
    gaussian_from_pupil,
    jinc,
    jinc_from_pupil,
    seen_by,
    sinc_from_pupil,
)
from sal_height.figures.unit_arrays import array_of

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
