"""The ground from layers: steps, walls, ghosts, shadow and gaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sal_height.numeric import F64, Bool
from sal_height.relief import GroundEstimate, GroundKind, GroundSettings
from sal_height.relief.ground import GroundGrid, _jumps_beside, estimated_ground
from sal_height.relief.layers import Layers, merged_dwell
from sal_height.relief.membrane import fitted_membrane

CELL, SPACING, SIGMA, SIDE = 0.05, 0.09, 0.01, 80
SETTINGS = GroundSettings()
GRID = GroundGrid((0, 0), (SIDE, SIDE), CELL, SPACING)
NOWHERE = np.zeros((SIDE, SIDE), dtype=bool)
CIRCLE = np.array([0.0, -1.0, 1.0])  # direction of an error: south and up, seen from the north at 45 degrees


def layers_at(places: F64) -> Layers:
    """Layers with errors of SIGMA along the circle, seen from the north at 45 degrees."""
    count = len(places)
    own = np.broadcast_to(SIGMA**2 * np.outer(CIRCLE, CIRCLE), (count, 3, 3))
    common, towards, once = np.zeros((count, 3, 3)), np.tile([0.0, 1.0], (count, 1)), np.ones(count)
    return Layers(places, own, common, towards, once.astype(np.int64), once, once, 0 * once)


def seen(terrain: Callable[[F64], F64], rng: np.random.Generator) -> F64:
    """Places on a terrain over north (m) with their errors, one per pixel, where the sensor in the north sees it."""
    east, north = np.meshgrid(np.arange(0.03, SIDE * CELL, SPACING), np.arange(0.02, SIDE * CELL, SPACING))
    fine = np.arange(0.0, SIDE * CELL + 3, 0.01)
    skyline = np.maximum.accumulate((terrain(fine) - fine)[::-1])[::-1]  # of the line of sight, which rises by 1 in 1
    height = terrain(north)
    lit = height - north >= np.interp(north, fine, skyline) - 1e-3
    places = np.stack([east[lit], north[lit], height[lit]], axis=-1)
    return places + rng.normal(0.0, SIGMA, (len(places), 1)) * CIRCLE


def is_inside(places: F64) -> Bool:
    return np.asarray(((places[:, :2] > 0) & (places[:, :2] < SIDE * CELL)).all(axis=1))


def ground_of(places: F64, silent: Bool | None = None) -> GroundEstimate:
    layers = merged_dwell(layers_at(places[is_inside(places)]), CELL, SETTINGS.gate)
    return estimated_ground(layers, NOWHERE if silent is None else silent, GRID, SETTINGS)


CENTRES = (np.arange(SIDE) + 0.5) * CELL


def test_level_ground_is_measured_everywhere_with_its_sigma() -> None:
    ground = ground_of(seen(lambda north: 0 * north, np.random.default_rng(1)))
    inner = np.s_[5:-5, 5:-5]
    assert np.mean(ground.kind[inner] == GroundKind.MEASURED) > 0.9
    assert np.isfinite(ground.height[inner]).all()
    z = (ground.height / ground.sigma)[inner]
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.02  # some 700 independent heights: the standard error is 3 %


def test_a_slope_away_has_the_sigma_of_height_at_a_place() -> None:
    """An error along the circle moves a point of a slope of 1 in 2 away from the sensor 1.5 times as far from it."""
    rng = np.random.default_rng(2)
    level, towards = (ground_of(seen(terrain, rng)) for terrain in (lambda north: 0 * north, lambda north: -north / 2))
    slope = ground_of(seen(lambda north: north / 2, rng))
    inner = np.s_[8:-8, 8:-8]
    assert np.isclose(np.nanmedian(towards.sigma[inner]) / np.median(level.sigma[inner]), 0.5, atol=0.06)
    assert np.isclose(np.nanmedian(slope.sigma[inner]) / np.median(level.sigma[inner]), 1.5, atol=0.12)
    error = (slope.height - CENTRES[:, None] / 2)[inner]
    assert abs(np.nanmean(error)) < 0.3 * SIGMA


def test_a_step_up_keeps_both_levels_and_no_ramp() -> None:
    """A wall of 0.6 m at 2 m north that faces the sensor, which sees ground, wall and roof."""
    rng = np.random.default_rng(3)
    ground = seen(lambda north: np.where(north < 2.0, 0.6, 0.0), rng)
    east, height = np.meshgrid(np.arange(0.03, SIDE * CELL, SPACING), np.arange(0.03, 0.6, SPACING))
    wall = np.stack([east.ravel(), np.full(east.size, 2.0), height.ravel()], axis=-1)
    estimate = ground_of(np.concatenate([ground, wall + rng.normal(0.0, SIGMA, (len(wall), 1)) * CIRCLE]))
    truth = np.where(CENTRES < 2.0, 0.6, 0.0)[:, None]
    away = np.abs(CENTRES - 2.0) > SPACING  # a cell beside the wall may show either level
    assert np.isfinite(estimate.height[5:-5][away[5:-5], 5:-5]).all()
    assert np.nanmax(np.abs(estimate.height - truth)[away]) < 5 * SIGMA


@pytest.mark.parametrize("step", [0.27, 0.4, 0.55, 0.8, 1.1, 1.6])
@pytest.mark.parametrize("faces_the_sensor", [True, False])
def test_steps_keep_what_was_measured_and_sigma_is_honest(step: float, faces_the_sensor: bool) -> None:
    """A wall at 2 m north with the higher ground south of it, which the sensor sees, or north of it.

    What the wall hides in the latter case has no signal.
    """
    rng = np.random.default_rng(round(100 * step))

    def terrain(north: F64) -> F64:
        return np.where((north < 2.0) == faces_the_sensor, step, 0.0)

    places = seen(terrain, rng)
    is_ground = np.ones(len(places), dtype=bool)
    if faces_the_sensor:
        east, height = np.meshgrid(np.arange(0.03, SIDE * CELL, SPACING), np.arange(0.03, step, SPACING))
        wall = np.stack([east.ravel(), np.full(east.size, 2.0), height.ravel()], axis=-1)
        places = np.concatenate([places, wall + rng.normal(0.0, SIGMA, (len(wall), 1)) * CIRCLE])
        is_ground = np.arange(len(places)) < len(is_ground)
    hidden = (2.0 - step + CELL / 2 < CENTRES) & (CENTRES < 2.0) & (not faces_the_sensor)
    estimate = ground_of(places, np.broadcast_to(hidden[:, None], NOWHERE.shape))
    pixels = places[is_ground & is_inside(places)]
    row, col = np.floor(pixels[:, 1::-1].T / CELL).astype(int)
    kept = np.abs(estimate.height[row, col] - pixels[:, 2]) < 3 * SIGMA
    assert np.mean(kept) > 0.98  # of 1600 or so: the standard error is 0.35 %
    measured = estimate.kind == GroundKind.MEASURED
    off = (np.abs(estimate.height - terrain(CENTRES)[:, None]) / estimate.sigma)[measured]
    assert np.mean(off > 5) < 0.01
    assert 0.6 < np.mean(off < 1) < 0.85


def test_what_a_wall_hides_is_shadow_and_ghosts_there_give_way() -> None:
    def terrain(north: F64) -> F64:
        return np.where((north > 2.0) & (north < 2.6), 1.0, 0.0)

    rng = np.random.default_rng(4)
    places = seen(terrain, rng)
    ghosts = np.column_stack([rng.uniform(0.2, 3.8, 40), rng.uniform(1.2, 1.8, 40), np.zeros(40)])
    for estimate in (ground_of(places), ground_of(np.concatenate([places, ghosts]))):
        dark = (CENTRES > 1.15) & (CENTRES < 1.9)
        assert np.mean(estimate.kind[dark] == GroundKind.SHADOW) > 0.9
        assert np.isnan(estimate.height[estimate.kind == GroundKind.SHADOW]).all()


def test_cells_that_silent_pixels_show_in_shadow_are_shadow_unless_they_were_measured() -> None:
    places = seen(lambda north: 0 * north, np.random.default_rng(9))
    kept = is_inside(places) & ((places[:, 1] < 1.0) | (places[:, 1] > 1.15))  # a pixel less, which footprints cover
    layers, silent = layers_at(places[kept]), np.zeros((SIDE, SIDE), dtype=bool)
    silent[20:23] = True  # north 1 m to 1.15 m
    silent[40:43] = True
    own = np.zeros((SIDE, SIDE), dtype=bool)
    own.ravel()[GRID.numbers(layers)] = True
    without, estimate = (estimated_ground(layers, cells, GRID, SETTINGS) for cells in (NOWHERE, silent))
    assert np.mean(without.kind[20:23] != GroundKind.SHADOW) == 1
    assert (estimate.kind[silent & ~own] == GroundKind.SHADOW).all()
    assert np.isnan(estimate.height[silent & ~own]).all()
    np.testing.assert_array_equal(estimate.height[own | ~silent], without.height[own | ~silent])


def test_a_ghost_above_the_ground_does_not_hide_what_is_seen_behind_it() -> None:
    rng = np.random.default_rng(5)
    places = seen(lambda north: 0 * north, rng)
    east, north = np.meshgrid(2.0 + 0.09 * np.arange(3), 3.0 + 0.09 * np.arange(2))
    flock = np.stack([east.ravel(), north.ravel(), np.full(6, 1.5)], axis=-1)  # 6 that hang together: not few
    estimate = ground_of(np.concatenate([places, flock]))
    assert np.nanmax(estimate.height) < 0.1
    assert np.isfinite(estimate.height[5:-5, 5:-5]).all()


def test_a_small_gap_is_interpolated_and_a_large_one_is_not() -> None:
    places = seen(lambda north: 0 * north, np.random.default_rng(6))
    small = (np.abs(places[:, 0] - 1.0) < 0.15) & (np.abs(places[:, 1] - 1.0) < 0.15)
    large = (np.abs(places[:, 0] - 2.5) < 0.8) & (np.abs(places[:, 1] - 2.5) < 0.8)
    ground = ground_of(places[~small & ~large])
    assert ground.kind[20, 20] == GroundKind.INTERPOLATED
    assert ground.sigma[20, 20] > 1.5 * np.nanmedian(ground.sigma)
    assert ground.kind[50, 50] == GroundKind.UNSEEN
    assert np.isnan(ground.height[50, 50])


def test_common_errors_of_a_dwell_do_not_average_out() -> None:
    places = seen(lambda north: 0 * north, np.random.default_rng(7))
    layers = layers_at(places)
    common = np.zeros((len(layers), 3, 3))
    common[:, 2, 2] = 0.05**2
    layers = replace(layers, common=common)
    ground = estimated_ground(layers.where(is_inside(places)), NOWHERE, GRID, SETTINGS)
    assert np.allclose(ground.sigma[5:-5, 5:-5], 0.05, rtol=0.1)


def test_heights_scattered_as_in_a_canopy_give_no_ground() -> None:
    rng = np.random.default_rng(8)
    places = seen(lambda north: 0 * north, rng)
    lifted = places + rng.uniform(0.0, 4.0, (len(places), 1)) * [0.0, 0.0, 1.0]
    assert np.mean(np.isfinite(ground_of(lifted).height)) < 0.02


def test_nothing_measured_gives_no_heights() -> None:
    ground = ground_of(np.empty((0, 3)))
    assert (ground.kind == GroundKind.UNSEEN).all()
    assert np.isnan(ground.height).all()


def test_there_is_no_step_to_a_cell_without_a_height() -> None:
    """Between trees a cell may be torn from all others; those beside it kept a height whose sigma was NaN."""
    measured = np.where(np.arange(5) < 3, 0.0, 1.0) + np.zeros((4, 5))
    membrane = fitted_membrane(measured, np.full(measured.shape, SIGMA), 1.0, SETTINGS.gate)
    membrane.height[1, 1] = np.nan
    for joint in membrane.joined:
        joint[:] = False
    jump = _jumps_beside(membrane)
    assert np.isfinite(jump).all()
    np.testing.assert_allclose(jump[:, 2:4], 1.0, atol=0.01)
    np.testing.assert_allclose(jump[:, :2], 0.0, atol=0.01)
