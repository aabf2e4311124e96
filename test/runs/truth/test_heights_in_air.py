"""Heights of flights through air that nobody has stated: sigma keeps what it promises."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS
from sal_height.geometry import STANDARD_ATMOSPHERE, Atmosphere
from sal_height.imaging import ImageSettings, Processing
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.runs.truth.comparison import compare
from sal_height.runs.truth.surface_report import as_flown, true_surfaces
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.air import SimulatedAir

STANDARD = STANDARD_ATMOSPHERE
HOT = Atmosphere(10.0, 1.01 * STANDARD.sea_level_pressure, 1.5 * STANDARD.vapour)
COLD = Atmosphere(-10.0, 0.99 * STANDARD.sea_level_pressure, 0.5 * STANDARD.vapour)


@cache
def errors_in_sigmas(through: Atmosphere | None, **settings: object) -> F64:
    """Errors of the heights of two dwells of the small preset over their sigmas."""
    found, preset, estimator = [], load_preset("small"), ESTIMATORS["ml"]
    if through:
        kelvin, pascal, _ = (float(values[0]) for values in through.at(np.zeros(1)))
        simulated = SimulatedAir(temperature_k=kelvin, pressure_pa=pascal, humidity=through.humidity(0.0))
        preset = replace(preset, impairments=replace(preset.impairments, air=simulated))
    for seed in (1, 2):
        flight = flight_of(preset, seed)
        image = ImageSettings(rows=preset.image.rows, cols=preset.image.cols, **settings)
        slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, image)
        assert slc
        looks = estimator.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
        field = heights(slc, flight.sensor, estimator, looks)
        seen, aperture = as_flown(field, slc.aperture, flight, 0)
        processing = Processing(image.range_window, image.azimuth_window)
        truth = true_surfaces(seen, aperture, processing, preset.looks, flight, flight.surface(0))
        errors = compare(field, truth, flight.sensor.beamwidth).errors
        found.append(errors.nearest / errors.sigma)
    every = np.concatenate(found)
    return np.asarray(np.abs(every[np.isfinite(every)]))


@pytest.mark.parametrize("air", [STANDARD, HOT, COLD])
def test_sigma_holds_the_errors_of_weather_and_vacuum_must_be_requested(air: Atmosphere) -> None:
    """Without a parameter no height is beyond 5 sigma; with air: none almost all are, by 0.7 m."""
    assert np.mean(errors_in_sigmas(air) > 5) <= 0.002
    assert np.mean(errors_in_sigmas(air) < 1) > 0.6
    assert np.mean(errors_in_sigmas(air, air="none") > 5) > 0.9


def test_ranges_that_may_be_corrected_or_not_are_right_within_sigma() -> None:
    for air in (STANDARD, None):
        assert np.mean(errors_in_sigmas(air, air="unknown") > 3) == 0
