"""Picture of a focused image: its power on the ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.transforms import Affine2D

from sal_height.geometry import Grid
from sal_height.graph.picture import COLUMN_WIDTH, POWERS, colour_bar, page
from sal_height.numeric import C64, F64
from sal_height.runs.responses.irf_picture import decibels

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
