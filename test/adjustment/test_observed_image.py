"""Images without heights: how errors of the antenna move them, and dwells over simulated points brought together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from stated_errors import foretold, layout_of

from sal_height.adjustment import ImageAdjustmentSettings, ObservedImage, Target, adjust_images, cell_size
from sal_height.adjustment.drift import Stated
from sal_height.adjustment.observed import displacement, pose
from sal_height.adjustment.observed_image import completed
from sal_height.geometry import ApertureState, Trajectory, locate_at_height, sphere_coordinates
from sal_height.imaging import ImageSettings
from sal_height.imports.followed_point import states_towards
from sal_height.numeric import F64
from sal_height.passes import Circle, Pass, simulated_passes
from sal_height.pipeline import Compressor
from sal_height.runs.products.adjustment_report import summary_of_images
from sal_height.sensor import Sensor

DWELLS = 3
CIRCLE = Circle(elevations=(np.radians(45.0),), pulses=33 * DWELLS, frequencies=160)
SETTINGS = ImageAdjustmentSettings(
    position_sigma_m=0.3, velocity_sigma_mps=0.02, position_step_m=0.3, correlation_s=1.0, ground_sigma_m=0.3
)
POST = Target(3.0, -4.0, 1.5)
NOTHING = np.zeros(3)

Errors = dict[int, tuple[F64, F64]]
"""What positions (m) and velocities (m/s) of a dwell are stated beyond what they are, by its number."""

ERRORS: dict[str, Errors] = {
    "none": {},
    "across": {1: (np.array([0.3, 0.0, 0.2]), NOTHING)},
    "along": {2: (np.array([0.0, -0.4, 0.0]), NOTHING)},
    "velocity": {0: (NOTHING, np.array([0.004, 0.0, 0.0])), 2: (NOTHING, np.array([0.0, 0.005, -0.01]))},
}


@cache
def flown(seed: int = 3) -> Pass:
    """Points within 15 cm of the ground, and a brighter one 1.5 m above it, whose image is 2.5 m from all others."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-14, 14, (180, 2)), rng.normal(0, 0.15, 180)])
    points = points[np.linalg.norm(points[:, :2] - POST.place[:2] - [POST.height, 0.0], axis=1) > 2.5]
    amplitudes = rng.exponential(1.0, len(points)) * np.exp(2j * np.pi * rng.uniform(size=len(points)))
    points, amplitudes = np.vstack([points, POST.place]), np.append(amplitudes, 20.0)
    (one,) = simulated_passes(CIRCLE, points, amplitudes, 1e3, rng)
    return one


def dwell(
    number: int, errors: Errors, settings: ImageAdjustmentSettings = SETTINGS, seed: int = 3
) -> tuple[ObservedImage, Sensor]:
    """A part of the pass, and its sensor."""
    one, count = flown(seed), CIRCLE.pulses // DWELLS
    own = slice(number * count, (number + 1) * count)
    times = one.history.pulse_times
    place, velocity = errors.get(number, (NOTHING, NOTHING))
    antenna = one.antenna + place + (times - times[own].mean())[:, None] * velocity
    stamps = np.rint(times * 1e9).astype(np.int64)
    moved = np.gradient(antenna, times, axis=0)
    states = states_towards(stamps[own], antenna[own], moved[own], NOTHING, one.sensor.look_side)
    history = one.history.pulses(own)
    history = replace(history, stamp_ns=int(stamps[own][0]), pulse_times=times[own] - times[own][0])
    sensor = replace(one.sensor, pulse_count=count)
    image = ImageSettings(image_plane="ground", rows=141, cols=141, ground_spacing_m=0.2, autofocus="never")
    slc = Compressor().add(history, Trajectory(states), sensor, image)
    assert slc
    return ObservedImage.of_image(slc, sensor, Trajectory(states), history, settings, cell_size(slc)), sensor


