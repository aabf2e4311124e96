"""From elevation to height: exact geometry, honest sigma, and what the looks' power-weighted centre is good for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, blocks, flat_scene, make_aperture, make_beams, make_sensor, multilook

from sal_height.beams.array import column_squint
from sal_height.elevation.array.estimate import ElevationEstimate, Scatterer, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.look_windows import Window
from sal_height.elevation.looks.looks import Looks, look_grid
from sal_height.geometry.earth import EARTH_RADIUS, height_of, sphere_point
from sal_height.geometry.frames import ApertureState, angles_of, aperture_at
from sal_height.geometry.grid import Grid, pixels_at
from sal_height.geometry.trajectory import locate_at_elevation
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.pixels import Processing, slant_plane_grid
from sal_height.numeric.windows import broadening, noise_gain, window
from sal_height.relief.heights import HeightField, height_field
from sal_height.relief.position_error import height_variance, pose_covariance
from sal_height.sensor.sensor import PhaseHistory
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.spotlight import cell_power, draw_amplitudes, simulate_dwell

TILTED = (0.11, -0.07, 0.23)


def slant_grid(aperture: ApertureState, side: int = 1, rows: int = 30, cols: int = 20) -> Grid:
    return slant_plane_grid(make_sensor(look_side=side), aperture, 5000.0, rows, cols, 1.188)


def looks_at(row: np.ndarray, col: np.ndarray) -> Looks:
    """Looks with their centres given; the covariance plays no role in `height_field`."""
    return replace(Looks.of(np.zeros((*row.shape, 2, 2)), 4), row=row, col=col)


def estimate_of(elevation: np.ndarray, sigma: float = 1e-5, validity: int = Validity.OK) -> ElevationEstimate:
    shape = elevation.shape
    validities = np.full(shape, validity, np.uint8)
    return ElevationEstimate.of_one(elevation, np.full(shape, sigma), np.full(shape, 50.0), validities)


def with_second(estimate: ElevationEstimate, elevation: np.ndarray, sigma: float, cnr: float) -> ElevationEstimate:
    """The estimate with a weaker scatterer at `elevation`, NaN where there is none."""
    values = (np.where(np.isnan(elevation), np.nan, value) for value in (sigma, cnr, 0.0))
    return replace(estimate, scatterers=(estimate.first, Scatterer(elevation, *values)))


@pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), TILTED], ids=["level", "tilted"])
def test_exact_elevations_give_the_positions_of_the_targets(side: int, angles: tuple[float, float, float]) -> None:
    aperture = make_aperture(angles=angles, velocity=(49.0, 4.0, -2.0))
    grid = slant_grid(aperture, side)
    rng = np.random.default_rng(28)
    middle = grid.points(14.5, 9.5)
    targets = sphere_point(middle[0] + rng.uniform(-1, 1, (3, 4)), middle[1] + rng.uniform(-1, 1, (3, 4)), 2.0)
    sight = targets - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.sum(sight**2, axis=-1) - along**2)
    looks = looks_at(*pixels_at(across, along, aperture, grid))
    _, elevation, _ = angles_of(targets, aperture, side)

    field = height_field(estimate_of(elevation), looks, grid, look_grid(grid, *blocks(10, 5)), aperture, side)
    np.testing.assert_allclose(field.first.positions, targets, atol=1e-6)
    np.testing.assert_allclose(field.first.height, 2.0, atol=1e-6)
    assert np.all(field.validity == Validity.OK)
    np.testing.assert_allclose(field.first.cnr_db, 10 * np.log10(50), atol=1e-12)


@pytest.mark.parametrize("sliding", [False, True], ids=["spotlight", "stripmap"])
@pytest.mark.parametrize("radial", [2e-3, -3e-3])
def test_moving_targets_get_the_place_and_height_that_they_really_have(sliding: bool, radial: float) -> None:
    """In the image they are range times radial velocity over speed behind: here 20 cm ahead of it or 30 behind."""
    speed = 50.0
    aperture = replace(make_aperture(velocity=(speed, 0.0, 0.0)), sliding=sliding)
    grid, rng = slant_grid(aperture), np.random.default_rng(29)
    middle = grid.points(14.5, 9.5)
    targets = sphere_point(middle[0] + rng.uniform(-0.5, 0.5, (3, 4)), middle[1] + rng.uniform(-1, 1, (3, 4)), 2.0)
    seen_from = aperture_at(targets, aperture).position
    slant_range = np.linalg.norm(targets - seen_from, axis=-1)
    along = (targets - aperture.position)[..., 0] - slant_range * radial / speed
    across = np.sqrt(slant_range**2 - (0 if sliding else along**2))
    looks = looks_at(*pixels_at(across, along, aperture, grid))
    _, elevation, _ = angles_of(targets, replace(aperture, position=seen_from), 1)
    coarse = look_grid(grid, *blocks(10, 5))
    field = height_field(estimate_of(elevation), looks, grid, coarse, aperture, 1, radial)
    np.testing.assert_allclose(field.first.positions, targets, atol=2e-5)  # v_r^2 / v^2 of the range
    np.testing.assert_allclose(field.first.height, 2.0, atol=2e-5)
    ignored = height_field(estimate_of(elevation), looks, grid, coarse, aperture, 1)
    np.testing.assert_allclose((ignored.first.positions - targets)[..., 0], -slant_range * radial / speed, rtol=1e-3)


def test_an_unknown_velocity_makes_the_place_along_the_flight_uncertain_and_nothing_else() -> None:
    """1 m/s along the sight moves an image by range over speed, each scatterer by another velocity."""
    aperture = make_aperture(velocity=(50.0, 0.0, 0.0))
    grid = slant_grid(aperture)
    rows, cols = np.full((2, 1, 3), 9.5)
    looks, coarse = looks_at(rows, cols), look_grid(grid, *blocks(10, 5))
    estimate = estimate_of(np.full((1, 3), np.pi / 4), 1e-5)
    known, moving = (
        height_field(estimate, looks, grid, coarse, aperture, 1, radial_velocity_sigma=sigma).first
        for sigma in (0.0, 0.02)
    )
    np.testing.assert_array_equal(moving.positions, known.positions)
    np.testing.assert_allclose(moving.sigma, known.sigma, rtol=1e-6)
    slant_range = np.linalg.norm(known.positions - aperture.position, axis=-1)
    along = (moving.own_covariance - known.own_covariance)[..., 0, 0]
    np.testing.assert_allclose(along, (slant_range * 0.02 / 50.0) ** 2, rtol=1e-3)


def test_sigma_of_height_is_that_of_elevation_across_the_sight_and_that_of_range_along_it() -> None:
    """On the sphere dh/dtheta = (R + H) rho sin(theta) / r and dh/drho = (rho - (R + H) cos(theta)) / r.

    The range of a scatterer is known up to a cell, evenly: its variance is 1/12 of the cell squared, over the looks.
    """
    aperture = make_aperture()
    grid, rows = slant_grid(aperture), np.array([[0.0], [14.5], [29.0]])
    elevation = np.pi / 4 + np.array([[-0.3], [0.0], [0.4]])
    slant_range = np.linalg.norm(grid.points(rows, 9.5) - aperture.position, axis=-1)
    centre_distance, looks = EARTH_RADIUS + aperture.position[2], 4
    for sigma in (0.0, 1e-5, 1.0):
        field = height_field(estimate_of(elevation, sigma), looks_at(rows, 0 * rows + 9.5), grid, grid, aperture, 1)
        radius = EARTH_RADIUS + field.first.height
        across = centre_distance * slant_range * np.sin(elevation) / radius * sigma
        along = (slant_range - centre_distance * np.cos(elevation)) / radius * grid.row_spacing / np.sqrt(12 * looks)
        np.testing.assert_allclose(field.first.sigma, np.hypot(across, along), rtol=1e-5)
    # A flat earth, for sigma 1.
    np.testing.assert_allclose(field.first.sigma, slant_range * np.sin(elevation), rtol=1e-3)


def test_an_error_of_the_angles_between_beams_is_common_and_grows_from_the_middle_of_the_array() -> None:
    """By as much as heights change if the beams are farther apart by a standard deviation."""
    aperture, beams = make_aperture(), make_sensor().beams
    grid, rows = slant_grid(aperture), np.full((3, 1), 14.5)
    offset = np.array([[-1e-4], [0.0], [2e-4]])
    looks, elevation = looks_at(rows, 0 * rows + 9.5), beams.axis_middle + offset
    seen, off, known = (
        height_field(estimate_of(angles, 1e-5), looks, grid, grid, aperture, 1, 0.0, of).first
        for angles, of in (
            (elevation, replace(beams, pitch_uncertainty=0.01)),
            (elevation + 0.01 * offset, beams),
            (elevation, beams),
        )
    )
    assert known.common_covariance is None
    assert seen.common_covariance is not None
    deviation = np.sqrt(seen.common_covariance[..., 2, 2])
    np.testing.assert_allclose(deviation, np.abs(off.height - known.height), rtol=1e-3, atol=1e-9)
    assert deviation[2, 0] > 5e-3
    np.testing.assert_array_equal(seen.own_covariance, known.own_covariance)
    np.testing.assert_allclose(seen.sigma, np.hypot(known.sigma, deviation), rtol=1e-4)


def pose_sigma(aperture: ApertureState, covariance: np.ndarray, side: int, row: float, col: float) -> np.ndarray:
    """What `covariance` adds in quadrature to the sigma of height of a pixel that looks at the middle of the beams."""
    grid, elevation = slant_grid(aperture, side), np.full((1, 1), np.pi / 4)
    looks = looks_at(np.full((1, 1), row), np.full((1, 1), col))
    with_it, without = (
        height_field(estimate_of(elevation), looks, grid, grid, replace(aperture, covariance=c), side).first.sigma
        for c in (covariance, np.zeros((6, 6)))
    )
    return np.sqrt(with_it**2 - without**2)[0, 0]


def test_level_flight_turns_roll_and_height_of_the_platform_into_height() -> None:
    """Eastwards, roll is about x: 1e-4 rad move a scatterer by 1e-4 rho sin(theta) in height; yaw and pitch do not."""
    moved = {}
    for axis, variance in enumerate((0.04, 0.04, 0.04, 1e-8, 1e-8, 1e-8)):
        covariance = np.zeros((6, 6))
        covariance[axis, axis] = variance
        moved[axis] = pose_sigma(make_aperture(), covariance, 1, 14.5, 9.5)
    np.testing.assert_allclose([moved[2], moved[3]], [0.2, 1e-4 * 5000 * np.sin(np.pi / 4)], rtol=1e-3)
    assert max(moved[0], moved[1], moved[4], moved[5]) < 1e-3


@pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
@pytest.mark.parametrize("sliding", [False, True], ids=["spotlight", "stripmap"])
def test_the_pose_adds_to_sigma_what_it_adds_to_the_position_along_the_vertical(side: int, sliding: bool) -> None:
    """At a squint, of a flight that turns and descends, with errors that depend on each other."""
    factor = 1e-3 * np.random.default_rng(5).standard_normal((6, 6)) * [[1.0], [1.0], [1.0], [0.1], [0.1], [0.1]]
    covariance = factor @ factor.T
    aperture = replace(make_aperture(angles=TILTED, velocity=(49.0, 4.0, -2.0)), sliding=sliding)
    pixel = slant_grid(aperture, side).points(3.0, 1900.0)
    here = aperture_at(pixel, aperture)
    sight = pixel - here.position
    along = sight @ aperture.direction
    assert abs(along) > 30.0
    point = locate_at_elevation(np.pi / 4, np.linalg.norm(sight), along, here, side)
    expected = pose_covariance(point, replace(aperture, covariance=covariance))
    assert expected is not None
    found = pose_sigma(aperture, covariance, side, 3.0, 1900.0)
    assert found**2 == pytest.approx(float(height_variance(expected, point)), rel=1e-4)


def test_pixels_without_a_usable_elevation_have_no_height() -> None:
    grid = slant_grid(make_aperture())
    estimate = estimate_of(np.array([[np.pi / 4, np.pi / 4, np.nan, np.pi / 4]]))
    estimate.validity[0, 1] = Validity.LOW_CNR
    estimate.cnr[0, 1] = -0.1
    there = np.full((1, 4), 5.0)
    field = height_field(estimate, looks_at(there, there), grid, grid, make_aperture(), 1)
    np.testing.assert_array_equal(
        field.validity, [[Validity.OK, Validity.LOW_CNR, Validity.OUTSIDE_ARRAY, Validity.OK]]
    )
    for values in (field.first.height, field.first.sigma, field.first.positions[..., 0], field.first.positions[..., 2]):
        np.testing.assert_array_equal(np.isnan(values), [[False, True, True, False]])
    np.testing.assert_array_equal(np.isnan(field.first.cnr_db), [[False, True, False, False]])


def test_pixels_of_a_height_image_are_the_middles_of_their_looks() -> None:
    grid = slant_grid(make_aperture(angles=TILTED, velocity=(49.0, 4.0, -2.0)))
    coarse = look_grid(grid, *blocks(4, 3))
    assert coarse.shape == (8, 7)  # 30 x 20 pixels; the last row and column of pixels have two each
    means = grid.pixels()[:28, :18].reshape(7, 4, 6, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse.pixels()[:7, :6], means, atol=1e-9)


def test_pixels_of_sliding_windows_are_the_middles_of_their_looks() -> None:
    grid = slant_grid(make_aperture(angles=TILTED, velocity=(49.0, 4.0, -2.0)))
    slid = look_grid(grid, Window.named("boxcar", 3, 1), Window.named("triangular", 4, 2))
    assert slid.shape == (30, 10)
    first = grid.pixels()[8:11, 5:9].mean(axis=(0, 1))
    np.testing.assert_allclose(slid.pixels()[9, 3], first, atol=1e-9)


@pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), TILTED], ids=["level", "tilted"])
def test_squint_of_a_column_is_that_of_the_target_in_the_middle_of_the_beams(
    side: int, angles: tuple[float, float, float]
) -> None:
    aperture, beams = make_aperture(angles=angles, velocity=(49.0, 4.0, -2.0)), make_beams()
    grid = slant_grid(aperture, side, rows=3, cols=5)
    sight = grid.points(1, np.arange(5)) - aperture.position
    slant_range = np.linalg.norm(sight, axis=-1)
    targets = locate_at_elevation(np.mean(beams.span), slant_range, sight @ aperture.direction, aperture, side)
    seen_range, seen_elevation, seen_squint = angles_of(targets, aperture, side)
    np.testing.assert_allclose(seen_range, slant_range, rtol=1e-13)
    np.testing.assert_allclose(seen_elevation, np.pi / 4, atol=1e-12)
    np.testing.assert_allclose(column_squint(grid, aperture, beams, side), seen_squint, atol=1e-12)


def test_columns_of_level_flight_are_a_resolution_apart_in_squint() -> None:
    grid = slant_grid(make_aperture(), rows=3, cols=5)
    squint = column_squint(grid, make_aperture(), make_beams(), 1)
    np.testing.assert_allclose(squint, np.arange(-2, 3) * grid.col_spacing / 5000, rtol=1e-6, atol=1e-15)


@dataclass(frozen=True)
class Chain:
    """Heights of level ground at 3.7 m, simulated without noise, with 2 x 2 looks: all dwells, valid pixels."""

    slc_row_spacing: float
    error: np.ndarray
    error_with_centres_ignored: np.ndarray
    cnr_db: np.ndarray


HEIGHT, CNR = 3.7, 100.0


@pytest.fixture(scope="module")
def chain() -> Chain:
    preset = load_preset("small")
    sensor = preset.make_sensor()
    flight = SimulatedFlight(preset, sensor, flat_scene(HEIGHT), dwells=6, seed=0)
    weights = window("taylor", sensor.sample_count)
    noise_power = noise_gain(weights) / (sensor.pulse_count * sensor.sample_count)
    rng = np.random.default_rng(29)
    fields: dict[bool, list[HeightField]] = {True: [], False: []}
    for dwell in range(flight.dwells):
        aperture, surface = flight.aperture(dwell), flight.surface(dwell)
        antenna = flight.position(flight.dwell_start_ns(dwell) * 1e-9 + flight.pulse_times)
        reference = np.full(sensor.pulse_count, preset.flight.slant_range_m)
        amplitudes = draw_amplitudes(surface, cell_power(CNR, sensor, len(antenna)), rng)
        samples = simulate_dwell(sensor, surface, amplitudes, antenna, reference)
        history = PhaseHistory(0, flight.pulse_times, reference, samples.astype(np.complex64))
        grid = slant_plane_grid(sensor, aperture, 5000.0, preset.image.rows, preset.image.cols, broadening(weights))
        slc, coarse = backproject(history, antenna, sensor, Processing("taylor"), grid), look_grid(grid, *blocks(2, 2))
        squint = column_squint(coarse, aperture, sensor.beams, sensor.look_side)
        looks = multilook(slc, 2, 2, squint=squint, noise_power=noise_power)
        estimate = ml_elevation(looks, sensor.beams, MlSettings(layover=False))
        rows, cols = np.indices(coarse.shape) * 2 + 0.5
        for centred, seen in ((True, looks), (False, replace(looks, row=rows, col=cols))):
            fields[centred].append(height_field(estimate, seen, grid, coarse, aperture, sensor.look_side))
    valid = np.stack([field.validity for field in fields[True]]) == Validity.OK
    return Chain(
        grid.row_spacing,
        np.stack([field.first.height for field in fields[True]])[valid] - HEIGHT,
        np.stack([field.first.height for field in fields[False]])[valid] - HEIGHT,
        np.stack([field.first.cnr_db for field in fields[True]])[valid],
    )


def test_level_ground_has_its_height(chain: Chain) -> None:
    """Without noise what is left is the wander of the speckle's centre inside the cells."""
    count = len(chain.error)
    assert count > 400
    assert np.mean(chain.error) == pytest.approx(0, abs=3.5 * np.std(chain.error) / np.sqrt(count))
    # That is the range known up to a cell; the model of it, an even spread, is good to a fifth.
    predicted = np.cos(np.pi / 4) * chain.slc_row_spacing / np.sqrt(12 * 4)
    assert np.std(chain.error) == pytest.approx(predicted, rel=0.2)
    # CNR of a look: 20 dB at the middle of the image, less the beam's 1.7 dB at its sides.
    assert 10 * np.log10(np.mean(10 ** (chain.cnr_db / 10))) == pytest.approx(19.5, abs=0.7)


