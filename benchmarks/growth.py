"""Growth of the cost of every stage with pixels, detectors, looks, the length of a dwell, and the number of dwells.

Processor time, the least of some runs. A curve ends where one run would take longer than LONGEST_S, or more memory than
MOST_BYTES. `python -m benchmarks.sizing` makes a picture, and the tables of docs/size_your_computer.md, of the results.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from benchmarks.row import Row, load, sized
from benchmarks.sizes import (
    APERTURE,
    COLS,
    PULSES,
    ROWS,
    SAMPLES,
    SPACINGS,
    heights_of_street,
    lidar,
    made_up_dwell,
    made_up_images,
    tiled,
)
from sal_height.elevation import ESTIMATORS
from sal_height.pipeline import heights
from sal_height.relief import GroundMap, HeightField, PriorEstimate, ReliefMap, fine_cell_size, track
from sal_height.relief.map import fitting_cell_size

LONGEST_S = sized(6.0, 1.0)
"""Greatest processor time of one run, s; the next point of a curve is expected to take as its law says."""

MOST_BYTES = 4e9
"""Of the samples, images or heights that a run is about; it needs a few times as many."""

REPEATS = sized(5, 1)
ENOUGH_S = sized(0.5, 0.0)
"""A run is repeated REPEATS times, or until that much time has passed."""

DETECTORS, LOOKS = 16, 4
"""Unless they vary."""

PIXELS = sized((10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000), (10_000, 20_000))
"""Height pixels, about."""

COUNTS = sized((2, 4, 8, 16, 32, 64, 128), (2, 4))
"""Of detectors."""

MANY_LOOKS = sized((1, 2, 4, 8, 16, 32, 64), (1, 2))
LENGTHS = sized((1, 2, 4, 8, 16, 32, 64), (1, 2))
"""Of a dwell, over that of the preset."""

DWELLS = sized((8, 16, 32, 64, 128, 256), (2, 4))

SEARCH = "the highest peak, by all pairs of detectors at each elevation of a swath that grows with them"

MARGIN = 0.1
"""By which the exponent of a curve may exceed its law's."""


@dataclass(frozen=True)
class Point:
    """The input on which a stage was measured, and the least processor time, s.

    Attributes:
        detectors: number of them.
        samples: samples of one detector in a dwell: pulses times samples of a pulse.
        pixels: height pixels in one dwell.
        looks: looks of a pixel.
        dwells: number of them.
        seconds: processor time.
    """

    detectors: int = DETECTORS
    samples: int = PULSES * SAMPLES
    pixels: int = ROWS * COLS // LOOKS
    looks: int = LOOKS
    dwells: int = 1
    seconds: float = 0.0

    @property
    def bytes(self) -> float:
        """Of the complex samples, or of the pixels of images, of all detectors."""
        return 8.0 * self.detectors * max(self.samples, self.pixels * self.looks)


Run = Callable[[], object]

Prepare = Callable[[Point], Run]
"""Makes what is needed, and returns what is to be timed."""


@dataclass(frozen=True)
class Curve:
    """The measurement of a stage.

    Attributes:
        stage: its name.
        over: the attribute of Point that varies.
        law: exponent that the cost should grow with.
        because: why.
        points: sizes.
        prepare: makes a run of a size.
    """

    stage: str
    over: str
    law: float
    because: str
    points: Sequence[Point]
    prepare: Prepare


