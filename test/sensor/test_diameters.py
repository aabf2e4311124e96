"""An antenna that is longer than high, or higher than long: what follows which of its two diameters.

The elevation diameter is 10 mm, the azimuth diameter 16 mm, unless the test says otherwise.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from helpers import Array, make_aperture, make_sensor
from scipy.special import j1

from sal_height.elevation import ESTIMATORS, ElevationEstimator, MlSettings
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.monopulse.pairs import MonopulseSettings
from sal_height.errors import Rejected, UserError
from sal_height.imaging import ImageSettings
from sal_height.imaging.checks import check_pulses
from sal_height.imaging.pixels import Processing, slant_plane_size
from sal_height.imaging.strip import lay_lattice
from sal_height.pipeline import Compressor, heights
from sal_height.sensor import Sensor, aperture_length, lit_angle, processed_angle
from sal_height.simulation import flight_of, load_preset

WAVELENGTH, HIGH, LONG = 1.55e-6, 0.010, 0.016
RANGE, MIDDLE = 5000.0, np.pi / 4


def sensor_of(**changes: object) -> Sensor:
    return make_sensor(elevation_diameter=HIGH, azimuth_diameter=LONG, **changes)


def bessel(radius: Array) -> Array:
    """Amplitude of a circular aperture, 2 J1(pi r) / (pi r)."""
    phase = np.pi * np.where(radius > 0, radius, 1.0)
    return np.where(radius > 0, 2 * j1(phase) / phase, 1.0)


def test_the_beam_is_as_narrow_in_each_direction_as_the_antenna_is_large() -> None:
    """The first null of the round aperture is 1.2197 wavelengths over its diameter off the boresight."""
    beams = sensor_of(elevation_boresights=(MIDDLE,), noise_power=(1.0,)).beams
    null = 3.8317059702 / np.pi
    np.testing.assert_allclose(beams.response(MIDDLE + null * WAVELENGTH / HIGH, 0.0), 0.0, atol=1e-9)
    np.testing.assert_allclose(beams.response(MIDDLE, null * WAVELENGTH / LONG), 0.0, atol=1e-9)
    elevation, squint = np.meshgrid([-1e-4, 3e-5, 2e-4], [-8e-5, 2e-5, 1.1e-4])
    expected = bessel(np.hypot(elevation * HIGH, squint * LONG) / WAVELENGTH)
    np.testing.assert_allclose(beams.response(MIDDLE + elevation, squint)[..., 0], expected, atol=1e-9)


@pytest.mark.parametrize("rotation", [0.0, 0.4, np.pi / 2])
def test_slopes_are_the_derivatives_of_an_elliptic_beam(rotation: float) -> None:
    beams = sensor_of(detector_rotation=rotation).beams
    elevation, squint, step = MIDDLE + np.array([-6e-5, 1e-5, 8e-5]), np.array([3e-5, -2e-5, 5e-5]), 1e-8
    difference = beams.response(elevation + step, squint) - beams.response(elevation - step, squint)
    np.testing.assert_allclose(beams.slope(elevation, squint), difference / (2 * step), rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize(("rotation", "size"), [(0.0, LONG), (np.pi / 2, HIGH)])
def test_what_lies_along_the_flight_follows_the_diameter_that_lies_along_it(rotation: float, size: float) -> None:
    """With the detector axis turned by 90 degrees that is the elevation diameter.

    Processed angle wavelength / D, aperture of a strip wavelength R / D, lit angle 1.22 wavelength / D and half the
    axis where that is turned, columns of a strip D / 2 apart to a pulse, an image of a dwell one beamwidth wide.
    """
    sensor = sensor_of(detector_rotation=rotation)
    ahead = np.ptp(sensor.elevation_boresights) / 2 * np.sin(rotation)
    assert processed_angle(sensor) == pytest.approx(WAVELENGTH / size, rel=1e-12)
    assert aperture_length(sensor, RANGE) == pytest.approx(WAVELENGTH * RANGE / size, rel=1e-12)
    assert lit_angle(sensor.beams) == pytest.approx(1.21967 * WAVELENGTH / size + ahead, rel=1e-4)
    aperture = make_aperture()
    resolution = WAVELENGTH * RANGE / (2 * aperture.length)
    assert slant_plane_size(sensor, aperture, RANGE, 1.0)[1] == int(WAVELENGTH / size * RANGE / resolution)
    pulses = np.arange(600)[:, None] * np.array([1e-4, 0.0, 0.0]) + aperture.position
    processing = Processing(angle=processed_angle(sensor))
    assert lay_lattice(sensor, processing, aperture, pulses, RANGE, (8, 8)).col_spacing == pytest.approx(size / 2)


def test_pulses_may_be_half_the_azimuth_diameter_apart() -> None:
    """Of each dwell; whatever the elevation diameter."""
    aperture = make_aperture()
    for high in (0.001, 0.1):
        sensor = make_sensor(elevation_diameter=high, azimuth_diameter=LONG)
        for share, refused in ((0.999, False), (1.001, True)):
            antenna = np.arange(48)[:, None] * np.array([share * LONG / 2, 0.0, 0.0])
            if refused:
                with pytest.raises(Rejected, match=r"0\.016 m"):
                    check_pulses(sensor, antenna, aperture)
            else:
                check_pulses(sensor, antenna, aperture)


def test_a_preset_needs_the_pulse_repetition_frequency_of_its_azimuth_diameter() -> None:
    """4 v 1.22 / D: 15.2 kHz with 16 mm at 50 m/s."""
    least = 4 * 50.0 * 1.21967 / LONG
    preset = load_preset("small")
    for share in (1.001, 0.999):
        sensor = replace(preset.sensor, azimuth_aperture_m=LONG, pulse_repetition_frequency_hz=share * least)
        with nullcontext() if share > 1 else pytest.raises(UserError, match=r"15245\.9 Hz .* length 0\.016 m"):
            flight_of(replace(preset, sensor=sensor), seed=0)


@pytest.mark.parametrize("rotation", [0.0, 0.3])
@pytest.mark.parametrize(("name", "settings"), [("ml", MlSettings()), ("monopulse", MonopulseSettings())])
def test_elevations_of_points_off_abeam_are_right(name: str, settings: MlSettings, rotation: float) -> None:
    """Covariances of a point without noise, in the round antenna's beams as Bessel functions of both diameters."""
    sensor = sensor_of(detector_rotation=rotation)
    estimator: ElevationEstimator = ESTIMATORS[name]
    truth = MIDDLE + np.array([-3e-5, 1e-5, 4e-5])
    squint = 2.5e-5
    along = (truth - MIDDLE) * np.cos(rotation) + squint * np.sin(rotation)
    beside = squint * np.cos(rotation) - (truth - MIDDLE) * np.sin(rotation)
    steps = along[:, None] - (np.array(sensor.elevation_boresights) - MIDDLE)
    beams = bessel(np.hypot(steps * HIGH, beside[:, None] * LONG) / WAVELENGTH)
    looks = Looks.of(1e6 * beams[:, None, :, None] * beams[:, None, None, :], 4, squint)
    estimate = estimator.estimate(looks, sensor.beams, settings)
    np.testing.assert_allclose(estimate.elevation[:, 0], truth, atol=2e-9)


