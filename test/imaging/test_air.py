"""The uncertainty of the air: each of its errors moves delay and bend together, and heights as the whole chain does."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS, MlSettings, Validity
from sal_height.geometry import STANDARD_ATMOSPHERE, Atmosphere, electron_delay, height_of, path_through_air
from sal_height.imaging import (
    CorrectionSettings,
    ImageSettings,
    Slc,
    errors_of_air,
    line_of_sight,
    with_errors,
)
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField
from sal_height.sensor import PhaseHistory
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

WARMER, DENSER, WETTER, UNSTATED, AT_SENSOR = range(1, 6)
"""Numbers of the errors of the standard atmosphere; that of electrons is before them."""


@cache
def flown(name: str) -> tuple[SimulatedFlight, PhaseHistory]:
    flight = flight_of(load_preset(name), seed=2)
    return flight, flight.phase_history(0)


def compressed(name: str, **air: object) -> Slc:
    flight, history = flown(name)
    image = flight.preset.image
    settings = ImageSettings(rows=image.rows, cols=image.cols, **air)
    slc = Compressor().add(history, flight.track(0), flight.sensor, settings)
    assert slc is not None
    return slc


def height_field(name: str, slc: Slc) -> HeightField:
    return heights(slc, flown(name)[0].sensor, ESTIMATORS["ml"], MlSettings())


def errors_of(name: str, **air: object) -> F64:
    slc = compressed(name, air="none")
    return errors_of_air(slc.aperture, slc.grid.middle, flown(name)[0].sensor, CorrectionSettings(**air))


def with_air(name: str, **air: object) -> Slc:
    """Images of a flight in vacuum, with the errors that such air would leave."""
    slc = compressed(name, air="none")
    errors = errors_of_air(slc.aperture, slc.grid.middle, flown(name)[0].sensor, CorrectionSettings(**air))
    return replace(slc, aperture=with_errors(slc.aperture, CorrectionSettings(), [errors]))


def sight_of(slc: Slc) -> tuple[float, float]:
    """Height of the antenna (m), and the angle of the middle of the image off nadir (rad)."""
    sight = slc.grid.middle - slc.aperture.position
    above = float(height_of(slc.aperture.position) - height_of(slc.grid.middle))
    return above, math.acos(above / float(np.linalg.norm(sight)))


def as_measured(air: Atmosphere, humidity: float) -> dict[str, object]:
    """Parameters of an atmosphere by its values at sea level."""
    kelvin, pascal, _ = (float(values[0]) for values in air.at(np.zeros(1)))
    return {"air": "measured", "air_temperature_k": kelvin, "air_pressure_pa": pascal, "air_humidity": humidity}


HUMIDITY = STANDARD_ATMOSPHERE.humidity(0.0)


@pytest.mark.parametrize("name", ["small", "xband_relief"])
@pytest.mark.parametrize(
    ("error", "other", "wetter"),
    [
        (WARMER, Atmosphere(warmer=10.0), None),
        (DENSER, Atmosphere(sea_level_pressure=1.01 * 101_325.0), 1.0),
        (WETTER, STANDARD_ATMOSPHERE, 1.5),
    ],
)
def test_an_error_of_the_air_moves_heights_as_its_shift_and_turn_say(
    name: str, error: int, other: Atmosphere, wetter: float | None
) -> None:
    """Against the whole chain with that air taken out, instead of the standard atmosphere."""
    standard = compressed(name, air="standard")
    humidity = other.humidity(0.0) if wetter is None else wetter * HUMIDITY
    moved = height_field(name, compressed(name, **as_measured(other, humidity))).first.height
    row = errors_of(name)[error]
    of_row = replace(standard, aperture=replace(standard.aperture, covariance=np.outer(row, row)))
    without = replace(standard, aperture=replace(standard.aperture, covariance=np.zeros((6, 6))))
    wide, narrow = height_field(name, of_row), height_field(name, without)
    valid = (wide.validity == Validity.OK) & (wide.first.sigma < 10)
    change = float(np.median(np.abs(moved - wide.first.height)[valid]))
    sigma = float(np.median(np.sqrt(wide.first.sigma**2 - narrow.first.sigma**2)[valid]))
    by_range = math.cos(math.pi / 4) * float(np.linalg.norm(row[:3]))  # of which the turn takes away a part
    assert sigma == pytest.approx(change, abs=0.04 * by_range)


def test_a_map_whose_height_is_not_stated_is_uncertain_by_100_m() -> None:
    """The shift and the turn are those of ground 100 m higher; a stated height has no such error."""
    slc = compressed("small", air="none")
    above, off_nadir = sight_of(slc)
    high, low = (path_through_air(1.55e-6, above + ground, ground, off_nadir) for ground in (100.0, 0.0))
    row = errors_of("small", air="standard")[UNSTATED]
    assert np.linalg.norm(row[:3]) == pytest.approx(low.delay - high.delay, rel=0.01)
    assert np.linalg.norm(row[3:]) == pytest.approx(low.bend - high.bend, rel=0.02)
    assert len(errors_of("small", air="standard", map_height_m=500.0)) == len(errors_of("small", air="standard")) - 1


def test_the_temperature_at_the_sensor_moves_the_bend_alone() -> None:
    """Where the air at the sensor alone is 3 K warmer, by tan(look) times what is missing of its refractivity there."""
    above, off_nadir = sight_of(compressed("small", air="none"))
    kelvin, pascal, _ = (float(values[0]) for values in STANDARD_ATMOSPHERE.at(np.array([above])))
    refractivity = 273.3e-6 * pascal / 101_325.0 * 288.15 / kelvin
    row = errors_of("small", air="standard")[AT_SENSOR]
    assert not row[:3].any()
    assert np.linalg.norm(row[3:]) == pytest.approx(math.tan(off_nadir) * 3.0 * refractivity / kelvin, rel=1e-3)


def test_of_ranges_that_may_be_corrected_the_whole_effect_is_uncertain() -> None:
    """It stays in images, as in vacuum, and is in sigma, delay and bend together."""
    slc, unknown = compressed("small", air="none"), compressed("small", air="unknown")
    np.testing.assert_array_equal(unknown.images, slc.images)
    above, off_nadir = sight_of(slc)
    path = path_through_air(1.55e-6, above, 0.0, off_nadir)
    row = errors_of("small", air="unknown")[-1]
    np.testing.assert_allclose(row[:3], -path.delay * line_of_sight(flown("small")[0].sensor, slc.aperture), rtol=5e-3)
    assert row[3] == pytest.approx(path.bend, rel=5e-3)
    np.testing.assert_allclose(unknown.aperture.covariance, slc.aperture.covariance + np.outer(row, row), rtol=1e-9)


def test_a_measurement_leaves_less_than_the_standard_atmosphere() -> None:
    """Of height at least half, without the height of the map; vacuum leaves nothing."""
    measured = as_measured(STANDARD_ATMOSPHERE, HUMIDITY)
    left = [
        height_field("xband_relief", with_air("xband_relief", **air)).first.sigma
        for air in ({"air": "standard", "map_height_m": 1.0}, {**measured, "map_height_m": 1.0}, {"air": "none"})
    ]
    standard, known, none = (float(np.nanmedian(np.sqrt(sigma**2 - left[2] ** 2))) for sigma in left)
    assert known < 0.8 * standard
    assert none == 0
    assert len(errors_of("small", air="none")) == 0


@pytest.mark.parametrize("look_side", [1, -1])
def test_a_greater_bend_turns_the_beams_towards_nadir_on_either_side(look_side: int) -> None:
    """As the correction itself turns the mounting."""
    slc = compressed("small", air="none")
    sensor = replace(flown("small")[0].sensor, look_side=look_side)
    middle = slc.grid.middle * np.array([1.0, look_side, 1.0])
    row = errors_of_air(slc.aperture, middle, sensor, CorrectionSettings(air="unknown"))[-1]
    assert row[3] * look_side > 0
    assert row[:3] @ (middle - slc.aperture.position) < 0


def test_electrons_delay_echoes_of_satellites_and_of_no_aircraft() -> None:
    """From above them all, 40.3 m^3/s^2 times 5e17 per m^2 over the square of the frequency."""
    assert electron_delay(0.3, 20_000.0) < 1e-30
    assert electron_delay(0.3, 60_000.0) < 1e-9
    assert electron_delay(0.03, 2e6) == pytest.approx(40.3 * 5e17 / (299_792_458.0 / 0.03) ** 2, rel=1e-6)
    assert electron_delay(0.03, 350e3) == pytest.approx(0.317 * electron_delay(0.03, 2e6), rel=1e-2)
    assert electron_delay(1.55e-6, 2e6) < 1e-6


def test_the_air_is_standard_unless_vacuum_is_requested() -> None:
    assert CorrectionSettings().atmosphere is STANDARD_ATMOSPHERE
    assert CorrectionSettings(air="none").atmosphere is None
