"""Passes over the same ground are brought together, with the errors that remain as stated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flown_passes import BORESIGHT, flown, flown_as, preset_of
from helpers import assert_one_sentence, few

from benchmarks.passes import FlownPasses, observed
from sal_height.adjustment import Adjustment, AdjustmentSettings, ObservedDwell, References, Target, Terrain, adjust
from sal_height.adjustment.equations import Form
from sal_height.adjustment.observed import BORESIGHT as TURN
from sal_height.adjustment.observed import vibration_of
from sal_height.imaging import Centroid, Placement
from sal_height.numeric import F64
from sal_height.runs.products.adjustment_report import summary_of
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.phase_errors import Vibration, VibrationLine
from sal_height.simulation.preset import TargetSettings

SETTINGS = AdjustmentSettings(boresight_sigma_rad=3e-5, lever_arm_sigma_m=0.01, jitter_rad=1e-7)


def errors_of(adjustment: Adjustment, passes: FlownPasses) -> tuple[F64, F64]:
    """Errors of the shifts that are left, m, shape (dwells, 3), and their mean square over what is stated."""
    shifts, covariances = adjustment.shifts
    errors = shifts - passes.shifts
    over = [e @ np.linalg.solve(c, e) / 3 for e, c in zip(errors, covariances, strict=True)]
    return errors, np.array(over)


def relative_over(adjustment: Adjustment, errors: F64) -> float:
    """Mean square of the errors against the mean of all dwells, over what is stated of that."""
    covariances, _ = adjustment.spread
    apart = errors - errors.mean(axis=0)
    return float(np.mean([e @ np.linalg.solve(c, e) / 3 for e, c in zip(apart, covariances, strict=True)]))


@cache
def adjusted_alone(seed: int = 1) -> Adjustment:
    """The adjustment of the dwells of `flown` without references."""
    passes = flown(seed)
    return adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS)


@pytest.mark.parametrize("seed", few(1, [1, 2]))
def test_dwells_are_brought_together_within_what_is_stated(seed: int) -> None:
    """From 60 cm to less than a pixel horizontally, and 6 mm in height."""
    passes, adjustment = flown(seed), adjusted_alone(seed)
    before = passes.shifts - passes.shifts.mean(axis=0)
    assert np.all(np.sqrt(np.mean(before**2, axis=0)) > 0.1)
    errors, over = errors_of(adjustment, passes)
    apart = np.sqrt(np.mean((errors - errors.mean(axis=0)) ** 2, axis=0))
    assert np.all(apart < [0.07, 0.045, 0.006]), apart
    assert relative_over(adjustment, errors) < 2.0
    assert np.mean(over) < 3.0
    found, covariance = adjustment.common
    off = found[TURN] + BORESIGHT
    assert off @ np.linalg.solve(covariance[TURN, TURN], off) < 16.3, "99.9 % of chi-square"


def test_known_ground_puts_all_dwells_in_their_place() -> None:
    """Within 5 cm horizontally and 5 mm in height; without it they stay where odometry puts them together."""
    passes = flown()
    terrain = References(terrain=Terrain(passes.flight.scene.heights, 0.02))
    alone, grounded = adjusted_alone(), adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS, terrain)
    assert any(one.is_absolute for one in grounded.comparisons)
    assert not any(one.is_absolute for one in alone.comparisons)
    errors, over = errors_of(grounded, passes)
    assert np.all(np.abs(errors.mean(axis=0)) < [0.05, 0.05, 0.005])
    assert np.mean(over) < 3.0
    stated = [np.sqrt(np.mean([c.diagonal() for c in one.shifts[1]], axis=0)) for one in (alone, grounded)]
    assert np.all(stated[1] < stated[0] * 0.6)
    assert np.all(stated[0] > 0.05)


@pytest.mark.parametrize(("off", "refused"), [(0.1, False), (1.0, True)])
def test_known_ground_may_be_off_by_what_is_stated_of_it_and_no_farther(off: float, refused: bool) -> None:
    """All of it by 10 cm, one standard deviation; by 1 m it contradicts what is known, and the result is without it."""
    passes = flown()
    heights = passes.flight.scene.heights
    ground = References(terrain=Terrain(lambda east, north: heights(east, north) + off, 0.1))
    adjustment = adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS, ground)
    errors, _ = errors_of(adjustment, passes)
    sigma = np.sqrt(adjustment.spread[1].diagonal())
    assert np.all(np.abs(errors.mean(axis=0)) < 3 * sigma)
    assert (adjustment.refused_ground is not None) == refused
    assert any(one.is_absolute for one in adjustment.comparisons) != refused
    if adjustment.refused_ground is not None:
        assert adjustment.refused_ground[2] == pytest.approx(off, abs=0.6)


def test_dwells_that_look_alike_and_share_no_ground_are_not_compared() -> None:
    """One of the second pass of `sal_passes` shows the end of a car, and so do three of the first, 1 to 2 m beside it.

    By what both show they would be the same with an evidence of 5.5 to 7.1.
    """
    preset = load_preset("sal_passes")
    dwells = {number: observed(number, preset, 4)[0] for number in (1, 2, 3, 5)}
    mounting = flight_of(preset, 4).sensor.mounting
    known = AdjustmentSettings(boresight_sigma_rad=2e-5, lever_arm_sigma_m=0.01, odometry_delay_sigma_s=1e-5)
    for number in (1, 2, 3):
        assert adjust([dwells[number], dwells[5]], mounting, known).comparisons == []


@pytest.mark.thorough
def test_targets_are_as_good() -> None:
    """A post whose place is known, in the middle of the dwells of each pass."""
    target = TargetSettings(east_m=0.0, north_m=1.0, height_m=0.5, power_db=25.0)
    passes = flown_as(replace(preset_of(4, 3), targets=(target,)), 5)
    post = Target(0.0, 1.0, 0.5)
    adjustment = adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS, References((post,)))
    assert sum(one.is_target for one in adjustment.comparisons) >= 3
    errors, over = errors_of(adjustment, passes)
    assert np.all(np.abs(errors.mean(axis=0)) < [0.06, 0.06, 0.03]), errors.mean(axis=0)
    assert np.mean(over) < 3.0


@pytest.mark.parametrize(
    "references",
    few(
        2,
        [
            References((Target(0.0, 1.0, 40.0),)),
            References(terrain=Terrain(lambda east, north: np.full_like(east + north, np.nan), 0.1)),
            References((Target(1000.0, 0.0, 0.0),)),
            References(terrain=Terrain(lambda east, north: np.full_like(east + north, 300.0), 0.1)),
        ],
    ),
    ids=["target too high", "no terrain", "target elsewhere", "terrain too high"],
)
def test_references_that_are_not_there_change_nothing(references: References) -> None:
    passes = flown()
    alone, other = adjusted_alone(), adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS, references)
    assert not any(one.is_absolute for one in other.comparisons)
    np.testing.assert_allclose(other.shifts[0], alone.shifts[0], atol=1e-9)


def test_a_target_that_does_not_stand_out_is_none() -> None:
    """All points as bright as each other, or one 20 dB brighter."""
    dwell = flown().dwells[0]
    points, reach = dwell.points, np.full(3, 1.0)
    place = points.place[len(points.place) // 2]
    target, form = Target(*place.tolist()), Form(np.zeros(1, np.int64), np.zeros((3, 1)), np.zeros(3))
    level = replace(points, cnr_db=np.full(len(points.place), 10.0))
    bright = replace(level, cnr_db=np.where(np.all(points.place == place, axis=1), 30.0, 10.0))
    assert target.sighted(level, form, np.zeros(3), reach) is None
    equation = target.sighted(bright, form, np.zeros(3), reach)
    assert equation is not None
    np.testing.assert_allclose(equation.right, 0.0, atol=1e-9)


def test_dwells_are_compared_with_as_many_others_as_wanted() -> None:
    passes = flown()
    few, many = (
        len(adjust(passes.dwells, passes.flight.sensor.mounting, settings).comparisons)
        for settings in (SETTINGS.model_copy(update={"partners": n}) for n in (1, 4))
    )
    assert 0 < few <= len(passes.dwells)
    assert many > 1.5 * few


def test_nothing_is_looked_for_farther_than_wanted() -> None:
    """Dwells lie off by many pixels: those that may be a third of one off, in each of two searches, stay apart."""
    passes = flown()
    near = SETTINGS.model_copy(update={"reach_spacings": 1 / 3})
    errors, _ = errors_of(adjust(passes.dwells, passes.flight.sensor.mounting, near), passes)
    apart = np.sqrt(np.mean((errors - errors.mean(axis=0)) ** 2, axis=0))
    assert np.all(apart[:2] > 0.1), apart


def test_passes_that_do_not_overlap_stay_as_odometry_has_them() -> None:
    passes = flown()
    apart = []
    for number, dwell in enumerate(passes.dwells):
        away = np.array([100.0 * number, 0.0, 0.0])
        points = replace(dwell.points, place=dwell.points.place + away)
        aperture = replace(dwell.aperture, position=dwell.aperture.position + away)
        apart.append(replace(dwell, points=points, aperture=aperture))
    adjustment = adjust(apart, passes.flight.sensor.mounting, SETTINGS)
    assert not adjustment.comparisons
    shifts, covariances = adjustment.shifts
    sigmas = np.sqrt(np.array([c.diagonal() for c in covariances]))
    assert np.all(np.abs(shifts) < 4 * sigmas)
    assert np.all(sigmas > 0.05)


@pytest.mark.parametrize("numbers", [(0, 3), (2, 5), (1, 3), (2, 11)])
def test_dwells_of_other_pieces_of_the_street_stay_as_odometry_has_them(numbers: tuple[int, int]) -> None:
    """Of one pass the west, and of another the east: kerbs fit best with both on each other, 60 cm and more off."""
    passes = flown()
    adjustment = adjust([passes.dwells[number] for number in numbers], passes.flight.sensor.mounting, SETTINGS)
    assert not adjustment.comparisons


def test_dwells_that_are_nearly_taken_for_the_same_ground_are_not() -> None:
    """The pair of other pieces, of 128 of 16 flights, whose evidence of the same ground is the greatest: 2.6."""
    preset, pair = preset_of(5, 3), (2, 5)
    made = [observed(number, preset, 4) for number in pair]
    mounting = flight_of(preset, 4).sensor.mounting
    assert not adjust([dwell for dwell, _ in made], mounting, SETTINGS).comparisons


def test_one_dwell_with_wrong_heights_does_not_move_the_others() -> None:
    """Its heights are those of another place: a wrong comparison loses its weight."""
    passes = flown()
    mounting, broken = passes.flight.sensor.mounting, 7
    points = passes.dwells[broken].points
    mirrored = replace(points, place=np.column_stack([points.place[:, 0], points.place[::-1, 1], points.place[:, 2]]))
    dwells = list(passes.dwells)
    dwells[broken] = replace(dwells[broken], points=mirrored)
    adjustment = adjust(dwells, mounting, SETTINGS)
    errors = np.delete(adjustment.shifts[0] - passes.shifts, broken, axis=0)
    apart = np.sqrt(np.mean((errors - errors.mean(axis=0)) ** 2, axis=0))
    assert np.all(apart < [0.06, 0.06, 0.01]), apart


def test_comparisons_that_contradict_the_others_are_said() -> None:
    """Those of a dwell that is 6 cm too high among its neighbours."""
    passes = flown()
    mounting, dwells = passes.flight.sensor.mounting, list(passes.dwells)
    points = dwells[7].points
    dwells[7] = replace(dwells[7], points=replace(points, place=points.place + np.array([0.0, 0.0, 0.06])))
    for some, contradict in ((passes.dwells, False), (dwells, True)):
        adjustment = adjust(some, mounting, SETTINGS)
        assert (adjustment.contradictions > 0) == contradict
        summary, said = summary_of(adjustment, some, mounting, SETTINGS, References())
        assert summary["comparisons_that_contradict"] == adjustment.contradictions
        assert (
            any("contradict the others: some dwells were taken for another place" in one for one in said) == contradict
        )


def test_a_dwell_that_is_compared_with_known_ground_only_is_said() -> None:
    passes = flown()
    mounting, (dwell, *_) = passes.flight.sensor.mounting, passes.dwells
    ground = References(terrain=Terrain(passes.flight.scene.heights, 0.02))
    summary, said = summary_of(adjust([dwell], mounting, SETTINGS, ground), [dwell], mounting, SETTINGS, ground)
    assert (summary["comparisons"], summary["comparisons_with_known_ground"] > 0) == (0, True)
    (warning,) = (one for one in said if one.startswith("No two dwells"))
    assert_one_sentence(warning.partition(". Fly")[0] + ".", "compared with known ground, but not with each other")


@pytest.mark.thorough
def test_dwells_that_vibrate_are_brought_together() -> None:
    """By up to 15 mm/s, half of what pulses tell from nothing: 1.5 m along the flight, of which a few cm are left."""
    shaken = Vibration(lines=(VibrationLine(60e-6, 40.0),))
    passes = flown_as(preset_of(4, 5, vibration=shaken), 3)
    adjustment = adjust(passes.dwells, passes.flight.sensor.mounting, SETTINGS)
    before, after = adjustment.differences
    known = np.array([one.equation.information[0, 0] > 0.3**-2 for one in adjustment.comparisons])
    assert known.sum() > 10
    assert np.sqrt(np.mean(before[known, 0] ** 2)) > 0.2
    assert np.sqrt(np.median(after[known, 0] ** 2)) < 0.1


def test_vibration_is_the_spread_of_centroids_on_their_circle() -> None:
    """5000 pairs of dwells: 8 mm/s within 5 %, though a fifth is beyond the ambiguity's half; 0 of equal ones."""
    rng = np.random.default_rng(1)
    one, ambiguity = flown().dwells[0], 0.031

    def shaken(speeds: F64) -> dict[int, ObservedDwell]:
        folded = speeds - ambiguity * np.rint(speeds / ambiguity)
        placements = [Placement(0.0, 0.0, 0.0, Centroid(speed, 1e-4)) for speed in folded.tolist()]
        return {n: replace(one, placement=told, ambiguity=ambiguity) for n, told in enumerate(placements)}

    drift = np.repeat(rng.normal(0.0, 0.02, 5000), 2)
    pairs = [range(2 * n, 2 * n + 2) for n in range(5000)]
    assert vibration_of(shaken(drift + rng.normal(0.0, 0.008, 10_000)), pairs) == pytest.approx(0.008, rel=0.05)
    assert vibration_of(shaken(drift), pairs) == pytest.approx(0.0, abs=1e-6)
    assert vibration_of(shaken(drift[:1]), [range(1)]) == 0.0
