"""Heights in stripmap: every column is seen from abeam, and level ground keeps its height in all of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import blocks, flat_scene, make_aperture, make_beams, make_sensor, multilook

from sal_height.beams.array import column_squint
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import Looks, look_grid
from sal_height.geometry.earth import sphere_point
from sal_height.geometry.frames import ApertureState, angles_of, aperture_at
from sal_height.geometry.grid import Grid, pixels_at
from sal_height.imaging.formers.backprojection import backproject_points
from sal_height.imaging.pixels import Processing, azimuth_resolution, slant_plane_grid, slc_noise_power
from sal_height.numeric.windows import broadening
from sal_height.relief.heights import height_field
from sal_height.sensor.sensor import PhaseHistory, processed_angle
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.lit_surfaces import truth_image
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import visible_surface

CRAB = (49.0, 1.0, -2.0)
"""A velocity that is not along the body's axis, m/s."""


def strip(velocity: tuple[float, float, float] = CRAB, angles: tuple[float, float, float] = (0, 0, 0)) -> ApertureState:
    return replace(make_aperture(velocity=velocity, angles=angles, length=0.775), sliding=True)


def test_aperture_that_does_not_slide_is_that_of_all_points() -> None:
    aperture = make_aperture()
    assert aperture_at(np.zeros((3, 2, 3)), aperture) is aperture


@pytest.mark.parametrize("angles", [(0, 0, 0), (0.02, -0.01, 0.03)], ids=["level", "tilted"])
def test_sliding_aperture_is_on_the_track_where_the_body_sees_the_point_abeam(angles: tuple[float, ...]) -> None:
    aperture, rng = strip(angles=angles), np.random.default_rng(60)
    points = np.array([3.0, -3500.0, 1.0]) + rng.uniform(-2, 2, (4, 5, 3))
    there = aperture_at(points, aperture)
    assert not there.sliding
    way = there.position - aperture.position
    np.testing.assert_allclose(np.cross(way, aperture.direction), 0, atol=1e-9)
    np.testing.assert_allclose(angles_of(points, there, 1)[2], 0, atol=1e-12)


def test_columns_of_a_strip_have_no_squint() -> None:
    sensor = make_sensor()
    for velocity in ((50.0, 0.0, 0.0), CRAB):
        grid = slant_plane_grid(sensor, strip(velocity), 5000.0, 5, 40, 1.0)
        np.testing.assert_allclose(column_squint(grid, strip(velocity), make_beams(), 1), 0, atol=1e-9)


