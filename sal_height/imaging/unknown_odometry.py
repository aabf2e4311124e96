"""Errors of odometry whose accuracy, or motion between samples, nobody states: assumed, and the images are doubted.

What is stated decides on autofocus, checks and the placement of images. What is only assumed covers the error of the
heights: it enters the covariance of the pose once the images are made.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.doubts import Assumption, Doubt, Unknown, doubts_of_assumed
from sal_height.geometry import (
    ASSUMED,
    ASSUMED_ACCELERATION,
    ASSUMED_TURNING,
    ApertureState,
    Motion,
    antenna_covariance,
    rotation_matrix,
    shift_along,
)
from sal_height.imaging.corrections import Corrected
from sal_height.imaging.focus import Slc
from sal_height.imaging.pixels import line_of_sight
from sal_height.numeric import F64

UNKNOWN_ODOMETRY = "odometry of unknown accuracy"
"""Name of the doubt about what samples do not state."""

SPARSE_ODOMETRY = "sparse odometry"
"""Name of the doubt about the motion between samples."""

UNSTATED = Unknown(
    "The odometry does not state how well it is known (a variance is zero, negative or NaN, or all axes have one "
    "number that is no measurement)",
    "in its covariances (0: unknown),",
)

_QUANTITIES = (
    (slice(0, 3), Assumption(f"position {ASSUMED.position_m:g} m", "odometry_position_sigma_m")),
    (slice(3, 5), Assumption(f"roll and pitch {ASSUMED.attitude_rad:g} rad", "odometry_attitude_sigma_rad")),
    (slice(5, 6), Assumption(f"heading {ASSUMED.heading_rad:g} rad", "odometry_heading_sigma_rad")),
    (slice(6, 9), Assumption(f"velocity {ASSUMED.velocity_mps:g} m/s", "odometry_velocity_sigma_mps")),
)
"""What is assumed of odometry, and the place of its axes among those of `geometry.accuracy`."""


def with_unknown_odometry(slc: Slc, dwell: Corrected) -> Slc:
    """Images with the errors in the covariance of their pose that are assumed of odometry, and between its samples.

    They are the same images if all of it is stated, and samples are dense.

    Args:
        slc: images.
        dwell: dwell, or block that completed the images of a strip.
    """
    history, track, sensor, _ = dwell
    of_samples, in_gaps, gap_s = track.assumed(history.stamp_ns, history.pulse_times)
    variances = of_samples + in_gaps
    if not variances.any():
        return slc
    assumed = [what for axes, what in _QUANTITIES if of_samples[axes].any()]
    sparse = [_doubt_of_gap(gap_s, track.motion)] if in_gaps.any() else []
    aperture, sight = slc.aperture, line_of_sight(sensor, slc.aperture)
    orientation = track.nearest(history.stamp_ns, history.pulse_times).orientation
    pose = antenna_covariance(np.diag(variances[:6]), orientation, sensor.mounting)
    # An error of the velocity moves the image along the flight, unless the image was placed by the data.
    speed = _deviation(variances[6:], rotation_matrix(orientation).T @ sight)
    pointing = _deviation(variances[3:6], np.cross(sight, aperture.velocity))
    slant_range = float(history.reference_range[len(history.reference_range) // 2])
    pose[:3, :3] += _moved(slc.placement.residual_speed(speed, pointing), aperture, sight, slant_range)
    return replace(
        slc,
        aperture=replace(aperture, covariance=aperture.covariance + pose),
        doubts=(*slc.doubts, *doubts_of_assumed(UNKNOWN_ODOMETRY, UNSTATED, assumed), *sparse),
    )


def _doubt_of_gap(gap_s: float, motion: Motion) -> Doubt:
    """The doubt about the motion between samples of odometry that are so far apart (s)."""
    acceleration = (
        f"random accelerations of {ASSUMED_ACCELERATION:g} m/s^2/sqrt(Hz), or those that the samples show",
        "acceleration_noise",
    )
    turning = f"turns of {ASSUMED_TURNING:g} rad/s^2/sqrt(Hz)", "turning_noise"
    pairs = (motion.acceleration, acceleration), (motion.turning, turning)
    assumed, parameters = zip(*(words for stated, words in pairs if stated < 0), strict=True)
    sentence = (
        f"Samples of the odometry are {gap_s:.3g} s apart, and nobody states how the platform moves between them; "
        f"assumed are {', and '.join(assumed)}. Send odometry every {motion.interval_s:g} s or more often, or "
        f"state {' and '.join(parameters)}."
    )
    return Doubt(SPARSE_ODOMETRY, sentence, size=gap_s, unit="s")


def _deviation(variances: F64, direction: F64) -> float:
    """Standard deviation of the component along a vector, times its length, from the variances along the axes."""
    return float(np.sqrt(variances @ direction**2))


def _moved(speed: float, aperture: ApertureState, sight: F64, slant_range: float) -> F64:
    """Covariance of the position of images by an error of the velocity along the line of sight, m^2, shape (3, 3)."""
    along = speed * slant_range / np.linalg.norm(aperture.velocity) * shift_along(aperture, sight)
    return np.outer(along, along)
