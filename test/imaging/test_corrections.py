"""Errors that are known: taken out of images, and what they leave in sigma."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS, MlSettings, Validity
from sal_height.errors import UserError
from sal_height.geometry import Trajectory, path_through_air
from sal_height.imaging import (
    CorrectionSettings,
    ImageSettings,
    Slc,
    correct_dwell,
    correct_track,
    with_errors,
    with_known_errors,
)
from sal_height.imaging.pixels import line_of_sight
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

SIZE = {"rows": 30, "cols": 8, "air": "none"}


@cache
def flown(name: str = "small") -> tuple[SimulatedFlight, PhaseHistory]:
    flight = flight_of(load_preset(name), seed=2)
    return flight, flight.phase_history(0)


def compressed(
    history: PhaseHistory, sensor: Sensor | None = None, track: Trajectory | None = None, **known: object
) -> Slc:
    flight, _ = flown()
    settings = ImageSettings(**{**SIZE, **known})
    slc = Compressor().add(history, track or flight.track(0), sensor or flight.sensor, settings)
    assert slc is not None
    return slc


def height_field(slc: Slc) -> HeightField:
    return heights(slc, flown()[0].sensor, ESTIMATORS["ml"], MlSettings())


def sigma_with(**known: object) -> tuple[HeightField, HeightField]:
    """Heights without and with what corrections leave."""
    _, history = flown()
    return height_field(compressed(history)), height_field(compressed(history, **known))


def middle_of(values: F64, field: HeightField) -> float:
    return float(np.median(values[field.validity == Validity.OK]))


def test_a_range_offset_is_taken_out_exactly() -> None:
    _, history = flown()
    late = replace(history, reference_range=history.reference_range + 12.5)
    plain, corrected = compressed(history), compressed(late, range_offset_m=12.5)
    np.testing.assert_allclose(corrected.grid.origin, plain.grid.origin, rtol=0, atol=1e-9)
    np.testing.assert_allclose(corrected.images, plain.images, rtol=0, atol=1e-5 * np.abs(plain.images).max())


def test_odometry_that_is_stamped_late_is_put_in_time() -> None:
    flight, history = flown()
    track = flight.track(0)
    late = Trajectory([replace(state, stamp_ns=state.stamp_ns + 3_000_000) for state in track.states])
    plain, corrected = compressed(history), compressed(history, track=late, odometry_delay_s=0.003)
    np.testing.assert_allclose(corrected.aperture.position, plain.aperture.position, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(corrected.images, plain.images)


@pytest.mark.parametrize("look_side", [1, -1])
def test_an_elevation_offset_turns_all_beams_towards_nadir(look_side: int) -> None:
    """By the offset, on either side, and however the sensor is mounted."""
    flight, history = flown()
    sensor = replace(flight.sensor, look_side=look_side)
    aperture = flight.track(0).aperture(history.stamp_ns, history.pulse_times)
    turned = correct_dwell(
        history, flight.track(0), sensor, CorrectionSettings(air="none", elevation_offset_rad=1e-3)
    ).sensor
    seen = flight.track(0).mounted(turned.mounting).aperture(history.stamp_ns, history.pulse_times)
    before, after = (np.arccos(-line_of_sight(sensor, state)[2]) for state in (aperture, seen))
    assert after - before == pytest.approx(-1e-3, abs=1e-9)


def test_heights_in_air_are_those_of_vacuum_after_the_correction() -> None:
    """In vacuum, the correction raises heights by cos(look) of the delay and lowers them by R sin(look) of the bend."""
    flight, _ = flown()
    slant_range, look = flight.preset.flight.slant_range_m, flight.preset.flight.look_angle_rad
    path = path_through_air(flight.sensor.wavelength, slant_range * np.cos(look), 0.0, look)
    plain, corrected = sigma_with(air="standard")
    moved = middle_of(corrected.first.height - plain.first.height, plain)
    expected = np.cos(look) * path.delay - slant_range * np.sin(look) * path.bend
    assert moved == pytest.approx(expected, abs=0.01 * abs(expected) + 0.005)


@pytest.mark.parametrize(
    ("offset", "sigma", "step"),
    [("range_offset_m", "range_sigma_m", 0.02), ("elevation_offset_rad", "elevation_sigma_rad", 2e-6)],
)
def test_sigma_holds_what_an_offset_of_one_sigma_moves_heights_by(offset: str, sigma: str, step: float) -> None:
    _, history = flown()
    low, high = (height_field(compressed(history, **{offset: sign * step})) for sign in (-1, 1))
    plain, wide = sigma_with(**{sigma: step})
    added = middle_of(np.sqrt(wide.first.sigma**2 - plain.first.sigma**2), plain)
    moved = middle_of(np.abs(high.first.height - low.first.height) / 2, plain)
    assert added == pytest.approx(moved, rel=0.03)


def test_the_lever_arm_and_the_boresight_enter_sigma() -> None:
    """An arm raises heights by as much; a boresight by R sin(look) for each radian of roll."""
    flight, _ = flown()
    reach = flight.preset.flight.slant_range_m * np.sin(flight.preset.flight.look_angle_rad)
    for known, expected in (({"lever_arm_sigma_m": 0.05}, 0.05), ({"boresight_sigma_rad": 1e-5}, 1e-5 * reach)):
        plain, wide = sigma_with(**known)
        added = middle_of(np.sqrt(wide.first.sigma**2 - plain.first.sigma**2), plain)
        assert added == pytest.approx(expected, rel=0.05)


def test_a_clock_moves_places_along_the_flight() -> None:
    _, history = flown()
    slc = compressed(history, odometry_delay_sigma_s=1e-3)
    assert np.sqrt(slc.aperture.covariance[0, 0]) == pytest.approx(1e-3 * np.linalg.norm(slc.aperture.velocity))


def test_without_corrections_nothing_is_touched() -> None:
    flight, history = flown()
    none, track = CorrectionSettings(air="none"), flight.track(0)
    aperture = track.aperture(history.stamp_ns, history.pulse_times)
    assert correct_track(track, none) is track
    assert correct_dwell(history, track, flight.sensor, none)[:3] == (history, track, flight.sensor)
    assert with_known_errors(aperture, np.zeros(3), flight.sensor, none) is aperture
    assert with_errors(aperture, none, [np.zeros((1, 6))]) is aperture


def test_air_that_is_not_known_is_refused() -> None:
    flight, history = flown()
    sensor = replace(flight.sensor, wavelength=1e-4)
    with pytest.raises(UserError, match=r"refraction of air is not known"):
        compressed(history, sensor=sensor, air="standard")


def test_air_that_was_measured_moves_heights_as_its_density_says() -> None:
    """Of the pressure and temperature of the standard atmosphere at 1 km: its heights; of less pressure: less."""
    standard = sigma_with(air="standard")[1]
    at_1_km = {"air": "measured", "air_height_m": 1000.0, "air_temperature_k": 281.65, "air_humidity": 0.5}
    same, thin = (sigma_with(**at_1_km, air_pressure_pa=pressure)[1] for pressure in (89_875.0, 80_000.0))
    plain = sigma_with()[1]
    moved, less = (middle_of(plain.first.height - field.first.height, plain) for field in (same, thin))
    assert moved == pytest.approx(middle_of(plain.first.height - standard.first.height, plain), abs=1e-3)
    assert less == pytest.approx(80_000 / 89_875 * moved, abs=5e-3)
