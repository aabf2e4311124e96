"""Heights of a dwell as it flies: a few hundred pixels must not cost more than their share of a large image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.row import Row, medians, sized
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, heights
from sal_height.sensor import Sensor
from sal_height.simulation import Preset, flight_of, load_preset

CASES = (("sal_spotlight", "monopulse"), ("sal_spotlight", "ml"), ("xband_sumdiff", "sum_difference"))
"""Presets and estimators."""

PIXELS = sized(1_000_000, 2000)
"""Height pixels of the large image, about."""

MARGIN, REST = 1.5, 1e-3
"""A dwell may take so many times its share of a large image, and so long (s) besides."""


def against_large_images() -> Iterator[Row]:
    """Time of one dwell over what is allowed by the time per pixel of an image tiled from it."""
    for name, estimator_name in CASES:
        preset = load_preset(name)
        flight = flight_of(replace(preset, dwells=1), seed=1)
        image = ImageSettings(rows=preset.image.rows, cols=preset.image.cols)
        track = Trajectory(flight.platform_states(0))
        slc = Compressor().add(flight.phase_history(0), track, flight.sensor, image)
        if slc is None:
            raise RuntimeError(f"Preset {name} makes no image of one dwell.")
        yield _row(preset, estimator_name, slc, flight.sensor)


def _row(preset: Preset, name: str, slc: Slc, sensor: Sensor) -> Row:
    estimator = ESTIMATORS[name]
    settings = estimator.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
    pixels = slc.images[0].size / (preset.looks[0] * preset.looks[1])
    tiles = max(1, round(np.sqrt(PIXELS / pixels)))
    large, wide = tiled(slc, sensor, tiles)
    small_time, large_time = medians(
        lambda: heights(slc, sensor, estimator, settings), lambda: heights(large, wide, estimator, settings)
    )
    allowed = MARGIN * large_time / tiles**2 + REST
    return Row(
        f"{name}, one dwell of {preset.name}",
        small_time / allowed,
        "1",
        "<= 1",
        f"{small_time * 1e3:.2f} ms; {MARGIN:g} times its share of an image of {pixels * tiles**2:.2g} pixels and "
        f"{REST * 1e3:g} ms are {allowed * 1e3:.2f} ms",
    )


def tiled(slc: Slc, sensor: Sensor, tiles: int) -> tuple[Slc, Sensor]:
    """The images side by side, so many times along each axis, and a sensor with beams as wide as they are then."""
    grid = slc.grid
    rows, cols = tiles * grid.rows, tiles * grid.cols
    origin = grid.points((grid.rows - rows) / 2, (grid.cols - cols) / 2)
    images = np.tile(slc.images, (1, tiles, tiles))
    wide = replace(sensor, azimuth_diameter=sensor.azimuth_diameter / tiles, config_hash="")
    return replace(slc, images=images, grid=replace(grid, origin=origin, rows=rows, cols=cols)), wide