def targets_in(grid_middle: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(61)
    return sphere_point(
        grid_middle[0] + rng.uniform(-0.08, 0.08, (3, 4)), grid_middle[1] + rng.uniform(-1, 1, (3, 4)), 2.0
    )


def test_exact_elevations_give_the_positions_of_the_targets_in_a_strip() -> None:
    """Off the image plane and with a crab angle of 50 mrad: range and Doppler are those of the track."""
    aperture = strip(angles=(0.02, -0.01, 0.03))
    grid = slant_plane_grid(make_sensor(), aperture, 5000.0, 30, 20, 1.188)
    targets = targets_in(grid.points(14.5, 9.5))
    row, col = range_and_doppler(targets, aperture, grid)
    points = grid.points(row, col)
    _, elevation, _ = angles_of(targets, aperture_at(points, aperture), 1)
    estimate = ElevationEstimate.of_one(
        elevation, np.full(row.shape, 1e-5), np.full(row.shape, 50.0), np.full(row.shape, Validity.OK, np.uint8)
    )
    looks = replace(Looks.of(np.zeros((*row.shape, 2, 2)), 4), row=row, col=col)
    field = height_field(estimate, looks, grid, look_grid(grid, *blocks(10, 5)), aperture, 1)
    np.testing.assert_allclose(field.first.positions, targets, atol=1e-5)
    np.testing.assert_allclose(field.first.height, 2.0, atol=1e-5)


def range_and_doppler(points: np.ndarray, aperture: ApertureState, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Row and column where points come to lie, as distances from and along the track."""
    sight = points - aperture.position
    along = sight @ aperture.direction
    return pixels_at(np.sqrt(np.sum(sight**2, axis=-1) - along**2), along, aperture, grid)


def test_truth_of_a_strip_is_the_height_of_the_ground_in_every_column() -> None:
    boresights = tuple(make_beams().boresights)
    sensor = make_sensor(pattern="sinc", elevation_boresights=boresights, noise_power=(1.0,) * len(boresights))
    aperture = strip((50.0, 0.0, 0.0))
    cell = sensor.range_resolution, azimuth_resolution(sensor, aperture, 5000.0)
    assert cell[1] == pytest.approx(0.005)
    scene = flat_scene(2.5, north=-5000 * np.sqrt(0.5), half=5.0)
    surface = visible_surface(scene, aperture, 1, cell, (-2.0, 2.0), (4998.0, 5002.0))
    grid = slant_plane_grid(sensor, aperture, 5000.0, 20, 600, 1.2)  # four beamwidths wide
    truth = truth_image(surface, aperture, grid, cell[0] * cell[1], sensor.beams)
    np.testing.assert_allclose(truth.height, 2.5, atol=1e-9)
    np.testing.assert_allclose(np.mean(truth.power, axis=0), 1, rtol=0.02)  # at any place along the flight
    assert np.mean(truth.power) == pytest.approx(1, rel=0.02)
    assert truth.single.all()


HEIGHT = 3.7


@dataclass(frozen=True)
class Strip:
    """Heights of level ground in the image of one block; error and sigma NaN where not valid.

    `turned` is the error of each column, as the one attitude of the image is not that when the column was abeam.
    """

    error: np.ndarray
    sigma: np.ndarray
    cnr_db: np.ndarray
    turned: np.ndarray


@pytest.fixture(scope="module", params=[0.0, 1.0], ids=["calm", "gusts"])
def heights(request: pytest.FixtureRequest) -> Strip:
    """Simulated with noise, three blocks, backprojected over one beamwidth about the middle block, 1 x 16 looks."""
    preset = load_preset("sal_stripmap")
    preset = replace(preset, flight=replace(preset.flight, gust_mps=request.param))
    flight = SimulatedFlight(preset, preset.make_sensor(), flat_scene(HEIGHT), dwells=3, seed=62)
    sensor, aperture = flight.sensor, flight.aperture(1)
    histories = [flight.phase_history(dwell) for dwell in range(3)]
    times = np.concatenate([h.stamp_ns * 1e-9 + h.pulse_times for h in histories])
    history = PhaseHistory(
        0,
        times,
        np.concatenate([h.reference_range for h in histories]),
        np.concatenate([h.samples for h in histories], axis=1),
    )
    processing = Processing(angle=processed_angle(sensor))
    widened = broadening(processing.range_weights(sensor.sample_count))
    grid = slant_plane_grid(sensor, aperture, 5000.0, preset.image.rows, preset.image.cols, widened)
    pixels = grid.pixels().reshape(-1, 3)
    slc = backproject_points(history, flight.position(times), sensor, processing, pixels, aperture.forward)
    coarse = look_grid(grid, *blocks(*preset.looks))
    squint = column_squint(coarse, aperture, sensor.beams, sensor.look_side)
    noise = slc_noise_power(sensor, processing, 310)[0]
    looks = multilook(slc.reshape(-1, *grid.shape), *preset.looks, squint=squint, noise_power=noise)
    estimate = ml_elevation(looks, sensor.beams, MlSettings(layover=False))
    field = height_field(estimate, looks, grid, coarse, aperture, sensor.look_side)
    return Strip(field.first.height - HEIGHT, field.first.sigma, field.first.cnr_db, turned(flight, coarse))


def turned(flight: SimulatedFlight, grid: Grid) -> np.ndarray:
    """Height error from the turn of the mount between the middle of block 1 and the time each column is abeam."""
    aperture, middle = flight.aperture(1), flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times[-1] / 2
    points = grid.points((grid.rows - 1) / 2, np.arange(grid.cols))
    there = aperture_at(points, aperture)
    seconds = (there.position - aperture.position) @ aperture.direction / np.linalg.norm(aperture.velocity)
    errors = []
    for point, position, time in zip(points, there.position, middle + seconds, strict=True):
        state = replace(there, position=position)
        then = replace(state, rotation=flight._gust.rotation(time).as_matrix())
        elevation = [angles_of(point, a, flight.sensor.look_side)[1] for a in (state, then)]
        errors.append((elevation[1] - elevation[0]) * 5000 * np.sin(np.pi / 4))
    return np.array(errors)


def test_level_ground_has_its_height_in_a_strip(heights: Strip) -> None:
    valid = np.isfinite(heights.error)
    error = heights.error[valid]
    assert len(error) > 200
    assert np.mean(error) == pytest.approx(0, abs=3 * np.std(error) / np.sqrt(len(error)))  # 1.4 mm
    assert np.std(error) < 0.01
    assert np.std(error / heights.sigma[valid]) == pytest.approx(1, abs=0.15)
    assert 10 * np.log10(np.mean(10 ** (heights.cnr_db[valid] / 10))) == pytest.approx(20, abs=0.3)


def test_no_column_of_a_strip_is_biased(heights: Strip) -> None:
    """In gusts the mount turns by a third of a microradian from the middle of the image to its ends: 1 mm of height."""
    for column, expected in zip(heights.error.T, heights.turned, strict=True):
        error = column[np.isfinite(column)]
        assert len(error) > 20
        assert np.mean(error) == pytest.approx(expected, abs=3 * np.std(error) / np.sqrt(len(error)))  # 4 mm
    assert np.abs(heights.turned).max() < 3e-3
