"""Style of all pictures: their width, fonts, colour maps, and the colour and line of each estimator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from string import ascii_lowercase
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from PIL import Image

from sal_height.elevation import ESTIMATORS
from sal_height.numeric import F64

mpl.use("Agg")

WIDTH, COLUMN_WIDTH = 183 / 25.4, 89 / 25.4
"""Widths of pictures, inches: two columns of a journal, and one."""

LEAST_POINTS = 6.0
"""Size of the smallest letters, points."""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c00")
"""Colours of lines, those of Okabe and Ito, Color Universal Design, 2008, and a brown instead of their yellow."""

STYLE: dict[Any, Any] = {
    "axes.prop_cycle": cycler(color=COLOURS),
    "font.size": 7.0,
    "axes.titlesize": 7.0,
    "axes.labelsize": 7.0,
    "figure.titlesize": 8.0,
    "legend.title_fontsize": 7.0,
    "xtick.labelsize": LEAST_POINTS,
    "ytick.labelsize": LEAST_POINTS,
    "legend.fontsize": 6.5,
    "axes.linewidth": 0.5,
    "grid.linewidth": 0.4,
    "grid.alpha": 0.4,
    "hatch.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "lines.markersize": 3.0,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
}
"""Sizes in points, and the colours of lines that stand for no estimator."""

HEIGHTS, SIGMAS, ERRORS, POWERS = "viridis", "magma", "RdBu_r", "gray"
"""Colour maps, which survive print in grey (but for the sign of an error) and suit the colour-blind."""

FAULT = "magenta"
"""Colour, which no colour map has, of what must not be there: a height where nothing is lit, or on one side only."""


class Look(NamedTuple):
    """Colour, style of line and marker of an estimator: the same in all pictures, and distinct in grey, too."""

    colour: str
    line: Any
    marker: str


_TRACKED = Look(COLOURS[0], "-", "o")
_LOOKS = (
    Look(COLOURS[2], "--", "s"),
    Look(COLOURS[1], "-.", "^"),
    Look(COLOURS[4], ":", "v"),
    Look(COLOURS[3], (0, (5, 1, 1, 1, 1, 1)), "D"),
    Look(COLOURS[5], (0, (1, 1)), "P"),
    Look(COLOURS[6], (0, (8, 2)), "X"),
)
"""Looks of estimators, in the order of ESTIMATORS."""


def look_of(estimator: str) -> Look:
    """Style of the estimator of that prefix of topics; one that is in no registry is drawn as tracked heights."""
    names = list(ESTIMATORS)
    return _LOOKS[names.index(estimator) % len(_LOOKS)] if estimator in names else _TRACKED


def title_of(estimator: str) -> str:
    """Name in pictures of the estimator of that prefix of topics."""
    return ESTIMATORS[estimator].title if estimator in ESTIMATORS else estimator


@contextmanager
def page(path: Path, tall: float, wide: float = WIDTH) -> Iterator[Figure]:
    """A figure of this size (inches) to draw on, written as a PNG when the block ends; one of greys alone as such."""
    dots_per_inch = 220  # a picture as wide as two columns has 1585 pixels in a row
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(wide, tall), dpi=dots_per_inch, layout="constrained")
        yield figure
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # once, and not twice as savefig does
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    image = Image.fromarray(pixels)
    if (pixels == pixels[..., :1]).all():
        image = image.convert("L")
    image.save(path, "PNG")


@contextmanager
def film_page(ratio: float, panels: int) -> Iterator[tuple[Figure, list[Axes]]]:
    """A figure for the frames of a film, in the letters of pictures: panels of this height over width, drawn by Agg."""
    with mpl.rc_context(STYLE):
        wide, dots_per_inch = 6.0, 150  # 900 pixels, as wide as a page of documentation
        figure = Figure(figsize=(wide, panels * (0.92 * wide * ratio + 0.15)), dpi=dots_per_inch, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure, list(figure.subplots(panels, 1, squeeze=False)[:, 0])


def letter_panels(panels: Iterable[Axes]) -> None:
    """Write a, b, c, … into the upper left corners of panels, in their order, for captions to name them."""
    paper: dict[str, Any] = {"boxstyle": "square,pad=0.15", "facecolor": "w", "edgecolor": "none", "alpha": 0.8}
    for letter, axes in zip(ascii_lowercase, panels, strict=False):
        where: dict[str, Any] = {"transform": axes.transAxes, "ha": "left", "va": "top", "zorder": 10}
        axes.text(0.015, 0.97, letter, fontweight="bold", bbox=paper, **where)


def beyond(values: F64, limits: tuple[float, float]) -> str:
    """Ends of a scale that values lie beyond: "neither", "min", "max" or "both"; NaN is ignored."""
    known = values[np.isfinite(values)]
    low, high = (known < limits[0]).any(), (known > limits[1]).any()
    return ("both" if high else "min") if low else ("max" if high else "neither")


def colour_bar(shown: ScalarMappable, axes: Any, label: str, values: F64, **where: Any) -> Colorbar:
    """Draw the scale of colours next to `axes`, with a triangle at each end that `values` go beyond.

    Args:
        shown: artist that is drawn in these colours.
        axes: panel, or several panels.
        label: quantity with its unit.
        values: values that are drawn in these colours.
        where: keywords of Figure.colorbar.
    """
    figure = np.ravel(axes)[0].figure
    low, high = (float(limit) for limit in shown.get_clim() if limit is not None)
    bar: Colorbar = figure.colorbar(shown, ax=axes, label=label, extend=beyond(values, (low, high)), **where)
    if isinstance(shown.norm, LogNorm):
        bar.locator = LogLocator(subs=_steps(high / low))
        bar.formatter = FuncFormatter(lambda value, _: f"{value:g}")
        bar.minorticks_off()
    bar.outline.set_linewidth(0.5)
    return bar


def _steps(ratio: float) -> tuple[float, ...]:
    """Steps of a decade that are numbered on a logarithmic scale whose ends have this ratio: four to six in all."""
    if ratio < 5:
        return (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    return (1.0, 2.0, 5.0) if ratio < 40 else (1.0, 3.0)


def log_norm(values: F64) -> LogNorm:
    """A logarithmic scale over the middle 98 % of positive values, however few or alike they are."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, [1, 99]) if known.size else (1.0, 1.0)
    return LogNorm(low * 0.98, high * 1.02)


def shaded(terrain: F64, steps: tuple[float, float], norm: Normalize) -> F64:
    """Colours of a terrain in light from the north-west, 45 degrees high; level ground keeps the colour of its height.

    Lambert's law: the brightness over that of level ground is (1 - g l) / sqrt(1 + g^2), with g the gradient of the
    terrain and l the horizontal direction to the light. It makes colours at most half black or half white.

    Args:
        terrain: heights, m, row 0 the southernmost, shape (rows, cols), at least 2 of each to have slopes.
        steps: distance of rows and of columns, m.
        norm: scale of the colours.

    Returns:
        RGBA from 0 to 1, transparent where the terrain is NaN, shape (rows, cols, 4).
    """
    colours = np.asarray(mpl.colormaps[HEIGHTS](norm(terrain)))
    if min(terrain.shape) > 1:
        north, east = np.gradient(terrain, *steps)
        bright = (1 - (north - east) / np.sqrt(2)) / np.sqrt(1 + north**2 + east**2) - 1
        mixed = np.clip(np.nan_to_num(bright), -0.5, 0.5)[..., None]
        colours[..., :3] = colours[..., :3] * (1 - np.abs(mixed)) + np.maximum(mixed, 0)
    colours[..., 3] = np.isfinite(terrain)
    return colours
