"""The one real pass of Gotcha at hand, with seven simulated passes over the bright points of its image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from sal_height.elevation import ESTIMATORS
from sal_height.errors import UserError
from sal_height.geometry import Grid, locate_at_height
from sal_height.imaging import Processing, backproject
from sal_height.imports import read_gotcha
from sal_height.imports.gotcha import import_gotcha
from sal_height.passes import (
    GOTCHA_ELEVATIONS,
    Circle,
    Pass,
    PassArray,
    PassSettings,
    ReferencePoint,
    heights_from_passes,
    simulated_passes,
)
from sal_height.runs.products.passes import heights_of_bags

SIDE = 40.0


@pytest.fixture(scope="module")
def real(shared_data: Callable[[str], Path]) -> Pass:
    """The first two degrees of azimuth."""
    collection = read_gotcha(sorted(shared_data("afrl_gotcha").glob("*.mat"))[:2])
    antenna = np.array([state.position for state in collection.states])
    return Pass("real", collection.sensor, collection.histories[0], antenna)


def bright_points(real: Pass) -> tuple[np.ndarray, np.ndarray, float]:
    """Places on the ground and amplitudes of points in the real image, and the power of its background."""
    spacing = 0.25
    size = round(SIDE / spacing) + 1
    east, north = np.eye(3)[:2]
    grid = Grid(np.array([-SIDE / 2, -SIDE / 2, 0.0]), east, north, spacing, spacing, size, size)
    image = backproject(real.history, real.antenna, real.sensor, Processing("taylor", "taylor"), grid)[0]
    power = np.abs(image) ** 2
    level = float(np.median(power) / np.log(2))
    row, col = np.nonzero((power == maximum_filter(power, 7)) & (power > 20 * level))
    return grid.points(row, col), image[row, col], level


@pytest.mark.thorough
def test_a_real_pass_goes_with_simulated_ones(real: Pass) -> None:
    """The others see the bright points at heights given to them, on circles that the real pass cannot tell apart."""
    rng = np.random.default_rng(3)
    places, amplitudes, level = bright_points(real)
    array = PassArray.of((real, real.moved(np.array([0.0, 0.0, 100.0]))), np.zeros(3), PassSettings())
    reference = replace(array.reference, position=real.antenna[len(real.antenna) // 2], velocity=real.flight)
    sight = places - reference.position
    heights = np.where(rng.uniform(size=len(places)) < 0.7, rng.normal(0, 0.1, len(places)), rng.uniform(0, 3))
    along = sight @ reference.direction
    raised = locate_at_height(heights, np.linalg.norm(sight, axis=1), along, reference, array.look_side)
    azimuth = np.arctan2(real.antenna[:, 1], real.antenna[:, 0])
    circle = Circle(
        elevations=GOTCHA_ELEVATIONS[1:],
        distance=float(np.linalg.norm(real.antenna, axis=1).mean()),
        arc=float(np.ptp(azimuth)),
        pulses=len(azimuth),
        frequencies=real.sensor.sample_count,
        frequency=299792458.0 / real.sensor.wavelength,
        bandwidth=real.sensor.bandwidth,
    )
    # Circles are flown about an azimuth of 0.
    middle = float(azimuth.mean())
    turn = np.array([[np.cos(middle), np.sin(middle), 0], [-np.sin(middle), np.cos(middle), 0], [0, 0, 1]])
    noise = level * len(azimuth) * real.sensor.sample_count / 2
    others = simulated_passes(circle, raised @ turn.T, amplitudes, noise, rng, rng.uniform(-np.pi, np.pi, 7))
    passes = [real, *(replace(one, antenna=one.antenna @ turn) for one in others)]
    known = [ReferencePoint(place, ties=True) for place in raised[:4]]
    settings = PassSettings(side_m=SIDE - 4, lowest_m=-1.0, highest_m=3.5, position_sigma_m=0.03)
    ml = ESTIMATORS["ml"]
    result = heights_from_passes(passes, np.zeros(3), ml, ml.settings(range_looks=1, azimuth_looks=1), settings, known)
    assert len(result.array.passes) == 8
    assert result.tie.coherence[0] > 0.85  # the real one
    found = result.found.points
    shown = np.column_stack(result.array.seen(raised)[:2])
    apart, nearest = cKDTree(shown).query(np.column_stack(result.array.seen(found.positions)[:2]))
    errors = (found.height - heights[nearest])[apart < 0.3]
    inside = np.all(np.abs(raised[:, :2]) < SIDE / 2 - 3, axis=1)
    assert len(errors) > 0.6 * inside.sum() > 5
    assert np.mean(np.abs(errors) > 0.3) < 0.1
    assert np.median(np.abs(errors)) < 0.04


def test_files_of_one_pass_are_no_passes(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    """They see the scene from azimuths that do not overlap, and from one elevation."""
    bags = []
    for number, file in enumerate(sorted(shared_data("afrl_gotcha").glob("*.mat"))):
        import_gotcha([file], tmp_path / f"part{number}")
        bags.append(tmp_path / f"part{number}")
    with pytest.raises(
        UserError, match=r"Of 3 passes 1 can be used; 3 are needed. Pass part0 is left out: it sees the"
    ):
        heights_of_bags(bags, tmp_path / "out", wanted={"side_m": 20.0})
