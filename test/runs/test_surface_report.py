"""A pixel is judged by what it saw, wherever the odometry says that the platform was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings, image_beams
from sal_height.pipeline import Compressor, heights
from sal_height.runs.comparison import PublishedErrors, compare
from sal_height.runs.surface_report import as_flown, true_surfaces
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors


def errors_with(position_m: float, seed: int) -> PublishedErrors:
    """Of a dwell over the street whose odometry errs by a constant of this size in each coordinate, and says so."""
    preset = load_preset("small")
    preset = replace(preset, impairments=Impairments(odometry=OdometryErrors(position_m=position_m)))
    flight, estimator = flight_of(preset, seed), ESTIMATORS["ml"]
    settings = ImageSettings(rows=preset.image.rows, cols=preset.image.cols)
    slc = Compressor().add(flight.phase_history(1), flight.track(1), flight.sensor, settings)
    assert slc
    field = heights(slc, flight.sensor, estimator, estimator.settings(range_looks=2, azimuth_looks=2))
    beams = image_beams(flight.sensor, settings.azimuth_window)
    seen, aperture = as_flown(field, slc.aperture, flight, 1)
    truth = true_surfaces(seen, aperture, beams, flight, flight.surface(1))
    return compare(field, truth, flight.sensor.beamwidth).errors


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_odometry_that_errs_moves_heights_up_and_changes_nothing_else(seed: int) -> None:
    """By 0.3 m: the heights' errors are those with exact odometry and one that all share, to 1 mm, at steps as well."""
    exact, off = errors_with(0.0, seed), errors_with(0.3, seed)
    assert len(off.nearest) == len(exact.nearest)
    common = off.nearest - exact.nearest
    assert np.nanmax(np.abs(common - np.nanmedian(common))) < 1e-3
    assert np.nanmin(off.sigma) > 0.3