def test_power_weighted_centre_removes_the_wander_of_the_looks(chain: Chain) -> None:
    """Two rows with the powers of two looks each share the centre as a Beta(2, 2) does: variance 1/20 of a row squared.

    A range off by d gives a height off by d cos(theta).
    """
    wander = np.cos(np.pi / 4) * chain.slc_row_spacing / np.sqrt(20)
    difference = chain.error_with_centres_ignored - chain.error
    standard_error = wander * np.sqrt((15 / 7 - 1) / (4 * len(difference)))  # kurtosis of Beta(2, 2): 15 / 7
    assert np.std(difference) == pytest.approx(wander, abs=3.5 * standard_error + 0.05 * wander)
    assert np.std(chain.error_with_centres_ignored) > 1.5 * np.std(chain.error)


def test_height_is_that_above_the_sphere() -> None:
    aperture, there = make_aperture(), np.full((1, 1), 14.5)
    grid = slant_grid(aperture)
    field = height_field(estimate_of(np.full((1, 1), np.pi / 4)), looks_at(there, there), grid, grid, aperture, 1)
    assert field.first.height[0, 0] == pytest.approx(height_of(field.first.positions[0, 0]), abs=1e-12)
    assert field.first.height[0, 0] - field.first.positions[0, 0, 2] == pytest.approx(
        0.98, abs=0.01
    )  # y^2 / 2 R at 3.5 km


