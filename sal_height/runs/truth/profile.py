"""Picture of heights along range: all surfaces before and after tracking, the terrain, and errors over sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sal_height import messages
from sal_height.engine.tracker import PREFIX
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, I64
from sal_height.picture import FAULT, letter_panels, look_of, page
from sal_height.relief import HeightField
from sal_height.runs.truth.surface_report import judged
from sal_height.simulation import Scene, SimulatedFlight

MOST_SIGMAS = 6.0
"""Errors beyond are drawn at the edge of their panel."""

FILL = ("full", "none", "none")
MARKERS = ("o", "s", "D")
"""Markers, and their fill, of the strongest surface of a pixel and of the others."""


def draw_profile(images: Mapping[str, Sequence[HeightImage]], source: str, flight: SimulatedFlight, path: Path) -> bool:
    """Draw the heights of the column that `column_of_greatest_relief` chooses as a PNG.

    Returns:
        Whether there were tracked heights to draw.
    """
    tracked, measured = ({one.dwell: one for one in images.get(prefix, ())} for prefix in (PREFIX, source))
    fields = {dwell: messages.field_from_message(measured[dwell]) for dwell in tracked.keys() & measured.keys()}
    chosen = column_of_greatest_relief(fields)
    if chosen is None:
        return False
    dwell, col = chosen
    profiles = {name: _profile(one[dwell], col, flight) for name, one in ((PREFIX, tracked), (source, measured))}
    if not all(len(one.height) for one in profiles.values()):
        return False
    with page(path, 3.9) as figure:
        heights, residuals = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
        start = min((one.place @ one.sight).min() for one in profiles.values())
        _draw_heights(heights, profiles, source, flight.scene, start)
        _draw_residuals(residuals, profiles, start)
        residuals.margins(x=0.01)
        residuals.set_xlabel("distance on the ground, from near to far (m)")
        figure.suptitle(f"heights along range in the column with the greatest relief: dwell {dwell}, column {col}")
        letter_panels((heights, residuals))
        drawn = [axes.get_legend_handles_labels() for axes in (heights, residuals)]
        handles, labels = (upper + lower for upper, lower in zip(*drawn, strict=True))
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return True


def column_of_greatest_relief(fields: Mapping[int, HeightField]) -> tuple[int, int] | None:
    """Dwell and column of the greatest relief, among columns with at least half as many heights as the fullest.

    The relief is the difference between the heights that 5 % and 95 % of all surfaces of a column are below. None:
    there is no height.
    """
    columns = {}
    for dwell, field in sorted(fields.items()):
        heights = np.concatenate([surface.height for surface in field.surfaces])
        for col in range(field.grid.cols):
            known = heights[np.isfinite(heights[:, col]), col]
            if known.size:
                columns[dwell, col] = known
    if not columns:
        return None
    fullest = max(len(known) for known in columns.values())
    full = {place: known for place, known in columns.items() if 2 * len(known) >= fullest}
    return max(full, key=lambda place: float(np.ptp(np.percentile(full[place], [5, 95]))))


@dataclass(frozen=True, eq=False)
class _Profile:
    """All surfaces of a column; arrays with an entry each, in the order of the rows, the strongest surfaces first.

    Attributes:
        number: number of the surface in its pixel, from 0.
        row: row of its pixel.
        place: position east and north, m, shape (surfaces, 2).
        height: height above the sphere, m.
        sigma: standard deviation of the height, m.
        error: height minus that of the nearest true surface in the pixel, m; NaN where nothing is lit.
        sight: direction of growing range on the ground, east and north, of length 1.
    """

    number: I64
    row: I64
    place: F64
    height: F64
    sigma: F64
    error: F64
    sight: F64


def _profile(image: HeightImage, col: int, flight: SimulatedFlight) -> _Profile:
    """Read a column of a height image, and compare it with the lit surfaces."""
    field = messages.field_from_message(image)
    errors = judged([image], flight, {image.dwell: flight.surface(image.dwell)}).comparison.errors
    # In the order in which surfaces are compared: one after the other, each over all pixels.
    there = [np.nonzero(np.isfinite(surface.height)) for surface in field.surfaces]
    number = np.concatenate([np.full(len(rows), index) for index, (rows, _) in enumerate(there)])
    row, cols = (np.concatenate([places[axis] for places in there]) for axis in (0, 1))
    chosen = np.flatnonzero(cols == col)
    chosen = chosen[np.lexsort((row[chosen], number[chosen]))]
    sight = field.grid.row_direction[:2] / np.hypot(*field.grid.row_direction[:2])
    place = errors.place[chosen]
    return _Profile(
        number[chosen], row[chosen], place[:, :2], place[:, 2], errors.sigma[chosen], errors.nearest[chosen], sight
    )


def _draw_heights(axes: Axes, profiles: Mapping[str, _Profile], source: str, scene: Scene, start: float) -> None:
    """Draw the terrain and all surfaces over the distance from `start` (m) along the line of sight."""
    tracked, measured = profiles[PREFIX], profiles[source]
    way = {name: one.place @ one.sight - start for name, one in profiles.items()}
    cut = np.linspace(0.0, max(one.max() for one in way.values()), 2000)
    across = measured.place[0] - (measured.place[0] @ measured.sight) * measured.sight
    ground = across[:, None] + measured.sight[:, None] * (start + cut)
    terrain = scene.heights(*ground)
    axes.plot(cut, terrain, color="k", label="terrain")
    if scene.canopy:
        axes.plot(cut, terrain + scene.canopy_tops(*ground), color="k", ls="--", label="top of the canopy")
    _draw_band(axes, tracked, way[PREFIX])
    look = look_of(source)
    for number in range(int(measured.number.max()) + 1):
        here = measured.number == number
        axes.errorbar(
            way[source][here],
            measured.height[here],
            measured.sigma[here],
            fmt=MARKERS[number % len(MARKERS)],
            fillstyle=FILL[number % len(FILL)],
            color=look.colour,
            ms=2.5,
            mew=0.5,
            elinewidth=0.5,
            label=f"{source}, surface {number + 1}, 1 sigma",
        )
    unlit = ~np.isfinite(measured.error)
    if unlit.any():
        axes.plot(way[source][unlit], measured.height[unlit], "x", color=FAULT, ms=5, label="where nothing is lit")
    axes.set_ylabel("height (m)")
    axes.margins(x=0.01)
    axes.grid()


def _draw_band(axes: Axes, tracked: _Profile, way: F64) -> None:
    """Draw the strongest tracked surfaces as a line with a band, torn where rows lack or the ground runs back."""
    first = tracked.number == 0
    steps = np.diff(way[first])
    torn = np.flatnonzero((np.diff(tracked.row[first]) > 1) | (steps < 0) | (steps > 4 * np.median(np.abs(steps)))) + 1
    place, height, sigma = (np.insert(one[first], torn, np.nan) for one in (way, tracked.height, tracked.sigma))
    colour = look_of(PREFIX).colour
    band = height - 2 * sigma, height + 2 * sigma
    axes.fill_between(place, *band, alpha=0.3, color=colour, lw=0, label="tracked, 2 sigma")
    axes.plot(place, height, color=colour, label="tracked")
    others = ~first
    axes.errorbar(way[others], tracked.height[others], 2 * tracked.sigma[others], fmt="_", color=colour, elinewidth=0.8)


def _draw_residuals(axes: Axes, profiles: Mapping[str, _Profile], start: float) -> None:
    """Draw errors over sigma; triangles at the edges stand for those beyond the panel."""
    axes.axhspan(-2, 2, color="0.93", lw=0)
    axes.axhspan(-1, 1, color="0.85", lw=0)
    label = f"error beyond {MOST_SIGMAS:g} sigma"
    for (name, one), marker in zip(profiles.items(), ("o", "s"), strict=True):
        colour, way, off = look_of(name).colour, one.place @ one.sight - start, one.error / one.sigma
        within = np.abs(off) <= MOST_SIGMAS
        axes.plot(way[within], off[within], marker, color=colour, ms=2.5, mew=0, label=f"error of {name}")
        for beyond, shape in ((off > MOST_SIGMAS, "^"), (off < -MOST_SIGMAS, "v")):
            if beyond.any():
                edge = np.sign(off[beyond]) * 0.93 * MOST_SIGMAS
                axes.plot(way[beyond], edge, shape, color=colour, ms=4, mew=0.4, mec="k", label=label)
                label = "_"  # which legends leave out
    axes.set(ylabel="error / sigma", ylim=(-MOST_SIGMAS, MOST_SIGMAS), yticks=range(-4, 5, 2))
    axes.grid()
