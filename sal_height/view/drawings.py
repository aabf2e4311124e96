"""Drawings and their times: plain arrays, which know neither messages nor the viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from sal_height.numeric import F32, U8


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
    """An image in colours.

    Attributes:
        path: name in the viewer.
        pixels: colours (red, green, blue), shape (rows, columns, 3).
    """

    path: str
    pixels: U8


@dataclass(frozen=True, eq=False)
class Classes:
    """An image of the values of `Validity`.

    Attributes:
        path: name in the viewer.
        values: values of `Validity`, shape (rows, columns).
    """

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
    """A line through positions.

    Attributes:
        path: name in the viewer.
        places: positions from the origin of the drawing, m, shape (places, 3).
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
