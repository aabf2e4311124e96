"""Heights from several passes over the same ground: each pass is a channel of a sparse array in elevation.

Read `flown` first (the phase history of a pass, and which passes go together), then `array` (ranges become phases: the
response of the passes to a point at any elevation, as `Beams` that all estimators take, and heights that they confuse),
`boxes` (the volume in pieces that one response is valid for, and their images in register), `tie` (errors of position
and phase between passes, from bright points), `points` (heights of bright points) and `heights` (all steps).
"""

from sal_height.passes.array import Ambiguity, PassArray, Steering, ambiguity_of
from sal_height.passes.boxes import Box, Lattice, registered
from sal_height.passes.flown import GOTCHA_ELEVATIONS, LEAST_PASSES, Circle, Pass, simulated_passes, together
from sal_height.passes.heights import ESTIMATORS_OF_PASSES, OF_POINTS, PassHeights, ReferencePoint, heights_from_passes
from sal_height.passes.points import PointHeights
from sal_height.passes.settings import PassSettings
from sal_height.passes.tie import Tie

__all__ = [
    "ESTIMATORS_OF_PASSES",
    "GOTCHA_ELEVATIONS",
    "LEAST_PASSES",
    "OF_POINTS",
    "Ambiguity",
    "Box",
    "Circle",
    "Lattice",
    "Pass",
    "PassArray",
    "PassHeights",
    "PassSettings",
    "PointHeights",
    "ReferencePoint",
    "Steering",
    "Tie",
    "ambiguity_of",
    "heights_from_passes",
    "registered",
    "simulated_passes",
    "together",
]
