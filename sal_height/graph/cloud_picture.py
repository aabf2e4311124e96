"""Point clouds in pictures: seen from the side of the sensor, in a box with axes, scale bar and line of sight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from scipy.spatial import cKDTree

from sal_height.numeric import F64, U8
from sal_height.picture import LEAST_POINTS

AZIMUTH, TILT = np.radians(18.0), np.radians(38.0)
"""Direction from which a cloud is seen: clockwise from the sensor's side, and above the horizon, rad."""

COLUMNS = 1400
"""Pixels of a picture of points in a row."""

LINES: dict[str, Any] = {"color": "0.45", "lw": 0.5}
LETTERS: dict[str, Any] = {"fontsize": LEAST_POINTS, "ha": "center", "va": "center"}


@dataclass(frozen=True, eq=False)
class CloudView:
    """Parallel projection of a box of points onto the page.

    Attributes:
        sight: direction from the sensor to the scene, of length 1: east, north, up.
        lower: lowest east, north and height of the box, m.
        upper: greatest east, north and height of the box, m.
        stretch: factor by which heights are drawn larger than distances on the ground.
    """

    sight: F64
    lower: F64
    upper: F64
    stretch: float

    @classmethod
    def of_points(cls, place: F64, sight: F64) -> Self:
        """View of nearly all of some points (east, north and height, m), shape (points, 3)."""
        lower, upper = np.percentile(place, [0.2, 99.8], axis=0)
        size = np.maximum(upper - lower, 1e-3)
        flat = 0.06  # least ratio of height to width in a picture that shows a relief
        stretch = max(1.0, float(np.round(flat * max(size[:2]) / size[2])))
        margin = size * np.array([0.02, 0.02, 0.05])
        return cls(sight, lower - margin, upper + margin, stretch)

    def inside(self, place: F64) -> F64:
        """Those of some points that are in the box, shape (points, 3)."""
        return np.asarray(place[np.all((place >= self.lower) & (place <= self.upper), axis=1)])

    def projected(self, place: F64) -> F64:
        """Positions on the page: to the right, upwards, and away from the viewer, m, shape (3, points)."""
        away = self.sight[:2] / np.hypot(*self.sight[:2])
        towards_east = -np.cos(AZIMUTH) * away[0] - np.sin(AZIMUTH) * away[1]
        towards_north = np.sin(AZIMUTH) * away[0] - np.cos(AZIMUTH) * away[1]
        east, north, up = np.asarray(place).T
        up = self.stretch * up
        towards = towards_east * east + towards_north * north
        right = -towards_north * east + towards_east * north
        upwards = np.cos(TILT) * up - np.sin(TILT) * towards
        return np.stack([right, upwards, -np.cos(TILT) * towards - np.sin(TILT) * up])

    @property
    def corners(self) -> F64:
        """The eight corners of the box, m, by the end in east, north and height, shape (2, 2, 2, 3)."""
        ends = np.stack([self.lower, self.upper]).T
        return np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1)

    @property
    def page(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper edge of the page, m, with room for the axes of the box."""
        right, up, _ = self.projected(self.corners.reshape(-1, 3))
        room = 0.08 * np.ptp(right)
        return right.min() - room, right.max() + room, up.min() - room, up.max() + 0.3 * room

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of pictures of points."""
        left, right, bottom, top = self.page
        return max(1, round(COLUMNS * (top - bottom) / (right - left))), COLUMNS


def point_size(view: CloudView, place: F64) -> int:
    """Width in pixels at which the points of a closed surface touch."""
    apart, _ = cKDTree(place[:, :2]).query(place[:, :2], k=[min(5, len(place))])
    left, right, *_ = view.page
    return int(np.clip(np.ceil(np.median(apart[:, -1]) / (right - left) * COLUMNS), 1, 24))


def point_image(view: CloudView, place: F64, colours: F64, size: int) -> U8:
    """Picture of points, darker the farther they are behind what is next to them on the page.

    The shading is that of eye-dome lighting: C. Boucheny, PhD thesis, Université Joseph Fourier, 2009, section 4.

    Args:
        view: projection of the points.
        place: east, north and height, m, shape (points, 3).
        colours: red, green and blue from 0 to 1, shape (points, 3).
        size: width of a point, pixels.

    Returns:
        Red, green, blue and opacity, row 0 the lowest, shape (*view.shape, 4).
    """
    rows, cols = view.shape
    left, right, bottom, top = view.page
    across, up, depth = view.projected(place)
    steps = np.arange(size) - size // 2
    col = np.floor((across - left) / (right - left) * cols).astype(int)[:, None, None] + steps
    row = np.floor((up - bottom) / (top - bottom) * rows).astype(int)[:, None, None] + steps[:, None]
    point = np.broadcast_to(np.arange(len(place))[:, None, None], np.broadcast_shapes(row.shape, col.shape))
    row, col = np.broadcast_arrays(row, col)
    shown = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col, point = row[shown], col[shown], point[shown]
    order = np.argsort(-depth[point], kind="stable")  # the nearest last, which so hides those behind it
    nearest = np.full((rows, cols), -1)
    nearest[row[order], col[order]] = point[order]
    drawn = nearest >= 0
    picture = np.zeros((rows, cols, 4), np.uint8)
    behind = np.where(drawn, depth[nearest], np.inf)
    shade = _shade(behind, (right - left) / cols, max(2, size // 2))
    picture[..., :3] = np.where(drawn[..., None], 255 * colours[nearest] * shade[..., None], 255)
    picture[..., 3] = 255 * drawn
    return picture


def _shade(depth: F64, pixel: float, reach: int) -> F64:
    """Brightness from 0.35 to 1 of pixels at these depths (m; inf: empty) by the eight pixels at a distance `reach`.

    A level surface and one that faces the viewer have nearly the same: a pixel that is farther than its neighbours by
    what a slope of the tilt explains is not darkened.
    """
    padded = np.pad(depth, reach, constant_values=np.inf)
    rows, cols = depth.shape
    hidden = np.zeros_like(depth)
    explained = reach * pixel / np.tan(TILT)
    for down in (0, reach, 2 * reach):
        for along in (0, reach, 2 * reach):
            neighbour = padded[down : down + rows, along : along + cols]
            with np.errstate(invalid="ignore"):
                ahead = np.nan_to_num(depth - neighbour, nan=0.0, posinf=0.0, neginf=0.0) - explained
            hidden += np.clip(ahead / (12 * pixel), 0.0, 1.0)
    return np.asarray(0.35 + 0.65 * np.exp(-hidden / 1.5))


def coloured(values: F64, norm: Normalize, colours: str) -> F64:
    """Red, green and blue of some values in a scale of colours, from 0 to 1, shape (points, 3)."""
    return np.asarray(mpl.colormaps[colours](norm(values)))[:, :3]


def draw_view(axes: Axes, view: CloudView, picture: U8) -> AxesImage:
    """Draw a picture of points in its box, with ticks, a scale bar and the direction of the line of sight."""
    left, right, bottom, top = view.page
    _draw_box(axes, view)
    shown = axes.imshow(picture, extent=(left, right, bottom, top), origin="lower", interpolation="none", zorder=2)
    _draw_scale_bar(axes, view)
    _draw_sight(axes, view)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    return shown


def _draw_box(axes: Axes, view: CloudView) -> None:
    """Draw the floor and the back of the box, with ticks and names on the edges next to the viewer."""
    corners = view.corners
    _, _, depth = view.projected(corners[:, :, 0].reshape(-1, 3)).reshape(3, 2, 2)
    near_north = int(depth[0, 1] < depth[0, 0])  # end of north that is next to the viewer
    near_east = int(depth[1, 0] < depth[0, 0])
    floor = corners[:, :, 0][[0, 0, 1, 1, 0], [0, 1, 1, 0, 0]]
    back = [corners[near_east, 1 - near_north], corners[1 - near_east, 1 - near_north]]
    back.append(corners[1 - near_east, near_north])
    top = np.stack([pillar[1] for pillar in back])
    for line in (floor, top, *back):
        axes.plot(*view.projected(line)[:2], **LINES, zorder=1)
    _draw_ticks(axes, view, corners[:, near_north, 0], 0, "east (m)")
    _draw_ticks(axes, view, corners[near_east, :, 0], 1, "north (m)")
    name = "height (m)" if view.stretch == 1 else f"height × {view.stretch:g} (m)"
    _draw_ticks(axes, view, corners[1 - near_east, near_north], 2, name)


def _draw_ticks(axes: Axes, view: CloudView, edge: F64, axis: int, name: str) -> None:
    """Draw numbers and a name outside an edge of the box, from `edge[0]` to `edge[1]`, along one of its axes."""
    low, high = sorted(edge[:, axis])
    span = view.projected(edge)[:2]
    length = np.hypot(*np.ptp(span, axis=1)) / np.ptp(view.page[:2])
    values = MaxNLocator(max(2, min(8, int(length * 12)))).tick_values(low, high)
    values = values[(values >= low) & (values <= high)]
    places = np.repeat(edge[:1], len(values), axis=0)
    places[:, axis] = values
    middle = view.projected(view.corners.reshape(-1, 3))[:2].mean(axis=1)
    outwards = np.array([-1.0, 1.0])[:, None] * (span[::-1, 1:] - span[::-1, :1])
    outwards = outwards / np.hypot(*outwards)
    outwards *= np.sign(np.sum(outwards * (span.mean(axis=1) - middle)[:, None]))
    for (across, up), value in zip(view.projected(places)[:2].T, values, strict=True):
        _write(axes, (across, up), f"{value:g}", 8.0 * outwards[:, 0])
        tick = {"arrowstyle": "-", "shrinkA": 0, "shrinkB": 0, **LINES}
        axes.annotate("", (across, up), tuple(3.0 * outwards[:, 0]), textcoords="offset points", arrowprops=tick)
    turn = np.degrees(np.arctan2(*(span[::-1, 1] - span[::-1, 0])))
    _write(axes, span.mean(axis=1), name, 17.0 * outwards[:, 0], rotation=(turn + 90) % 180 - 90)


def _write(axes: Axes, place: Sequence[float] | F64, text: str, offset: Sequence[float] | F64, **how: Any) -> None:
    """Write small letters at an offset, points, from a place on the page, m."""
    axes.annotate(text, (place[0], place[1]), (offset[0], offset[1]), textcoords="offset points", **LETTERS, **how)


def _draw_scale_bar(axes: Axes, view: CloudView) -> None:
    """Draw a bar of a round length; distances to the right are true in this projection."""
    left, right, bottom, _ = view.page
    most = 0.16 * (right - left)
    length = max(step for step in np.outer(10.0 ** np.arange(-3, 6), (1, 2, 5)).ravel() if step <= most)
    start, level = left + 0.02 * (right - left), bottom + 0.03 * (right - left)
    axes.plot([start, start + length], [level, level], color="k", lw=2.0, solid_capstyle="butt", zorder=3)
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    _write(axes, (start + length / 2, level), text, (0.0, 5.0))


def _draw_sight(axes: Axes, view: CloudView) -> None:
    """Draw the line of sight of the sensor as an arrow in the corner that the box leaves free."""
    left, right, bottom, _ = view.page
    across, up, _ = view.projected(np.stack([np.zeros(3), view.sight]))[:, 1]
    along = 0.07 * (right - left) * np.array([across, up]) / np.hypot(across, up)
    head = np.array([right - 0.12 * (right - left), bottom + 0.05 * (right - left)])
    where: dict[str, Any] = {"arrowstyle": "-|>", "color": "k", "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tuple(head), tuple(head - along), arrowprops=where, zorder=3)
    _write(axes, head, "line of sight", (0.0, -7.0))
