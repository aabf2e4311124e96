"""Dwells adjusted to each other: errors of navigation and mounting, from height images that overlap.

Read `adjustment` first (the way through), then `observed` (how errors move what a dwell shows), `comparing` and
`matching` (which images of the same ground are compared, and how far they lie apart), `drift` (how errors of navigation
develop), `network` and `equations` (least squares), `known_ground` and `targets` (known ground) and `corrected` (the
trajectory and the heights that result). `window` does the same for a flight in progress.
"""

from sal_height.adjustment.adjustment import Adjustment, adjust, describe_ground
from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.corrected import (
    corrected_aperture,
    corrected_heights,
    corrected_mounting,
    corrected_states,
    mounting_covariance,
)
from sal_height.adjustment.drift import PulseTrack, Stated
from sal_height.adjustment.known_ground import UNKNOWN_GROUND, References, Target, Terrain
from sal_height.adjustment.matching import LEAST_POINTS, Points
from sal_height.adjustment.observed import (
    BORESIGHT,
    ObservedDwell,
    placement_in_strip,
    stated_sigmas,
)
from sal_height.adjustment.targets import read_targets
from sal_height.adjustment.window import MOST_POINTS, AdjustmentWindow, PoseError

__all__ = [
    "BORESIGHT",
    "LEAST_POINTS",
    "MOST_POINTS",
    "UNKNOWN_GROUND",
    "Adjustment",
    "AdjustmentSettings",
    "AdjustmentWindow",
    "ObservedDwell",
    "Points",
    "PoseError",
    "PulseTrack",
    "References",
    "Stated",
    "Target",
    "Terrain",
    "adjust",
    "corrected_aperture",
    "corrected_heights",
    "corrected_mounting",
    "corrected_states",
    "describe_ground",
    "mounting_covariance",
    "placement_in_strip",
    "read_targets",
    "stated_sigmas",
]