def test_a_dwell_lights_the_ground_in_the_main_lobe_of_the_azimuth_diameter() -> None:
    """It reached one beamwidth in elevation: with a short antenna, part of the lit ground was missing."""
    preset = load_preset("small")
    for azimuth in (0.008, 0.02):
        sensor = replace(preset.sensor, azimuth_aperture_m=azimuth, pulse_repetition_frequency_hz=31e3)
        flight = flight_of(replace(preset, sensor=sensor), seed=1)
        along = flight.surface(0).positions[:, 0] - flight.aperture(0).position[0]
        assert np.abs(along).max() == pytest.approx(1.22 * WAVELENGTH / azimuth * RANGE, rel=0.05)


@pytest.mark.parametrize("azimuth", [0.008, 0.02])
def test_simulated_heights_are_as_good_with_another_azimuth_diameter(azimuth: float) -> None:
    """Heights of points on level ground: the median error of the bright pixels is a small part of a beamwidth."""
    preset = load_preset("small")
    mounted = replace(preset.sensor, azimuth_aperture_m=azimuth, pulse_repetition_frequency_hz=31e3)
    flight = flight_of(replace(preset, dwells=1, sensor=mounted), seed=1)
    slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, IMAGE)
    assert slc
    field = heights(slc, flight.sensor, ESTIMATORS["ml"], MlSettings())
    east, north = field.first.positions[..., 0], field.first.positions[..., 1]
    error = field.first.height - flight.scene.heights(east, north)
    assert np.isfinite(error).sum() > 50
    assert abs(np.nanmedian(error)) < 0.02


IMAGE = ImageSettings(air="none", rows=46, cols=12)


def test_a_sensor_widened_by_a_factor_is_wider_in_both_directions() -> None:
    sensor = sensor_of()
    wide = sensor.widened(1.5)
    assert wide.elevation_diameter == pytest.approx(HIGH / 1.5)
    assert wide.azimuth_diameter == pytest.approx(LONG / 1.5)
    assert wide.beams.beamwidth == pytest.approx(sensor.beams.widened(1.5).beamwidth)
    assert wide.beams.beamwidth_beside == pytest.approx(sensor.beams.widened(1.5).beamwidth_beside)
