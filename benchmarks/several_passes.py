"""Coverage of the sigma of heights from several passes, and their distance from the bound.

The eight passes of AFRL's Gotcha set, simulated over reflectors with errors of phase and position; three reflectors are
reference points, known to 2 cm. `python -m benchmarks.several_passes` prints the scenes one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.row import Row, load, medians, sized
from sal_height.elevation import ESTIMATORS, conditional_crb
from sal_height.numeric import F64, error_statistics, mean_of, root_mean_square
from sal_height.passes import (
    GOTCHA_ELEVATIONS,
    OF_POINTS,
    Circle,
    Pass,
    PassHeights,
    PassSettings,
    ReferencePoint,
    heights_from_passes,
    simulated_passes,
)

SCENES = sized(30, 1)
REFLECTORS = 20
"""Of a scene; a third of them 0 to 4 m above the ground."""

CIRCLE = Circle(pulses=60, frequencies=112)
SIDE = 14.0
"""Side of the square with reflectors, m: what these pulses and frequencies sample."""

POSITION_SIGMA = 0.03
"""Errors of position of a pass each way, m, as the settings say."""

REFERENCE_SIGMA = 0.02
"""Error of the height of reference points, m, as the settings say."""

CNR_DB = 22.0
"""Of a reflector in an image without windows: 20 dB and less in the pixels of windowed ones."""

PAIRS, PAIR_SCENES, PAIR_CNR_DB = 5, sized(12, 1), 26.0
"""Reflectors of a scene that have another one in their cell, such scenes, and the CNR of each, dB."""

AMPLITUDE_ERROR = 0.1
"""Of reflectors from pass to pass, in half of the scenes."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A scene and what was found in it.

    Attributes:
        reflectors: places, m, (reflectors, 3).
        result: the heights.
        errors: height error of each point, m; NaN: no reflector is within .5 m.
        over_bound: errors across range and flight over the Cramer-Rao bound of a single look, without their plane.
    """

    reflectors: F64
    result: PassHeights
    errors: F64
    over_bound: F64


def flown(seed: int) -> Flown:
    """A scene, with errors of amplitudes if its number is odd."""
    rng = np.random.default_rng(seed)
    places = reflectors(rng)
    power = 10 ** (CNR_DB / 10) / (CIRCLE.pulses * CIRCLE.frequencies)
    amplitudes = np.sqrt(power) * np.exp(2j * np.pi * rng.uniform(size=REFLECTORS))
    if seed % 2:
        error = rng.standard_normal((8, REFLECTORS, 2)) @ np.array([1.0, 1j])
        amplitudes = amplitudes * (1 + AMPLITUDE_ERROR * error / np.sqrt(2))
    turns, off = rng.uniform(-np.pi, np.pi, 8), rng.normal(0, POSITION_SIGMA, (8, 3))
    passes = simulated_passes(CIRCLE, places, amplitudes, 1.0, rng, turns, off)
    known = [
        ReferencePoint(place + np.array([0.0, 0.0, rng.normal(0, REFERENCE_SIGMA)]), ties=True) for place in places[:3]
    ]
    result = _heights(passes, known)
    apart, nearest = cKDTree(places).query(result.found.points.positions)
    off_by = result.found.points.positions - places[nearest]
    errors = np.where(apart < 0.5, off_by[:, 2], np.nan)
    return Flown(places, result, errors, _over_bound(result, off_by, apart < 0.1))


def _heights(passes: Sequence[Pass], known: Sequence[ReferencePoint]) -> PassHeights:
    settings = PassSettings(
        side_m=SIDE + 2,
        lowest_m=-1.0,
        highest_m=4.5,
        position_sigma_m=POSITION_SIGMA,
        reference_sigma_m=REFERENCE_SIGMA,
    )
    ml = ESTIMATORS["ml"]
    looks = ml.settings(**OF_POINTS)
    return heights_from_passes(passes, np.zeros(3), ml, looks, settings, known)


def _over_bound(result: PassHeights, off_by: F64, here: F64) -> F64:
    points, array = result.found.points, result.array
    across = off_by @ array.axes[2]
    steering = array.steering(array.centre, -2.0, 2.0)
    cnr = 10 ** (points.cnr_db / 10)
    bound = steering.metres * conditional_crb(steering.beams(), steering.elevation, 0.0, cnr, 1)
    plane = np.column_stack([np.ones(len(across)), points.positions[:, :2]])[here]
    left = across[here] - plane @ np.linalg.lstsq(plane, across[here], rcond=None)[0]
    return np.asarray(left / bound[here] * np.sqrt(len(left) / (len(left) - 3)))


def reflectors(rng: np.random.Generator) -> F64:
    """Places of reflectors, none in the cell of another."""
    tangent = np.tan(np.mean(GOTCHA_ELEVATIONS))
    places: list[F64] = []
    shown: list[F64] = []
    while len(places) < REFLECTORS:
        height = rng.normal(0, 0.3) if rng.uniform() < 2 / 3 else rng.uniform(0, 4)
        place = np.array([*rng.uniform(-SIDE / 2, SIDE / 2, 2), height])
        here = place[:2] + np.array([tangent * height, 0.0])
        if all(np.linalg.norm(here - other) > 1.2 for other in shown):
            places.append(place)
            shown.append(here)
    return np.array(places)


def flown_pairs(seed: int) -> Flown:
    """A scene of which PAIRS of the reflectors, on the ground, have another one in their cell of range and Doppler."""
    rng = np.random.default_rng([seed, PAIRS])
    tangent = float(np.tan(np.mean(GOTCHA_ELEVATIONS)))
    alone, upwards = reflectors(rng), np.array([-tangent, 0.0, 1.0])
    alone[-PAIRS:] -= alone[-PAIRS:, 2:] * upwards
    places = np.concatenate([alone, alone[-PAIRS:] + rng.uniform(0.4, 3.5, PAIRS)[:, None] * upwards])
    power = 10 ** (PAIR_CNR_DB / 10) / (CIRCLE.pulses * CIRCLE.frequencies)
    amplitudes = np.sqrt(power) * np.exp(2j * np.pi * rng.uniform(size=len(places)))
    turns, off = rng.uniform(-np.pi, np.pi, 8), rng.normal(0, POSITION_SIGMA, (8, 3))
    passes = simulated_passes(CIRCLE, places, amplitudes, 1.0, rng, turns, off)
    result = _heights(passes, [ReferencePoint(place, ties=True) for place in alone[:3]])
    apart, nearest = cKDTree(places).query(result.found.points.positions)
    errors = np.where(apart < 0.5, result.found.points.height - places[nearest, 2], np.nan)
    return Flown(places, result, errors, np.zeros(0))


def pairs_in_a_cell() -> Iterator[Row]:
    """Rows of scenes in which a quarter of the bright pixels hold two reflectors."""
    scenes = [flown_pairs(seed) for seed in range(PAIR_SCENES)]
    errors = np.concatenate([one.errors for one in scenes])
    sigmas = np.concatenate([one.result.found.points.total_sigma for one in scenes])
    single = (REFLECTORS - PAIRS) * PAIR_SCENES
    source = f"{len(errors)} heights; {single} reflectors alone and {PAIRS * PAIR_SCENES} pairs, {PAIR_CNR_DB:g} dB"
    wrong = mean_of(~(np.abs(errors) <= 5 * sigmas))  # those without a reflector in reach, too
    yield Row("passes: beside pairs, heights", len(errors) / single, "1", ">= 0.8", source)
    yield Row("passes: beside pairs, wrong heights", wrong, "1", "<= 0.01", source)


def coverage() -> Iterator[Row]:
    """Rows of the scenes, and of the time of one."""
    yield from single_points()
    yield from pairs_in_a_cell()
    (seconds,) = medians(lambda: flown(0), repeats=sized(3, 1))
    yield Row("passes: a scene of 16 m, simulation included", seconds, "s", "<= 10", load())


def single_points() -> Iterator[Row]:
    """Rows of reflectors that have their cell for themselves."""
    scenes = [flown(seed) for seed in range(SCENES)]
    errors = np.concatenate([one.errors for one in scenes])
    sigmas = np.concatenate([one.result.found.points.total_sigma for one in scenes])
    known = np.isfinite(errors)
    found = error_statistics(errors[known], sigmas[known])
    total = SCENES * REFLECTORS
    source = f"{known.sum()} points of {total} reflectors in {SCENES} scenes, eight passes as of Gotcha, {CNR_DB:g} dB"
    error = np.sqrt(0.68 * 0.32 / found.count)
    yield Row(
        "passes: c1, share within sigma",
        found.within_1_sigma,
        "1",
        ">= 0.6",
        f"{source}; standard error {error:.2f}",
        {"c2": found.within_2_sigma, "rms_m": found.rms},
    )
    yield Row("passes: o5, share beyond five sigma", found.beyond_5_sigma, "1", "<= 0.01", source)
    yield Row("passes: heights where nothing is", float(np.mean(~known)), "1", "<= 0.01", source)
    yield Row("passes: reflectors with a height", known.sum() / total, "1", ">= 0.9", source)
    clean = np.concatenate([one.over_bound for one in scenes[::2]])
    yield Row(
        "passes: error across over the Cramer-Rao bound",
        float(root_mean_square(clean)),
        "1",
        "<= 1.15",
        f"{len(clean)} points of equal amplitude in all passes, CNR over the measured background; standard error "
        f"{1 / np.sqrt(2 * len(clean)):.2f}",
    )


if __name__ == "__main__":
    for number in range(SCENES):
        one = flown(number)
        ratio = one.errors / one.result.found.points.total_sigma
        print(  # noqa: T201
            f"scene {number}: {len(one.errors)} points, rms {np.sqrt(np.nanmean(one.errors**2)):.4f} m, "
            f"over sigma {np.sqrt(np.nanmean(ratio**2)):.2f}, over bound {root_mean_square(one.over_bound):.2f}"
        )
