"""Pictures of a budget: accuracy over power, accuracy over the swath, and CNR over range and along-track distance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage

from sal_height import messages
from sal_height.graph.picture import POWERS, page
from sal_height.io import writing
from sal_height.messages.types import HeightImage
from sal_height.numeric import F64


def draw_budget(
    name: str, by_power: tuple[F64, F64], by_place: tuple[F64, F64], point: tuple[float, float], path: Path
) -> None:
    """Write a PNG: sigma of a height by noise over the mean power, and over the swath.

    Args:
        name: name of the preset.
        by_power: mean power transmitted (W), and sigma (m) in the middle of the swath.
        by_place: elevation from the middle of the beams (beamwidths), and sigma (m).
        point: power (W) and sigma (m) of the budget.
        path: path of the picture.

    Raises:
        UserError: it cannot be written.
    """
    with writing(path), page(path, 2.6) as figure:
        power, swath = figure.subplots(1, 2)
        power.loglog(*by_power)
        power.plot(*point, "o", color="black", label=f"{point[0]:.3g} W: {point[1]:.2g} m")
        power.set(xlabel="mean power transmitted (W)", ylabel="sigma of a height by noise (m)")
        power.set_title(f"{name}: what a power gives, middle of the swath")
        power.legend(frameon=False)
        swath.plot(*by_place)
        swath.set(xlabel="elevation from the middle (beamwidths)", ylabel="sigma of a height by noise (m)")
        swath.set_title("over the swath, at that power")
        for axes in (power, swath):
            axes.grid(which="both")
        swath.set_ylim(bottom=0)


def powers_db(image: HeightImage) -> F64:
    """Power of all surfaces of each pixel over that of the noise, dB, shape (rows, cols); NaN where it is not known.

    It is the carrier-to-noise ratio of one look that the estimator states for each surface, in a detector that looks
    straight at it: the image without the beams. Pixels without a height have it, too.
    """
    surfaces = messages.field_from_message(image).surfaces
    # Of a surface beyond the first, where it is there; of the first, whether it has a height or not.
    linear = [
        np.where(np.isfinite(one.height) | (number == 0), 10 ** (one.cnr_db / 10), 0.0)
        for number, one in enumerate(surfaces)
    ]
    with np.errstate(divide="ignore"):
        level = 10 * np.log10(np.sum(linear, axis=0))
    return np.where(np.isfinite(level), level, np.nan)


def draw_powers(axes: Axes, images: Sequence[HeightImage], factor: float) -> tuple[AxesImage, F64]:
    """Draw the pixels of all dwells side by side; returns the last image, and all values (dB).

    Args:
        axes: axes to draw on.
        images: heights of one estimator.
        factor: units of length in a metre.
    """
    levels = [powers_db(image) for image in images]
    values = np.concatenate([level.ravel() for level in levels])
    norm = Normalize(*np.nanpercentile(values, (2, 99)))  # of the darkest and the brightest grey
    grids = [messages.grid_from_message(image.grid) for image in images]
    for grid, level in zip(grids, levels, strict=True):
        sides = [float(grid.points(0, col)[0]) * factor for col in (-0.5, grid.cols - 0.5)]
        depth = grid.rows * grid.row_spacing * factor
        extent = (sides[0], sides[1], -depth / 2, depth / 2)
        shown = axes.imshow(level, POWERS, norm, extent=extent, origin="lower", interpolation="nearest", aspect="equal")
    ends = np.array([grid.points(0, [-0.5, grid.cols - 0.5])[:, 0] for grid in grids]) * factor
    axes.set(xlim=(ends.min(), ends.max()), ylim=(-depth / 2, depth / 2), facecolor="0.7")
    if grids[0].row_direction[1] < 0:  # what is far is in the south, below
        axes.invert_yaxis()
    return shown, values
