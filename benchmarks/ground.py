"""The estimate of the ground, brought up to date with a dwell like those of sal_spotlight."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.row import Row, medians, sized
from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, Grid, sphere_point
from sal_height.relief import GroundMap, HeightField, Surface, circle_covariance, fine_cell_size

ROWS, COLS, SPACINGS = 92, 6, (0.085, 0.097)
"""Height pixels of a dwell of sal_spotlight, and their spacing on the ground, m."""

DWELLS = sized(16, 2)
SIGMA = 0.012  # m
APERTURE = ApertureState(np.array([0.0, 3535, 3535]), np.array([50.0, 0, 0]), np.eye(3), 0.08, np.zeros((6, 6)))


def throughput() -> Iterator[Row]:
    """Dwells entered one by one, with the estimate at the end; and all dwells estimated at once."""
    rng = np.random.default_rng(1)
    fields = [dwell_of_spotlight(number, rng) for number in range(DWELLS)]

    def mapped() -> GroundMap:
        ground = GroundMap(fine_cell_size(fields[0].grid), max(SPACINGS), 10**6)
        for field in fields:
            ground.add(field, APERTURE)
        ground.estimate()
        return ground

    one_by_one, whole = medians(mapped, mapped().settle)
    estimate = mapped().estimate()
    cells = 0 if estimate is None else estimate.height.size
    yield Row(
        "ground, a dwell of sal_spotlight",
        1e3 * one_by_one / DWELLS,
        "ms",
        "<= 10",
        f"{ROWS} × {COLS} pixels, kerb and car; of {DWELLS} dwells and the estimate at the end",
    )
    yield Row("ground, all at once", cells / 1e6 / whole, "Mcell/s", ">= 0.2", f"{cells} cells: {1e3 * whole:.0f} ms")


def dwell_of_spotlight(number: int, rng: np.random.Generator) -> HeightField:
    """Level ground with a kerb of 0.12 m and the roof of a car, beside those of the numbers before; without shadow."""
    place = np.arange(ROWS)[:, None] * SPACINGS[0], (np.arange(COLS) + number * COLS) * SPACINGS[1]
    north, east = np.broadcast_arrays(*place)
    error = rng.normal(0.0, SIGMA, north.shape)
    height = np.where(north > 6, 0.12, np.where((north > 2) & (north < 4), 1.4, 0.0)) + error
    positions = sphere_point(east, north - error, height)
    own = circle_covariance(np.full(north.shape, SIGMA), positions, APERTURE)
    surface = Surface.seen_from(APERTURE, positions, own, np.full(north.shape, 20.0))
    sight = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    grid = Grid(np.zeros(3), sight, np.array([1.0, 0.0, 0.0]), SPACINGS[0] / np.sqrt(2), SPACINGS[1], ROWS, COLS)
    return HeightField(grid, np.full(north.shape, Validity.OK, np.uint8), (surface,))
