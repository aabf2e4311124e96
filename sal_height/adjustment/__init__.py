"""Dwells adjusted to each other: errors of navigation and mounting, from height images that overlap.

Read `adjustment` first (the way through), then `observed` (how errors move what a dwell shows), `matching` (how far two
images of the same ground lie apart), `drift` (how errors of navigation develop), `equations` (least squares),
`reference` (known ground) and `corrected` (the trajectory that results).
"""

from sal_height.adjustment.adjustment import Adjustment, adjust
from sal_height.adjustment.corrected import corrected_mounting, corrected_states
from sal_height.adjustment.drift import Stated
from sal_height.adjustment.matching import LEAST_POINTS, Points
from sal_height.adjustment.observed import BORESIGHT, DELAY, LEVER_ARM, PITCH, ObservedDwell, stated_sigmas
from sal_height.adjustment.reference import UNKNOWN_GROUND, References, Target, Terrain
from sal_height.adjustment.settings import AdjustmentSettings

__all__ = [
    "BORESIGHT",
    "DELAY",
    "LEAST_POINTS",
    "LEVER_ARM",
    "PITCH",
    "UNKNOWN_GROUND",
    "Adjustment",
    "AdjustmentSettings",
    "ObservedDwell",
    "Points",
    "References",
    "Stated",
    "Target",
    "Terrain",
    "adjust",
    "corrected_mounting",
    "corrected_states",
    "stated_sigmas",
]
