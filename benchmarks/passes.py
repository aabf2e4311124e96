"""Simulated passes over the same ground as an adjustment takes them, and how far their surfaces truly lie off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.adjustment import ObservedDwell
from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.relief import position_jacobian, turn_jacobian
from sal_height.simulation import Preset, SimulatedFlight, flight_of


@dataclass(frozen=True, eq=False)
class FlownPasses:
    """Dwells that were flown, and the truth: shifts, m, shape (dwells, 3)."""

    flight: SimulatedFlight
    dwells: list[ObservedDwell]
    shifts: F64

    @classmethod
    def of(cls, flight: SimulatedFlight, made: Sequence[tuple[ObservedDwell, F64]]) -> FlownPasses:
        """Dwells with their shifts."""
        return cls(flight, [dwell for dwell, _ in made], np.array([shift for _, shift in made]))


def observed(number: int, preset: Preset, seed: int) -> tuple[ObservedDwell, F64]:
    """A dwell of the flight of a preset, and how far its surfaces lie off."""
    flight, ml = flight_of(preset, seed), ESTIMATORS["ml"]
    sensor, history, track = flight.sensor, flight.phase_history(number), flight.track(number)
    given = preset.processing.get("sar_compression", {})
    slc = Compressor().add(
        history, track, sensor, ImageSettings(rows=preset.image.rows, cols=preset.image.cols, **given)
    )
    assert slc is not None  # noqa: S101 (a spotlight dwell has an image)
    field = heights(slc, sensor, ml, ml.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1]))
    dwell = ObservedDwell.of(field, slc, sensor, track, history)
    return dwell, _true_shift(dwell, flight, number)


def _true_shift(dwell: ObservedDwell, flight: SimulatedFlight, number: int) -> F64:
    """By the aperture that was published and the true one, vibration and jitter; velocities modulo the ambiguity."""
    stated, true, sensor = dwell.aperture, flight.aperture(number), flight.sensor
    u, climb = dwell.sight, position_jacobian(dwell.middle, stated)[:, 0]
    times = flight.dwell_start_ns(number) * 1e-9 + flight.pulse_times
    ahead, off_nadir = (float(np.mean(angle)) for angle in flight.pointing(times))
    turn = Rotation.from_matrix(stated.rotation @ true.rotation.T).as_rotvec()
    turned = turn_jacobian(dwell.middle, stated) @ turn + sensor.look_side * off_nadir * climb
    if dwell.placement.by_beams:
        along = dwell.slant_range * (float(np.cross(u, stated.direction) @ turn) - ahead)
    else:
        trend = np.polyfit(flight.pulse_times, flight.pulse_phase(number), 1)[0]
        speed = float((stated.velocity - true.velocity) @ u) - trend * sensor.wavelength / (4 * np.pi)
        speed -= dwell.ambiguity * np.rint(speed / dwell.ambiguity)
        along = -dwell.lever * speed
    return stated.position - true.position + turned + along * stated.direction
