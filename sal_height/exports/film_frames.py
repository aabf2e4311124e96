"""Frames of a film: the clouds of more and more dwells, above what the scene truly looks like."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage

from sal_height.graph.cloud_picture import CloudView, coloured, draw_view, point_image, point_size
from sal_height.numeric import F64, U8
from sal_height.picture import HEIGHTS, colour_bar, film_page


@dataclass(frozen=True, eq=False)
class _Style:
    """Projection of the points, colours of their heights, and their size in pixels."""

    view: CloudView
    norm: Normalize
    size: int

    @classmethod
    def of_points(cls, place: F64, sight: F64) -> Self:
        view = CloudView.of_points(place, sight)
        return cls(view, Normalize(*np.percentile(place[:, 2], [1, 99])), point_size(view, place))

    def picture(self, place: F64, size: int) -> U8:
        """Picture of some points, of this size in pixels."""
        seen = self.view.inside(place)
        return point_image(self.view, seen, coloured(seen[:, 2], self.norm, HEIGHTS), size)

    def drawn(self, axes: Axes, place: F64, size: int, title: str) -> AxesImage:
        """Draw some points in their box."""
        axes.set_title(title, loc="left")
        return draw_view(axes, self.view, self.picture(place, size))


def frames_of(clouds: Sequence[F64], truth: F64 | None, sight: F64, title: str, most: int) -> Iterator[U8]:
    """Frames of the first dwells, of more of them, and at last of all: red, green and blue, shape (rows, cols, 3).

    Args:
        clouds: points of each dwell: east, north and height, m, shape (points, 3).
        truth: points of the truth, in the same way; None: unknown.
        sight: direction from the sensor to the scene, of length 1.
        title: title of the cloud.
        most: greatest number of frames; of more dwells several appear at once.
    """
    whole = np.concatenate(clouds)
    style = _Style.of_points(whole, sight)
    rows, cols = style.view.shape
    with film_page(rows / cols, panels=1 if truth is None else 2) as (figure, panels):
        grown = style.drawn(panels[0], whole, style.size, title)
        if truth is not None:
            style.drawn(panels[1], truth, 2, "truth, where it is lit")
        scale = ScalarMappable(style.norm, HEIGHTS)
        colour_bar(scale, panels, "height (m)", whole[:, 2], shrink=0.6, aspect=30, pad=0.01)
        canvas: Any = figure.canvas
        grown.set_visible(False)
        canvas.draw()
        empty = canvas.copy_from_bbox(figure.bbox)
        grown.set_visible(True)
        ends = np.unique(np.linspace(0, len(clouds), min(len(clouds), most) + 1).round().astype(int))[1:]
        for end in ends:
            canvas.restore_region(empty)
            grown.set_data(style.picture(np.concatenate(clouds[:end]), style.size))
            panels[0].draw_artist(grown)
            yield np.array(canvas.buffer_rgba())[..., :3]
