"""The picture of `sal-height irf`: measured targets and the cuts through their peaks."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sal_height.graph.picture import colour_bar, page
from sal_height.numeric import F64
from sal_height.response import OVERSAMPLING, REACH, Chip, CutResponse, ImpulseResponse

PIXELS_SHOWN = 300
"""Greatest number of interpolated rows or columns in the picture of a target; more would not be visible."""

HALF_POWER_DB = 10 * np.log10(0.5)


@dataclass(frozen=True, eq=False)
class DrawnTarget:
    """A measured target to be drawn.

    Attributes:
        title: name of its image.
        axes: names of the directions of rows and of columns, for example range and azimuth.
        chip: the pixels around the target.
        response: measured impulse response of the target.
    """

    title: str
    axes: tuple[str, str]
    chip: Chip
    response: ImpulseResponse


def draw_responses(targets: Sequence[DrawnTarget], title: str, path: Path) -> None:
    """Write a PNG with a row for each target: its interpolated surroundings and both cuts through its peak."""
    with page(path, 0.6 + 2.0 * len(targets)) as figure:
        for panels, target in zip(figure.subplots(len(targets), 3, squeeze=False), targets, strict=True):
            _draw_target(panels, target)
        figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower right", ncols=2, frameon=False)
        figure.suptitle(title)


def _draw_target(panels: Sequence[Axes], target: DrawnTarget) -> None:
    """Draw the surroundings of a target, and the cuts down and across."""
    surroundings, down, across = panels
    chip, response = target.chip, target.response
    rows = _around(response.row, response.row_cut, chip.finite[0])
    cols = _around(response.col, response.col_cut, chip.finite[1])
    peak = chip.power(response.row, response.col)[0, 0]
    level = decibels(chip.power(_thinned(rows), _thinned(cols)) / peak)
    shown = surroundings.imshow(
        level, extent=(cols[0], cols[-1], rows[-1], rows[0]), vmin=-40, vmax=0, cmap="magma", aspect="auto"
    )
    surroundings.set(
        title=textwrap.fill(target.title, 42), xlabel=f"column ({target.axes[1]})", ylabel=f"row ({target.axes[0]})"
    )
    colour_bar(shown, surroundings, "power (dB of the peak)", level)
    _draw_cut(down, rows - response.row, chip.power(rows, response.col) / peak, response.row_cut, target.axes[0])
    _draw_cut(across, cols - response.col, chip.power(response.row, cols) / peak, response.col_cut, target.axes[1])


def _around(position: float, cut: CutResponse, finite: tuple[int, int]) -> F64:
    """Interpolated positions around a peak: REACH widths to both sides, as far as there are pixels."""
    reach = REACH * cut.width if np.isfinite(cut.width) else np.inf
    first, last = max(finite[0], position - reach), min(finite[1], position + reach)
    before, after = int((position - first) * OVERSAMPLING), int((last - position) * OVERSAMPLING)
    return position + np.arange(-before, after + 1) / OVERSAMPLING


def _thinned(positions: F64) -> F64:
    """At most PIXELS_SHOWN positions, evenly spaced from the first to the last."""
    return np.linspace(positions[0], positions[-1], min(len(positions), PIXELS_SHOWN))


def _draw_cut(axis: Axes, offset: F64, power: F64, cut: CutResponse, kind: str) -> None:
    """Draw one cut with its width at -3 dB and its highest sidelobe."""
    axis.plot(offset, decibels(power.ravel()), lw=1)
    axis.plot([-cut.width / 2, cut.width / 2], [HALF_POWER_DB] * 2, "|-", color="#d55e00", ms=6, label="width at -3 dB")
    if np.isfinite(cut.pslr_db):
        axis.axhline(cut.pslr_db, color="#009e73", ls="--", lw=1, label="highest sidelobe")
    axis.set(
        title=f"{kind}: {cut.width:.3f} px\nPSLR {cut.pslr_db:.1f} dB, ISLR {cut.islr_db:.1f} dB".replace("nan", "-"),
        xlabel=f"offset in {kind} (pixels)",
        ylabel="power (dB of the peak)",
        ylim=(-50, 3),
    )
    axis.grid()


def decibels(power: F64) -> F64:
    """Power ratio in dB; minus infinity for 0."""
    with np.errstate(divide="ignore"):
        return 10 * np.log10(power)
