"""Coverage of the sigma of published heights: scenes with layover and shadow against their lit surfaces.

Every surface of every pixel that is published as valid is compared with the nearest true surface of its pixel, at the
range and Doppler to which the published height belongs. All scenes go through the core of the pipeline, from images to
heights, at the geometry of preset sal_spotlight unless the case says otherwise.

    python -m benchmarks honest                           every case as rows with targets, into bench.json
    python -m benchmarks.honest                           every case as a line of a table, for people
    python -m benchmarks.honest 'step*' 'level 20*'       some cases; --estimator monopulse: of another estimator
    python -m benchmarks.honest 'step +1.0*' --confusion  with the table of what pixels hold against what was found

From other code: `compared(case_named("step +1.0"), "ml")` is a `SurfaceComparison` (`runs.truth.comparison`) with the
`errors` of every published surface; `measured(case, "ml")` is the height image, the truth and the images themselves.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache, partial
from itertools import groupby
from typing import Annotated, Any, NamedTuple

import numpy as np
from cyclopts import App, Parameter

from benchmarks import honest_scenes as scenes
from benchmarks.direct_images import SLANT_RANGE, DirectImages, direct_images, lidar
from benchmarks.row import Row, sized
from benchmarks.spread import in_processes
from sal_height.beams import Beams
from sal_height.elevation import ESTIMATORS, Validity
from sal_height.imaging import ImageSettings, Processing
from sal_height.numeric import error_statistics, fraction_of
from sal_height.pipeline import heights
from sal_height.relief import HeightField
from sal_height.runs.truth.comparison import FOUND_ORDERS, TRUE_ORDERS, SurfaceComparison, compare
from sal_height.simulation import Scene, load_preset
from sal_height.simulation.lit_surfaces import CONNECTED, LitSurfaces, lit_surfaces

PIXELS = sized(40_000, 1_000)
"""Height pixels of a case; fewer where looks would make its image longer than MOST_COLS."""

MOST_COLS = sized(1740, 80)

SEED = 4


@dataclass(frozen=True)
class Case:
    """A scene and how it is seen.

    Attributes:
        name: name in the results; starts with that of the scene.
        scene: makes the ground.
        cnr_db: CNR of a detector that looks straight at a cell, dB.
        looks: averaged in range and azimuth.
        range_window: over the bandwidth.
        pattern: pattern of the beams.
        detectors: number of detectors of the array.
        size: size of a detector along and across the axis of the array, beamwidths.
        look_angle: angle from nadir of the middle of the array, rad.
        preset: name of the preset of the lidar.
    """

    name: str
    scene: Callable[[], Scene]
    cnr_db: float = 20.0
    looks: tuple[int, int] = (2, 2)
    range_window: str = "taylor"
    pattern: str = "jinc"
    detectors: int = 16
    size: tuple[float, float] = (0.0, 0.0)
    look_angle: float = np.pi / 4
    preset: str = "sal_spotlight"

    def images(self, pixels: int) -> ImageInput:
        """Input of its images, which show about that number of height pixels."""
        rows, per_pixel = load_preset(self.preset).image.rows, self.looks[0] * self.looks[1]
        cols = min(MOST_COLS, pixels * per_pixel // rows) // self.looks[1] * self.looks[1]
        lidar_as = cols, self.pattern, self.detectors, self.size, self.look_angle, self.preset
        return ImageInput(self.scene, (rows, cols), self.range_window, lidar_as)


class ImageInput(NamedTuple):
    """Input of images; cases that differ only in CNR or looks may share it.

    Attributes:
        scene: makes the ground.
        shape: rows and columns before looks are averaged.
        range_window: over the bandwidth.
        lidar: arguments of `lidar`, the last two of which are its look angle and preset.
    """

    scene: Callable[[], Scene]
    shape: tuple[int, int]
    range_window: str
    lidar: tuple[int, str, int, tuple[float, float], float, str]


def _level_cases() -> Iterator[Case]:
    """Level ground: looks, CNR, windows, patterns and detectors. Those that share images follow each other."""
    level = scenes.level
    for looks in ((1, 1), (2, 2), (4, 4), (4, 12)):
        for cnr in (3, 10, 20, 30, 40):
            yield Case(f"level {cnr} dB K {looks[0] * looks[1]}", level, cnr, looks)
    for cnr in (20, 30, 40):
        yield Case(f"level {cnr} dB rectangular range window", level, cnr, range_window="rectangular")
    yield from (Case(f"level {pattern}", level, pattern=pattern) for pattern in ("gaussian", "sinc"))
    yield Case("level finite detectors", level, size=(0.5, 0.5))
    yield from (Case(f"level {detectors} detectors", level, detectors=detectors) for detectors in (2, 8, 32))


def _relief_cases() -> Iterator[Case]:
    """Slopes, rough ground, layover and shadow."""
    for size in (0.5, 1.0, -1.0, 3.0):
        yield Case(f"step {size:+.1f} beamwidths 2 detectors", partial(scenes.step, size), detectors=2)
    yield Case("slope +20 deg 2 detectors", partial(scenes.slope, np.radians(20)), detectors=2)
    yield Case("roofs 2 detectors", scenes.roofs, detectors=2)
    for angle in (-40, -30, -20, -10, 10, 20, 30, 40):
        yield Case(f"slope {angle:+d} deg", partial(scenes.slope, np.radians(angle)))
    yield from (Case(name, scenes.SCENES[name]) for name in ("roofs", "rubble", "forest", "canopy"))
    for size in (0.3, 0.5, 1.0, 2.0, 3.0, -0.3, -0.5, -1.0, -2.0, -3.0):
        scene = partial(scenes.step, size)
        for cnr in (10, 20, 30) if abs(size) == 1 else (20,):
            yield Case(f"step {size:+.1f} beamwidths {cnr} dB", scene, cnr)
    for detectors in (8, 32):
        yield Case(f"step +1.0 beamwidths {detectors} detectors", partial(scenes.step, 1.0), detectors=detectors)
    yield from (Case(f"fence {cnr} dB", scenes.fence, cnr) for cnr in (20, 30, 40))
    yield from _street_cases()


def _street_cases() -> Iterator[Case]:
    """The street: at low CNR, with many looks, in stripmap and under a steep look."""
    street = scenes.street
    yield from (Case(f"street {cnr} dB", street, cnr) for cnr in (3, 10, 20, 30))
    yield from (Case(f"street K {looks[0]}x{looks[1]}", street, looks=looks) for looks in ((4, 12), (1, 20)))
    for cnr in (10, 20):
        yield Case(
            f"street stripmap {cnr} dB", street, cnr, (1, 16), pattern="sinc", detectors=8, preset="sal_stripmap"
        )
    for name, scene in (("level", scenes.level), ("street", street), ("step +1.0", partial(scenes.step, 1.0))):
        yield Case(f"{name} look angle 20 deg", scene, look_angle=np.radians(20))


CASES = (*_level_cases(), *_relief_cases())
"""All cases. A new scene is a function in honest_scenes.py and a line in `_relief_cases`."""


def case_named(pattern: str) -> Case:
    """The first case whose name matches (`*` stands for any text), or begins so."""
    return next(case for case in CASES if fnmatchcase(case.name, pattern + "*"))


def compared(case: Case, estimator: str = "ml", pixels: int = PIXELS, **settings: Any) -> SurfaceComparison:
    """A case of that number of height pixels against its truth; `settings` are those of the estimator."""
    field, truth, images = measured(case, estimator, pixels, **settings)
    return compare(field, truth, images.sensor.beamwidth)


def all_compared(
    cases: Sequence[Case], estimator: str = "ml", pixels: int = PIXELS
) -> Iterator[tuple[SurfaceComparison, LitScatterers]]:
    """Cases against their truth, in their order; those that share images in one process."""
    groups = [list(group) for _, group in groupby(cases, lambda case: case.images(pixels))]
    for group in in_processes(partial(_compared_group, estimator=estimator, pixels=pixels), groups):
        yield from group


def _compared_group(
    cases: Sequence[Case], estimator: str, pixels: int
) -> list[tuple[SurfaceComparison, LitScatterers]]:
    results = []
    for case in cases:
        field, truth, images = measured(case, estimator, pixels)
        compared_surfaces = compare(field, truth, images.sensor.beamwidth)
        results.append((compared_surfaces, LitScatterers.of(field, truth, images.sensor.beams)))
    return results


def measured(
    case: Case, estimator: str = "ml", pixels: int = PIXELS, **settings: Any
) -> tuple[HeightField, LitSurfaces, DirectImages]:
    """Height image of a case, what it should show, and the images that it was made of."""
    images = _images(case.images(pixels))
    entry = ESTIMATORS[estimator]
    chosen = entry.settings(**{"range_looks": case.looks[0], "azimuth_looks": case.looks[1], **settings})
    field = heights(images.slc(case.cnr_db), images.sensor, entry, chosen)
    layers = 1.5 * case.scene().layer_spacing / scenes.STEP_OF_A_BEAMWIDTH
    connected = max(CONNECTED, layers)
    beams, seen = images.sensor.beams, field.first.positions
    reach = images.processing.reach(images.cell, (images.grid.row_spacing, images.grid.col_spacing))
    of_pixels = field.grid, images.cell, reach
    truth = lit_surfaces(images.surface, images.aperture, *of_pixels, beams, connected, seen)
    return field, truth, images


@lru_cache(maxsize=1)
def _images(of: ImageInput) -> DirectImages:
    processing, rng = Processing(of.range_window, ImageSettings().azimuth_window), np.random.default_rng(SEED)
    look_angle, preset = of.lidar[-2:]
    return direct_images(of.scene(), lidar(*of.lidar), of.shape, processing, rng, look_angle, preset)


class LitScatterers(NamedTuple):
    """Published surfaces that are beyond 5 sigma of every lit scatterer of their pixel, fractions from 0 to 1.

    It is for scenes whose pixels have no surface of one height, such as a forest. Of an extended surface the middle is
    compared, and its spread is added to sigma.

    Attributes:
        beyond_5: fraction of the published heights.
        by_chance: fraction of as many random heights within the array, with the same sigma.
    """

    beyond_5: float
    by_chance: float

    @classmethod
    def of(cls, field: HeightField, truth: LitSurfaces, beams: Beams) -> LitScatterers:
        """Count them; scatterers of a surface are so close to each other that it has all heights between them."""
        published, missed, rng = 0, [0, 0], np.random.default_rng(SEED)
        lowest, highest = truth.height + truth.lowest, truth.height + truth.highest
        elevation = truth.elevation[0]
        for one in field.surfaces:
            there = np.isfinite(one.height) & np.isfinite(elevation)
            spread = np.where(field.validity == Validity.EXTENDED, one.spread, 0.0)
            turn = rng.uniform(*beams.span, elevation.shape) - elevation
            random = truth.height[0] + turn * SLANT_RANGE * np.sin(elevation)
            for number, height in enumerate((one.height, random)):
                apart = np.nanmin(np.maximum(lowest - height, height - highest)[:, there], axis=0)
                missed[number] += int(np.count_nonzero(apart > 5 * np.hypot(one.sigma, spread)[there]))
            published += int(np.count_nonzero(there))
        return cls(*(fraction_of(count, published) for count in missed))


@dataclass(frozen=True)
class Summary:
    """Rows of a comparison, fractions from 0 to 1; NaN where there is nothing to count.

    Attributes:
        pixels: lit pixels inside the array.
        valid: fraction of them with a height.
        published: surfaces.
        within_1: fraction of the published surfaces within 1 sigma of the nearest true one.
        within_2: within 2 sigma.
        beyond_5: beyond 5 sigma.
        own_beyond_5: beyond 5 sigma of the one it should be, or without any left.
        missed: fraction of the lit surfaces for which none is published.
        ghosts: fraction of the pixels in shadow that have a height.
        right_order: fraction of the pixels with a height in which as many surfaces were found as there are.
    """

    pixels: int
    valid: float
    published: int
    within_1: float
    within_2: float
    beyond_5: float
    own_beyond_5: float
    missed: float
    ghosts: float
    right_order: float

    @classmethod
    def of(cls, result: SurfaceComparison) -> Summary:
        """Summary of a comparison."""
        errors = result.errors.where(np.isfinite(result.errors.nearest))
        off = error_statistics(errors.nearest, errors.sigma)
        found = result.confusion[1:, 2:6]
        return cls(
            pixels=result.pixels,
            valid=fraction_of(result.valid, result.pixels),
            published=len(result.errors.sigma),
            within_1=off.within_1_sigma,
            within_2=off.within_2_sigma,
            beyond_5=off.beyond_5_sigma,
            own_beyond_5=errors.own_beyond_5_sigma,
            missed=fraction_of(result.missed, result.surfaces),
            ghosts=fraction_of(result.ghosts, result.shadow),
            right_order=fraction_of(int(np.trace(found)), int(found.sum())),
        )

    def as_line(self) -> str:
        """The fractions in percent."""
        return (
            f"{self.pixels:6d} {100 * self.valid:6.1f} {self.published:6d} {100 * self.within_1:6.1f} "
            f"{100 * self.within_2:6.1f} {100 * self.beyond_5:7.2f} {100 * self.own_beyond_5:7.2f} "
            f"{100 * self.missed:6.1f} {100 * self.ghosts:6.1f} {100 * self.right_order:6.1f}"
        )


HEADING = "pixels  valid  publ.     c1     c2      o5  own o5 missed ghosts  order   scat chance  sigma"
"""Of the lines; scat is o5 by the nearest lit scatterer, chance that of random heights, sigma the median in mm."""


def line_of(result: SurfaceComparison, scatterers: LitScatterers) -> str:
    """Line of the table."""
    of_scatterers = f"{100 * scatterers.beyond_5:6.2f} {100 * scatterers.by_chance:6.1f}"
    sigma = 1e3 * float(np.median(result.errors.sigma)) if len(result.errors.sigma) else np.nan
    return f"{Summary.of(result).as_line()} {of_scatterers} {sigma:6.1f}"


def coverage() -> Iterator[Row]:
    """Rows of the group: of every case the deviation of c1 and of c2, o5, and ghosts where there is shadow."""
    for case, (comparison, scatterers) in zip(CASES, all_compared(CASES), strict=True):
        result = Summary.of(comparison)
        text = f"{HEADING} (%)\n    {line_of(comparison, scatterers)}"
        for name, value, nominal in (("c1", result.within_1, 68.27), ("c2", result.within_2, 95.45)):
            deviation = abs(100 * value - nominal) if result.published else 0.0
            yield Row(f"{case.name}: {name} off {nominal} %", deviation, "points", "<= 4", text)
        yield Row(f"{case.name}: o5", 100 * result.beyond_5 if result.published else 0.0, "%", "<= 0.2", text)
        if result.ghosts >= 0:
            yield Row(f"{case.name}: ghosts in shadow", 100 * result.ghosts, "%", "<= 1", text)
        if case.scene is scenes.forest:
            by_scatterers = 100 * scatterers.beyond_5
            yield Row(f"{case.name}: o5 of the nearest lit scatterer", by_scatterers, "%", "<= 0.2", text)


app = App(name="python -m benchmarks.honest", help_format="plaintext", default_parameter=Parameter(negative=()))


@app.default
def table(
    names: Annotated[tuple[str, ...], Parameter(name="CASE", show_default=False)] = (),
    /,
    *,
    estimator: str = "ml",
    pixels: int = PIXELS,
    confusion: Annotated[bool, Parameter(show_default=False)] = False,
) -> int:
    """Print a line for each case: shares in percent, over every surface that is published.

    Args:
        names: Cases; * stands for any text. Default: all.
        estimator: Whose heights.
        pixels: Height pixels of a case, about; fewer are quicker.
        confusion: Print what the pixels hold against what was found, too.
    """
    chosen = [case for case in CASES if not names or any(fnmatchcase(case.name, name) for name in names)]
    _print(f"{'':40} {HEADING}")
    for case, (result, scatterers) in zip(chosen, all_compared(chosen, estimator, pixels), strict=True):
        _print(f"{case.name:40} {line_of(result, scatterers)}")
        if confusion:
            _print(confusion_table(result))
    return 0 if chosen else 2


def confusion_table(result: SurfaceComparison) -> str:
    """Lit pixels inside the array and pixels in shadow: what they hold (rows) against what was found (columns)."""
    lines = [" " * 18 + "".join(f"{name:>13}" for name in FOUND_ORDERS)]
    for name, counts in zip(TRUE_ORDERS, result.confusion, strict=True):
        lines.append(f"    {name:14}" + "".join(f"{count:13d}" for count in counts))
    return "\n".join(lines)


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(app(result_action="return_value"))
