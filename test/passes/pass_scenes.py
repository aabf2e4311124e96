"""Small scenes of reflectors, and the passes over them, that several tests share."""

from __future__ import annotations

import numpy as np

from sal_height.passes import GOTCHA_ELEVATIONS, Circle, Pass, PassArray, PassSettings, simulated_passes

SMALL = Circle(pulses=60, frequencies=112)
"""The geometry of Gotcha, sampled for a scene of 20 m."""

TANGENT = float(np.tan(np.mean(GOTCHA_ELEVATIONS)))
"""Of the middle elevation over the horizon."""

SETTINGS = PassSettings(side_m=16.0, lowest_m=-1.0, highest_m=4.5)


def reflectors(rng: np.random.Generator, count: int, side: float = 14.0) -> np.ndarray:
    """Places of reflectors, m, (count, 3), most of them near the ground, none in the cell of another."""
    places: list[np.ndarray] = []
    while len(places) < count:
        height = rng.normal(0, 0.3) if rng.uniform() < 0.6 else rng.uniform(0, 4)
        place = np.array([*rng.uniform(-side / 2, side / 2, 2), height])
        if all(np.linalg.norm(shown(place) - shown(other)) > 1.2 for other in places):
            places.append(place)
    return np.array(places)


def shown(place: np.ndarray) -> np.ndarray:
    """Where on level ground an image shows places (..., 3): height brings them nearer to the radar, which is east."""
    return np.asarray(place[..., :2] + place[..., 2:] * [TANGENT, 0.0])


def amplitudes(rng: np.random.Generator, count: int, cnr_db: float) -> np.ndarray:
    """Of points with this CNR in an image without windows, in noise of power 1 per sample."""
    power = 10 ** (cnr_db / 10) / (SMALL.pulses * SMALL.frequencies)
    return np.sqrt(power) * np.exp(2j * np.pi * rng.uniform(size=count))


def flown(rng: np.random.Generator, points: np.ndarray, cnr_db: float = 23.0, **errors: np.ndarray) -> list[Pass]:
    """Eight passes over points in noise."""
    return simulated_passes(SMALL, points, amplitudes(rng, len(points), cnr_db), 1.0, rng, **errors)


def array_of(passes: list[Pass]) -> PassArray:
    """The array of passes over the origin of map."""
    return PassArray.of(tuple(passes), np.zeros(3), SETTINGS)