def test_second_scatterer_lies_on_the_circle_of_the_first() -> None:
    grid, aperture = slant_grid(make_aperture()), make_aperture()
    there, lower = np.full((1, 2), 5.0), np.pi / 4 - 3 * BEAMWIDTH
    estimate = with_second(estimate_of(np.full((1, 2), np.pi / 4)), np.array([[lower, np.nan]]), 2e-6, 40.0)
    estimate.validity[0, 0] = Validity.TWO_SCATTERERS
    field = height_field(estimate, looks_at(there, there), grid, grid, aperture, 1)
    alone = height_field(estimate_of(np.full((1, 2), lower)), looks_at(there, there), grid, grid, aperture, 1)
    assert np.isfinite(field.first.height).all()
    second = field.surfaces[1]
    assert second.height[0, 0] == pytest.approx(alone.first.height[0, 0], abs=1e-9)
    assert second.cnr_db[0, 0] == pytest.approx(10 * np.log10(40))
    distances = [np.linalg.norm(s.positions[0, 0] - aperture.position) for s in field.surfaces]
    assert distances[0] == pytest.approx(distances[1], abs=1e-6)
    for values in (second.height, second.sigma, second.cnr_db, second.positions[..., 1]):
        np.testing.assert_array_equal(np.isnan(values), [[False, True]])


