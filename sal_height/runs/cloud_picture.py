"""Picture of the point cloud of a run: all surfaces of all pixels, seen obliquely."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from sal_height.numeric import F64
from sal_height.runs.comparison import PublishedErrors
from sal_height.runs.surface_report import Judged
from sal_height.simulation import Preset

mpl.use("Agg")

AZIMUTH, TILT = np.radians(35.0), np.radians(38.0)
"""Direction from which the cloud is seen: clockwise from the sensor's side, and above the horizon, rad."""
WIDTH = 9.3
"""Of each of the two views, inches."""


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
    figure = Figure(figsize=(2 * WIDTH + 0.4, 1.6 + WIDTH * ratio), layout="constrained")
    # Points so large that those of a closed surface touch: their distance on the page.
    apart, _ = cKDTree(surfaces.place[:, :2]).query(surfaces.place[:, :2], k=5)
    size = (72 * WIDTH / (1.1 * np.ptp(across)) * float(np.median(apart[:, -1]))) ** 2
    low, high = np.percentile(surfaces.place[:, 2], [0.5, 99.5])
    scales = (
        (surfaces.place[:, 2], Normalize(low, high), "turbo", "height above the reference sphere (m)"),
        (surfaces.sigma, LogNorm(*np.percentile(surfaces.sigma, [1, 99])), "viridis", "sigma of height (m)"),
    )
    for axis, (values, norm, colours, label) in zip(figure.subplots(1, 2), scales, strict=True):
        drawn = axis.scatter(across[order], up[order], c=values[order], cmap=colours, norm=norm, s=size, linewidths=0)
        axis.set(aspect="equal", facecolor="0.12", xticks=[], yticks=[])
        figure.colorbar(drawn, ax=axis, label=label, orientation="horizontal", aspect=50)
    figure.suptitle(
        f"{preset.name}, {estimator}: all {len(order)} surfaces of all pixels, seen from the side of the sensor, "
        f"{np.degrees(TILT):.0f}° above the horizon"
    )
    figure.savefig(path, dpi=100)


def projected(place: F64, side: float) -> tuple[F64, F64, F64]:
    """Parallel projection of places (east, north, height): to the right, upwards, and away from the viewer, all m.

    Args:
        place: shape (points, 3), m.
        side: +1 if the sensor looks to the right of its flight eastwards, and is in the north; -1 in the south.
    """
    east, north, height = place.T * np.array([[side], [side], [1.0]])
    right = -np.cos(AZIMUTH) * east + np.sin(AZIMUTH) * north
    towards = np.sin(AZIMUTH) * east + np.cos(AZIMUTH) * north
    return right, np.cos(TILT) * height - np.sin(TILT) * towards, -np.cos(TILT) * towards - np.sin(TILT) * height
