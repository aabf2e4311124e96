"""Picture of the worst dwell of a comparison: the golden heights, the compared ones, and the difference."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap, Normalize

from sal_height.bag.compare import TopicComparison
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.messages import to_ns
from sal_height.numeric import F64
from sal_height.picture import ERRORS, FAULT, HEIGHTS, colour_bar, page


def worst_height_image(compared: Mapping[str, TopicComparison], golden: BagReader) -> tuple[str, int] | None:
    """Topic and dwell of the height image with most values beyond the tolerance; of those that differ if none is.

    None: no height image differs, or none is on both sides.
    """
    topics = {name: topic.type_name for name, topic in golden.topics.items()}
    images = {name: one for name, one in compared.items() if topics.get(name) == HEIGHT_TYPE and one.matched}
    beyond = {name: one.outside.most_common(1)[0] for name, one in images.items() if one.outside}
    if beyond:
        name = max(beyond, key=lambda topic: beyond[topic][1])
        return name, beyond[name][0]
    for name, one in images.items():
        places = [known.worst for known in one.fields.values() if known.worst]
        if places:
            return name, places[0].dwell
    return None


def draw_difference(golden: BagReader, made: BagReader, topic: str, dwell: int, path: Path) -> None:
    """Write a PNG of the first surface of an image in two bags, and of the difference of their heights.

    Pixels that have a height on one side only are marked in the difference.
    """
    sides = worst_pair(*(_heights(bag, topic, dwell) for bag in (golden, made)))
    same_shape = sides[0].shape == sides[1].shape
    known = np.concatenate([side[np.isfinite(side)] for side in sides])
    limits = Normalize(*np.percentile(known, [0.5, 99.5])) if known.size else Normalize(0, 1)
    how: dict[str, Any] = {"aspect": "auto", "interpolation": "nearest"}
    with page(path, 2.8) as figure:
        axes = figure.subplots(1, 3 if same_shape else 2)
        for axis, side, title in zip(axes, sides, ("golden", "made"), strict=False):
            shown = axis.imshow(side, HEIGHTS, limits, **how)
            axis.set(title=title, xlabel="column (along-track)", ylabel="row (range)")
        colour_bar(shown, axes[:2], "height of the first surface (m)", known)
        if same_shape:
            difference = sides[1] - sides[0]
            lone = np.where(np.isfinite(sides[0]) != np.isfinite(sides[1]), 1.0, np.nan)
            greatest = float(np.nanmax(np.abs(difference), initial=0.0)) or 1.0
            axes[2].imshow(lone, ListedColormap([FAULT]), vmin=0, vmax=1, **how)
            shown = axes[2].imshow(difference, ERRORS, vmin=-greatest, vmax=greatest, **how)
            axes[2].set(title=f"made - golden\n{FAULT}: a height on one side only", xlabel="column (along-track)")
            colour_bar(shown, axes[2], "difference (m)", difference)
        figure.suptitle(f"{topic}, dwell {dwell}")


def worst_pair(golden: dict[int, F64], made: dict[int, F64]) -> list[F64]:
    """The two images of one stamp that have most different heights; the first ones if the bags have no stamp in common.

    Args:
        golden: heights of the images of a dwell number, m, by stamp.
        made: the same of the other bag.
    """

    def differences(stamp_ns: int) -> int:
        one, other = golden[stamp_ns], made[stamp_ns]
        if one.shape != other.shape:
            return max(one.size, other.size)
        return int(np.count_nonzero(~np.isclose(one, other, rtol=0.0, atol=0.0, equal_nan=True)))

    common = [stamp_ns for stamp_ns in golden if stamp_ns in made]
    if not common:
        return [next(iter(side.values())) for side in (golden, made)]
    worst = max(common, key=differences)
    return [golden[worst], made[worst]]


def _heights(bag: BagReader, topic: str, dwell: int) -> dict[int, F64]:
    """Heights of the first surface of the dwells with a number, m, shape (rows, cols), by stamp, ns.

    They are NaN where the pixel has no surface.
    """
    decoded: Any = (bag.decode(one.type_name, one.cdr) for one in bag.messages([topic]))
    return {to_ns(image.header.stamp): _first_surface(image) for image in decoded if image.dwell == dwell}


def _first_surface(message: Any) -> F64:
    shape = message.grid.rows, message.grid.cols
    heights = np.asarray(message.surfaces[0].height, np.float64) if message.surfaces else np.zeros(0)
    return heights.reshape(shape) if heights.size == shape[0] * shape[1] else np.full(shape, np.nan)