def layover_of(sigmas: tuple[float, float], shape: tuple[int, int] = (1, 1)) -> HeightField:
    """Two scatterers in every pixel, whose elevations are known to `sigmas`, rad."""
    aperture = make_aperture()
    elevation = np.full(shape, np.pi / 4)
    first = estimate_of(elevation, sigmas[0], Validity.TWO_SCATTERERS)
    estimate = with_second(first, elevation - BEAMWIDTH, sigmas[1], 20.0)
    grid = slant_grid(aperture)
    looks = looks_at(np.full(shape, 14.5), np.full(shape, 9.5))
    return height_field(estimate, looks, grid, replace(grid, rows=shape[0], cols=shape[1]), aperture, 1)


@pytest.mark.parametrize("sigmas", [(np.inf, 1e-5), (1e-5, np.inf), (1e-5, np.nan), (1e40, 1e-5)])
def test_two_scatterers_of_which_one_is_not_determined_have_no_heights(sigmas: tuple[float, float]) -> None:
    """1e40 is infinite as a message holds it, in single precision."""
    field = layover_of(sigmas)
    assert (field.validity == Validity.NOT_ONE_SCATTERER).all()
    for surface in field.surfaces:
        assert not np.isfinite(np.stack([surface.height, surface.sigma, *np.moveaxis(surface.positions, -1, 0)])).any()
    assert not np.isfinite(field.surfaces[1].cnr_db).any()


def test_two_scatterers_that_are_determined_keep_their_heights() -> None:
    field = layover_of((1e-5, 2e-5))
    assert (field.validity == Validity.TWO_SCATTERERS).all()
    assert np.isfinite(field.first.height).all()
    assert field.surfaces[1].height < field.first.height


@pytest.mark.parametrize(
    ("elevation", "sigma", "reason"),
    [
        (np.pi / 4, np.inf, Validity.LOW_CNR),
        (np.pi / 4, np.nan, Validity.LOW_CNR),
        (np.nan, 1e-5, Validity.OUTSIDE_ARRAY),
    ],
)
def test_a_pixel_without_a_finite_height_and_sigma_has_a_reason(elevation: float, sigma: float, reason: int) -> None:
    aperture = make_aperture()
    grid = slant_grid(aperture)
    looks, estimate = (
        looks_at(np.full((1, 1), 14.5), np.full((1, 1), 9.5)),
        estimate_of(np.full((1, 1), elevation), sigma),
    )
    field = height_field(estimate, looks, grid, replace(grid, rows=1, cols=1), aperture, 1)
    assert field.validity == reason
    assert not np.isfinite([field.first.height, field.first.sigma]).any()
