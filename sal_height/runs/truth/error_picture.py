"""Picture of errors over their stated standard deviations: a histogram of every published surface, and N(0, 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.special import ndtr

from sal_height.graph.picture import look_of, page, title_of
from sal_height.numeric import F64, I64
from sal_height.runs.truth.comparison import PublishedErrors
from sal_height.runs.truth.surface_report import Judged

EDGES = np.linspace(-8.0, 8.0, 65)
"""Edges of the bins, in sigmas; errors beyond them are counted in the outermost bins."""


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
        middle.set(title="middle", xlim=(-4, 4), ylim=(0, None), ylabel="share of surfaces per sigma")
        tails.set(title="tails (bins at the edges: all beyond)", yscale="log", xlim=(EDGES[0], EDGES[-1]))
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
