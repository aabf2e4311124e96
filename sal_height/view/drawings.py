"""What can be drawn, and when: plain arrays, which know neither messages nor the viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from sal_height.numeric import F32, U8


class Heard(NamedTuple):
    """A message that has come, not decoded yet.

    Attributes:
        topic: its topic, with the namespace.
        type_name: its type, such as "sal_height_msgs/msg/HeightImage".
        heard_ns: when it was received, or recorded, ns since the epoch.
        read: decodes it; raises an error of any class if it cannot be decoded.
    """

    topic: str
    type_name: str
    heard_ns: int
    read: Callable[[], Any]


@dataclass(frozen=True, eq=False)
class Picture:
    """An image in colours.

    Attributes:
        path: its name in the viewer.
        pixels: red, green and blue, shape (rows, columns, 3).
    """

    path: str
    pixels: U8


@dataclass(frozen=True, eq=False)
class Classes:
    """An image of the values of `Validity`.

    Attributes:
        path: its name in the viewer.
        values: shape (rows, columns).
    """

    path: str
    values: U8


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a surface.

    Attributes:
        path: their name in the viewer.
        places: shape (points, 3), m from the origin of the drawing.
        colours: red, green and blue, shape (points, 3).
        height: above the sphere, m, shape (points,).
        sigma: standard deviation of height, m, shape (points,).
        radius: of the points, m.
    """

    path: str
    places: F32
    colours: U8
    height: F32
    sigma: F32
    radius: float


@dataclass(frozen=True, eq=False)
class Line:
    """A line through places.

    Attributes:
        path: its name in the viewer.
        places: shape (places, 3), m from the origin of the drawing.
    """

    path: str
    places: F32


@dataclass(frozen=True)
class Number:
    """A value of a time series, whose name in the viewer is `path`."""

    path: str
    value: float


@dataclass(frozen=True)
class Note:
    """A sentence for the user, in the log of that `path`."""

    path: str
    text: str


Drawing: TypeAlias = Picture | Classes | Cloud | Line | Number | Note


class Sheet(NamedTuple):
    """Drawings of one time.

    Attributes:
        stamp_ns: the sensor's time, ns since the epoch; None: not known.
        heard_ns: when the message came that they are made of, ns since the epoch.
        drawings: what is drawn.
    """

    stamp_ns: int | None
    heard_ns: int
    drawings: tuple[Drawing, ...]
