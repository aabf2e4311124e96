"""Delay and bend of the way through air, against closed forms and tables."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.errors import UserError
from sal_height.geometry import STANDARD_ATMOSPHERE, Atmosphere, path_through_air, refractivities


@pytest.mark.parametrize(
    ("height", "temperature", "pressure"),
    [(0.0, 288.15, 101_325.0), (5000.0, 255.65, 54_020.0), (11_000.0, 216.65, 22_632.0), (20_000.0, 216.65, 5475.0)],
)
def test_the_standard_atmosphere_is_that_of_its_tables(height: float, temperature: float, pressure: float) -> None:
    found = STANDARD_ATMOSPHERE.at(np.array([height]))
    assert found[0][0] == pytest.approx(temperature)
    assert found[1][0] == pytest.approx(pressure, rel=1e-3)


def test_light_is_refracted_as_in_tables_and_its_group_is_slower() -> None:
    """At 15 degrees and 101 325 Pa n - 1 is 2.7650e-4 at 0.633 µm and 2.7327e-4 at 1.55 µm (Ciddor)."""
    sea_level = np.array([0.0])
    assert refractivities(sea_level, 0.633e-6)[0][0] == pytest.approx(2.7653e-4, rel=2e-4)
    phase, group = refractivities(sea_level, 1.55e-6)
    assert phase[0] == pytest.approx(2.7327e-4, rel=3e-4)
    step = 1e-10  # group: n - wavelength dn / dwavelength
    near, far = (refractivities(sea_level, 1.55e-6 + sign * step)[0][0] for sign in (-1, 1))
    assert group[0] == pytest.approx(phase[0] - 1.55e-6 * (far - near) / (2 * step), rel=1e-6)


def test_radio_waves_see_vapour() -> None:
    """At sea level the reference has 7.5 g/m^3: N = 77.6 p / T - 5.6 e / T + 3.75e5 e / T^2."""
    vapour = 7.5 * 288.15 / 216.7
    expected = 77.6 * 1013.25 / 288.15 - 5.6 * vapour / 288.15 + 3.75e5 * vapour / 288.15**2
    assert refractivities(np.array([0.0]), 0.03)[0][0] * 1e6 == pytest.approx(expected, rel=1e-3)


def test_straight_down_the_delay_is_the_integral_and_nothing_bends() -> None:
    path = path_through_air(1.55e-6, 3000.0, 0.0, 0.0)
    heights = np.linspace(0, 3000, 300_001)
    group = refractivities(heights, 1.55e-6)[1]
    assert path.delay == pytest.approx(np.trapezoid(group, heights), abs=2e-6)
    assert path.bend == 0


def test_a_way_at_an_angle_is_longer_and_comes_from_farther_off() -> None:
    """To first order the delay is that of the vertical over cos, and the bend tan (mean of n - n at the sensor)."""
    height, off_nadir = 3535.5, np.pi / 4
    path, vertical = (path_through_air(1.55e-6, height, 0.0, angle) for angle in (off_nadir, 0.0))
    assert path.delay == pytest.approx(vertical.delay / np.cos(off_nadir), rel=1e-3)
    phase = refractivities(np.linspace(0, height, 10_001), 1.55e-6)[0]
    assert path.bend == pytest.approx(np.tan(off_nadir) * (phase.mean() - phase[-1]), rel=2e-3)


def test_what_air_does_to_heights_of_the_presets() -> None:
    """By range -0.82 m for the lidar at 5 km and -2.3 m for X-band at 35 km, both at 45 degrees.

    The refractivity of radio waves is about 319e-6 exp(-h / 7.35 km): 92e-6 in the mean of 24.7 km, 11e-6 at the top.
    """
    lidar = path_through_air(1.55e-6, 5000.0 * np.cos(np.pi / 4), 0.0, np.pi / 4)
    radar = path_through_air(0.03, 35e3 * np.cos(np.pi / 4), 0.0, np.pi / 4)
    assert -np.cos(np.pi / 4) * lidar.delay == pytest.approx(-0.82, abs=0.01)
    assert -np.cos(np.pi / 4) * radar.delay == pytest.approx(-2.3, abs=0.05)
    assert 5000.0 * np.sin(np.pi / 4) * lidar.bend == pytest.approx(0.1374, abs=0.002)
    assert 35e3 * np.sin(np.pi / 4) * radar.bend == pytest.approx(24.7e3 * (92 - 11) * 1e-6, rel=0.1)


@pytest.mark.parametrize(
    ("wavelength", "sensor", "ground", "wrong"),
    [
        (1e-4, 1000.0, 0.0, "wavelength of 0.0001 m"),
        (0.03, 1e5, 9e4, "ground at 90000 m"),
        (0.03, 10.0, 20.0, "ground at 20 m"),
        (0.03, 10.0, -3500.0, "State map_height_m"),
    ],
)
def test_air_that_is_not_known_is_refused(wavelength: float, sensor: float, ground: float, wrong: str) -> None:
    with pytest.raises(UserError, match=wrong):
        path_through_air(wavelength, sensor, ground, 0.5)


def test_the_air_ends_at_80_km_without_a_step() -> None:
    """Where its layers are those of the tables: 228.65 K and 868 Pa at 32 km, 196.65 K and 0.886 Pa at 80 km."""
    temperature, pressure, _ = STANDARD_ATMOSPHERE.at(np.array([32_000.0, 80_000.0]))
    np.testing.assert_allclose(temperature, [228.65, 196.65])
    np.testing.assert_allclose(pressure, [868.02, 0.88628], rtol=1e-3)
    below, above = (path_through_air(0.03, height, 0.0, 0.7) for height in (80_000.0, 80_000.001))
    assert above.delay == pytest.approx(below.delay, abs=1e-6)
    assert above.bend == pytest.approx(below.bend, abs=2e-8)


def test_from_far_above_the_air_the_delay_is_that_of_all_of_it_and_nothing_bends() -> None:
    """The bend is tan(look) times the mean refractivity of the path, most of which is in vacuum."""
    high, higher = (path_through_air(0.03, height, 0.0, 0.7) for height in (100e3, 800e3))
    assert higher.delay == pytest.approx(high.delay, rel=1e-3)
    heights = np.linspace(0, 80_000, 200_001)
    vertical = float(np.trapezoid(refractivities(heights, 0.03)[0], heights))
    assert path_through_air(0.03, 800e3, 0.0, 0.0).delay == pytest.approx(vertical, rel=1e-4)
    assert higher.bend == pytest.approx(np.tan(0.7) * vertical / 800e3, rel=5e-3)


@pytest.mark.parametrize("height", [0.0, 500.0, 12_000.0])
def test_air_is_as_it_was_measured_and_in_equilibrium_elsewhere(height: float) -> None:
    """Pressure falls by the weight of the air: dp / dh = -g p / (R T)."""
    air = Atmosphere.measured(height, 250.0, 60_000.0, 0.4)
    temperature, pressure, vapour = air.at(np.array([height]))
    assert temperature[0] == pytest.approx(250.0)
    assert pressure[0] == pytest.approx(60_000.0, rel=1e-9)
    celsius = 250.0 - 273.15
    assert vapour[0] == pytest.approx(0.4 * 611.21 * np.exp(17.502 * celsius / (240.97 + celsius)), rel=1e-9)
    for at in (1000.0, 15_000.0):
        warm, below, _ = air.at(np.array([at - 0.5, at, at + 0.5]))
        assert below[2] - below[0] == pytest.approx(-9.80665 * below[1] / (287.053 * warm[1]), rel=1e-6)


def test_what_the_standard_atmosphere_has_makes_the_standard_atmosphere() -> None:
    temperature, pressure, vapour = (values[0] for values in STANDARD_ATMOSPHERE.at(np.array([1500.0])))
    celsius = temperature - 273.15
    humidity = vapour / (611.21 * np.exp(17.502 * celsius / (240.97 + celsius)))
    found = Atmosphere.measured(1500.0, temperature, pressure, humidity)
    standard, measured = (path_through_air(0.03, 3000.0, 0.0, 0.7, air) for air in (STANDARD_ATMOSPHERE, found))
    assert measured.delay == pytest.approx(standard.delay, rel=1e-9)
    assert measured.bend == pytest.approx(standard.bend, rel=1e-9)


def test_light_is_late_in_proportion_to_the_density_of_the_air() -> None:
    """Straight down from 3 km, with a tenth more pressure: a tenth later; 10 K warmer: 3.5 % less at the ground."""
    dense = Atmosphere(sea_level_pressure=1.1 * 101_325.0)
    standard, late = (path_through_air(1.55e-6, 3000.0, 0.0, 0.0, air).delay for air in (STANDARD_ATMOSPHERE, dense))
    assert late == pytest.approx(1.1 * standard, rel=1e-9)
    warm = refractivities(np.array([0.0]), 1.55e-6, Atmosphere(warmer=10.0))[0][0]
    assert warm == pytest.approx(refractivities(np.array([0.0]), 1.55e-6)[0][0] * 288.15 / 298.15, rel=1e-9)
