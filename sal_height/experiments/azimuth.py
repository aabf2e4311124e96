"""Figures 8 and 9 of the SAL paper: elevation over the discriminant along the flight, in spotlight and in stripmap.

Detectors of 0.6 x 1.2 beamwidths that touch, behind a circular aperture, on an axis turned by psi from elevation. An
edge of the beam is half a beamwidth from its centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.discriminant import invert
from sal_height.experiments.arrays import array_of
from sal_height.experiments.curve import Curve, exact_curve
from sal_height.experiments.patterns import DETECTOR_SIZE
from sal_height.experiments.reference import (
    ReferencePair,
    elevations_with,
    jinc,
    nodes_between,
    passed_over,
    seen_by,
)
from sal_height.optics import detector_pattern

Array = npt.NDArray[np.float64]
Amplitudes = Callable[[Array], tuple[Array, Array]]

RATIOS = np.linspace(-0.9, 0.9, 37)
"""Discriminants."""

ROTATIONS_DEG = (0, 15)
"""psi."""

AZIMUTHS = {"beam centre": 0.0, "upper beam edge": 0.5, "lower beam edge": -0.5}
"""Along-track angle of a target in spotlight, and of the Doppler centroid processed in stripmap; beamwidths."""

ASPECTS = 16
"""Nodes of the mean over the passing beam; the patterns vary slowly."""


def fig8() -> Iterator[Curve]:
    """Spotlight: the target stays where it is in the beam."""

    def beams_at(pair: Beams, _azimuth: float) -> Beams:
        return pair

    def amplitudes_at(reference: ReferencePair, azimuth: float) -> Amplitudes:
        return lambda elevation: reference.lower_and_upper(elevation, azimuth)

    yield from _curves(beams_at, amplitudes_at, squint_of=lambda azimuth: azimuth)
