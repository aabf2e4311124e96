"""Heights of reflectors from simulated passes of Gotcha's geometry, with errors of phase and position."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import few
from pass_scenes import SETTINGS, SMALL, TANGENT, amplitudes, flown, reflectors, shown
from scipy.spatial import cKDTree

from sal_height.elevation import ESTIMATORS, Validity
from sal_height.errors import UserError
from sal_height.passes import Pass, PassHeights, PassSettings, ReferencePoint, heights_from_passes, simulated_passes

ORIGIN = np.zeros(3)


def made(
    passes: list[Pass], references: list[ReferencePoint], settings: PassSettings = SETTINGS, name: str = "ml"
) -> PassHeights:
    """Heights by an estimator, one look each."""
    estimator = ESTIMATORS[name]
    alone = estimator.settings(range_looks=1, azimuth_looks=1)
    return heights_from_passes(passes, ORIGIN, estimator, alone, settings, references)


@cache
def scene(seed: int) -> tuple[np.ndarray, tuple[Pass, ...], tuple[ReferencePoint, ...]]:
    """Twenty reflectors, the passes over them, and three of them as reference points known to 2 cm."""
    rng = np.random.default_rng(seed)
    points = reflectors(rng, 20)
    passes = flown(rng, points, phases=rng.uniform(-np.pi, np.pi, 8), offsets=rng.normal(0, 0.03, (8, 3)))
    known = points[:3] + rng.normal(0, 0.02, (3, 1)) * [0, 0, 1]
    return points, tuple(passes), tuple(ReferencePoint(place, ties=True) for place in known)


def errors_of(result: PassHeights, points: np.ndarray) -> np.ndarray:
    """Errors of height of the points that were found, NaN for those more than half a metre from any true one."""
    apart, nearest = cKDTree(points).query(result.found.points.positions)
    return np.where(apart < 0.5, result.found.points.height - points[nearest, 2], np.nan)


@pytest.mark.parametrize("seeds", few(1, [range(11, 12), range(11, 13)]), ids=len)
def test_reflectors_have_their_heights(seeds: range) -> None:
    """20 of them in each scene; of the share within one sigma two standard errors are allowed, .2 of one scene."""
    ratios = []
    for seed in seeds:
        points, passes, references = scene(seed)
        result = made(list(passes), list(references), SETTINGS.changed(position_sigma_m=0.03))
        errors = errors_of(result, points)
        assert not result.warnings
        assert len(errors) >= 19
        assert np.isfinite(errors).all()
        assert np.std(errors) < 0.012
        ratios += (errors / result.found.points.total_sigma).tolist()
    assert np.mean(np.abs(ratios) < 1) > 0.683 - 2 * np.sqrt(0.683 * 0.317 / len(ratios))
    assert np.abs(ratios).max() < 4


def test_what_all_passes_err_in_range_is_in_the_heights_and_in_their_sigma() -> None:
    """All 6 cm nearer than they are said to be, seen at 44 degrees: 4 cm of height, and 3 are stated for 10 cm each."""
    rng = np.random.default_rng(16)
    points = reflectors(rng, 20)
    (one, *_) = flown(np.random.default_rng(0), points)
    sight = -np.mean(one.antenna, axis=0) / np.linalg.norm(np.mean(one.antenna, axis=0))
    passes = flown(rng, points, offsets=np.tile(0.06 * sight, (8, 1)))
    result = made(passes, [ReferencePoint(place, ties=True) for place in points[:3]], SETTINGS)
    errors = errors_of(result, points)
    assert np.isfinite(errors).sum() >= 18
    assert abs(np.nanmean(errors)) == pytest.approx(0.06 * abs(sight[2]), abs=0.008)
    stated = np.median(result.found.points.common_sigma)
    assert stated == pytest.approx(np.sqrt(np.pi / 2) * 0.1 / np.sqrt(8) * abs(sight[2]), rel=0.1)


def test_a_reference_that_is_not_there_is_told_and_without_any_only_a_common_height_is_open() -> None:
    points, passes, _ = scene(11)
    nowhere = ReferencePoint(np.array([0.0, 300.0, 0.0]), ties=True)
    result = made(list(passes), [nowhere])
    (sentence,) = result.warnings
    assert sentence.startswith("The reference point at 0, 300, 0 m is not used: the nearest bright point is ")
    assert result.tie.references == 0
    moved = result.found.points.positions
    apart, nearest = cKDTree(shown(points)).query(shown(moved))
    errors = (moved[:, 2] - points[nearest, 2])[apart < 0.3]
    assert len(errors) >= 18
    assert np.std(errors) < 0.015
    assert np.abs(np.median(moved[:, 2])) < 0.2  # most are on the ground


@pytest.mark.thorough
def test_capon_agrees_with_maximum_likelihood() -> None:
    points, passes, references = scene(12)
    errors = errors_of(made(list(passes), list(references), name="capon"), points)
    assert np.isfinite(errors).sum() >= 18
    assert np.nanstd(errors) < 0.015


def test_a_pass_whose_phase_cannot_be_tied_is_left_out() -> None:
    """The images of the seventh pass are those of other phases from point to point, as after a wrong autofocus."""
    rng = np.random.default_rng(14)
    points = reflectors(rng, 20)
    each = np.broadcast_to(amplitudes(rng, 20, 23.0), (8, 20)).copy()
    each[6] *= np.exp(2j * np.pi * rng.uniform(size=20))
    passes = simulated_passes(SMALL, points, each, 1.0, rng)
    result = made(passes, [ReferencePoint(place, ties=True) for place in points[:3]])
    (sentence,) = result.warnings
    assert sentence.startswith("Pass pass_7 is left out: its phase cannot be tied to the others")
    assert len(result.array.passes) == 7
    errors = errors_of(result, points)
    assert np.isfinite(errors).sum() >= 18
    assert np.nanstd(errors) < 0.015


def test_points_that_differ_from_pass_to_pass_are_less_certain() -> None:
    """Amplitudes that err by 15 % are found to do so, and are in sigma."""
    rng = np.random.default_rng(15)
    points = reflectors(rng, 20)
    each = amplitudes(rng, 20, 26.0) * (1 + 0.15 * (rng.standard_normal((8, 20, 2)) @ [1.0, 1j]) / np.sqrt(2))
    passes = simulated_passes(SMALL, points, each, 1.0, rng)
    result = made(passes, [ReferencePoint(place, ties=True) for place in points[:3]])
    assert result.tie.uncertainty == pytest.approx(0.15, abs=0.05)
    ratios = errors_of(result, points) / result.found.points.total_sigma
    assert np.isfinite(ratios).sum() >= 18
    assert np.nanstd(ratios) < 1.6


@pytest.mark.thorough
def test_pairs_in_a_cell_do_not_spoil_the_tie() -> None:
    """Five of thirteen bright pixels hold two reflectors, some of them nearly in phase as one."""
    rng = np.random.default_rng(100)
    points = reflectors(rng, 13, side=12.0)
    apart = rng.uniform(0.4, 3.0, 5)
    above = points[8:] + apart[:, None] * [-TANGENT, 0.0, 1.0]
    passes = flown(rng, np.concatenate([points, above]), cnr_db=26.0, phases=rng.uniform(-np.pi, np.pi, 8))
    result = made(passes, [ReferencePoint(place, ties=True) for place in points[:3]])
    assert result.tie.points >= 7
    assert result.tie.coherence.min() > 0.95
    off, nearest = cKDTree(points[:8]).query(result.found.points.positions)
    assert off.max() < 0.5
    errors = result.found.points.height - points[nearest, 2]
    assert len(errors) >= 7
    assert np.abs(errors).max() < 0.05


def test_two_reflectors_in_a_cell_get_no_height() -> None:
    """One .6 m higher in the same range and Doppler: they are told from one, and counted."""
    rng = np.random.default_rng(16)
    points = reflectors(rng, 18)
    below = np.array([[0.0, 0.0, 0.0]])
    apart = np.linalg.norm(shown(points), axis=1) > 1.5
    above = below + 0.6 * np.array([[-TANGENT, 0.0, 1.0]])
    scene_points = np.concatenate([points[apart], below, above])
    passes = flown(rng, scene_points, cnr_db=26.0)
    result = made(passes, [ReferencePoint(place, ties=True) for place in scene_points[:4]])
    near = np.linalg.norm(shown(result.found.points.positions), axis=1) < 1.0
    assert not near.any()
    assert result.found.reasons[Validity.TWO_SCATTERERS] >= 1


def test_a_volume_that_is_too_large_is_refused() -> None:
    _, passes, references = scene(13)
    with pytest.raises(UserError, match="at most 67108864 are allowed: choose a smaller side_m"):
        made(list(passes), list(references), SETTINGS.changed(highest_m=9000.0))


def clustered(rng: np.random.Generator, spread: float, errors: float) -> tuple[np.ndarray, list[Pass]]:
    """Twenty reflectors whose amplitudes err from pass to pass, seven passes within 2 `spread` degrees, one .4 off."""
    elevations = 52.0 + np.append(rng.uniform(-spread, spread, 7), 0.4)
    circle = replace(SMALL, elevations=tuple(np.radians(elevations)))
    points = reflectors(rng, 20)
    each = amplitudes(rng, 20, 19.0) * (1 + errors * (rng.standard_normal((8, 20, 2)) @ [1.0, 1j]) / np.sqrt(2))
    return points, simulated_passes(circle, points, each, 1.0, rng)


@pytest.mark.thorough
def test_heights_that_clustered_passes_confuse_are_not_given() -> None:
    """Errors of amplitude count as noise where sidelobes of 0.9 are told apart; else 3 of 74 heights would be wrong."""
    rng = np.random.default_rng(17)
    errors = []
    for _ in range(5):
        points, passes = clustered(rng, 0.04, 0.3)
        result = made(passes, [ReferencePoint(place, ties=True) for place in points[:3]])
        if result.tie.references:
            errors += errors_of(result, points).tolist()
    assert len(errors) > 30
    assert np.isfinite(errors).all()


def test_a_reference_that_cannot_tell_two_heights_of_all_points_apart_is_not_used() -> None:
    rng = np.random.default_rng(18)
    points, passes = clustered(rng, 0.02, 0.1)
    result = made(passes, [ReferencePoint(points[0], ties=True)])
    assert result.tie.references == 0
    assert abs(result.tie.elsewhere) == pytest.approx(result.ambiguity.at, rel=0.15)
    (sentence,) = result.warnings
    assert "reference points are not used: from what they state, every point may as well be" in sentence
