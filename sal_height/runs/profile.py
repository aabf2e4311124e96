"""Picture of a height profile along range: estimated and tracked heights with their error bands, and the terrain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from sal_height_msgs.msg import HeightImage

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.geometry import sphere_coordinates
from sal_height.numeric import F64
from sal_height.relief import Surface
from sal_height.simulation import Scene


def draw_profile(bag: Path, source: str, scene: Scene, path: Path) -> bool:
    """Draw the heights of one column as a PNG: in the middle dwell, the column with the most tracked heights.

    Args:
        bag: of the run.
        source: prefix of the heights that were tracked.
        scene: the terrain.
        path: of the picture.

    Returns:
        Whether there were tracked heights to draw.
    """
    tracked, measured = (_heights(bag, prefix) for prefix in ("tracked", source))
    dwells = sorted(tracked.keys() & measured.keys())
    if not dwells:
        return False
    dwell = dwells[len(dwells) // 2]
    fields = [messages.field_from_message(images[dwell]) for images in (tracked, measured)]
    seen = np.isfinite(fields[0].first.height)
    if not seen.any():
        return False
    col = int(np.argmax(seen.sum(axis=0)))
    line, raw = (_line(field.first, col) for field in fields)
    ends = _ground(line)[:, [0, -1]]
    place, measured_place = (_along(which, ends) for which in (line, raw))
    height, sigma = line.height, line.sigma
    figure = Figure(figsize=(11, 5), layout="constrained")
    axis = figure.subplots()
    axis.fill_between(place, height - 2 * sigma, height + 2 * sigma, alpha=0.3, color="C0", label="tracked, 2 sigma")
    axis.plot(place, height, color="C0", label="tracked")
    axis.errorbar(measured_place, raw.height, raw.sigma, fmt=".", color="0.6", ms=4, lw=0.6, label=source)
    axis.plot(place, scene.heights(*_ground(line)), color="k", lw=1.5, label="terrain")
    spread = np.ptp(height) + 4 * float(np.median(sigma))
    axis.set(
        title=f"dwell {dwell}, column {col}: heights along range, before and after tracking",
        xlabel="distance on the ground (m)",
        ylabel="height above the reference sphere (m)",
        xlim=(float(place.min()), float(place.max())),
        ylim=(float(height.min()) - spread / 2, float(height.max()) + spread / 2),
    )
    axis.legend(loc="best")
    figure.savefig(path, dpi=110)
    return True


def _heights(bag: Path, prefix: str) -> dict[int, HeightImage]:
    """Height images of that prefix by dwell; none if there is no such topic."""
    reader = BagReader(bag)
    topic = f"/{prefix}/height"
    if topic not in reader.topics:
        return {}
    images = (reader.decode(message.type_name, message.cdr) for message in reader.messages([topic]))
    return {image.dwell: image for image in images}


def _line(surface: Surface, col: int) -> Surface:
    """The pixels of a column that have a height."""
    there = np.isfinite(surface.height[:, col])
    return Surface.at(*(getattr(surface, name)[there, col] for name in ("positions", "height", "sigma", "cnr_db")))


def _ground(line: Surface) -> F64:
    """Arc distances east and north, m, shape (2, pixels)."""
    return np.stack(sphere_coordinates(line.positions)[:2])


def _along(line: Surface, ends: F64) -> F64:
    """Distance on the ground (m) along the line between two `ends` (east and north, m, shape (2, 2))."""
    way = ends[:, 1] - ends[:, 0]
    return way @ (_ground(line) - ends[:, :1]) / max(float(np.hypot(*way)), np.finfo(float).tiny)