@cache
def exact() -> ObservedImage:
    return dwell(1, {})[0]


def located(place: F64, aperture: ApertureState, stated: ApertureState) -> F64:
    """Where ground lies, east and north, in an image of ranges and Doppler frequencies of other antennas."""
    sight = place - aperture.position
    along = sight @ aperture.velocity / np.linalg.norm(stated.velocity)
    found = locate_at_height(0.0, np.linalg.norm(sight), along, stated, exact().look_side)
    return np.array(sphere_coordinates(found)[:2])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("unknown", ["position", "velocity"])
def test_the_ground_moves_as_foretold(unknown: str, axis: int) -> None:
    """Within 0.5 % and 0.1 mm of where range and Doppler put it."""
    image = exact()
    size, first = (0.3, 0) if unknown == "position" else (0.01, 3)
    off = size * np.eye(3)[axis]
    stated = (
        replace(image.aperture, position=image.aperture.position + off)
        if unknown == "position"
        else replace(image.aperture, velocity=image.aperture.velocity + off)
    )
    moved = located(image.middle, image.aperture, stated) - image.points.place[0, :2]
    layout = layout_of(image.seconds, image.seconds + 1)
    form = displacement(pose(0, image, layout, flown().sensor.mounting), image)
    expected = foretold(form, ((first + axis, size),))
    assert np.linalg.norm(expected[:2]) > 1e-3 or axis == 1
    np.testing.assert_allclose(moved, expected[:2], atol=1e-4 + 0.005 * np.abs(expected).max())
    assert expected[2] == pytest.approx(off[2] if unknown == "position" else 0.0, abs=1e-9)


def test_what_stands_over_the_ground_lies_off_by_its_height() -> None:
    """In the layover, within 1 mm for 2 m."""
    image = exact()
    place = image.points.place[0, :2]
    raised = np.array([*place, 2.0])
    found = located(raised, image.aperture, image.aperture) - place
    np.testing.assert_allclose(found, 2.0 * image.layover, atol=1e-3)
    assert image.across @ image.layover == pytest.approx(-1.0, abs=0.01), "45 degrees: towards the antenna"


def true_displacements(dwells: list[ObservedImage], errors: Errors, *, of_mean: bool) -> F64:
    """How far errors that were put in move images on the ground, of the mean of all, as the report has it, (dwells, 2).

    Towards the ground and along the flight, each in the axes of its own dwell.
    """
    shifts = []
    for number, image in enumerate(dwells):
        place, velocity = errors.get(number, (NOTHING, NOTHING))
        off = place - image.lever * (image.sight @ velocity) * image.aperture.direction
        shifts.append(off[:2] + image.layover * off[2])
    apart = np.array(shifts) - (np.mean(shifts, axis=0) if of_mean else 0.0)
    axes = [np.stack([image.sight[:2], image.aperture.direction[:2]]) for image in dwells]
    return np.array([own @ shift for own, shift in zip(axes, apart, strict=True)])


def found_in(dwells: list[ObservedImage], sensor: Sensor, targets: tuple[Target, ...] = ()) -> tuple[F64, F64, str]:
    """Errors as in the report, their sigmas, shape (dwells, 2), and against what they count."""
    summary, _ = summary_of_images(adjust_images(dwells, sensor.mounting, SETTINGS, targets), dwells)
    names = ("towards_ground", "along_flight")
    values, sigmas = (
        np.array([[one[f"{name}{kind}"] for name in names] for one in summary["images"]]) for kind in ("_m", "_sigma_m")
    )
    return values, sigmas, summary["images_against"]


