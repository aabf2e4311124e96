"""A pixel is judged by what it saw, wherever the odometry says that the platform was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import few

from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings, image_beams
from sal_height.pipeline import Compressor, heights
from sal_height.runs.truth.comparison import PublishedErrors, compare
from sal_height.runs.truth.surface_report import as_flown, true_surfaces
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors


def errors_with(position_m: float, name: str, seed: int) -> PublishedErrors:
    """Of an image of the street whose odometry errs by a constant of this size in each coordinate, and says so."""
    preset = load_preset(name)
    preset = replace(preset, impairments=Impairments(odometry=OdometryErrors(position_m=position_m)))
    flight, estimator = flight_of(preset, seed), ESTIMATORS["ml"]
    settings, compressor = ImageSettings(rows=preset.image.rows, cols=preset.image.cols), Compressor()
    for dwell in range(3):
        slc = compressor.add(flight.phase_history(dwell), flight.track(dwell), flight.sensor, settings)
    assert slc
    looks = estimator.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
    field = heights(slc, flight.sensor, estimator, looks)
    beams = image_beams(flight.sensor, settings.azimuth_window)
    seen, aperture = as_flown(field, slc.aperture, flight, 2)
    truth = true_surfaces(seen, aperture, beams, flight, flight.surface(2))
    return compare(field, truth, flight.sensor.beamwidth).errors


@pytest.mark.parametrize("seed", few(2, [1, 2]))
@pytest.mark.parametrize("name", ["small", "sal_stripmap"])
def test_odometry_that_errs_moves_heights_up_and_changes_nothing_else(name: str, seed: int) -> None:
    """By 0.1 m: the heights' errors are those with exact odometry and one that all share, to 1 mm, at steps as well.

    That is less than half a kerb, so that the nearest surface remains the nearest, but for 2 % of a strip's pixels at
    most. Seen from where the odometry says, a third of them has other errors.
    """
    exact, off = errors_with(0.0, name, seed), errors_with(0.1, name, seed)
    assert len(off.nearest) == len(exact.nearest)
    common = off.nearest - exact.nearest
    assert np.nanmean(np.abs(common - np.nanmedian(common)) > 1e-3) <= (0.02 if name == "sal_stripmap" else 0.0)
    assert np.nanmin(off.sigma) > 0.1
