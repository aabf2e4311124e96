"""Pictures of a run and its truth: its point cloud, its ground, and its errors over their standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.patches import Patch
from scipy.special import ndtr

from sal_height.graph.cloud_picture import CloudView, coloured, draw_view, point_image, point_size
from sal_height.numeric import F64, I64, Bool
from sal_height.picture import (
    ERRORS,
    HEIGHTS,
    SIGMAS,
    WIDTH,
    colour_bar,
    letter_panels,
    log_norm,
    look_of,
    page,
    shaded,
    title_of,
)
from sal_height.relief import GroundEstimate, GroundKind
from sal_height.runs.truth.comparison import PublishedErrors
from sal_height.runs.truth.height_picture import error_limit, height_limits
from sal_height.runs.truth.report import TrueGround
from sal_height.runs.truth.surface_report import Judged
from sal_height.simulation import Preset

NOTHING = "0.7"
"""Grey of cells without a value."""

KIND_COLOURS = ("#1b7837", "#f0a830", "0.25", "0.9")
"""Colours of the kinds in the order of their values."""

EDGES = np.linspace(-8.0, 8.0, 65)
"""Edges of the bins, in sigmas; errors beyond them are counted in the outermost bins."""


def cloud_of(judgements: Mapping[str, Judged]) -> tuple[str, PublishedErrors]:
    """The estimator with the most surfaces, and its surfaces."""
    name = max(judgements, key=lambda one: len(judgements[one].comparison.errors.sigma))
    return name, judgements[name].comparison.errors


def draw_cloud(estimator: str, surfaces: PublishedErrors, preset: Preset, path: Path) -> None:
    """Write a PNG: every published surface as a point, in the colours of its height and in those of its sigma."""
    side = {"right": 1.0, "left": -1.0}[preset.sensor.look_side]
    angle = preset.flight.look_angle_rad
    view = CloudView.of_points(surfaces.place, np.array([0.0, -side * np.sin(angle), -np.cos(angle)]))
    height, size = surfaces.place[:, 2], point_size(view, surfaces.place)
    scales = (
        (height, Normalize(*np.percentile(height, [0.5, 99.5])), HEIGHTS, "height above the reference sphere (m)"),
        (surfaces.sigma, log_norm(surfaces.sigma), SIGMAS, "sigma (m)"),
    )
    ratio = view.shape[0] / view.shape[1]
    panels = (2, 1) if ratio < 0.55 else (1, 2)
    with page(path, 0.4 + WIDTH * panels[0] / panels[1] * 0.85 * ratio) as figure:
        for axes, (values, norm, colours, label) in zip(figure.subplots(*panels).flat, scales, strict=True):
            draw_view(axes, view, point_image(view, surfaces.place, coloured(values, norm, colours), size))
            colour_bar(ScalarMappable(norm, colours), axes, label, values, shrink=0.7, aspect=25, pad=0.01)
        letter_panels(figure.axes[:2])
        figure.suptitle(f"{preset.name}, {title_of(estimator)}: {len(height)} surfaces, seen from the sensor's side")


def draw_ground(estimate: GroundEstimate, truth: TrueGround, path: Path) -> None:
    """Write a PNG of the ground of a simulated flight, north up; grey where there is no lit terrain, or no height."""
    rows, cols = estimate.height.shape
    west, south = (first - estimate.cell_size / 2 for first in (estimate.east, estimate.north))
    unit, factor = ("km", 1e-3) if max(rows, cols) * estimate.cell_size > 3000 else ("m", 1.0)
    size = estimate.cell_size * factor
    extent = (west * factor, west * factor + cols * size, south * factor, south * factor + rows * size)
    how: dict[str, Any] = {"extent": extent, "origin": "lower", "interpolation": "nearest"}
    error = np.where(truth.lit, estimate.height - truth.height, np.nan)
    worst = error_limit(error[np.isfinite(error)])
    lit = np.where(truth.lit, truth.height, np.nan)
    heights, errors = Normalize(*height_limits(lit, worst)), Normalize(-worst, worst)
    steps = estimate.cell_size, estimate.cell_size
    kinds = ListedColormap(KIND_COLOURS), BoundaryNorm(np.arange(5) - 0.5, 4)
    tall = float(np.clip(1.6 * rows / cols, 0.8, 2.6))
    with page(path, 1.4 + 2 * tall) as figure:
        axes = figure.subplots(2, 3)
        axes[0, 0].imshow(shaded(lit, steps, heights), **how)
        axes[0, 1].imshow(shaded(estimate.height, steps, heights), **how)
        axes[0, 2].imshow(error, ERRORS, errors, **how)
        axes[1, 0].imshow(estimate.kind.astype(float), *kinds, **how)
        _draw_shares(axes[1, 1], estimate, truth)
        sigmas = log_norm(estimate.sigma)
        axes[1, 2].imshow(estimate.sigma, SIGMAS, sigmas, **how)
        for axis, title in zip(
            axes.flat,
            ("truth: lit terrain", "estimate", "error where lit", "what heights rest on", "fraction of cells", "sigma"),
            strict=True,
        ):
            axis.set(title=title, facecolor=NOTHING if axis.images else "w")
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
        patches.append(Patch(facecolor=NOTHING, edgecolor="0.5", label="a, c: no lit terrain; b, c, f: no height"))
        letter_panels(axes.flat)
        figure.legend(handles=patches, loc="outside lower center", ncols=5, frameon=False)


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


@dataclass(frozen=True, eq=False)
class SigmaCounts:
    """Histogram of the errors of published surfaces from the nearest true surface, in units of their sigma.

    Attributes:
        bins: surfaces between EDGES, those beyond in the first and the last, shape (len(EDGES) - 1,).
        unlit: surfaces where nothing is lit, which have no error.
        within: fractions of all surfaces, unlit ones included, that are within 1 and 2 sigma.
        beyond: fraction of all surfaces that are more than 5 sigma off.
    """

    bins: I64
    unlit: int
    within: tuple[float, float]
    beyond: float

    @property
    def total(self) -> int:
        """Number of surfaces."""
        return int(self.bins.sum()) + self.unlit


def counted(errors: PublishedErrors) -> SigmaCounts:
    """Count every published surface, at least one."""
    off = errors.nearest / errors.sigma
    known = np.isfinite(off)
    bins, _ = np.histogram(np.clip(off[known], EDGES[0], EDGES[-1]), EDGES)
    size = np.abs(off)
    return SigmaCounts(
        bins=bins.astype(np.int64),
        unlit=int(np.count_nonzero(~known)),
        within=(float(np.mean(size < 1)), float(np.mean(size < 2))),
        beyond=float(np.mean(size > 5)),
    )


def draw_errors(judgements: Mapping[str, Judged], path: Path) -> None:
    """Write a PNG: errors over sigma of all surfaces of each estimator, their middle and tails, and the fractions."""
    counts = {name: counted(one.comparison.errors) for name, one in judgements.items()}
    with page(path, 2.9 + 0.16 * len(counts)) as figure:
        middle, tails = figure.subplots(1, 2)
        for axes in (middle, tails):
            _draw_densities(axes, counts)
        middle.set(title="middle", xlim=(-4, 4), ylim=(0, None), ylabel="probability density")
        tails.set(title="tails (bins at the edges: all beyond)", yscale="log", xlim=(EDGES[0], EDGES[-1]))
        letter_panels((middle, tails))
        least = min(1 / one.total for one in counts.values())
        tails.set_ylim(least / np.diff(EDGES)[0] / 2, 1.0)
        figure.legend(*middle.get_legend_handles_labels(), loc="outside lower left", frameon=False)
        figure.suptitle("(height - nearest true height in its pixel) / sigma, of all published surfaces")


def _draw_densities(axes: Axes, counts: Mapping[str, SigmaCounts]) -> None:
    width = np.diff(EDGES)[0]
    axes.stairs(_normal() / width, EDGES, color="0.85", fill=True, label=_expected())
    for name, one in counts.items():
        look = look_of(name)
        axes.stairs(one.bins / one.total / width, EDGES, color=look.colour, ls=look.line, lw=1.1, label=_row(name, one))
    axes.set_xlabel("error / sigma")
    axes.grid()


def _normal() -> F64:
    """Fraction of N(0, 1) in each bin; beyond the outermost ones it is invisible."""
    return np.diff(ndtr(EDGES))


def _expected() -> str:
    within = [100 * (2 * ndtr(limit) - 1) for limit in (1.0, 2.0)]
    return f"N(0, 1): {within[0]:.1f} % within 1 sigma, {within[1]:.1f} % within 2"


def _row(name: str, one: SigmaCounts) -> str:
    within = [100 * share for share in one.within]
    return (
        f"{title_of(name)}: {within[0]:.1f} % within 1 sigma, {within[1]:.1f} % within 2, {100 * one.beyond:.2g} % "
        f"beyond 5; {one.unlit} where nothing is lit; {one.total} surfaces"
    )
