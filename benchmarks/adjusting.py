"""Agreement of passes over the same ground after an adjustment, against what it states, and its time.

python -m benchmarks adjustment
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.boresight import of_boresight, with_drawn_mounting
from benchmarks.passes import FlownPasses, observed, observed_strip
from benchmarks.row import Row, load, sized
from benchmarks.spread import in_processes
from sal_height.adjustment import (
    BORESIGHT,
    Adjustment,
    AdjustmentSettings,
    AdjustmentWindow,
    ObservedDwell,
    References,
    Stated,
    Terrain,
    adjust,
)
from sal_height.adjustment.observed import pose_jacobian
from sal_height.numeric import F64, Index, root_mean_square
from sal_height.simulation import Preset, flight_of, load_preset

PRESET, STRIPS = "sal_passes", "sal_strips"
FLIGHTS, FLIGHTS_OF_STRIPS = sized(6, 1), sized(3, 1)
COPIES = sized(10, 2)
"""Times that a flight is taken, one after the other, to measure the time that many dwells take."""

WINDOW_DWELLS, ALL_DWELLS = 30, 200
"""Dwells that are kept where they are adjusted one by one: few, and more than arrive."""

UNKNOWN_DWELLS = sized(2, 0)
"""First dwells of a pass, which show too little to be recognised as they come."""

HELD_IMAGES, GROWN_IMAGES = 60, sized(5, 1)
"""Images of strips that are kept where they are adjusted one by one, and after how many of a strip it is recognised."""

FAR_OFF, PLACED_M = 25.0, 0.02
"""Square of an error over its variance that is far off, and standard deviation of a height that is known, m."""

PAUSE_S = 4000.0
"""Time between copies."""


def _preset() -> Preset:
    return _shortened(load_preset(PRESET), 4)


def _shortened(preset: Preset, dwells: int) -> Preset:
    """A preset, or only two passes of it with that number of dwells together to try it."""
    passes = sized(preset.flight.passes, replace(preset.flight.passes, count=2))
    return replace(preset, flight=replace(preset.flight, passes=passes), dwells=sized(preset.dwells, dwells))


def _settings(preset: Preset) -> AdjustmentSettings:
    given = preset.processing["sar_compression"]
    names = "boresight_sigma_rad", "lever_arm_sigma_m", "odometry_delay_sigma_s"
    return AdjustmentSettings(**{name: given[name] for name in names})


def passes_of(seed: int) -> FlownPasses:
    """The flight of the preset with a seed, from which the errors of the mounting are drawn, too."""
    preset = with_drawn_mounting(_preset(), seed)
    made = in_processes(partial(observed, preset=preset, seed=seed), range(preset.dwells))
    return FlownPasses.of(flight_of(preset, seed), list(made))


def brought_together() -> Iterator[Row]:
    """Rows of the group: heights and velocities between dwells, and of all dwells where ground is known; the time."""
    settings, flights = _settings(_preset()), [passes_of(seed) for seed in range(1, 1 + FLIGHTS)]
    apart, over, off, boresights, covariances = [], [], [], [], []
    for passes in flights:
        mounting, levers = passes.flight.sensor.mounting, np.array([dwell.lever for dwell in passes.dwells])
        alone = adjust(passes.dwells, mounting, settings)
        grounded = adjust(
            passes.dwells, mounting, settings, References(terrain=Terrain(passes.flight.scene.heights, 0.02))
        )
        errors, sigmas = _between(alone, passes)
        apart.append(np.column_stack([1e3 * errors[:, 0] / levers, errors[:, 2]]))
        over.append(np.mean((errors / sigmas) ** 2, axis=0))
        left = grounded.shifts[0] - passes.shifts
        off.append(np.column_stack([1e3 * left[:, 0] / levers, left[:, 2]]))
        found, covariance = alone.common
        true = np.array(passes.flight.preset.impairments.odometry.undescribed_boresight_rad)
        boresights.append(found[BORESIGHT] + true)
        covariances.append(covariance[BORESIGHT, BORESIGHT])
    text = f"{FLIGHTS} flights of {len(flights[0].dwells)} dwells"
    speed, height = root_mean_square(np.concatenate(apart), axis=0), root_mean_square(np.concatenate(off), axis=0)
    yield Row("heights between dwells", 1e3 * speed[1], "mm", "<= 10", text)
    yield Row("errors between dwells over what is stated", float(np.sqrt(np.mean(over))), "1", "<= 1.2", text)
    yield Row("velocity that moves images, between dwells", speed[0], "mm/s", "<= 0.5", text)
    yield Row("velocity that moves images, with known ground", height[0], "mm/s", "<= 0.5", text)
    yield Row("heights with known ground", 1e3 * height[1], "mm", "<= 10", text)
    edges_m = flights[0].dwells[0].edges_sigma
    yield from of_boresight(_preset(), np.array(boresights), np.array(covariances), edges_m, text)
    yield from of_dwells_apart(flights, settings)
    yield from of_strips()
    yield from as_they_come(flights, settings)
    yield from times(flights[0], settings)


def of_dwells_apart(flights: list[FlownPasses], settings: AdjustmentSettings) -> Iterator[Row]:
    """Row on two dwells of two passes that follow each other, which join or lie farther apart: how many are far off."""
    far, total = 0, 0
    for passes in flights:
        each = len(passes.dwells) // passes.flight.preset.flight.passes.count
        for first, second in ((a, 2 * each - 1 - b) for a in range(each) for b in range(each) if a != b):
            numbers = [first, second]
            adjustment = adjust([passes.dwells[n] for n in numbers], passes.flight.sensor.mounting, settings)
            errors = adjustment.shifts[0] - passes.shifts[numbers]
            error, covariance = errors[0] - errors.mean(axis=0), adjustment.spread[0][0]
            far += bool(error @ np.linalg.solve(covariance + 1e-8 * np.eye(3), error) > FAR_OFF)
            total += 1
    text = f"{total} pairs of two passes"
    yield Row("dwells that share no ground, off by more than 5 sigma", far / max(1, total), "1", "<= 0.01", text)


def of_strips() -> Iterator[Row]:
    """Rows on strips: heights, and places along the flight, between their images; of short ones; as they come."""
    preset, apart, over = _shortened(load_preset(STRIPS), 8), [], []
    settings, flights = _settings(preset), [strips_of(seed, preset) for seed in range(1, 1 + FLIGHTS_OF_STRIPS)]
    for passes in flights:
        adjustment = adjust(passes.dwells, passes.flight.sensor.mounting, settings)
        errors, sigmas = _between(adjustment, passes)
        apart.append(errors[:, [0, 2]])
        over.append(np.mean((errors / sigmas) ** 2, axis=0))
    along, height = 1e3 * root_mean_square(np.concatenate(apart), axis=0)
    count = preset.flight.passes.count
    text = f"{FLIGHTS_OF_STRIPS} flights of {count} strips"
    yield Row("heights between images of strips", height, "mm", "<= 10", text)
    yield Row("places along the flight between images of strips", along, "mm", "<= 50", text)
    yield Row("errors between images of strips over what is stated", float(np.sqrt(np.mean(over))), "1", "<= 1.2", text)
    yield from of_short_strips(flights, settings, count)
    yield from strips_as_they_come(flights, settings, count)


def strips_of(seed: int, preset: Preset) -> FlownPasses:
    """The flight of a preset of strips with a seed."""
    made = in_processes(partial(observed_strip, preset=preset, seed=seed), range(preset.flight.passes.count))
    return FlownPasses.of(flight_of(preset, seed), [image for strip in made for image in strip])


def of_short_strips(flights: list[FlownPasses], settings: AdjustmentSettings, count: int) -> Iterator[Row]:
    """Rows on some images of each of four strips: how many are far off, and how many are placed."""
    far, placed, total = 0, 0, 0
    for passes in flights:
        for numbers in _short(len(passes.dwells) // count, count):
            dwells = [passes.dwells[number] for number in numbers]
            adjustment = adjust(dwells, passes.flight.sensor.mounting, settings)
            errors = adjustment.shifts[0] - passes.shifts[numbers]
            errors -= errors.mean(axis=0)
            for error, covariance in zip(errors, adjustment.spread[0], strict=True):
                known = covariance + 1e-8 * np.eye(3)
                far += bool(error @ np.linalg.solve(known, error) > FAR_OFF)
                placed += bool(known[2, 2] < PLACED_M**2)
                total += 1
    text = f"{total} images, of which {placed} are known to {1e3 * PLACED_M:.0f} mm; 4 strips of 1 to 4 images"
    yield Row("images of short strips off by more than 5 sigma", far, "1", "<= 0", text)


def _short(each: int, count: int) -> Iterator[list[int]]:
    """Numbers of a few images over the same ground of four strips that follow each other, of `count` of `each` images.

    Every other strip is flown the other way.
    """
    for images in range(1, min(4, each) + 1):
        for first in range(0, count - 3, 4):
            for begin in range(0, each + 1 - images, max(2, images - 1)):
                starts = [
                    (strip, begin if strip % 2 == 0 else each - begin - images) for strip in range(first, first + 4)
                ]
                yield [strip * each + start + image for strip, start in starts for image in range(images)]


def strips_as_they_come(flights: list[FlownPasses], settings: AdjustmentSettings, count: int) -> Iterator[Row]:
    """Rows on images of strips that are adjusted one by one, of the later half of each flight."""
    apart, over, seconds, until, late = [], [], [], [], slice(count // 2, None)
    for passes in flights:
        errors, stated, times = _one_by_one(passes, settings, HELD_IMAGES)
        sigmas = np.sqrt(stated[:, 2, 2]).reshape(count, -1)
        until.append(np.argmax(sigmas[1:] < 2 * sigmas.min(), axis=1) + 1)
        by_strip = errors[:, 2].reshape(count, -1)[late, GROWN_IMAGES:]
        apart.append((by_strip - by_strip.mean()).ravel())
        over += [e @ np.linalg.solve(c, e) / 3 for e, c in zip(errors, stated, strict=True)]
        seconds.append(times.reshape(count, -1)[late].mean(axis=1))
    text = f"one by one, {HELD_IMAGES} held; {len(flights)} flights"
    grown = f"{text}; from image {GROWN_IMAGES + 1} of each strip on, the later half of the strips"
    height = 1e3 * float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))
    yield Row("heights between images of strips as they come", height, "mm", "<= 20", grown)
    first = np.concatenate(until)
    told = f"{text}; half of them by image {np.median(first):.0f}"
    yield Row("image of a strip from which on it is recognised, latest", int(first.max()), "1", "<= 6", told)
    off = float(np.sqrt(np.mean(over)))
    yield Row("errors of images of strips as they come over what is stated", off, "1", "<= 1.2", f"{text}, all images")
    time_ms = 1e3 * float(np.median(np.concatenate(seconds)))
    yield Row("time for an image of a strip as it comes", time_ms, "ms", "<= 300", f"{text}, mean of a strip; {load()}")


def as_they_come(flights: list[FlownPasses], settings: AdjustmentSettings) -> Iterator[Row]:
    """Rows on dwells that are adjusted one by one, of the later half of each flight."""
    apart, of_all, over, seconds = [], [], [], []
    for passes in flights:
        count = passes.flight.preset.flight.passes.count
        errors, stated, times = _one_by_one(passes, settings, WINDOW_DWELLS)
        seconds += times.tolist()
        late = slice(len(errors) // 2, None)
        known = np.array([n for n in range(len(errors))[late] if n % (len(errors) // count) >= UNKNOWN_DWELLS])
        apart.append(_speeds_and_heights(passes, errors, known))
        errors_of_all, _, _ = _one_by_one(passes, settings, ALL_DWELLS)
        of_all.append(_speeds_and_heights(passes, errors_of_all, known))
        over += [e @ np.linalg.solve(c, e) / 3 for e, c in zip(errors[late], stated[late], strict=True)]
    text = f"one by one, {WINDOW_DWELLS} held; the later half of {len(flights)} flights"
    grown = f"{text}, from dwell {UNKNOWN_DWELLS + 1} of each pass on"
    speed, height = root_mean_square(np.concatenate(apart), axis=0)
    yield Row("heights between dwells as they come", 1e3 * height, "mm", "<= 10", grown)
    yield Row("velocity that moves images, as they come", speed, "mm/s", "<= 0.5", grown)
    alike = grown.replace(f"{WINDOW_DWELLS} held", f"{ALL_DWELLS} held")
    yield Row(
        "velocity that moves images, as they come, all held",
        root_mean_square(np.concatenate(of_all), axis=0)[0],
        "mm/s",
        "<= 0.5",
        alike,
    )
    yield Row("errors of dwells as they come over what is stated", float(np.sqrt(np.mean(over))), "1", "<= 1.2", text)
    yield Row("time for a dwell as it comes", 1e3 * float(np.median(seconds)), "ms", "<= 100", f"{text}; {load()}")


def _speeds_and_heights(passes: FlownPasses, errors: F64, late: Index) -> F64:
    """Errors of late dwells against their mean, as velocities along the line of sight, mm/s, and in height, m."""
    left = errors[late] - errors[late].mean(axis=0)
    return np.column_stack([1e3 * left[:, 0] / [passes.dwells[number].lever for number in late], left[:, 2]])


def _one_by_one(passes: FlownPasses, settings: AdjustmentSettings, held: int) -> tuple[F64, F64, F64]:
    """Errors of dwells as they come, m, shape (dwells, 3), what is stated of them, m^2, and the time for each, s."""
    window = AdjustmentWindow(passes.flight.sensor.mounting, settings, held)
    errors, stated, seconds = [], [], []
    for dwell, truth in zip(passes.dwells, passes.shifts, strict=True):
        begun = time.monotonic()
        off, jacobian = window.add(dwell), pose_jacobian(dwell.middle, dwell)
        seconds.append(time.monotonic() - begun)
        errors.append(jacobian @ off.error - truth)
        stated.append(jacobian @ off.covariance @ jacobian.T)
    return np.array(errors), np.array(stated), np.array(seconds)


def _between(adjustment: Adjustment, passes: FlownPasses) -> tuple[F64, F64]:
    """Errors of the dwells against the mean of all, m, and what is stated of them, both (dwells, 3)."""
    covariances, _ = adjustment.spread
    errors = adjustment.shifts[0] - passes.shifts
    return errors - errors.mean(axis=0), np.sqrt([covariance.diagonal() for covariance in covariances])


def times(passes: FlownPasses, settings: AdjustmentSettings) -> Iterator[Row]:
    """Time for many dwells, and over that for half as many, halved."""
    mounting, seconds = passes.flight.sensor.mounting, []
    for copies in (COPIES // 2, COPIES):
        dwells = [_later(dwell, PAUSE_S * copy) for copy in range(copies) for dwell in passes.dwells]
        begun = time.monotonic()
        _ = adjust(dwells, mounting, settings).shifts
        seconds.append(time.monotonic() - begun)
    text = f"{COPIES * len(passes.dwells)} dwells, with the covariance of each; {load()}"
    yield Row("time of the adjustment", seconds[1], "s", "<= 60", text)
    yield Row("growth of the time with the dwells", seconds[1] / seconds[0] / 2, "1", "<= 1.2", text)


def _later(dwell: ObservedDwell, seconds: float) -> ObservedDwell:
    stated = dwell.stated
    return replace(dwell, stated=Stated(stated.seconds + seconds, stated.pose, stated.velocity))
