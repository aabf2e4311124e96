"""Shifts, phases and positions of passes, recovered from the images of bright points."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import few
from pass_scenes import SETTINGS, array_of, flown, reflectors

from sal_height.errors import UserError
from sal_height.passes import PassArray, PassSettings, ReferencePoint, Tie, registered
from sal_height.passes.boxes import Registered
from sal_height.passes.heights import _with_references
from sal_height.passes.tie import Candidates, sensitivity, tie_passes


def tied(
    seed: int, settings: PassSettings, references: int = 0, cnr_db: float = 23.0, offset_m: float = 0.03
) -> tuple[Registered, Tie, np.ndarray, np.ndarray]:
    """What ties passes with errors of phase and position; and the true phases and positions of these."""
    rng = np.random.default_rng(seed)
    points = reflectors(rng, 20)
    phases, offsets = rng.uniform(-np.pi, np.pi, 8), rng.normal(0, offset_m, (8, 3))
    array = array_of(flown(rng, points, cnr_db, phases=phases, offsets=offsets))
    seen = registered(array, settings)
    known = [ReferencePoint(place, ties=True) for place in points[:references]]
    candidates, lacking = _with_references(Candidates.of(seen, settings), seen, known, settings)
    assert not lacking
    return seen, tie_passes(candidates, seen.lattice.array, settings), phases, offsets


def errors_of_phase(seen: Registered, tie: Tie, phases: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """How far the phases of the passes are off at the middle of the scene, rad from -pi to pi, less their mean."""
    array: PassArray = seen.lattice.array
    sight = -array.middles / np.linalg.norm(array.middles, axis=1, keepdims=True)
    # What registration has moved already is not in the phases any more.
    left = offsets + seen.shifts @ array.axes[:2]
    true = phases + array.wavenumbers * np.sum(sight * left, axis=1)
    off = np.exp(1j * (tie.phase - true))
    return np.asarray(np.angle(off / np.mean(off) * np.abs(np.mean(off))))


def without_gauge(errors: np.ndarray, seen: Registered) -> np.ndarray:
    """Errors of phase without those that a height of all points makes: searched, as they are modulo a turn."""
    slope = seen.lattice.steering(np.zeros(3)).slope(0.0)
    lifts = np.arange(-30, 30, 0.02)
    turned = np.exp(1j * (errors - np.multiply.outer(lifts, slope)))
    best = int(np.argmax(np.abs(turned.mean(axis=1))))
    mean = turned[best].mean()
    return np.asarray(np.angle(turned[best] / mean))


@pytest.mark.parametrize("seed", few(1, [0, 1, 2]))
def test_phases_are_found_but_for_a_height(seed: int) -> None:
    """Without reference points; within .1 rad, the sum of tilts at 3 cm of position and of noise."""
    seen, tie, phases, offsets = tied(seed, SETTINGS)
    assert tie.points >= 12
    assert tie.references == 0
    assert tie.coherence.min() > 0.95
    assert without_gauge(errors_of_phase(seen, tie, phases, offsets), seen) == pytest.approx(0.0, abs=0.15)


def test_reference_points_fix_the_height() -> None:
    """Phases are what they should be, by the standard deviations that the covariance states."""
    ratios = []
    for seed in range(3, 7):
        seen, tie, phases, offsets = tied(seed, SETTINGS.changed(position_sigma_m=0.03), references=3)
        assert tie.references >= 2
        errors = errors_of_phase(seen, tie, phases, offsets)
        slope = seen.lattice.steering(np.zeros(3)).slope(0.0)
        turning = slope - slope.mean()
        height = turning @ errors / np.sum(turning**2)
        ratios.append(height / np.sqrt(tie.variance(np.zeros(3), slope, seen.lattice.array)))
        assert without_gauge(errors, seen) == pytest.approx(0.0, abs=0.15)
    # References are exact here, but taken to be known to 2 cm: the greatest of four is within two sigma.
    assert np.abs(ratios).max() < 2


def test_a_tilt_is_as_uncertain_as_positions() -> None:
    """Far from the middle the variance is that of positions across the line of sight, which no phase tells."""
    _, near, *_ = tied(1, SETTINGS.changed(position_sigma_m=0.02))
    seen, far, *_ = tied(1, SETTINGS.changed(position_sigma_m=0.2))
    array = seen.lattice.array
    slope = seen.lattice.steering(np.zeros(3)).slope(0.0)
    place = np.array([0.0, 200.0, 0.0])
    turning = slope - slope.mean()
    pull = turning / np.sum(turning**2)
    sensitive = sensitivity(array, place[None])[0]
    closed = np.sqrt(np.sum((pull[:, None] * sensitive) ** 2))  # per m of position
    for sigma, tie in ((0.02, near), (0.2, far)):
        assert np.sqrt(tie.variance(place, slope, array)) == pytest.approx(sigma * closed, rel=0.05)


def test_an_error_of_position_adds_what_it_should() -> None:
    """Differences of exact ranges, between points at the edge and in the middle of the scene, for 10 cm each way."""
    array = array_of(flown(np.random.default_rng(0), np.zeros((1, 3))))
    place = np.array([5.0, -7.0, 1.0])
    for axis in (0, 1):
        off = 0.1 * array.axes[1 + axis]
        nearer = [
            np.linalg.norm(array.middles - point, axis=1) - np.linalg.norm(array.middles + off - point, axis=1)
            for point in (place, np.zeros(3))
        ]
        exact = array.wavenumbers * (nearer[0] - nearer[1])
        assert 0.1 * sensitivity(array, place[None])[0][:, axis] == pytest.approx(exact, rel=1e-2, abs=1e-5)


def test_antennas_in_place_leave_constant_phases() -> None:
    """What a displaced antenna adds to the middle of the scene is in the phases before, and not after."""
    rng = np.random.default_rng(10)
    array = array_of(flown(rng, np.zeros((1, 3))))
    phases, offset = rng.uniform(-np.pi, np.pi, 8), rng.normal(0, 0.2, (8, 2))
    moved = offset @ array.axes[1:]
    nearer = np.linalg.norm(array.middles, axis=1) - np.linalg.norm(array.middles + moved, axis=1)
    nothing = np.zeros((24, 24))
    tie = Tie(phases + array.wavenumbers * nearer, offset, nothing, 0.0, np.ones(8), 5, 0, np.zeros((5, 3)))
    placed, left = tie.placed(array)
    assert placed.middles == pytest.approx(array.middles + moved)
    assert left.phase == pytest.approx(phases, abs=0.02)  # waves are curved over .4 m


def test_images_are_brought_onto_each_other() -> None:
    """By 70 and 40 cm: what is left is below a quarter of a cell, in range and along the flight."""
    rng = np.random.default_rng(8)
    points = reflectors(rng, 20)
    offsets = np.zeros((8, 3))
    offsets[2], offsets[6] = [0.7, 0.3, -0.3], [-0.4, -0.5, 0.2]
    array = array_of(flown(rng, points, offsets=offsets))
    seen = registered(array, SETTINGS)
    left = offsets @ array.axes[:2].T + seen.shifts
    left -= np.median(left, axis=0)
    assert left == pytest.approx(0.0, abs=0.06)
    assert np.abs(seen.shifts).max() > 0.4


def test_noise_does_not_tie_passes() -> None:
    rng = np.random.default_rng(9)
    seen = registered(array_of(flown(rng, np.zeros((0, 3)))), SETTINGS)
    with pytest.raises(UserError, match="has 0 points that all passes see 10 dB above the background; 5 are needed"):
        Candidates.of(seen, SETTINGS)
