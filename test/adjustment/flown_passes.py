"""Dwells of simulated passes as an adjustment takes them, and how far their surfaces truly lie off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.adjustment import ObservedDwell, Points, Stated
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import sphere_point
from sal_height.imaging import ImageSettings, Slc
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.relief import position_jacobian
from sal_height.simulation import Preset, SimulatedFlight, flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import Passes

BORESIGHT = (1.5e-5, -2e-5, 1e-5)
ERRORS = OdometryErrors(
    position_m=0.1,
    velocity_mps=0.003,
    attitude_rad=3e-5,
    undescribed_lever_arm_m=(0.008, -0.006, 0.01),
    undescribed_boresight_rad=BORESIGHT,
)


@dataclass(frozen=True, eq=False)
class FlownPasses:
    """Dwells that were flown, and the truth: shifts, m, shape (dwells, 3)."""

    flight: SimulatedFlight
    dwells: list[ObservedDwell]
    shifts: F64


def preset_of(passes: int, per_pass: int, **impairments: object) -> Preset:
    """The street in passes to and fro."""
    preset = load_preset("sal_spotlight")
    wrong = Impairments(**{"odometry": ERRORS, **impairments})  # type: ignore[arg-type]
    flight = replace(preset.flight, passes=Passes(passes, 100.0))
    return replace(preset, dwells=passes * per_pass, flight=flight, impairments=wrong)


@cache
def flown(seed: int = 1, passes: int = 5, per_pass: int = 3) -> FlownPasses:
    """Passes over the street with errors of navigation and mounting."""
    flight = flight_of(preset_of(passes, per_pass), seed)
    made = [observed(flight, dwell) for dwell in range(flight.dwells)]
    return FlownPasses(flight, [dwell for dwell, _ in made], np.array([shift for _, shift in made]))


def observed(flight: SimulatedFlight, number: int) -> tuple[ObservedDwell, F64]:
    """A dwell, and how far its surfaces lie off."""
    sensor, ml, history, track = flight.sensor, ESTIMATORS["ml"], flight.phase_history(number), flight.track(number)
    slc = Compressor().add(history, track, sensor, ImageSettings(rows=184, cols=12))
    assert slc
    field = heights(slc, sensor, ml, ml.settings(range_looks=2, azimuth_looks=2))
    aperture = track.aperture(history.stamp_ns, history.pulse_times)
    velocity = track.velocity_covariance(history.stamp_ns, history.pulse_times)
    middle = history.stamp_ns * 1e-9 + float(history.pulse_times.mean())
    ambiguity = sensor.wavelength * sensor.pulse_repetition_frequency / 2
    dwell = ObservedDwell(
        Points.of(field),
        slc.aperture,
        slc.placement,
        Stated(middle, aperture.covariance, velocity),
        sensor.beams.axis_middle,
        sensor.look_side,
        ambiguity,
    )
    return dwell, true_shift(dwell, slc, flight, number)


def true_shift(dwell: ObservedDwell, slc: Slc, flight: SimulatedFlight, number: int) -> F64:
    """By the aperture that was published and the true one; velocities count modulo the ambiguity."""
    stated, true = slc.aperture, flight.aperture(number)
    place = sphere_point(*dwell.points.middle)
    sight = place - stated.position
    plane = np.cross(stated.forward, sight)
    turn = np.cross(sight, plane) / (plane @ plane)
    climb = position_jacobian(place, stated)[:, 0]
    angle = turn @ Rotation.from_matrix(stated.rotation @ true.rotation.T).as_rotvec()
    speed = (stated.velocity - true.velocity) @ sight / np.linalg.norm(sight)
    speed -= dwell.ambiguity * np.rint(speed / dwell.ambiguity)
    return stated.position - true.position + angle * climb - dwell.lever * speed * stated.direction
