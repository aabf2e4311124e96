"""Picture of the ground: the terrain, the estimate, what its heights rest on, sigma, and the errors."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm
from matplotlib.figure import Figure

from sal_height.numeric import F64
from sal_height.relief import GroundEstimate, GroundKind
from sal_height.runs.ground_report import TrueGround

mpl.use("Agg")

KIND_COLOURS = ("#4c9f70", "#f2c14e", "#333344", "#d9d9d9")
"""Of the kinds in the order of their values."""


def draw_ground(estimate: GroundEstimate, truth: TrueGround, path: Path) -> None:
    """Write a PNG of the ground of a simulated flight, north up; grey where there is no lit terrain, or no height."""
    rows, cols = estimate.height.shape
    west, south = (first - estimate.cell_size / 2 for first in (estimate.east, estimate.north))
    unit, factor = ("km", 1e-3) if max(rows, cols) * estimate.cell_size > 3000 else ("m", 1.0)
    size = estimate.cell_size * factor
    extent = (west * factor, west * factor + cols * size, south * factor, south * factor + rows * size)
    figure = Figure(figsize=(16, 2 + 5 * 2 * rows / cols), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    low, high = np.nanpercentile(np.where(truth.lit, truth.height, np.nan), [0.5, 99.5])
    error = np.where(truth.lit, estimate.height - truth.height, np.nan)
    worst = 5 * float(np.nanmedian(estimate.sigma))

    def show(row: int, col: int, values: F64, title: str, label: str, **colours: object) -> None:
        axis = axes[row, col]
        image = axis.imshow(values, extent=extent, origin="lower", interpolation="nearest", **colours)
        axis.set(title=title, facecolor="0.7")
        figure.colorbar(image, ax=axis, label=label, shrink=0.8)

    heights = {"vmin": float(low), "vmax": float(high) + 1e-9}
    lit = np.where(truth.shadow, np.nan, truth.height)
    show(0, 0, lit, "truth: the terrain that is lit", "height (m)", **heights)
    show(0, 1, estimate.height, "estimate", "height (m)", **heights)
    show(0, 2, error, "error where lit", "height error (m)", cmap="RdBu_r", vmin=-worst, vmax=worst)
    show(1, 0, np.where(truth.shadow, 1.0, np.nan), "truth: shadow inside the array", "", cmap="gray", vmin=0, vmax=3)
    kinds = {"cmap": ListedColormap(KIND_COLOURS), "norm": BoundaryNorm(np.arange(5) - 0.5, 4)}
    show(1, 1, estimate.kind.astype(float), "what the height rests on", "", **kinds)
    bar = figure.axes[-1]
    bar.set_yticks(range(4), [kind.name.lower() for kind in GroundKind])
    show(1, 2, estimate.sigma, "sigma", "m", norm=LogNorm(*np.nanpercentile(estimate.sigma, [1, 99])))
    for axis in axes[1]:
        axis.set_xlabel(f"east ({unit})")
    for axis in axes[:, 0]:
        axis.set_ylabel(f"north ({unit})")
    figure.savefig(path, dpi=90)
