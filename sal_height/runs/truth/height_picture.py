"""Picture of the heights of a run: surfaces found on the ground, their errors, sigmas and number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from scipy.spatial import cKDTree

from sal_height import messages
from sal_height.engine.tracker import PREFIX
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64, half_width, mean_of
from sal_height.picture import (
    ERRORS,
    FAULT,
    HEIGHTS,
    LEAST_POINTS,
    POWERS,
    SIGMAS,
    colour_bar,
    letter_panels,
    log_norm,
    page,
    shaded,
    title_of,
)
from sal_height.runs.truth.comparison import FOUND_ORDERS, TRUE_ORDERS
from sal_height.runs.truth.surface_report import CELL_PIXELS, Judged
from sal_height.simulation import Preset
from sal_height.tables import number_text

SHADOW, NO_ANSWER = "0.35", "0.8"
"""Greys of cells without a height: where only noise was found, and where the signal gave no height."""


@dataclass(frozen=True, eq=False)
class GroundPicture:
    """Layers of a picture of the ground; row 0 the southernmost, NaN where there is nothing.

    Attributes:
        extent: west, east, south and north edge, m.
        terrain: height of the ground inside the array, m.
        lit: terrain height where it is lit, m; NaN elsewhere.
        height: height of the surface nearest to the middle of the cell, m.
        error: error of that surface, m.
        sigma: predicted standard deviation of that surface, m.
        ghost: mask, 1 where that surface is at a position at which nothing is lit.
        silent: mask of absent heights, 1 where only noise was found, 0 where there is another reason.
    """

    extent: tuple[float, float, float, float]
    terrain: F64
    lit: F64
    height: F64
    error: F64
    sigma: F64
    ghost: F64
    silent: F64


def ground_picture(judgement: Judged) -> GroundPicture:
    """Lay the published surfaces, all of each pixel, out on the ground inside the array.

    A cell shows the surface nearest to its middle, seen from above.
    """
    ground, errors = judgement.ground, judgement.comparison.errors
    ground_inside = ground.number[ground.inside]
    first = ground_inside.min(axis=0)
    shape = np.ptp(ground_inside, axis=0) + 1
    middle = (ground_inside[:, ::-1] + 0.5) * ground.size
    reach = 1.25 / CELL_PIXELS * ground.size  # 1.25 pixels on level ground, m
    distance, nearest = cKDTree(errors.place[:, :2]).query(middle, distance_upper_bound=reach)
    found = np.isfinite(distance)
    chosen = np.where(found, nearest, 0)

    def laid_out(values: F64, there: npt.NDArray[np.bool_]) -> F64:
        layer = np.full(shape, np.nan)
        layer[*(ground_inside - first).T] = np.where(there, values, np.nan)
        return layer

    (south, west), (north, east) = first * ground.size, (first + shape) * ground.size
    terrain, lit, silent = ground.terrain[ground.inside], ground.lit[ground.inside], ground.silent[ground.inside]
    return GroundPicture(
        extent=(west, east, south, north),
        terrain=laid_out(terrain, np.ones_like(lit)),
        lit=laid_out(terrain, lit),
        height=laid_out(errors.place[chosen, 2], found),
        error=laid_out(errors.nearest[chosen], found),
        sigma=laid_out(errors.sigma[chosen], found),
        ghost=laid_out(np.ones(len(chosen)), found & errors.ghost[chosen]),
        silent=laid_out(silent.astype(np.float64), ~found),
    )


def draw_heights(judgements: Mapping[str, Judged], images: Sequence[HeightImage], preset: Preset, path: Path) -> None:
    """Write a PNG: truth and CNR above; of each estimator heights, surfaces in a pixel, errors and sigmas below.

    All heights have one colour scale, all errors another, centred on zero, and all sigmas a third. Tracked heights
    look like those that they are tracked from: only their errors and sigmas are shown, in the first row.
    """
    pictures = {name: ground_picture(one) for name, one in judgements.items()}
    own = [name for name in pictures if name != PREFIX]
    scales = _scales(judgements, pictures)
    first = next(iter(pictures.values()))
    tall = float(np.clip(1.45 * np.ptp(first.extent[2:]) / np.ptp(first.extent[:2]), 1.0, 2.2)) + 0.3
    with page(path, 1.25 + tall * (1 + len(own))) as figure:
        axes = figure.subplots(1 + len(own), 4, squeeze=False)  # height, surfaces in a pixel, error and sigma
        terrain = _draw_truth(axes[0, 0], first, scales)
        powers = draw_powers(axes[0, 1], images, scales.factor)
        for row, name in enumerate(own, start=1):
            _draw_found(axes[row, 0], name, pictures[name], judgements[name], scales)
            _draw_confusion(axes[row, 1], judgements[name].comparison.confusion, named=row == len(own))
        for axis, name in zip(axes[:, 2:], [PREFIX, *own], strict=True):
            if name in pictures:
                _draw_error(axis[0], name, pictures[name], judgements[name], scales)
                _show(axis[1], pictures[name], pictures[name].sigma, scales.sigma, SIGMAS, scales.factor)
                axis[1].set_title(f"sigma, {name}")
            else:
                for panel in axis:
                    panel.set_axis_off()
                axis[0].text(0.5, 0.5, "no tracked heights", ha="center", va="center", transform=axis[0].transAxes)
        _name_axes(axes, scales.unit)
        edges = scales.factor * np.array([one.extent for one in pictures.values()])
        for axis in axes[:, [0, 2, 3]].flat:
            axis.set(xlim=(edges[:, 0].min(), edges[:, 1].max()), ylim=(edges[:, 2].min(), edges[:, 3].max()))
        where = {"location": "bottom", "aspect": 30, "pad": 0.02}
        colour_bar(terrain, axes[:, 0], "height (m)", scales.heights, **where)
        colour_bar(powers[0], axes[:, 1], "CNR (dB)", powers[1], **where)
        colour_bar(mpl.cm.ScalarMappable(scales.error, ERRORS), axes[:, 2], "error (m)", scales.errors, **where)
        colour_bar(mpl.cm.ScalarMappable(scales.sigma, SIGMAS), axes[:, 3], "sigma (m)", scales.sigmas, **where)
        letter_panels(axis for axis in axes.flat if axis.axison)
        _explain(figure)
        figure.suptitle(_title(preset))


@dataclass(frozen=True, eq=False)
class _Scales:
    """Colour scales of a picture, all values (m) drawn in them, and the unit of its axes, `factor` of which are a m."""

    height: Normalize
    error: Normalize
    sigma: Normalize
    heights: F64
    errors: F64
    sigmas: F64
    unit: str
    factor: float


def _scales(judgements: Mapping[str, Judged], pictures: Mapping[str, GroundPicture]) -> _Scales:
    layers = list(pictures.values())
    shown = [layers[0].terrain, *(one.height for name, one in pictures.items() if name != PREFIX)]
    heights = np.concatenate([layer.ravel() for layer in shown])
    errors, sigmas = (np.concatenate([getattr(one, name).ravel() for one in layers]) for name in ("error", "sigma"))
    worst = max(error_limit(one.comparison.errors.from_one_height.nearest) for one in judgements.values())
    norms = Normalize(*height_limits(layers[0].terrain, worst)), Normalize(-worst, worst), log_norm(sigmas)
    unit, factor = ("km", 1e-3) if np.ptp(layers[0].extent[:2]) > 3000 else ("m", 1.0)
    return _Scales(*norms, heights, errors, sigmas, unit, factor)


def height_limits(terrain: F64, worst: float) -> tuple[float, float]:
    """Lowest and highest height of the colour scale, m: those of the terrain, and at least its middle +- `worst`.

    On flat ground the colours thus show errors of the heights, instead of one colour.
    """
    low, high = np.nanpercentile(terrain, [0.5, 99.5])
    middle = (low + high) / 2
    return float(min(low, middle - worst)), float(max(high, middle + worst))


def _draw_truth(axis: Axes, picture: GroundPicture, scales: _Scales) -> mpl.cm.ScalarMappable:
    """Draw the terrain with the light from the north-west, and hatch what is in shadow; returns its colours."""
    west, east, south, north = picture.extent
    rows, cols = picture.terrain.shape
    colours = shaded(picture.terrain, ((north - south) / rows, (east - west) / cols), scales.height)
    axis.imshow(colours, extent=_edges(picture, scales.factor), origin="lower", interpolation="nearest")
    _hatch(axis, picture, scales.factor)
    axis.set_title("truth inside the array\nhatched: in shadow")
    return mpl.cm.ScalarMappable(scales.height, HEIGHTS)


def powers_db(image: HeightImage) -> F64:
    """Power of all surfaces of each pixel over that of the noise, dB, shape (rows, cols); NaN where it is not known.

    It is the carrier-to-noise ratio of one look that the estimator states for each surface, in a detector that looks
    straight at it: the image without the beams. Pixels without a height have it, too.
    """
    surfaces = messages.field_from_message(image).surfaces
    # Of a surface beyond the first, where it is there; of the first, whether it has a height or not.
    linear = [
        np.where(np.isfinite(one.height) | (number == 0), 10 ** (one.cnr_db / 10), 0.0)
        for number, one in enumerate(surfaces)
    ]
    with np.errstate(divide="ignore"):
        level = 10 * np.log10(np.sum(linear, axis=0))
    return np.where(np.isfinite(level), level, np.nan)


def draw_powers(axes: Axes, images: Sequence[HeightImage], factor: float) -> tuple[AxesImage, F64]:
    """Draw the pixels of all dwells side by side; returns the last image, and all values (dB).

    Args:
        axes: axes to draw on.
        images: heights of one estimator.
        factor: units of length in a metre.
    """
    levels = [powers_db(image) for image in images]
    values = np.concatenate([level.ravel() for level in levels])
    norm = Normalize(*np.nanpercentile(values, (2, 99)))  # of the darkest and the brightest grey
    grids = [messages.grid_from_message(image.grid) for image in images]
    for grid, level in zip(grids, levels, strict=True):
        sides = [float(grid.points(0, col)[0]) * factor for col in (-0.5, grid.cols - 0.5)]
        depth = grid.rows * grid.row_spacing * factor
        extent = (sides[0], sides[1], -depth / 2, depth / 2)
        shown = axes.imshow(level, POWERS, norm, extent=extent, origin="lower", interpolation="nearest", aspect="equal")
    ends = np.array([grid.points(0, [-0.5, grid.cols - 0.5])[:, 0] for grid in grids]) * factor
    axes.set(xlim=(ends.min(), ends.max()), ylim=(-depth / 2, depth / 2), facecolor="0.7")
    axes.set_title("CNR of all surfaces of a pixel\nby range, from near to far")
    if grids[0].row_direction[1] < 0:  # what is far is in the south, below
        axes.invert_yaxis()
    return shown, values


def _draw_found(axis: Axes, name: str, picture: GroundPicture, judgement: Judged, scales: _Scales) -> None:
    ground = judgement.ground
    _show(axis, picture, picture.height, scales.height, HEIGHTS, scales.factor)
    right = number_text(ground.shares["right"], ".1f", 100.0)
    axis.set_title(f"{title_of(name)}\n{right} % of lit ground\nwithin {ground.tolerance:.2g} m of the truth")


def _draw_error(axis: Axes, name: str, picture: GroundPicture, judgement: Judged, scales: _Scales) -> None:
    _show(axis, picture, picture.error, scales.error, ERRORS, scales.factor)
    _show(axis, picture, picture.ghost, Normalize(0, 1), ListedColormap([FAULT]), scales.factor)
    errors = judgement.comparison.errors.from_one_height.nearest
    known = f"bias {mean_of(errors):+.2g} m, s68 {half_width(errors):.2g} m" if errors.size else "no error known"
    axis.set_title(f"error, {name}\n{known}")


def _name_axes(axes: npt.NDArray[Any], unit: str) -> None:
    """Name the axes at the left and at the bottom; all maps are of the same ground."""
    for axis in axes[:, 0]:
        axis.set_ylabel(f"north ({unit})")
    axes[0, 1].set_ylabel(f"range ({unit})")
    for axis in axes[-1, [0, 2, 3]]:
        axis.set_xlabel(f"east ({unit})")
    for axis in (*axes[:-1, 0], *axes[:-1, 2], *axes[:-1, 3]):
        axis.tick_params(labelbottom=False)
    for axis in axes[:, 2:].flat:
        axis.tick_params(labelleft=False)


def _explain(figure: Figure) -> None:
    """Explain the colours of cells without a height, or without an error."""
    patches = [
        Patch(color=SHADOW, label="no signal, as in shadow"),
        Patch(color=NO_ANSWER, label="a signal, but no height certain enough"),
        Patch(facecolor="white", edgecolor="0.6", label="outside the array"),
        Patch(color=FAULT, label="a height where nothing is lit"),
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=4, frameon=False)


def _title(preset: Preset) -> str:
    flight, sensor = preset.flight, preset.sensor
    return (
        f"{preset.name}: {preset.dwells} dwells of {sensor.detectors} detectors, CNR {preset.cnr_db:g} dB, "
        f"{preset.looks[0]} x {preset.looks[1]} looks, {flight.slant_range_m / 1e3:g} km at "
        f"{np.degrees(flight.look_angle_rad):.0f}° from nadir, flying east and looking "
        f"{'south' if sensor.look_side == 'right' else 'north'}"
    )


def _show(
    axis: Axes, picture: GroundPicture, values: F64, norm: Normalize, colours: str | Colormap, factor: float
) -> None:
    """Draw one layer in ground coordinates, and the greys of the cells that have no height."""
    how: dict[str, Any] = {"extent": _edges(picture, factor), "origin": "lower", "interpolation": "nearest"}
    axis.imshow(picture.silent, ListedColormap([NO_ANSWER, SHADOW]), vmin=0, vmax=1, **how)
    axis.imshow(values, colours, norm, **how)


def _hatch(axis: Axes, picture: GroundPicture, factor: float) -> None:
    """Hatch the terrain that is not lit."""
    west, east, south, north = _edges(picture, factor)
    rows, cols = picture.terrain.shape
    if min(rows, cols) < 2:
        return
    x = west + (np.arange(cols) + 0.5) / cols * (east - west)
    y = south + (np.arange(rows) + 0.5) / rows * (north - south)
    dark = (np.isfinite(picture.terrain) & ~np.isfinite(picture.lit)).astype(float)
    axis.contourf(x, y, dark, levels=[0.5, 1.5], colors="none", hatches=["//////"])


def _edges(picture: GroundPicture, factor: float) -> tuple[float, float, float, float]:
    """West, east, south and north edge in a unit of which `factor` are a metre."""
    west, east, south, north = (factor * edge for edge in picture.extent)
    return west, east, south, north


def _draw_confusion(axis: Axes, table: npt.NDArray[np.int64], named: bool) -> None:
    """Draw the found orders of pixels, in percent of those with each true order; `named`: with names of columns."""
    totals = table.sum(axis=1, keepdims=True)
    share = table / np.maximum(totals, 1)
    axis.imshow(share, "Blues", vmin=0, vmax=1.4, aspect="auto")
    for (row, col), value in np.ndenumerate(share):
        if value:
            axis.text(col, row, percent_text(value), ha="center", va="center", fontsize=LEAST_POINTS, color="0.1")
    axis.set_xticks(range(len(FOUND_ORDERS)), FOUND_ORDERS if named else [], rotation=90)
    names = [f"{name}\n({count})" for name, count in zip(TRUE_ORDERS, totals.ravel(), strict=True)]
    axis.set_yticks(range(len(TRUE_ORDERS)), names, linespacing=0.9)
    axis.set_xlim(-1.3, len(FOUND_ORDERS) - 0.5)  # room for the letter of the panel
    axis.set(title="surfaces of a pixel: % of\nthose with a true number", ylabel="true")
    if named:
        axis.set_xlabel("found")


def percent_text(share: float) -> str:
    """A fraction above 0 in percent, such that only nothing is 0 and only all is 100."""
    rounded = round(100 * share)
    if rounded == 0:
        return "<1"
    return ">99" if rounded == 100 and share < 1 else str(rounded)


def error_limit(error: F64) -> float:
    """End of a colour scale of errors, m: that of their median and three s68, so that a common error is seen."""
    return abs(float(np.median(error))) + 3 * half_width(error) if error.size else 1.0
