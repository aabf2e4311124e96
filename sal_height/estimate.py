"""What every elevation estimator returns, and the reasons a pixel has no height."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Validity(IntEnum):
    """Why a pixel has no height; the same values as the constants of sal_height_msgs/HeightImage."""

    OK = 0
    LOW_CNR = 1
    OUTSIDE_ARRAY = 2
    OUTSIDE_PAIR = 3
    NOT_ONE_SCATTERER = 4
    MISSING_DATA = 5


@dataclass(frozen=True)
class ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel; all arrays have the shape (rows, cols) of the looks.

    Attributes:
        elevation: rad from nadir in body axes.
        sigma: standard deviation of elevation, rad; infinite where there is no signal.
        cnr: carrier-to-noise power ratio of one look in a hypothetical detector looking straight at the scatterer.
        validity: `Validity` of each pixel, uint8.
    """

    elevation: Array
    sigma: Array
    cnr: Array
    validity: npt.NDArray[np.uint8]
