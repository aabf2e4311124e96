"""A flight that is adjusted as it goes on: as good as all at once, with no more dwells held than wanted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flown_passes import flown, flown_as, preset_of
from helpers import few
from window_runs import WindowRun, run_through

from benchmarks.passes import FlownPasses
from sal_height.adjustment import AdjustmentSettings, AdjustmentWindow, References, Target, Terrain, adjust
from sal_height.adjustment.comparing import FINE_POINTS, DwellChain, compared, joined
from sal_height.adjustment.equations import Solution
from sal_height.adjustment.known_ground import UNKNOWN_GROUND
from sal_height.adjustment.network import Network
from sal_height.numeric import F64
from sal_height.simulation.preset import TargetSettings

SETTINGS = AdjustmentSettings(boresight_sigma_rad=3e-5, lever_arm_sigma_m=0.01, jitter_rad=1e-7)
RECOGNISED_M = 0.2
"""Standard deviation of a height below which a dwell has been recognised: alone it is known to .29 m, with others to
.14 m."""


def told_of(passes: FlownPasses, most_dwells: int, references: References = UNKNOWN_GROUND) -> WindowRun:
    window = AdjustmentWindow(passes.flight.sensor.mounting, SETTINGS, most_dwells, references=references)
    return run_through(window, passes.dwells)


@cache
def kept_all(seed: int) -> tuple[AdjustmentWindow, WindowRun]:
    """A window that has kept all dwells of `flown`, and its adjustment of each when it arrived."""
    passes = flown(seed)
    window = AdjustmentWindow(passes.flight.sensor.mounting, SETTINGS, 1000)
    return window, run_through(window, passes.dwells)


def over(told: WindowRun, truth: F64) -> F64:
    """Mean square of the errors over what is stated, shape (dwells,)."""
    errors = told.shifts - truth
    return np.array([e @ np.linalg.solve(c, e) / 3 for e, c in zip(errors, told.covariances, strict=True)])


@pytest.mark.parametrize("seed", few(1, [1, 2]))
def test_dwells_are_brought_together_as_they_come(seed: int) -> None:
    """From more than 10 cm to 6 cm in height and 30 cm along the flight, once the ground is recognised.

    It is by the end of each pass, and mostly before: how much a single dwell shows depends on its noise.
    """
    passes, (_, told) = flown(seed), kept_all(seed)
    assert told.kept == len(passes.dwells)
    before = passes.shifts - passes.shifts.mean(axis=0)
    assert np.all(np.sqrt(np.mean(before**2, axis=0)) > 0.1)
    late = slice(3, None)  # The first pass has nothing to be compared with.
    recognised = told.covariances[late, 2, 2] < RECOGNISED_M**2
    assert recognised[2::3].all()
    assert recognised.mean() > 0.5
    errors = (told.shifts - passes.shifts)[late]
    apart = (errors - errors[recognised].mean(axis=0))[recognised]
    assert np.sqrt(np.mean(apart[:, 2] ** 2)) < 0.04, apart
    assert np.all(np.abs((errors - errors[2::3].mean(axis=0))[2::3, :2]) < [0.3, 0.1]), apart
    assert np.mean(over(told, passes.shifts)) < 3.0


def test_the_last_adjustment_is_that_of_all_dwells_at_once() -> None:
    """Within a standard deviation, though comparisons began from what was known then."""
    passes, (window, _) = flown(1), kept_all(1)
    whole = adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS)
    (ours, covariance), (theirs, _) = window.adjustment.shifts, whole.shifts
    sigmas = np.sqrt([one.diagonal() for one in covariance])
    assert np.sqrt(np.mean(((ours - theirs) / sigmas) ** 2)) < 0.5
    assert len(window.adjustment.comparisons) > 0.5 * len(whole.comparisons)


@pytest.mark.thorough
def test_dwells_that_left_have_told_what_they_knew() -> None:
    """With half of the dwells held, the last ones of passes lie where they do with all; else they would not."""
    passes = flown()
    whole, short = told_of(passes, 1000), told_of(passes, 6)
    assert short.kept <= 9, "six, and a chain that begins"
    sigmas = np.sqrt([one.diagonal() for one in whole.covariances])
    apart = (np.abs(short.shifts - whole.shifts) / sigmas)[2::3]
    assert np.sqrt(np.mean(apart**2)) < 0.5
    late = FlownPasses(passes.flight, passes.dwells[-6:], passes.shifts[-6:])
    forgetful = told_of(late, 1000)
    variances = [np.mean([c[2, 2] for c in one.covariances[-3:]]) for one in (short, forgetful)]
    assert variances[0] < 0.8 * variances[1]
    assert np.mean(over(short, passes.shifts)) < 3.0


def test_no_more_points_are_held_than_wanted() -> None:
    """But for a chain that is over, and one that grows."""
    passes = flown()
    chain = sum(len(dwell.points.place) for dwell in passes.dwells[:3])
    window = AdjustmentWindow(passes.flight.sensor.mounting, SETTINGS, 1000, 2 * chain)
    held = []
    for dwell in passes.dwells:
        window.add(dwell)
        held.append(window.points)
    assert 2 * chain < max(held) < 3.5 * chain


def chains_of(passes: FlownPasses) -> tuple[Network, Solution, list[DwellChain]]:
    """A network of all dwells, what is known of it without comparisons, and its chains."""
    network = Network(passes.flight.sensor.mounting, SETTINGS)
    for dwell in passes.dwells:
        network.add(dwell)
    chains = joined(network.dwells, SETTINGS)
    known = network.solved(chains)
    return network, known, [DwellChain.of(numbers, network, known) for numbers in chains]


@pytest.mark.parametrize("wrong_m", [0.0, 20.0])
def test_what_dwells_leave_says_the_same_of_the_others(wrong_m: float) -> None:
    """Without new comparisons, poses and covariances stay as they were, but for weights that settle.

    So they do if one of those that leave is wrong, and has lost its weight.
    """
    passes = flown()
    network, known, joint = chains_of(passes)
    chains = joined(network.dwells, SETTINGS)
    found = []
    for number, chain in enumerate(joint):
        found += compared(chain, joint[:number], network, known, UNKNOWN_GROUND, FINE_POINTS)
    found[0] = replace(found[0], equation=replace(found[0].equation, right=found[0].equation.right + wrong_m))
    for _ in range(3):
        before = network.solved(chains, found)
    stay = found
    for number in range(2):  # one after the other
        fewer = network.forget(list(joint[number].shifts))
        assert 0 < len(fewer) < len(stay)
        stay = fewer
    assert list(network.dwells) == [number for chain in joint[2:] for number in chain.shifts]
    after = network.solved(chains[2:], stay)
    forms = list(network.poses.values())
    for form, one, other in zip(forms, before.covariance(forms), after.covariance(forms), strict=True):
        sigmas = np.sqrt(one.diagonal())
        assert np.all(np.abs(after.at(form) - before.at(form)) < 0.05 * sigmas)
        np.testing.assert_allclose(np.sqrt(other.diagonal()), sigmas, rtol=0.02)


def test_a_strip_that_is_known_to_lie_elsewhere_by_now_is_compared_as_before() -> None:
    """Whatever was taken out of it when it was over: the same comparison, to a tenth of a pixel."""
    network, known, (first, second, *_) = chains_of(flown())
    off = np.array([0.5, -0.7, 0.11])
    held = replace(
        first,
        shifts={number: shift - off for number, shift in first.shifts.items()},
        points=first.points.moved(-off),
        low=first.low + off[:2],
        high=first.high + off[:2],
    )
    one, other = (
        next(compared(second, [chain], network, known, UNKNOWN_GROUND, FINE_POINTS)) for chain in (first, held)
    )
    np.testing.assert_allclose(one.equation.right, other.equation.right, atol=0.1 * first.points.spacing)


def test_targets_are_used_as_dwells_come() -> None:
    """A post whose place is known: heights of the pass that sees it are known three times as well."""
    seen = TargetSettings(east_m=0.0, north_m=1.0, height_m=0.5, power_db=25.0)
    passes = flown_as(replace(preset_of(2, 3), targets=(seen,)), 5)
    with_post, without = (
        told_of(passes, 1000, known) for known in (References((Target(0.0, 1.0, 0.5),)), UNKNOWN_GROUND)
    )
    assert with_post.covariances[-1][2, 2] < without.covariances[-1][2, 2] / 9
    assert np.mean(over(with_post, passes.shifts)) < 3.0


def test_known_ground_is_used_as_dwells_come() -> None:
    """Heights within 2 cm of the truth from the first dwell on; a target that is not there changes nothing."""
    passes = flown()
    ground = References((Target(1000.0, 0.0, 0.0),), Terrain(passes.flight.scene.heights, 0.02))
    told = told_of(passes, 6, ground)
    assert np.sqrt(np.mean((told.shifts - passes.shifts)[:, 2] ** 2)) < 0.02
    assert np.mean(over(told, passes.shifts)) < 3.0


def test_a_window_tells_of_nothing_before_the_first_dwell() -> None:
    window = AdjustmentWindow(flown().flight.sensor.mounting, SETTINGS, 10)
    with pytest.raises(ValueError, match="no dwell"):
        _ = window.adjustment