def curves() -> Iterator[Curve]:
    """All curves that are measured."""
    images = "every pixel on its own"
    for name in ("monopulse", "ml"):
        pixels = [Point(pixels=count) for count in PIXELS]
        yield Curve(name, "pixels", 1.0, images, pixels, partial(_heights, name))
        detectors = [Point(detectors=count) for count in COUNTS]
        yield Curve(name, "detectors", 3.0, SEARCH, detectors, partial(_heights, name))
        looks = [Point(looks=count) for count in MANY_LOOKS]
        yield Curve(name, "looks", 1.0, "covariances are sums over looks", looks, partial(_heights, name))
    transforms = "transforms, N log N"
    counts = [Point(detectors=count) for count in COUNTS]
    yield Curve("compression", "detectors", 1.0, "every detector on its own", counts, _compression)
    lengths = [Point(samples=PULSES * SAMPLES * n, pixels=ROWS * COLS // LOOKS * n) for n in LENGTHS]
    yield Curve("compression", "samples", 1.0, f"{transforms}, of longer dwells", lengths, _compression_of_length)
    squares = [Point(samples=PULSES * SAMPLES * n * n, pixels=ROWS * COLS // LOOKS * n * n) for n in LENGTHS]
    yield Curve("compression", "pixels", 1.0, transforms, squares, _compression)
    for stage, prepare in (("tracker", _tracker), ("map", _map), ("ground", _ground)):
        yield Curve(stage, "pixels", 1.0, images, [Point(pixels=count) for count in PIXELS], prepare)
        dwells = [Point(dwells=count) for count in DWELLS]
        yield Curve(stage, "dwells", 1.0, "what was before costs nothing", dwells, prepare)


def growth() -> Iterator[Row]:
    """The exponent of every curve, of its upper half."""
    for curve in curves():
        points = list(_measured(curve))
        sizes, seconds = [getattr(point, curve.over) for point in points], [point.seconds for point in points]
        exponent = _exponent(sizes, seconds)
        yield Row(
            f"growth of {curve.stage} with {curve.over}",
            exponent,
            "1",
            f"<= {curve.law + MARGIN:g}",
            f"exponent in the upper half of {sizes[0]} to {sizes[-1]}{_end_of(curve, points)}; law: {curve.law:g} "
            f"({curve.because}); {1e3 * seconds[0]:.3g} to {1e3 * seconds[-1]:.4g} ms of a processor; {load()}",
            {"stage": curve.stage, "over": curve.over, "law": curve.law, "points": [asdict(point) for point in points]},
        )


def _measured(curve: Curve) -> Iterator[Point]:
    """The points of a curve as far as they are measured."""
    before: Point | None = None
    for point in curve.points:
        if before is not None:
            ratio = getattr(point, curve.over) / getattr(before, curve.over)
            if before.seconds * ratio**curve.law > LONGEST_S or point.bytes > MOST_BYTES:
                return
        before = replace(point, seconds=_least_cpu_s(curve.prepare(point)))
        yield before


def _end_of(curve: Curve, points: Sequence[Point]) -> str:
    left = len(curve.points) - len(points)
    return f" ({left} more would take longer than {LONGEST_S:g} s or {1e-9 * MOST_BYTES:g} GB)" if left else ""


def _least_cpu_s(run: Run) -> float:
    """The least processor time of some runs, after one that is not counted unless it is long, s."""
    took: list[float] = []
    while len(took) <= REPEATS and sum(took) <= max(ENOUGH_S, 2 * took[0] if took else 0.0):
        began = time.process_time()
        run()
        took.append(time.process_time() - began)
    return min(took)


def _exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of the straight line through the logarithms, of the upper half of the sizes, three points at least."""
    if len(sizes) < 2:
        return float("nan")
    x, y = np.log(sizes), np.log(np.maximum(seconds, 1e-6))
    first = min(int(np.searchsorted(x, (x[0] + x[-1]) / 2)), max(0, len(x) - 3))
    return float(np.polyfit(x[first:], y[first:], 1)[0])


def _heights(name: str, point: Point) -> Run:
    """Images that lie side by side as often as necessary; 2 × 2 looks, or K columns."""
    side = round(np.sqrt(LOOKS))
    down, across = (side, side) if point.looks == LOOKS else (1, point.looks)
    rows, cols = ROWS // side * down, COLS // side  # of a height pixel each, if multiplied by the looks along it
    sensor = lidar(point.detectors)
    tiles = max(1, round(np.sqrt(point.pixels / (ROWS // side * cols))))
    narrow = made_up_images(sensor, rows, cols)
    slc, wide = tiled(narrow, sensor, tiles, tiles * across)
    settings = ESTIMATORS[name].settings(range_looks=down, azimuth_looks=across)
    return lambda: heights(slc, wide, ESTIMATORS[name], settings)


def _compression(point: Point) -> Run:
    larger = round(np.sqrt(point.samples / (PULSES * SAMPLES)))
    sensor = lidar(point.detectors, PULSES * larger, SAMPLES * larger)
    return made_up_dwell(sensor, ROWS * larger, COLS * larger).compress


def _compression_of_length(point: Point) -> Run:
    longer = point.samples // (PULSES * SAMPLES)
    return made_up_dwell(lidar(point.detectors, PULSES * longer), ROWS, COLS * longer).compress


def _tracker(point: Point) -> Run:
    fields = _fields(point)
    _, _, before = track(fields[0], APERTURE, PriorEstimate())

    def run() -> None:
        prior = before
        for field in fields:
            _, _, prior = track(field, APERTURE, prior)

    return run


def _map(point: Point) -> Run:
    fields = _fields(point)

    def run() -> None:
        relief_map = ReliefMap(fitting_cell_size(fields[0].grid, APERTURE), 10**8)
        for field in fields:
            relief_map.add(field)

    return run


def _ground(point: Point) -> Run:
    fields = _fields(point)

    def run() -> None:
        ground = GroundMap(fine_cell_size(fields[0].grid), max(SPACINGS), 10**8)
        for field in fields:
            ground.add(field, APERTURE)
        ground.estimate()

    return run


def _fields(point: Point) -> list[HeightField]:
    """Heights of dwells side by side."""
    rng = np.random.default_rng(3)
    rows, cols = ROWS // 2, COLS // 2
    if point.dwells == 1:
        rows = cols = round(np.sqrt(point.pixels))
    return [heights_of_street(rows, cols, number, rng) for number in range(point.dwells)]