@pytest.mark.parametrize("name", ERRORS)
def test_errors_from_dwell_to_dwell_are_found(name: str) -> None:
    """Within three sigma, which are millimetres towards the ground and less than 7 cm along the flight."""
    dwells, (sensor, *_) = map(list, zip(*(dwell(number, ERRORS[name]) for number in range(DWELLS)), strict=True))
    true = true_displacements(dwells, ERRORS[name], of_mean=True)
    values, sigmas, against = found_in(dwells, sensor)
    assert against == "mean"
    assert np.all(sigmas < [0.01, 0.07]), sigmas
    assert np.all(np.abs(values - true) < 3 * sigmas), (values, true, sigmas)


def test_errors_over_what_is_stated() -> None:
    """Over 48 scenes 1.0 towards the ground and 0.9 along the flight; eight tell it to 18 %."""
    errors = ERRORS["velocity"]
    over = []
    for seed in range(8):
        flights = [dwell(number, errors, seed=seed) for number in range(DWELLS)]
        dwells, (sensor, *_) = map(list, zip(*flights, strict=True))
        values, sigmas, _ = found_in(dwells, sensor)
        over.append((values - true_displacements(dwells, errors, of_mean=True)) / sigmas)
    rms = np.sqrt(np.mean(np.square(over), axis=(0, 1)))
    assert np.all((rms > 0.55) & (rms < 1.4)), rms


def test_ground_of_unknown_height_leaves_errors_along_the_flight() -> None:
    """The layover turns from dwell to dwell by a degree: by 14 cm for ground 8 m over its level, which is in sigma."""
    settings = SETTINGS.changed(ground_m=-8.0, ground_sigma_m=8.0)
    dwells, (sensor, *_) = map(list, zip(*(dwell(number, {}, settings) for number in range(DWELLS)), strict=True))
    values, sigmas, _ = found_in(dwells, sensor)
    assert np.ptp(values[:, 1]) > 0.2
    assert np.all(np.abs(values) < 2 * sigmas), (values, sigmas)
    assert np.all(sigmas < [0.01, 0.2])


def test_a_target_tells_what_all_dwells_share() -> None:
    """An error of half a metre that all dwells have; its 1.5 m of height would move it by as much."""
    shared = {number: (np.array([0.3, 0.35, 0.25]), np.array([0.002, 0.0, 0.0])) for number in range(DWELLS)}
    dwells, (sensor, *_) = map(list, zip(*(dwell(number, shared) for number in range(DWELLS)), strict=True))
    true = true_displacements(dwells, shared, of_mean=False)
    assert np.abs(true).max() > 0.3
    values, sigmas, against = found_in(dwells, sensor, (POST,))
    assert against == "targets"
    assert np.all(sigmas < [0.02, 0.06]), sigmas
    assert np.all(np.abs(values - true) < 3 * sigmas), (values, true, sigmas)


@pytest.mark.parametrize("target", [Target(3.0, -4.0, 4.5), Target(200.0, 0.0, 0.0)], ids=["too high", "elsewhere"])
def test_a_target_that_is_not_there_changes_nothing(target: Target) -> None:
    dwells, (sensor, *_) = map(list, zip(*(dwell(number, {}) for number in range(DWELLS)), strict=True))
    with_it, without = found_in(dwells, sensor, (target,)), found_in(dwells, sensor)
    np.testing.assert_array_equal(with_it[0], without[0])
    assert with_it[2] == "mean"


def test_settings_stand_in_only_for_what_odometry_does_not_state() -> None:
    silent = Stated(0.0, np.zeros((6, 6)), np.zeros((3, 3)))
    told = completed(silent, SETTINGS)
    np.testing.assert_allclose(told.pose[:3, :3], 0.09 * np.eye(3))
    np.testing.assert_allclose(told.velocity, 4e-4 * np.eye(3))
    assert not told.pose[3:, 3:].any()
    stated = Stated(0.0, np.eye(6), np.eye(3))
    assert completed(stated, SETTINGS).pose is not stated.pose
    np.testing.assert_array_equal(completed(stated, SETTINGS).pose, np.eye(6))
    np.testing.assert_array_equal(completed(stated, SETTINGS).velocity, np.eye(3))
