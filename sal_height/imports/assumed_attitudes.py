"""Attitudes of a platform whose track has none: level, along the track, or turned to the point that ranges follow.

Doppler shows where the beams point along the flight, up to multiples of wavelength PRF / (2 speed), and the range to
the point that the radar followed shows it without multiples. Neither shows the roll, on which the height rests.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.geometry import PlatformState, Trajectory, look_direction
from sal_height.imports.collection import Description
from sal_height.sensor import PhaseHistory, Sensor

FOLLOWED_SIGMA = 0.01
"""Standard deviation of the heading that ranges to a followed point give, rad: as well as beams stay on a point."""

_LOG = logging.getLogger(__name__)


def with_assumed_attitudes(
    states: Sequence[PlatformState], histories: Sequence[PhaseHistory], sensor: Sensor, described: Description
) -> list[PlatformState]:
    """Level states along the track, turned to the points that the ranges of dwells follow, with their covariance.

    What is assumed is logged.

    Args:
        states: level states along the track.
        histories: phase histories of the dwells.
        sensor: sensor of the dwells.
        described: description that states how level the flight is.
    """
    track = Trajectory(list(states))
    found = [followed_squint(one, track) for one in histories] if sensor.mode == "spotlight" else []
    squints = [squint for squint in found if squint is not None]
    level, heading = described.assumed_attitude_sigma_rad, described.assumed_heading_sigma_rad
    yaws = np.zeros(len(states))
    seen = "nothing shows whether the beams look abeam"
    if squints and len(squints) == len(found):
        epoch_ns = states[0].stamp_ns
        # The squint of a dwell is that of its middle pulse.
        middles = [
            (one.stamp_ns - epoch_ns) * 1e-9 + float(one.pulse_times[len(one.pulse_times) // 2]) for one in histories
        ]
        order, turns = np.argsort(middles), np.array([_yaw(squint, sensor) for squint in squints])
        seconds = [(state.stamp_ns - epoch_ns) * 1e-9 for state in states]
        yaws = np.interp(seconds, np.array(middles)[order], turns[order])
        heading = min(heading, FOLLOWED_SIGMA)
        seen = f"the ranges follow points that lie {squints[0]:.3g} rad ahead of abeam (first dwell)"
    _LOG.warning(
        "The track has no attitudes. Assumed is level flight along the track, uncertain by %.2g rad in roll and pitch "
        "and %.2g rad in heading, so that all heights may be off together, by %.3g m here; %s. Add attitudes, or state "
        "assumed_attitude_sigma_rad and assumed_heading_sigma_rad in the description.",
        level,
        heading,
        level * float(np.mean(histories[0].reference_range)) * np.sin(np.mean(sensor.elevation_boresights)),
        seen,
    )
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = np.diag([level, level, heading]) ** 2
    return [
        replace(
            state,
            orientation=(Rotation.from_euler("z", yaw) * Rotation.from_quat(state.orientation)).as_quat(),
            covariance=state.covariance + covariance,
        )
        for state, yaw in zip(states, yaws, strict=True)
    ]


def followed_squint(history: PhaseHistory, track: Trajectory) -> float | None:
    """Angle ahead of abeam (rad) of a fixed point whose distance the ranges of a dwell are; None: they follow none.

    It is the angle at the middle pulse.

    Of a straight flight the squared distance from a point is R^2 = s^2 - 2 a s + R0^2, with the path s from the middle
    and the position a of the point along it. Ranges that are constant, or those of a window that follows the ground, do
    not have the s^2.

    Args:
        history: phase history of the dwell.
        track: track of the platform.

    Raises:
        UserError: the track does not cover the dwell.
    """
    positions = track.positions(history.stamp_ns, history.pulse_times)
    way = positions[-1] - positions[0]
    along = (positions - positions[len(positions) // 2]) @ (way / np.linalg.norm(way))
    line = np.polynomial.Polynomial.fit(along, history.reference_range**2 - along**2, 1).convert()
    left = history.reference_range**2 - along**2 - line(along)
    bend = along**2 - np.polynomial.Polynomial.fit(along, along**2, 1)(along)
    if np.std(left) > 0.1 * np.std(bend):
        return None
    mean_range = float(np.mean(history.reference_range))
    return float(np.arcsin(np.clip(-line.coef[1] / 2 / mean_range, -1.0, 1.0)))


def _yaw(squint: float, sensor: Sensor) -> float:
    """Turn about the vertical (rad, from east to north) of a level platform whose beams look so far ahead (rad)."""
    elevation = float(np.mean(sensor.elevation_boresights))
    forward, left, _ = sensor.mounting.axes.apply(look_direction(elevation, 0.0, sensor.look_side))
    horizontal = float(np.hypot(forward, left))
    # Of the horizontal part of the line of sight, a turn by yaw leaves cos(azimuth + yaw) ahead.
    azimuth = float(np.arctan2(left, forward))
    ahead = float(np.arccos(np.clip(np.sin(squint) / horizontal, -1.0, 1.0)))
    return float((ahead if azimuth > 0 else -ahead) - azimuth)
