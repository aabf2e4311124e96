"""Maps of many dwells over the scenes of group `honest`: what they publish against the nearest lit height of each cell.

    python -m benchmarks honest-maps

Each dwell has its own speckle and noise, and lies elsewhere on the cells of the map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks import honest_scenes as scenes
from benchmarks.direct_images import direct_images, lidar
from benchmarks.row import Row, sized
from benchmarks.spread import in_processes
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import ApertureState, sphere_coordinates
from sal_height.imaging import ImageSettings, Processing
from sal_height.numeric import F64
from sal_height.pipeline import heights
from sal_height.relief import GroundMap, HeightField, ReliefMap, SharedError, fine_cell_size, fitting_cell_size
from sal_height.relief.cell_map import CellMap, Relief
from sal_height.relief.tracked import ground_spacings
from sal_height.simulation import Scene

ROWS, COLS = 184, 96
"""Size of an image, pixels."""

STAGES = sized((1, 2, 5, 20, 50), (1, 2))
"""Numbers of dwells after which maps are judged."""

SEED = 23

CASES: dict[str, tuple[Callable[[], Scene], float]] = {
    "level": (scenes.level, 20.0),
    "level 6 dB": (scenes.level, 6.0),
    "rubble": (scenes.rubble, 20.0),
    "roofs": (scenes.roofs, 20.0),
    "step +0.7": (partial(scenes.step, 0.7), 20.0),
    "step +2.0": (partial(scenes.step, 2.0), 20.0),
    "fence": (scenes.fence, 20.0),
    "forest": (scenes.forest, 20.0),
}
"""Scene and CNR (dB) of each case, by name."""


@dataclass(frozen=True, eq=False)
class Dwell:
    """Heights of a dwell, and the scatterers that it lit, m, shape (scatterers, 3)."""

    field: HeightField
    aperture: ApertureState
    lit: F64


@dataclass(frozen=True)
class Score:
    """Heights of a map: their number, shares within one and beyond five sigma, and median sigma, m.

    `chance` is the share beyond five sigma that heights anywhere between the lowest and the highest lit one would have.
    """

    cells: int
    within_1: float
    beyond_5: float
    chance: float
    sigma: float

    def __str__(self) -> str:
        return (
            f"{self.cells} cells, within 1 sigma {100 * self.within_1:.1f} %, beyond 5 {100 * self.beyond_5:.2f} % "
            f"(random heights {100 * self.chance:.0f} %), sigma {1e3 * self.sigma:.1f} mm"
        )


def coverage() -> Iterator[Row]:
    """Of each case and map the share of heights beyond 5 sigma, the greatest after any number of dwells."""
    for name, scores in zip(CASES, in_processes(_scores, list(CASES)), strict=True):
        for kind, stages in scores.items():
            text = "".join(f"\n    {count:3d} dwells: {score}" for count, score in zip(STAGES, stages, strict=True))
            worst = max(score.beyond_5 for score in stages)
            yield Row(f"{kind} of {name}: o5", 100 * worst, "%", "<= 0.2", f"1 to {STAGES[-1]} dwells{text}")


VARYING, LASTING, FLIGHTS = SharedError(0.066, 10.0), 0.03, sized(100, 2)
"""Course of the shared error of dwells, standard deviation of what lasts of it, m, and number of flights."""


def offsets() -> Iterator[Row]:
    """Errors over sigma of maps of level ground whose dwells are off by a stated process, and how far sigma falls."""
    rng, times = np.random.default_rng(SEED + 1), np.arange(0.0, 60.0, 3.0)[: STAGES[-1]]
    dwells = list(dwells_over(scenes.level(), 20.0, len(times)))
    alike = np.exp(-np.abs(times[:, None] - times) / VARYING.correlation)
    root, cell_size = np.linalg.cholesky(alike), fitting_cell_size(dwells[0].field.grid, dwells[0].aperture)
    scores, ratios, contradicted = [], [], 0
    for _ in range(FLIGHTS):
        lifts = LASTING * rng.standard_normal() + VARYING.varying * root @ rng.standard_normal(len(times))
        stated, unstated = ReliefMap(cell_size, 10**7, VARYING), ReliefMap(cell_size, 10**7)
        for dwell, time, lift in zip(dwells, times, lifts, strict=True):
            lifted = _lifted(dwell.field, lift)
            for map_ in (stated, unstated):
                map_.add(lifted, dwell.aperture, time)
        contradicted += stated.contradiction is not None
        made, other = stated.relief(), unstated.relief()
        assert made is not None  # noqa: S101 (all dwells have heights)
        assert other is not None  # noqa: S101
        scores.append(float(np.nanmedian(made.height) / np.nanmedian(made.sigma)))
        ratios.append(float(np.nanmedian(made.sigma) / np.nanmedian(other.sigma)))
    text = (
        f"{FLIGHTS} flights of {len(times)} dwells over {times[-1]:g} s, offsets {1e3 * VARYING.varying:.0f} mm with "
        f"{VARYING.correlation:g} s and {1e3 * LASTING:.0f} mm that last; standard error of the row "
        f"{1 / np.sqrt(2 * FLIGHTS):.2f}; sigma {np.median(ratios):.2f} of that without a statement, contradicted "
        f"{contradicted}"
    )
    yield Row(
        "relief map, stated offsets: errors over sigma, rms",
        float(np.sqrt(np.mean(np.square(scores)))),
        "1",
        "<= 1.2",
        text,
    )


def _lifted(field: HeightField, lift: float) -> HeightField:
    """The heights, too high by `lift` (m), with the covariance of what all pixels share."""
    up = np.array([0.0, 0.0, 1.0])
    shared = (VARYING.varying**2 + LASTING**2) * np.outer(up, up)
    surfaces = tuple(
        replace(
            one,
            positions=one.positions + lift * up,
            height=one.height + lift,
            common_covariance=np.broadcast_to(shared, one.own_covariance.shape),
        )
        for one in field.surfaces
    )
    return replace(field, surfaces=surfaces)


def _scores(name: str) -> dict[str, list[Score]]:
    """Scores of both maps of a case after each of STAGES."""
    make, cnr_db = CASES[name]
    dwells = list(dwells_over(make(), cnr_db, STAGES[-1]))
    grid, lit = dwells[0].field.grid, np.concatenate([dwell.lit for dwell in dwells])
    relief = ReliefMap(fitting_cell_size(grid, dwells[0].aperture), 10**7)
    ground = GroundMap(fine_cell_size(grid), max(ground_spacings(grid)), 10**7)
    scores: dict[str, list[Score]] = {"relief map": [], "ground map": []}
    for count, dwell in enumerate(dwells, start=1):
        maps: tuple[CellMap, CellMap] = relief, ground
        for map_ in maps:
            map_.add(dwell.field, dwell.aperture)
        if count in STAGES:
            for kind, map_ in zip(scores, maps, strict=True):
                if made := map_.relief():
                    scores[kind].append(scored(made, lit))
    return scores


def dwells_over(scene: Scene, cnr_db: float, count: int) -> Iterator[Dwell]:
    """Dwells over a scene, displaced at random by up to 20 cm, in the axes of the scene."""
    rng, estimator = np.random.default_rng(SEED), ESTIMATORS["ml"]
    sensor, processing = lidar(COLS), Processing("taylor", ImageSettings().azimuth_window)
    for _ in range(count):
        east, north = rng.uniform(-0.2, 0.2, 2)
        moved = replace(scene, east=scene.east + east, north=scene.north + north)
        images = direct_images(moved, sensor, (ROWS, COLS), processing, rng)
        settings = estimator.settings(range_looks=2, azimuth_looks=2)
        field, back = heights(images.slc(cnr_db), images.sensor, estimator, settings), -np.array([east, north, 0.0])
        surfaces = tuple(replace(one, positions=one.positions + back) for one in field.surfaces)
        yield Dwell(
            replace(field, surfaces=surfaces, grid=replace(field.grid, origin=field.grid.origin + back)),
            replace(images.aperture, position=images.aperture.position + back),
            np.stack(sphere_coordinates(images.surface.positions + back), axis=-1),
        )


def scored(relief: Relief, lit: F64) -> Score:
    """Compare the heights of cells with the nearest height that is lit in each; cells without any are left out.

    Args:
        relief: heights of the cells.
        lit: places east and north and heights that are lit, m, shape (n, 3).
    """
    height, sigma = (values.ravel().astype(np.float64) for values in (relief.height, relief.sigma))
    rows, cols = relief.height.shape
    corner = np.rint(np.array([relief.north, relief.east]) / relief.cell_size - 0.5).astype(np.int64)
    row, col = (np.floor(lit[:, 1::-1] / relief.cell_size).astype(np.int64) - corner).T
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    numbers, levels = row[inside] * cols + col[inside], lit[inside, 2]
    order = np.lexsort((levels, numbers))
    numbers, levels = numbers[order], levels[order]
    first, end = (np.searchsorted(numbers, np.arange(rows * cols), side=side) for side in ("left", "right"))
    seen = np.flatnonzero(np.isfinite(height) & (end > first))
    uniform = np.random.default_rng(SEED).uniform(lit[:, 2].min(), lit[:, 2].max(), len(seen))

    def distance(cell: Any, value: float) -> float:
        return float(np.abs(levels[first[cell] : end[cell]] - value).min())

    error, chance = (
        np.array([distance(cell, value) for cell, value in zip(seen, values, strict=True)])
        for values in (height[seen], uniform)
    )
    sigmas = sigma[seen]
    return Score(
        len(seen),
        float(np.mean(error < sigmas)),
        float(np.mean(error > 5 * sigmas)),
        float(np.mean(chance > 5 * sigmas)),
        float(np.median(sigmas)),
    )
