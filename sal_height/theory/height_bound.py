"""Cramér-Rao bound of the height in each pixel of a simulated scene."""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation import speckle_crb
from sal_height.numeric import F64
from sal_height.simulation import Truth


def height_crb(truth: Truth, cnr: float, looks: int, beams: Beams, squint: F64, height_slope: F64) -> F64:
    """Return the speckle-averaged Cramer-Rao bound of height (m) in each pixel: `speckle_crb` times |dh/dtheta|.

    Infinite for one look, for which a fluctuating target has no efficient estimator.

    Args:
        truth: elevation and power of the pixels.
        cnr: power ratio of a pixel of power 1 in a detector that looks straight at it.
        looks: number of looks K.
        beams: of the detectors.
        squint: of each column, rad.
        height_slope: dh/dtheta, m/rad, shape (rows, cols).
    """
    with np.errstate(invalid="ignore"):  # where there is nothing
        return np.abs(height_slope) * speckle_crb(beams, truth.elevation, squint, cnr * truth.power, looks)
