"""Position of an image along the flight, as far as the Doppler of pulses leaves it ambiguous.

Pulses at the rate PRF give the direction of the beams along the flight up to multiples of wavelength PRF / (2 speed).
Attitude and boresight choose one of these. Where they are not known well enough, the image may lie a multiple of range
times that ahead of its true position or behind it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.geometry import shift_along
from sal_height.imaging.autofocus.placement import NavigationPrior
from sal_height.imaging.focus import Slc
from sal_height.imaging.pixels import line_of_sight
from sal_height.numeric import F64
from sal_height.sensor import Sensor


def with_ambiguous_position(slc: Slc, sensor: Sensor, stated: F64) -> Slc:
    """Images with the ambiguity of their position along the flight in the covariance of the pose.

    Where the direction of the beams is known far better than the ambiguity, they are the same images.

    Args:
        slc: images, with all that is known and assumed in the covariance of their pose.
        sensor: sensor of the images, with its mounting.
        stated: covariance of the pose that decided on their placement, shape (6, 6). Autofocus has taken its ambiguity
            into account.
    """
    if slc.placement.by_beams:  # where the whole error of the pointing counts
        return slc
    sight, speed = line_of_sight(sensor, slc.aperture), float(np.linalg.norm(slc.aperture.velocity))
    ambiguity = sensor.wavelength * sensor.pulse_repetition_frequency / (2 * speed)
    pointing = _pointing(slc, sight, slc.aperture.covariance)
    variance = wrapped_variance(pointing, ambiguity)
    if slc.placement.centroid is not None:
        variance -= wrapped_variance(_pointing(slc, sight, stated), ambiguity)
    if not variance > 0:
        return slc
    slant_range = float(np.linalg.norm(slc.grid.middle - slc.aperture.position))
    along = slant_range * shift_along(slc.aperture, sight)
    covariance = np.array(slc.aperture.covariance)
    covariance[:3, :3] += variance * np.outer(along, along)
    return replace(slc, aperture=replace(slc.aperture, covariance=covariance))


def wrapped_variance(pointing: float, ambiguity: float) -> float:
    """Variance of the multiple of an ambiguity (rad) that a pointing of this standard deviation (rad) leaves, rad^2."""
    if pointing < ambiguity / 8:  # one of 10^14 is another multiple
        return 0.0
    if pointing > 10 * ambiguity:  # the sum is that of all angles
        return pointing**2
    multiples = ambiguity * np.arange(1, 100)
    weights = np.exp(-(multiples**2) / (2 * pointing**2))
    return float(2 * np.sum(weights * multiples**2) / (1 + 2 * np.sum(weights)))


def _pointing(slc: Slc, sight: F64, covariance: F64) -> float:
    return NavigationPrior.of(replace(slc.aperture, covariance=covariance), np.zeros((3, 3)), sight).pointing
