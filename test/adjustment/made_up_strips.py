"""Strips to and fro over the street, made up without pulses: what is seen of it from either side, with errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from sal_height.adjustment import ObservedDwell, Points, Stated
from sal_height.geometry import ApertureState
from sal_height.imaging import Placement
from sal_height.numeric import F64
from sal_height.simulation import load_preset
from sal_height.simulation.scenes import load_scene

SENSOR, STREET = load_preset("sal_strips").make_sensor(), load_scene("street")
SPACING, COLS, RANGE_M, HEIGHT_M = 0.1, 6, 3.2, 3500.0
"""Pixels on the ground and columns of an image, width of the strip, and height of the flight."""

WALK_M, VELOCITY_MPS, INTERVAL_S, SPEED_MPS = 1.0, 1e-4, 120.0, 50.0
"""By which the position errs from one pass to the next, which odometry states; of the velocity; between passes; of the
flight."""


@dataclass(frozen=True, eq=False)
class Strips:
    """Images in the order of time, how far they lie off, m, shape (images, 3), and how many each strip has."""

    images: list[ObservedDwell]
    shifts: F64
    each: int


@cache
def strips(count: int, each: int, west_m: float, seed: int) -> Strips:
    """Strips of so many images over the ground from so far west on."""
    rng, shift = np.random.default_rng(seed), np.zeros(3)
    images, shifts = [], []
    for strip in range(count):
        for number in range(each):
            place = number if strip % 2 == 0 else each - 1 - number
            begin_m = west_m + place * COLS * SPACING
            seconds = strip * INTERVAL_S + number * COLS * SPACING / SPEED_MPS
            images.append(_image(begin_m, seconds, strip, shift, rng))
            shifts.append(shift)
        shift = shift + WALK_M * rng.standard_normal(3)
    return Strips(images, np.array(shifts), each)


def _image(begin_m: float, seconds: float, strip: int, shift: F64, rng: np.random.Generator) -> ObservedDwell:
    sight = 1.0 if strip % 2 == 0 else -1.0
    middle_m = begin_m + COLS * SPACING / 2
    aperture = ApertureState(
        np.array([middle_m, sight * HEIGHT_M, HEIGHT_M]),
        sight * np.array([SPEED_MPS, 0.0, 0.0]),
        np.diag([sight, sight, 1.0]),
        0.75,
        np.zeros((6, 6)),
        sliding=True,
    )
    place = _seen(begin_m, sight)
    place += shift + rng.normal(0.0, [0.02, 0.02, 0.01], place.shape)
    points = Points(place, np.full(len(place), 0.01), np.full(len(place), 20.0), np.zeros(len(place), int), SPACING)
    pose = np.diag([0.01 + strip * WALK_M**2] * 3 + [1e-12] * 3)
    stated = Stated(seconds, pose, VELOCITY_MPS**2 * np.eye(3))
    placement = Placement(0.0, 0.0, 0.0, by_beams=True, beams_error=1e-5)
    return ObservedDwell(points, aperture, placement, stated, SENSOR.beams.axis_middle, SENSOR.look_side, 0.03)


def _seen(begin_m: float, sight: float) -> F64:
    """What is not in the shadow of what is nearer, under 45 degrees; shape (points, 3)."""
    east = begin_m + SPACING * (np.arange(COLS) + 0.5)
    north = sight * np.arange(RANGE_M / 2, -RANGE_M / 2, -SPACING / 2)
    height = STREET.heights(*np.meshgrid(east, north))
    rays = height + np.abs(north - north[0])[:, None]
    lit = rays >= np.maximum.accumulate(rays, axis=0)
    rows, cols = np.nonzero(lit[::2])
    return np.column_stack([east[cols], north[::2][rows], height[::2][rows, cols]])
