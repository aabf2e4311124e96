"""Picture of the point cloud of a run: all surfaces of all pixels, seen obliquely."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from scipy.spatial import cKDTree

from sal_height.graph.picture import HEIGHTS, SIGMAS, WIDTH, colour_bar, log_norm, page, title_of
from sal_height.numeric import F64
from sal_height.runs.truth.comparison import PublishedErrors
from sal_height.runs.truth.surface_report import Judged
from sal_height.simulation import Preset

AZIMUTH, TILT = np.radians(35.0), np.radians(38.0)
"""Direction from which the cloud is seen: clockwise from the sensor's side, and above the horizon, rad."""
VIEW_WIDTH = 0.48 * WIDTH
"""Width of each of the two views, inches."""


def cloud_of(judgements: Mapping[str, Judged]) -> tuple[str, PublishedErrors]:
    """The estimator with the most surfaces, and its surfaces."""
    name = max(judgements, key=lambda one: len(judgements[one].comparison.errors.sigma))
    return name, judgements[name].comparison.errors


def draw_cloud(estimator: str, surfaces: PublishedErrors, preset: Preset, path: Path) -> None:
    """Write a PNG: every published surface as a point, coloured by height on the left and by sigma on the right."""
    side = {"right": 1.0, "left": -1.0}[preset.sensor.look_side]
    across, up, depth = projected(surfaces.place, side)
    order = np.argsort(-depth)  # the farthest first, so that nearer points hide them
    ratio = np.ptp(up) / np.ptp(across)
    # Points so large that those of a closed surface touch: their distance on the page.
    apart, _ = cKDTree(surfaces.place[:, :2]).query(surfaces.place[:, :2], k=5)
    size = (72 * VIEW_WIDTH / (1.1 * np.ptp(across)) * float(np.median(apart[:, -1]))) ** 2
    height = surfaces.place[:, 2]
    scales = (
        (height, Normalize(*np.percentile(height, [0.5, 99.5])), HEIGHTS, "height above the reference sphere (m)"),
        (surfaces.sigma, log_norm(surfaces.sigma), SIGMAS, "sigma (m)"),
    )
    with page(path, 0.9 + VIEW_WIDTH * ratio) as figure:
        for axis, (values, norm, colours, label) in zip(figure.subplots(1, 2), scales, strict=True):
            shown = values[order]
            drawn = axis.scatter(across[order], up[order], c=shown, cmap=colours, norm=norm, s=size, linewidths=0)
            axis.set(aspect="equal", facecolor="0.75", xticks=[], yticks=[])
            colour_bar(drawn, axis, label, values, orientation="horizontal", aspect=40, pad=0.02)
        figure.suptitle(
            f"{preset.name}, {title_of(estimator)}: all {len(order)} surfaces of all pixels, seen from the side of the "
            f"sensor, {np.degrees(TILT):.0f}° above the horizon"
        )


def projected(place: F64, side: float) -> tuple[F64, F64, F64]:
    """Parallel projection of positions (east, north, height): to the right, upwards, and away from the viewer, all m.

    Args:
        place: positions, m, shape (points, 3).
        side: look side on a flight eastwards: +1 right, with the sensor in the north; -1 left, in the south.
    """
    east, north, height = place.T * np.array([[side], [side], [1.0]])
    right = -np.cos(AZIMUTH) * east + np.sin(AZIMUTH) * north
    towards = np.sin(AZIMUTH) * east + np.cos(AZIMUTH) * north
    return right, np.cos(TILT) * height - np.sin(TILT) * towards, -np.cos(TILT) * towards - np.sin(TILT) * height
