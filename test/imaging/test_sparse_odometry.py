"""Odometry of five samples a second: the motion between them is in sigma, and does not move heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS
from sal_height.geometry import ASSUMED_TURNING, NOT_STATED, STEADY, Motion, Trajectory
from sal_height.imaging import SPARSE_ODOMETRY, ImageSettings, Processing, Slc
from sal_height.pipeline import Compressor, heights
from sal_height.runs.truth.comparison import PublishedErrors, compare, joined_errors
from sal_height.runs.truth.surface_report import as_flown, true_surfaces
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

UNKNOWN = Motion(NOT_STATED, NOT_STATED, 0.05)


def flown(preset: str, rate_hz: float, gust_mps: float = 0.0, seed: int = 1) -> SimulatedFlight:
    """A flight with odometry that is exact at its samples, and so many of them a second."""
    chosen = load_preset(preset)
    return flight_of(replace(chosen, flight=replace(chosen.flight, odometry_rate_hz=rate_hz, gust_mps=gust_mps)), seed)


def compressed(flight: SimulatedFlight, motion: Motion, dwell: int = 0) -> Slc:
    """Images of a dwell."""
    track, image = flight.track(dwell), flight.preset.image
    moving = Trajectory(track.states, motion=motion, accuracy=track.accuracy)
    settings = ImageSettings(air="none", rows=image.rows, cols=image.cols)
    slc = Compressor().add(flight.phase_history(dwell), moving, flight.sensor, settings)
    assert slc is not None
    return slc


def test_a_straight_track_gives_the_images_of_dense_odometry_with_a_greater_sigma_and_a_doubt() -> None:
    dense, sparse = (compressed(flown("small", rate_hz), UNKNOWN) for rate_hz in (200.0, 5.0))
    assert not dense.doubts
    (doubt,) = sparse.doubts
    assert (doubt.name, doubt.unit) == (SPARSE_ODOMETRY, "s")
    assert doubt.size == 0.2
    for part in ("are 0.2 s apart", "0.1 m/s^2/sqrt(Hz)", "0.01 rad/s^2/sqrt(Hz)", "every 0.05 s", "turning_noise"):
        assert part in doubt.sentence
    assert sparse.focus is None
    scale = np.abs(dense.images).max()
    np.testing.assert_allclose(sparse.images, dense.images, atol=1e-4 * scale)
    assert (np.diag(sparse.aperture.covariance) > np.diag(dense.aperture.covariance)).all()


@pytest.mark.parametrize(
    ("motion", "stated"),
    [(Motion(0.3, NOT_STATED, 0.05), "acceleration"), (Motion(NOT_STATED, 0.02, 0.05), "turn")],
)
def test_the_doubt_does_not_name_what_is_stated(motion: Motion, stated: str) -> None:
    (doubt,) = compressed(flown("small", 5.0), motion).doubts
    assert stated not in doubt.sentence
    assert "or state " in doubt.sentence


def test_dense_odometry_gives_what_it_gave() -> None:
    """To the last bit, whatever is assumed of gaps."""
    flight = flown("small", 200.0)
    assumed, steady = (compressed(flight, motion) for motion in (UNKNOWN, STEADY))
    np.testing.assert_array_equal(assumed.images, steady.images)
    np.testing.assert_array_equal(assumed.aperture.covariance, steady.aperture.covariance)


def errors_of(flight: SimulatedFlight, motion: Motion, dwell: int) -> PublishedErrors:
    """Errors of the heights of a dwell."""
    slc, ml, looks = compressed(flight, motion, dwell), ESTIMATORS["ml"], flight.preset.looks
    field = heights(slc, flight.sensor, ml, ml.settings(range_looks=looks[0], azimuth_looks=looks[1]))
    seen, aperture = as_flown(field, slc.aperture, flight, dwell)
    processing = Processing(slc.range_window, slc.azimuth_window)
    truth = true_surfaces(seen, aperture, processing, looks, flight, flight.surface(dwell))
    return compare(field, truth, flight.sensor.beamwidth).errors


def test_heights_between_samples_in_gusts_are_within_five_sigma() -> None:
    """Positions and velocities show how the platform is shaken; if only its turns counted, many would be beyond."""
    flights = [flown("sal_spotlight", 5.0, 2.0, seed) for seed in range(3)]
    beyond = []
    for motion in (UNKNOWN, Motion(0.0, ASSUMED_TURNING, 0.05)):
        errors = joined_errors([errors_of(flight, motion, 15) for flight in flights])
        beyond.append(float(np.mean(np.abs(errors.nearest) > 5 * errors.sigma)))
    assert beyond[0] <= 0.002
    assert beyond[1] > 0.01
