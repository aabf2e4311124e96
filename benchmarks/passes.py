"""Simulated passes over the same ground as an adjustment takes them, and how far their surfaces truly lie off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.adjustment import ObservedDwell
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import ApertureState
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
        history, track, sensor, ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols, **given)
    )
    assert slc is not None  # noqa: S101 (a spotlight dwell has an image)
    field = heights(slc, sensor, ml, ml.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1]))
    dwell = ObservedDwell.of(field, slc, sensor, track, history)
    return dwell, _true_shift(dwell, flight, number)


def observed_strip(number: int, preset: Preset, seed: int) -> list[tuple[ObservedDwell, F64]]:
    """The images of a strip, which is the pass of that number of a preset, each with how far its surfaces lie off.

    What autofocus leaves along the flight, a centimetre with sal_strips, is not in that.
    """
    flight, ml, compressor = flight_of(preset, seed), ESTIMATORS["ml"], Compressor()
    sensor, given = flight.sensor, preset.processing.get("sar_compression", {})
    settings = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols, **given)
    looks = ml.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
    blocks, found = preset.flight.passes.dwells_each(preset.dwells), []
    for block in range(blocks * number, blocks * (number + 1)):
        history, track = flight.phase_history(block), flight.track(block)
        slc = compressor.add(history, track, sensor, settings)
        if slc:
            image = ObservedDwell.of(heights(slc, sensor, ml, looks), slc, sensor, track, history)
            found.append((image, _true_shift_of_strip(image, flight)))
    return found


def _true_shift_of_strip(image: ObservedDwell, flight: SimulatedFlight) -> F64:
    """By the aperture that was published, and the true one and the jitter while the image's middle was lit."""
    stated, seconds = image.aperture, image.seconds
    true = replace(
        stated,
        position=flight.position(seconds),
        velocity=flight.velocity(seconds),
        rotation=flight.attitude(seconds).as_matrix(),
    )
    lit = stated.length / image.speed
    return _shift(image, true, seconds + np.linspace(-lit / 2, lit / 2, 64), flight)


def _true_shift(dwell: ObservedDwell, flight: SimulatedFlight, number: int) -> F64:
    """By the aperture that was published and the true one, vibration and jitter; velocities modulo the ambiguity."""
    stated, true, times = dwell.aperture, flight.aperture(number), flight.pulse_times
    shift = _shift(dwell, true, flight.dwell_start_ns(number) * 1e-9 + times, flight)
    if dwell.placement.by_beams:
        return shift
    trend = np.polyfit(times, flight.pulse_phase(number), 1)[0]
    speed = float((stated.velocity - true.velocity) @ dwell.sight) - trend * flight.sensor.wavelength / (4 * np.pi)
    speed -= dwell.ambiguity * np.rint(speed / dwell.ambiguity)
    return shift - dwell.lever * speed * dwell.along


def _shift(image: ObservedDwell, true: ApertureState, times: F64, flight: SimulatedFlight) -> F64:
    """Offsets of the surfaces of an image that was seen from a true aperture; along the flight if it is by beams.

    Args:
        image: as published.
        true: aperture from which it was seen.
        times: times at which beams lit it, s after the start of the flight.
        flight: whose beams jitter.
    """
    stated = image.aperture
    climb = position_jacobian(image.middle, stated)[:, 0]
    ahead, off_nadir = (float(np.mean(angle)) for angle in flight.pointing(times))
    turn = Rotation.from_matrix(stated.rotation @ true.rotation.T).as_rotvec()
    turned = turn_jacobian(image.middle, stated) @ turn + flight.sensor.look_side * off_nadir * climb
    shift = stated.position - true.position + turned
    if image.placement.by_beams:
        along = image.slant_range * (float(np.cross(image.sight, stated.direction) @ turn) - ahead)
        shift += along * image.along
    return shift
