"""A target at a known position, such as a corner reflector, in the images of dwells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sal_height.calibration.calibration_settings import DEFAULTS, CalibrationSettings
from sal_height.geometry import ApertureState, Grid, angles_of, aperture_at, pixels_at
from sal_height.numeric import C64, C128, F64


class Sighting(NamedTuple):
    """A reference target in the images of a dwell.

    Attributes:
        samples: pixel of the target in each channel, complex128, shape (channels,).
        elevation: elevation of the line of sight, rad from nadir.
        squint: squint of the line of sight, rad.
    """

    samples: C128
    elevation: float
    squint: float


def find_reference_target(
    pixels: C64,
    grid: Grid,
    aperture: ApertureState,
    look_side: int,
    target: F64,
    settings: CalibrationSettings = DEFAULTS,
) -> Sighting | None:
    """Find the reference target in the images of a dwell; None: it is not in them, or does not stand out.

    Args:
        pixels: pixels of all channels, shape (channels, rows, cols).
        grid: positions of the pixels, in the slant plane.
        aperture: aperture of the images.
        look_side: +1 looking right, -1 left.
        target: position in the map, m, shape (3,).
        settings: search distance, and least brightness.
    """
    sight = target - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.maximum(sight @ sight - along**2, 0.0))
    row, col = (int(np.rint(index)) for index in pixels_at(across, along, aperture, grid))
    (rows, cols), reach = pixels.shape[1:], settings.target_reach
    if not (reach <= row < rows - reach and reach <= col < cols - reach):
        return None
    power = np.sum(pixels.real**2 + pixels.imag**2, axis=0)
    near = power[row - reach : row + reach + 1, col - reach : col + reach + 1]
    if not near.max() > 10 ** (settings.target_over_image_db / 10) * np.median(power):
        return None
    down, right = np.unravel_index(np.argmax(near), near.shape)
    _, elevation, squint = angles_of(target, aperture_at(target, aperture), look_side)
    samples = pixels[:, row - reach + int(down), col - reach + int(right)].astype(np.complex128)
    return Sighting(samples, float(elevation), float(squint))
