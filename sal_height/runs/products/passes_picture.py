"""Picture of heights from passes: where the points are, what the passes confuse, and the errors at reference points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sal_height.graph.picture import HEIGHTS, colour_bar, page
from sal_height.passes import PassHeights
from sal_height.runs.products.passes_report import ReferenceComparison


def draw_passes(result: PassHeights, comparisons: Sequence[ReferenceComparison], path: Path) -> None:
    """Write a PNG: the map of the points on the left; on the right heights over range, and the array response."""
    with page(path, 5.6) as figure:
        panels = figure.subplot_mosaic([["plan", "profile"], ["plan", "response"]], width_ratios=[1.2, 1.0])
        _draw_plan(panels["plan"], result, comparisons)
        _draw_profile(panels["profile"], result, comparisons)
        _draw_response(panels["response"], result)


def _draw_plan(axis: Axes, result: PassHeights, comparisons: Sequence[ReferenceComparison]) -> None:
    points = result.found.points
    east, north, height = points.positions.T
    limits = np.percentile(height, [1, 99]) if len(height) else (0.0, 1.0)
    size = 4 + 20 * np.clip(np.log10(np.maximum(points.power, 1.0)) / 4, 0, 1)
    drawn = axis.scatter(east, north, c=height, s=size, cmap=HEIGHTS, vmin=limits[0], vmax=limits[1], linewidths=0)
    for one in comparisons:
        axis.plot(*one.reference.position[:2], marker="+", color="k", ms=9)
    colour_bar(drawn, axis, "height (m)", height, orientation="horizontal", aspect=40, pad=0.02)
    axis.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title=f"{len(height)} points, + reference points")


def _draw_profile(axis: Axes, result: PassHeights, comparisons: Sequence[ReferenceComparison]) -> None:
    points, array = result.found.points, result.array
    sight = array.axes[0] * np.array([1.0, 1.0, 0.0])
    sight /= np.linalg.norm(sight)
    away = (points.positions - array.centre) @ sight
    axis.errorbar(away, points.height, 2 * points.total_sigma, fmt=".", ms=3, lw=0.6)
    for one in comparisons:
        axis.plot((one.reference.position - array.centre) @ sight, one.reference.position[2], "k+", ms=9)
    axis.set(xlabel="ground range (m)", ylabel="height (m), 2 sigma")


def _draw_response(axis: Axes, result: PassHeights) -> None:
    ambiguity = result.ambiguity
    axis.plot(ambiguity.offsets, ambiguity.response, lw=1.0)
    axis.set(
        xlabel="error of height (m)",
        ylabel="fraction of power",
        ylim=(0, 1),
        title=f"{len(result.array.passes)} passes: greatest sidelobe {ambiguity.sidelobe:.2g}",
    )
