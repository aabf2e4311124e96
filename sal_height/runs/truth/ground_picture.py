"""Picture of the ground: the terrain, the estimate, what its heights rest on, sigma, and the errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.patches import Patch

from sal_height.graph.picture import ERRORS, HEIGHTS, SIGMAS, colour_bar, log_norm, page, shaded
from sal_height.numeric import F64, Bool
from sal_height.relief import GroundEstimate, GroundKind
from sal_height.runs.truth.ground_report import TrueGround
from sal_height.runs.truth.height_picture import height_limits

KIND_COLOURS = ("#1b7837", "#f0a830", "0.25", "0.9")
"""Colours of the kinds in the order of their values."""


def draw_ground(estimate: GroundEstimate, truth: TrueGround, path: Path) -> None:
    """Write a PNG of the ground of a simulated flight, north up; grey where there is no lit terrain, or no height."""
    rows, cols = estimate.height.shape
    west, south = (first - estimate.cell_size / 2 for first in (estimate.east, estimate.north))
    unit, factor = ("km", 1e-3) if max(rows, cols) * estimate.cell_size > 3000 else ("m", 1.0)
    size = estimate.cell_size * factor
    extent = (west * factor, west * factor + cols * size, south * factor, south * factor + rows * size)
    how: dict[str, Any] = {"extent": extent, "origin": "lower", "interpolation": "nearest"}
    error = np.where(truth.lit, estimate.height - truth.height, np.nan)
    worst = 5 * float(np.nanmedian(estimate.sigma))
    lit = np.where(truth.lit, truth.height, np.nan)
    heights, errors = Normalize(*height_limits(lit, worst)), Normalize(-worst, worst)
    steps = estimate.cell_size, estimate.cell_size
    kinds = ListedColormap(KIND_COLOURS), BoundaryNorm(np.arange(5) - 0.5, 4)
    tall = float(np.clip(1.6 * rows / cols, 0.8, 2.6))
    with page(path, 1.4 + 2 * tall) as figure:
        axes = figure.subplots(2, 3)
        axes[0, 0].imshow(shaded(lit, steps, heights), **how)
        axes[0, 1].imshow(shaded(estimate.height, steps, heights), **how)
        _show(axes[0, 2], error, ERRORS, errors, how)
        _show(axes[1, 0], estimate.kind.astype(float), *kinds, how)
        _draw_shares(axes[1, 1], estimate, truth)
        sigmas = log_norm(estimate.sigma)
        _show(axes[1, 2], estimate.sigma, SIGMAS, sigmas, how)
        for axis, title in zip(
            axes.flat,
            ("truth: lit terrain", "estimate", "error where lit", "what heights rest on", "fraction of cells", "sigma"),
            strict=True,
        ):
            axis.set(title=title, facecolor="0.7" if axis.images else "w")
        for axis in (axes[0, 0], axes[1, 0]):
            axis.set_ylabel(f"north ({unit})")
        for axis in (*axes[0], axes[1, 0], axes[1, 2]):
            axis.set_xlabel(f"east ({unit})")
        where: dict[str, Any] = {"location": "right", "shrink": 0.85, "pad": 0.02}
        colour_bar(ScalarMappable(heights, HEIGHTS), axes[0, 1], "height (m)", estimate.height, **where)
        colour_bar(ScalarMappable(errors, ERRORS), axes[0, 2], "error (m)", error, **where)
        colour_bar(ScalarMappable(sigmas, SIGMAS), axes[1, 2], "sigma (m)", estimate.sigma, **where)
        patches = [
            Patch(facecolor=colour, edgecolor="0.5", label=kind.name.lower())
            for kind, colour in zip(GroundKind, KIND_COLOURS, strict=True)
        ]
        figure.legend(handles=patches, loc="outside lower center", ncols=4, frameon=False)


def _show(axis: Axes, values: F64, colours: str | Colormap, norm: Normalize, how: dict[str, Any]) -> None:
    axis.imshow(values, colours, norm, **how)


def kind_shares(estimate: GroundEstimate, cells: Bool) -> F64:
    """Fractions of some cells by what their heights rest on, in the order of GroundKind; all 0 without cells."""
    count = np.bincount(estimate.kind[cells], minlength=len(GroundKind))
    return np.asarray(count / max(1, count.sum()))


def _draw_shares(axis: Axes, estimate: GroundEstimate, truth: TrueGround) -> None:
    """Draw, for cells that are truly lit and truly in shadow, what their heights rest on."""
    for place, cells in enumerate((truth.lit, truth.shadow)):
        left = 0.0
        for share, colour in zip(kind_shares(estimate, cells), KIND_COLOURS, strict=True):
            axis.barh(place, 100 * share, left=100 * left, color=colour, height=0.6, edgecolor="0.5", lw=0.4)
            left += share
    rows, cols = estimate.kind.shape
    counts = [np.count_nonzero(cells) for cells in (truth.lit, truth.shadow)]
    axis.set_yticks((0, 1), [f"lit\n({counts[0]})", f"in shadow\n({counts[1]})"])
    axis.set(xlabel="%", xlim=(0, 100), ylim=(1.6, -0.6), box_aspect=rows / cols)
