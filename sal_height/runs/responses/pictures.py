"""Pictures of responses: the power of an image on the ground, and cuts through the brightest targets."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from sal_height.geometry import Grid
from sal_height.graph.picture import COLUMN_WIDTH, POWERS, colour_bar, page
from sal_height.numeric import C64, F64
from sal_height.response import OVERSAMPLING, REACH, Chip, CutResponse, ImpulseResponse

SHARES = (20.0, 99.9)
"""Percentiles of the power that black and white stand for: targets are far above all else, noise has no least power."""


def draw_image(image: C64, grid: Grid, title: str, path: Path) -> None:
    """Write a PNG of the power of a focused image in dB below its peak, where its pixels are on the ground, north up.

    Args:
        image: pixels, shape (rows, cols).
        grid: grid of the pixels; rows of a slant plane are laid out on level ground around its middle.
        title: title of the picture.
        path: path of the file.
    """
    power = np.abs(image) ** 2
    level = decibels(power / np.nanmax(power))
    black, white = np.percentile(level[np.isfinite(level)], SHARES)
    with page(path, 0.88 * COLUMN_WIDTH, COLUMN_WIDTH) as figure:
        axes = figure.subplots()
        shown = axes.imshow(level, POWERS, vmin=black, vmax=white, origin="lower", interpolation="nearest")
        shown.set_transform(_to_ground(grid) + axes.transData)
        west, south = corners(grid).min(axis=0)
        east, north = corners(grid).max(axis=0)
        axes.set(title=title, xlabel="east (m)", ylabel="north (m)", facecolor="0.7")
        axes.set(xlim=(west, east), ylim=(south, north), aspect="equal")
        colour_bar(shown, axes, "power (dB of the peak)", level, shrink=0.8)


def ground_steps(grid: Grid) -> tuple[F64, F64]:
    """Way on level ground, east and north (m), from a row to the next and from a column to the next, each shape (2,).

    A step along the line of sight changes the range; on the ground, which is seen under the angle of incidence, the
    same change takes the step divided by the sine of that angle, which is the horizontal part of its direction.
    """
    sight, along = grid.row_direction[:2], grid.col_direction[:2]
    return grid.row_spacing * sight / (sight @ sight), grid.col_spacing * along / (along @ along)


def corners(grid: Grid) -> F64:
    """East and north of the outer corners of an image on the ground, m, shape (4, 2)."""
    down, across = ground_steps(grid)
    middle = grid.middle[:2]
    sides = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]]) * np.array(grid.shape)
    return np.asarray(middle + sides @ np.stack([down, across]))


def _to_ground(grid: Grid) -> Affine2D:
    """From column and row of an image to east and north, m."""
    down, across = ground_steps(grid)
    middle = grid.middle[:2]
    first = middle - (grid.rows - 1) / 2 * down - (grid.cols - 1) / 2 * across
    return Affine2D.from_values(*across, *down, *first)


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
