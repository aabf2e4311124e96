"""Movers in the images of a strip, or of successive dwells.

Read `likelihood` first, which both searches share. For strips read `strip_detection`, then `detection`, `courses`,
`search`, `spectrum` and `migration`; for dwells read `dwell_detection`, then `dwell_search`, `dwell_paths` and
`dwell_images`.
"""

from sal_height.movers.detection import MoverSettings, check_sensor, search_strip
from sal_height.movers.dwell_detection import ALONE, DwellMovers, ShownDwell
from sal_height.movers.dwell_images import DwellImage
from sal_height.movers.mover import Blind, Looked, Mover
from sal_height.movers.strip_detection import StripImage, StripMovers

__all__ = [
    "ALONE",
    "Blind",
    "DwellImage",
    "DwellMovers",
    "Looked",
    "Mover",
    "MoverSettings",
    "ShownDwell",
    "StripImage",
    "StripMovers",
    "check_sensor",
    "search_strip",
]
