"""Picture of the heights of a run: what was found on the ground, its errors and sigmas, and how many surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from scipy.spatial import cKDTree

from sal_height.elevation import ESTIMATORS
from sal_height.numeric import F64
from sal_height.runs.comparison import FOUND_ORDERS, TRUE_ORDERS
from sal_height.runs.surface_report import CELL_PIXELS, Judged
from sal_height.simulation import Preset

mpl.use("Agg")

SHADOW, NO_ANSWER = "0.35", "0.8"
"""Greys of cells without a height: where nothing was found but noise, and where what was found gave no height."""

GHOST = "magenta"
"""Colour, among the errors, of heights where nothing is lit."""

HEIGHTS = "turbo"
"""Colours of heights."""

REACH_PIXELS = 1.25
"""Distance from a cell's middle within which the nearest surface is drawn in it, pixels on level ground."""


@dataclass(frozen=True, eq=False)
class GroundPicture:
    """Layers of a picture of the ground; row 0 the southernmost, NaN where there is nothing.

    Attributes:
        extent: west, east, south and north edge, m.
        terrain: height of the ground inside the array, m.
        lit: the same of what is lit.
        height: of the surface nearest to the middle of the cell, m.
        error: of that surface, m.
        sigma: of that surface, m.
        ghost: 1 where that surface is where nothing is lit.
        silent: 1 where there is none because nothing was found but noise, 0 where there is none for another reason.
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
    reach = REACH_PIXELS / CELL_PIXELS * ground.size
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


def draw_heights(judgements: Mapping[str, Judged], preset: Preset, path: Path) -> None:
    """Write a PNG: truth and heights above, then errors, sigmas, and how many surfaces were found of how many.

    All heights share one colour scale, all errors another, centred on zero, and all sigmas a third.
    """
    pictures = {name: ground_picture(one) for name, one in judgements.items()}
    first = next(iter(pictures.values()))
    worst = 4 * min(_s68(one.comparison.errors.nearest) for one in judgements.values())
    heights = Normalize(*height_limits(first.terrain, worst))
    sigma = np.concatenate([one.comparison.errors.sigma for one in judgements.values()])
    sigmas = LogNorm(*np.percentile(sigma, [1, 99]) * np.array([0.999, 1.001]))
    columns = len(pictures) + 1
    tall = max(2.6, 4.2 * np.ptp(first.extent[2:]) / np.ptp(first.extent[:2]))
    figure = Figure(figsize=(5.2 * columns, 3.9 + 3 * (tall + 0.5)), layout="constrained")
    axes = figure.subplots(4, columns, squeeze=False, height_ratios=[tall, tall, tall, 2.4])
    terrain = _show(axes[0, 0], first, first.terrain, heights, HEIGHTS)
    axes[0, 0].set_title("truth: terrain inside the array\nhatched: in shadow")
    _hatch(axes[0, 0], first)
    for column, (name, picture) in enumerate(pictures.items(), start=1):
        title = ESTIMATORS[name].title if name in ESTIMATORS else name
        width = _s68(judgements[name].comparison.errors.nearest)
        tolerance, right = judgements[name].ground.tolerance, judgements[name].ground.shares["right"]
        _show(axes[0, column], picture, picture.height, heights, HEIGHTS)
        axes[0, column].set_title(f"height, {title}\nright to {tolerance:.2g} m: {_percent(right)} of the lit ground")
        error = _show(axes[1, column], picture, picture.error, Normalize(-worst, worst), "RdBu_r")
        _show(axes[1, column], picture, picture.ghost, Normalize(0, 1), ListedColormap([GHOST]))
        axes[1, column].set_title(f"error, {title}\nhalf the 16-84 % width of all surfaces {width:.3g} m")
        stated = _show(axes[2, column], picture, picture.sigma, sigmas, "viridis")
        axes[2, column].set_title(f"sigma, {title}")
        _draw_confusion(axes[3, column], judgements[name].comparison.confusion, title)
    figure.colorbar(terrain, ax=axes[0], label="height above the reference sphere (m)")
    figure.colorbar(error, ax=axes[1], label="height error (m)")
    figure.colorbar(stated, ax=axes[2], label="sigma of height (m)")
    _draw_geometry(axes[1, 0], preset)
    axes[3, 0].axis("off")
    axes[2, 0].axis("off")
    axes[2, 0].legend(
        handles=[
            Patch(color=SHADOW, label="no signal: in shadow, or too weak"),
            Patch(color=NO_ANSWER, label="no answer: a signal, but no height\nthat is certain enough"),
            Patch(facecolor="white", edgecolor="0.6", label="outside the array"),
            Patch(color=GHOST, label="a height where nothing is lit"),
        ],
        title="cells without a height, or without an error",
        loc="center",
        fontsize="large",
    )
    flight = preset.flight
    figure.suptitle(
        f"{preset.name}: {preset.dwells} dwells, {preset.sensor.detectors} detectors, CNR {preset.cnr_db:g} dB, "
        f"{preset.looks[0]} x {preset.looks[1]} looks, slant range {flight.slant_range_m / 1e3:g} km. "
        "Each cell shows the surface nearest to its middle, of all surfaces of all pixels."
    )
    figure.savefig(path, dpi=100)


def height_limits(terrain: F64, worst: float) -> tuple[float, float]:
    """Lowest and highest height of the colour scale, m: those of the terrain, and at least its middle +- `worst`.

    On flat ground the colours thus show errors of the heights, instead of one colour.
    """
    low, high = np.nanpercentile(terrain, [0.5, 99.5])
    middle = (low + high) / 2
    return float(min(low, middle - worst)), float(max(high, middle + worst))


def _show(axis: Axes, picture: GroundPicture, values: F64, norm: Normalize, colours: str | Colormap) -> AxesImage:
    """Draw one layer in ground coordinates, and the greys of the cells that have no height."""
    unit, (west, east, south, north) = _edges(picture)
    axis.set(xlabel=f"east, along-track ({unit})", ylabel=f"north ({unit})")
    extent, greys = (west, east, south, north), ListedColormap([NO_ANSWER, SHADOW])
    axis.imshow(picture.silent, greys, vmin=0, vmax=1, extent=extent, origin="lower", interpolation="nearest")
    return axis.imshow(values, colours, norm, extent=extent, origin="lower", interpolation="nearest")


def _hatch(axis: Axes, picture: GroundPicture) -> None:
    """Hatch the terrain that is not lit."""
    _, (west, east, south, north) = _edges(picture)
    rows, cols = picture.terrain.shape
    x = west + (np.arange(cols) + 0.5) / cols * (east - west)
    y = south + (np.arange(rows) + 0.5) / rows * (north - south)
    dark = (np.isfinite(picture.terrain) & ~np.isfinite(picture.lit)).astype(float)
    axis.contourf(x, y, dark, levels=[0.5, 1.5], colors="none", hatches=["////"])


def _edges(picture: GroundPicture) -> tuple[str, tuple[float, float, float, float]]:
    """Unit of length in which the picture is drawn, and its west, east, south and north edge in it."""
    unit, factor = ("km", 1e-3) if np.ptp(picture.extent[:2]) > 3000 else ("m", 1.0)
    west, east, south, north = picture.extent
    return unit, (factor * west, factor * east, factor * south, factor * north)


def _draw_confusion(axis: Axes, table: npt.NDArray[np.int64], title: str) -> None:
    """Draw how many surfaces the pixels hold (rows) and how many were found: numbers, and shares of the row as grey."""
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    axis.imshow(share, "Blues", vmin=0, vmax=1.3, aspect="auto")
    for (row, col), count in np.ndenumerate(table):
        axis.text(col, row, f"{count}", ha="center", va="center", fontsize="small", color="0.1" if count else "0.7")
    axis.set_xticks(
        range(len(FOUND_ORDERS)), [name.replace(" ", "\n") for name in FOUND_ORDERS], fontsize="small", rotation=30
    )
    axis.set_yticks(range(len(TRUE_ORDERS)), TRUE_ORDERS, fontsize="small")
    axis.set(title=f"surfaces in a pixel, {title}", xlabel="found", ylabel="true")


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _s68(error: F64) -> float:
    """Half the width from 16 to 84 %; 1 if there is no error at all, so that a colour scale exists."""
    return float(np.diff(np.nanpercentile(error, [16, 84]))[0] / 2) if np.any(np.isfinite(error)) else 1.0


def _draw_geometry(axis: Axes, preset: Preset) -> None:
    """Draw the vertical section across the flight: platform, line of sight and fan of beams."""
    flight, sensor = preset.flight, preset.sensor
    side = {"right": -1, "left": 1}[sensor.look_side]
    across, up = np.sin(flight.look_angle_rad), np.cos(flight.look_angle_rad)
    axis.plot([0, side * across], [up, 0], "k-", lw=1)
    for edge in (-0.06, 0.06):
        angle = flight.look_angle_rad + edge
        reach = up / np.cos(angle)
        axis.plot([0, side * reach * np.sin(angle)], [up, 0], "k--", lw=0.7)
    axis.plot([-1.1, 1.1], [0, 0], color="saddlebrown", lw=3)
    axis.plot([0, 0], [0, up], color="0.6", lw=0.7)
    axis.plot(0, up, "o", color="tab:red", ms=9)
    axis.annotate("platform, flying east", (0, up), (0.0, up + 0.07), ha="center")
    span = sensor.detectors * sensor.pitch_beamwidths * sensor.wavelength_m / sensor.aperture_m
    axis.annotate(
        f"slant range {flight.slant_range_m / 1e3:g} km\n"
        f"look angle {np.degrees(flight.look_angle_rad):.0f}° from nadir\n"
        f"{sensor.detectors} beams span {span * 1e3:.3g} mrad\n"
        f"= {span * flight.slant_range_m:.4g} m across the line of sight",
        (side * across / 2, up / 2),
        (0.08 if side < 0 else -0.08, up * 0.45),
        ha="left" if side < 0 else "right",
    )
    axis.set(title="look geometry (beams not to scale)", aspect="equal", ylim=(-0.1, 0.95))
    axis.text(side * 1.0, -0.09, "south" if side < 0 else "north", ha="center")
    axis.axis("off")
