"""Drawings, their times and colours: plain arrays, which know neither messages nor the viewer."""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from sal_height.elevation import Validity
from sal_height.numeric import F32, U8
from sal_height.relief import HeightField

EMPTY = (18, 20, 24)
"""Red, green and blue of pixels without a value, and behind the points."""

VALIDITY_COLOURS = {
    Validity.OK: (48, 160, 80),
    Validity.TWO_SCATTERERS: (60, 190, 210),
    Validity.THREE_SCATTERERS: (40, 110, 220),
    Validity.EXTENDED: (150, 205, 90),
    Validity.INTERPOLATED: (225, 205, 80),
    Validity.LOW_CNR: (70, 70, 80),
    Validity.NO_SIGNAL: (30, 30, 38),
    Validity.OUTSIDE_ARRAY: (110, 95, 85),
    Validity.OUTSIDE_PAIR: (135, 115, 100),
    Validity.NOT_ONE_SCATTERER: (215, 80, 60),
    Validity.MISSING_DATA: (120, 0, 20),
    Validity.AMBIGUOUS: (200, 90, 190),
    Validity.SATURATED: (255, 150, 40),
    Validity.IMPRECISE: (120, 80, 150),
    Validity.NO_GROUND: (90, 60, 40),
}
"""Red, green and blue: green and blue where there is a measurement, the more scatterers the bluer; yellow between
measurements; grey where there is too little signal; red and violet where a measurement cannot be used."""


class Span:
    """The values that colours stand for: those of the last images but for the outermost, so that none decides alone.

    Attributes:
        ends: lowest and highest value, which differ.
    """

    def __init__(self, low: float, high: float, images: int) -> None:
        """Look at the percentiles `low` and `high` of that many images."""
        self._percentiles = low, high
        self._ends: deque[tuple[float, float]] = deque(maxlen=images)
        self.ends = 0.0, 1.0

    def add(self, values: npt.NDArray[np.floating]) -> None:
        """Look at an image, of any shape; values that are not finite do not count."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return
        most = 20_000  # numbers; more would not change percentiles by more than a colour
        first, last = np.percentile(finite[:: 1 + finite.size // most], self._percentiles)
        self._ends.append((float(first), float(last)))
        low, high = min(one for one, _ in self._ends), max(other for _, other in self._ends)
        wider = 0.0 if high > low else max(0.5, abs(low))
        self.ends = low - wider, high + wider


class Spans:
    """Spans of the colours of heights and of their sigmas.

    Attributes:
        heights: span of the heights, m.
        sigmas: span of the sigmas, m.
        are_settled: True if images that are drawn do not change them any more.
    """

    def __init__(self, images: int = 64) -> None:
        """Look at the last surfaces, that many."""
        self.heights, self.sigmas = Span(0.5, 99.5, images), Span(0.0, 95.0, images)
        self.are_settled = False

    def add(self, field: HeightField) -> None:
        """Look at a height image."""
        for surface in field.surfaces:
            self.heights.add(surface.height)
        self.sigmas.add(field.first.sigma)


@functools.cache
def _table(name: str) -> U8:
    """A colour map of Matplotlib, shape (256, 3)."""
    import matplotlib as mpl  # noqa: PLC0415 (slow)

    return np.round(255 * mpl.colormaps[name](np.arange(256))[:, :3]).astype(np.uint8)


def coloured(values: npt.NDArray[np.floating], span: tuple[float, float], name: str) -> U8:
    """Red, green and blue of values, EMPTY where they are not finite: their shape with one more axis of 3.

    Args:
        values: values, any shape.
        span: values of the first and the last colour.
        name: name of a colour map of Matplotlib, such as "viridis".
    """
    low, high = span
    there = np.isfinite(values)
    share = np.clip((np.where(there, values, low) - low) / (high - low), 0.0, 1.0)
    colours = _table(name)[np.round(255 * share).astype(np.intp)]
    colours[~there] = EMPTY
    return colours


class ReceivedMessage(NamedTuple):
    """A message that has arrived, not decoded yet.

    Attributes:
        topic: topic, with the namespace.
        type_name: type, such as "sal_height_msgs/msg/HeightImage".
        received_ns: time at which it was received, or recorded, ns since the epoch.
        read: function that decodes it, and raises an error of any class if it cannot be decoded.
    """

    topic: str
    type_name: str
    received_ns: int
    read: Callable[[], Any]


@dataclass(frozen=True, eq=False)
class Picture:
    """An image: its name in the viewer, and colours (red, green, blue), shape (rows, columns, 3)."""

    path: str
    pixels: U8


@dataclass(frozen=True, eq=False)
class Classes:
    """An image: its name in the viewer, and values of `Validity`, shape (rows, columns)."""

    path: str
    values: U8


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a surface.

    Attributes:
        path: name in the viewer.
        places: positions from the origin of the drawing, m, shape (points, 3).
        colours: colours (red, green, blue), shape (points, 3).
        height: height above the sphere, m, shape (points,).
        sigma: standard deviation of height, m, shape (points,).
        radius: radius of the points, m.
    """

    path: str
    places: F32
    colours: U8
    height: F32
    sigma: F32
    radius: float


@dataclass(frozen=True, eq=False)
class Line:
    """A line: its name in the viewer, and positions from the origin of the drawing, m, shape (positions, 3)."""

    path: str
    places: F32


@dataclass(frozen=True)
class Number:
    """A value of a time series, whose name in the viewer is `path`."""

    path: str
    value: float


@dataclass(frozen=True)
class Note:
    """A message for the user, in the log of that `path`."""

    path: str
    text: str


Drawing: TypeAlias = Picture | Classes | Cloud | Line | Number | Note


class Sheet(NamedTuple):
    """Drawings of one time.

    Attributes:
        stamp_ns: time of the sensor, None: not known, ns since the epoch.
        received_ns: time at which their message arrived, ns since the epoch.
        drawings: drawings.
    """

    stamp_ns: int | None
    received_ns: int
    drawings: tuple[Drawing, ...]
