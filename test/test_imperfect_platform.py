"""The cases of `python -m benchmarks platform` with leaves in the wind and double bounce fly what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.imperfect_platform import BOUNCES, CASES, WINDS, Case, flown, still_share
from sal_height.simulation import flight_of, load_preset


def named(name: str) -> Case:
    return next(case for case in CASES if case.name == name)


def test_still_share_is_that_of_vegetation_wind() -> None:
    """0.46 at 10 GHz in 10 miles per hour, and nothing for light."""
    assert still_share(4.4704, 10e9) == pytest.approx(0.46, abs=0.005)
    assert still_share(2.0, 193e12) < 1e-4


def test_leaves_move_as_fast_as_the_wind_of_a_case_says() -> None:
    """Rms over those that move, of an exponential spectrum: within 2 %."""
    for wind, rms in {0: 0.0, **WINDS}.items():
        case = named(f"woods over relief, radar, wind {wind} m/s")
        speed = np.linalg.norm(flight_of(case.preset, 1).surface(0).velocity, axis=1)
        found = np.sqrt(np.mean(speed[speed > 0] ** 2)) if speed.any() else 0.0
        assert found == pytest.approx(rms, rel=0.02)


def test_grass_stands_on_level_ground() -> None:
    """Nothing is as high as the cars of the street of the preset."""
    case = named("grass, lidar, wind 0 m/s")
    street, grass = (flown(1, case.preset, "never", scene).comparison for scene in (None, case.scene))
    assert street
    assert grass
    assert street.errors.place[:, 2].max() > 0.5
    assert np.abs(grass.errors.place[:, 2]).max() < 0.5
    assert case.scene
    assert case.scene(1).extent == case.preset.scene_extent_m


def test_heights_are_those_of_the_first_estimator_of_a_preset() -> None:
    """Ground under a canopy is no ground where there is none; the other estimator has heights there."""
    bare = load_preset("small")
    ground = flown(1, replace(bare, estimators=("canopy_ground",), looks=(4, 12)), "never").comparison
    surface = flown(1, replace(bare, looks=(4, 12)), "never").comparison
    assert ground
    assert surface
    assert ground.valid < surface.valid
    assert named("ground under woods, radar, wind 10 m/s").preset.estimators == ("canopy_ground",)


def test_walls_bounce() -> None:
    """By as much as a case says, from both sensors: the greatest power of what is no target."""
    for sensor in ("lidar", "radar"):
        greatest = []
        for bounce in BOUNCES[-2:]:
            seen = flight_of(named(f"street, {sensor}, double bounce {bounce:g} dB").preset, 1).surface(0)
            greatest.append(seen.power[~seen.deterministic].max())
        assert greatest[1] == pytest.approx(greatest[0] * 10 ** ((BOUNCES[-1] - BOUNCES[-2]) / 10), rel=1e-6)
