"""Twelve channels whose beams are known to -25 dB, at 50 dB: from phase history to heights that say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, flat_scene

from sal_height.beams import BeamTable, detector_pattern
from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS, MEASURED, ElevationEstimate, MlSettings, Validity
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, elevations, heights
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset

CHANNELS, UNCERTAINTY = 12, 10 ** (-25 / 20)


def measured_beams(rng: np.random.Generator) -> tuple[BeamTable, ...]:
    """Tables of jinc beams with errors of that rms, which vary over angles as the beams of the antenna may."""
    angles = np.linspace(-6.5, 6.5, 105)
    exact = detector_pattern("jinc", (0.0, 0.0)).amplitude(angles[:, None], angles[32:-32:4])
    tables = []
    for _ in range(CHANNELS):
        waves = np.exp(2j * np.pi * angles[:, None] * rng.uniform(-0.5, 0.5, 16))
        error = UNCERTAINTY * waves @ circular(rng, (16,)) / 4
        values = (exact + error[:, None]).ravel()
        offsets = (tuple((BEAMWIDTH * nodes).tolist()) for nodes in (angles, angles[32:-32:4]))
        tables.append(BeamTable(*offsets, tuple(values.real.tolist()), tuple(values.imag.tolist())))
    return tuple(tables)


@pytest.fixture(scope="module")
def level() -> tuple[Sensor, Slc]:
    """A sensor and the images that it has made of level ground."""
    preset = load_preset("small")
    preset = replace(preset, dwells=1, cnr_db=50.0, sensor=replace(preset.sensor, detectors=CHANNELS))
    flight = replace(flight_of(preset, seed=1), scene=flat_scene(half=20.0))
    settings = ImageSettings(air="none", rows=46, cols=12)
    slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, settings)
    assert slc
    return flight.sensor, slc


def estimated(slc: Slc, sensor: Sensor, calibration: Calibration | None = None) -> ElevationEstimate:
    settings = MlSettings(range_looks=1, azimuth_looks=4)
    return elevations(slc, sensor, ESTIMATORS["ml"], settings, calibration)[0]


def test_pixels_stay_valid_with_a_sigma_that_is_right(level: tuple[Sensor, Slc]) -> None:
    """Eight sensors with beams of their own: errors over sigma have an rms of 1 within 3 standard errors of 8 %.

    Taken for perfect, the same beams give errors of 4 sigma, where a pixel is valid at all.
    """
    sensor, slc = level
    true = estimated(slc, sensor)
    lit, ratios, shares, unaware = true.validity == Validity.OK, [], [], []
    assert lit.mean() > 0.8
    for seed in range(8):
        tables = measured_beams(np.random.default_rng([90, seed]))
        described = replace(sensor, pattern="table", beam_tables=tables, config_hash="")
        if seed < 2:
            found = estimated(slc, described)
            usable = lit & np.isin(found.validity, MEASURED)
            unaware.append(((found.elevation - true.elevation) / found.sigma)[usable])
        found = estimated(slc, replace(described, beam_uncertainty=UNCERTAINTY))
        valid = lit & (found.validity == Validity.OK)
        shares.append(valid.sum() / lit.sum())
        ratios.append(((found.elevation - true.elevation) / found.sigma)[valid])
    assert np.sqrt(np.mean(np.concatenate(unaware) ** 2)) > 3
    assert min(shares) > 0.9
    assert np.sqrt(np.mean(np.concatenate(ratios) ** 2)) == pytest.approx(1, abs=0.25)


def test_the_uncertainty_of_the_beams_is_common_to_pixels(level: tuple[Sensor, Slc]) -> None:
    """Own covariances stay those of known beams; both parts make up sigma.

    Without the search for layover, as doubts about a second scatterer depend on what is taken for noise.
    """
    sensor, slc = level
    estimator = ESTIMATORS["ml"]
    fields = [
        heights(slc, one, estimator, estimator.settings(layover=False))
        for one in (sensor, replace(sensor, beam_uncertainty=UNCERTAINTY, config_hash=""))
    ]
    known, stated = (field.first for field in fields)
    assert known.common_covariance is None
    assert stated.common_covariance is not None
    seen = np.all([field.validity == Validity.OK for field in fields], axis=0)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(stated.own_covariance[seen], known.own_covariance[seen], rtol=1e-2, atol=1e-9)
    up = (stated.own_covariance + stated.common_covariance)[seen][:, 2, 2]
    np.testing.assert_allclose(np.sqrt(up), stated.sigma[seen], rtol=1e-4)
    assert np.median(stated.common_covariance[seen][:, 2, 2] / up) > 0.5


def test_the_standard_errors_of_a_calibration_count(level: tuple[Sensor, Slc]) -> None:
    """They add in squares to what the sensor states, but where there are doubts about a second scatterer."""
    sensor, slc = level
    ones, unknown = np.ones((CHANNELS, sensor.sample_count), np.complex128), np.full(CHANNELS, np.nan)
    errors = np.full(CHANNELS, UNCERTAINTY / np.sqrt(2))
    calibration = Calibration(sensor.config_hash, ones, unknown, errors, errors)
    stated = replace(sensor, beam_uncertainty=UNCERTAINTY, config_hash=sensor.config_hash)
    by_nothing, by_sensor, by_calibration, by_both = (
        estimated(slc, sensor),
        estimated(slc, stated),
        estimated(slc, sensor, calibration),
        estimated(slc, stated, calibration),
    )
    np.testing.assert_allclose(by_calibration.sigma, by_sensor.sigma, rtol=1e-9)
    once, twice = (one.sigma**2 - by_nothing.sigma**2 for one in (by_sensor, by_both))
    lit = by_nothing.validity == Validity.OK
    assert np.mean(np.abs(twice[lit] / once[lit] - 2) < 0.02) > 0.9
