"""Drawings of messages: surfaces, their colours, the track, and the numbers of the nodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from sal_height.errors import Rejected
from sal_height.geometry import PlatformState
from sal_height.messages import (
    MAP_FRAME,
    Frames,
    complex_view,
    field_from_message,
    state_from_message,
    to_ns,
)
from sal_height.messages.types import ComplexImage, DiagnosticArray, HeightImage, Odometry
from sal_height.nodes.accounts.account import STAGE, Account
from sal_height.numeric import F32, F64
from sal_height.relief import Surface
from sal_height.view.drawings import (
    Classes,
    Cloud,
    Drawing,
    Line,
    Note,
    Number,
    Picture,
    ReceivedMessage,
    Sheet,
    Span,
    Spans,
    coloured,
)

HEIGHT_IMAGE, COMPLEX_IMAGE = "sal_height_msgs/msg/HeightImage", "sal_height_msgs/msg/ComplexImage"

ODOMETRY, DIAGNOSTICS = "nav_msgs/msg/Odometry", "diagnostic_msgs/msg/DiagnosticArray"

WORLD = "map"
"""Path under which everything with a position is."""

SERIES = {
    "offered_hz": "rates/{}/offered",
    "achieved_hz": "rates/{}/achieved",
    "latency_p50_ms": "latency/{}/p50",
    "latency_p95_ms": "latency/{}/p95",
}
"""Paths of the time series by the fields of an account; rates in dwells/s, latencies in ms."""

LOST = "drops/{}"
"""Path of the number of messages that a node has left out so far."""

TOLD = "messages/{}"
"""Path of the messages in which a node states its reasons."""

ORIGIN = "messages/origin"
"""Path of the message that states the origin of the points."""

MOST_PATHS = 1000
"""Names that time series may have: a viewer keeps each of them, and messages could bring ever new ones."""


class Track:
    """The positions of a platform that have not been drawn yet.

    Attributes:
        received_ns: time at which the last one arrived, ns since the epoch.
    """

    def __init__(self) -> None:
        self._states: list[PlatformState] = []
        self.received_ns = 0

    def add(self, state: PlatformState, received_ns: int) -> int:
        """Accept a state; the time from the first that waits to it, ns."""
        self._states.append(state)
        del self._states[:-4096]  # more would not be needed, and the oldest are dropped
        self.received_ns = received_ns
        return abs(state.stamp_ns - self._states[0].stamp_ns)

    def pieces(self) -> list[tuple[int, F64]]:
        """Stamp of the end (ns) and positions (m in map) of each part without gaps, shape (positions, 3).

        They are cut where the platform, or its clock, cannot have gone from one to the next. The last position is kept
        as the first of the next piece. About 32 positions are enough for a short piece, as a platform is inert.
        """
        states = self._states
        cuts = [i + 1 for i, (one, other) in enumerate(pairwise(states)) if not _joined(one, other)]
        parts = [states[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(states)], strict=True)]
        self._states = states[-1:]
        found = []
        for part in parts:
            if len(part) > 1:
                kept = np.unique(np.linspace(0, len(part) - 1, min(len(part), 32)).round().astype(int))
                found.append((part[-1].stamp_ns, np.array([part[i].position for i in kept])))
        return found


def _joined(one: PlatformState, other: PlatformState) -> bool:
    """True if a platform can have gone from one state to the other.

    Within 5 s it may be up to 5 m, in addition to half the path, from where the velocity of the first one leads.
    """
    step_ns = other.stamp_ns - one.stamp_ns
    way = one.velocity * step_ns * 1e-9
    off = float(np.linalg.norm(other.position - one.position - way))
    return 0 < step_ns <= 5_000_000_000 and off <= 5.0 + 0.5 * float(np.linalg.norm(way))


def is_shown(topic: str, type_name: str, namespace: str = "") -> bool:
    """True if messages of a topic are drawn.

    Args:
        topic: name, with the namespace.
        type_name: type of its messages.
        namespace: namespace of the sensors; empty: any. /diagnostics belongs to all.
    """
    if type_name == DIAGNOSTICS:
        return topic == "/diagnostics"
    if namespace and not topic.startswith(f"/{namespace.strip('/')}/"):
        return False
    return type_name in {HEIGHT_IMAGE, COMPLEX_IMAGE} or (type_name == ODOMETRY and topic.endswith("platform/odometry"))


def estimator_of(topic: str) -> str:
    """The path of an estimator, by the topic of its heights."""
    return topic.strip("/").removesuffix("/height")


@dataclass(frozen=True)
class Subject:
    """Description of all drawings so far, for the arrangement of the views.

    Attributes:
        estimators: paths of the height images, in the order of their names.
        powers: paths of the images of power.
        middle: middle of all points, m from the origin of the drawing.
        size: half the diagonal of the box around them, 0: no point has been drawn, m.
        sensor: east and north of a horizontal unit vector that leads to the sensor.
        are_wide: True if the height images have more columns than rows.
        spans: spans of the colours of heights and of sigmas; None: they still change, m.
    """

    estimators: tuple[str, ...] = ()
    powers: tuple[str, ...] = ()
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0)
    size: float = 0.0
    sensor: tuple[float, float] = (0.0, -1.0)
    are_wide: bool = False
    spans: tuple[tuple[float, float], tuple[float, float]] | None = None


@dataclass(eq=False)
class _Powers:
    """The power of the channels of a dwell that have arrived; `drawn` is the number of those that have been drawn."""

    stamp_ns: int
    received_ns: int
    total: F64
    channels: set[int] = field(default_factory=set)
    drawn: int = 0


class Painter:
    """Makes drawings of messages.

    Positions are relative to an origin near the first image, because viewers calculate in single precision. What is
    drawn of /diagnostics gets the stamp of the latest data.
    """

    def __init__(self, map_frame: str = MAP_FRAME, spans: Spans | None = None) -> None:
        """Begin without an origin.

        Args:
            map_frame: name of the frame that all positions are in.
            spans: spans of the colours; None: those of the last images.
        """
        self._map_frame = map_frame
        self._spans, self._power = spans or Spans(), Span(1.0, 99.9, images=64)
        self._origin: Any = None
        self._surfaces: dict[str, int] = {}
        self._tracks: dict[str, Track] = {}
        self._powers: dict[str, _Powers] = {}
        self._channels: dict[str, int] = {}
        self._reported: dict[str, str] = {}
        self._paths: set[str] = set()
        self._stamp_ns: int | None = None
        self._sensor, self._are_wide = (0.0, -1.0), False
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)

    @property
    def subject(self) -> Subject:
        """Description of all drawings so far."""
        spans = (self._spans.heights.ends, self._spans.sigmas.ends) if self._spans.are_settled else None
        names = Subject(tuple(sorted(self._surfaces)), tuple(sorted(self._channels)), spans=spans)
        if not np.isfinite(self._low).all():
            return names
        east, north, up = ((self._low + self._high) / 2).tolist()
        return replace(
            names,
            middle=(east, north, up),
            size=float(np.linalg.norm(self._high - self._low)) / 2,
            sensor=self._sensor,
            are_wide=self._are_wide,
        )

    def paint(self, received: ReceivedMessage, message: Any) -> list[Sheet]:
        """Drawings of a decoded message, which may be empty at first.

        Raises:
            Rejected: it cannot be used.
        """
        paint: Callable[[str, Any, int], Iterator[Sheet]] = {
            HEIGHT_IMAGE: self._paint_heights,
            COMPLEX_IMAGE: self._paint_power,
            ODOMETRY: self._paint_track,
            DIAGNOSTICS: self._paint_accounts,
        }[received.type_name]
        return list(paint(received.topic.strip("/"), message, received.received_ns))

    def finish(self) -> list[Sheet]:
        """The remaining drawings if no more messages arrive, or for a while."""
        sheets = [sheet for path in list(self._powers) for sheet in self._finish_power(path)]
        return [*sheets, *self._finish_tracks()]

    def _paint_heights(self, topic: str, image: HeightImage, received_ns: int) -> Iterator[Sheet]:
        field, path = field_from_message(image, self._map_frame), estimator_of(topic)
        there = field.first.is_determined
        notes = self._settle(field.first.positions[there].mean(axis=0) if there.any() else field.grid.origin)
        self._stamp_ns = to_ns(image.header.stamp)
        if not self._spans.are_settled:
            self._spans.add(field)
        self._are_wide = field.grid.cols > field.grid.rows
        east, north, _ = field.grid.row_direction.tolist()
        if away := math.hypot(east, north):
            self._sensor = -east / away, -north / away
        self._surfaces[path] = max(len(field.surfaces), self._surfaces.get(path, 0))
        # In diagonals of a pixel: points of a closed surface nearly touch.
        radius = 0.4 * float(np.hypot(field.grid.row_spacing, field.grid.col_spacing))
        names = [f"{WORLD}/{path}/surface_{number + 1}" for number in range(self._surfaces[path])]
        clouds = [self._cloud(name, one, radius) for name, one in zip(names, field.surfaces, strict=False)]
        clouds += [_no_cloud(name) for name in names[len(clouds) :]]  # or the viewer would keep those of another dwell
        drawings: list[Drawing] = [
            Picture(f"{path}/height", coloured(field.first.height, self._spans.heights.ends, "viridis")),
            Picture(f"{path}/sigma", coloured(field.first.sigma, self._spans.sigmas.ends, "viridis")),
            Classes(f"{path}/validity", field.validity),
            *clouds,
            *notes,
        ]
        yield from self._finish_tracks()
        yield Sheet(self._stamp_ns, received_ns, tuple(drawings))

    def _cloud(self, path: str, surface: Surface, radius: float) -> Cloud:
        """The points of a surface, in the colours of their heights."""
        there = surface.is_determined
        places = self._placed(surface.positions[there])
        if len(places):
            self._low = np.minimum(self._low, places.min(axis=0))
            self._high = np.maximum(self._high, places.max(axis=0))
        height, sigma = surface.height[there], surface.sigma[there]
        colours = coloured(height, self._spans.heights.ends, "viridis")
        return Cloud(path, places, colours, height.astype(np.float32), sigma.astype(np.float32), radius)

    def _paint_power(self, topic: str, image: ComplexImage, received_ns: int) -> Iterator[Sheet]:
        where = f"ComplexImage of dwell {image.dwell}, channel {image.channel}"
        if image.header.frame_id != self._map_frame:
            raise Rejected(
                "wrong frames", f"{where} is in {image.header.frame_id!r}; it must be in {self._map_frame!r}."
            )
        shape = image.grid.rows, image.grid.cols
        count = 2 * shape[0] * shape[1]
        if len(image.samples) != count or count == 0:
            raise Rejected(
                "wrong size",
                f"{where}: samples has {len(image.samples)} entries, {shape[0]} x {shape[1]} complex pixels need "
                f"{count}.",
            )
        samples = complex_view(image.samples, shape).astype(np.complex128)
        power, stamp_ns = samples.real**2 + samples.imag**2, to_ns(image.header.stamp)
        collected = self._powers.get(topic)
        if collected and (
            collected.stamp_ns != stamp_ns or collected.total.shape != shape or image.channel in collected.channels
        ):
            yield from self._finish_power(topic)
            collected = None
        if collected is None:
            collected = self._powers[topic] = _Powers(stamp_ns, received_ns, np.zeros(shape))
        collected.total += power
        collected.channels.add(image.channel)
        if len(collected.channels) >= self._channels.get(topic, math.inf):
            yield self._power_sheet(topic, collected)

    def _finish_power(self, topic: str) -> Iterator[Sheet]:
        """The mean power of the channels that have arrived, unless it has been drawn: no more are expected."""
        collected = self._powers.pop(topic)
        if collected.drawn < len(collected.channels):
            yield self._power_sheet(topic, collected)

    def _power_sheet(self, topic: str, collected: _Powers) -> Sheet:
        """The mean power of the channels that have arrived, in dB; the next dwell is drawn when it has as many."""
        collected.drawn = len(collected.channels)
        self._channels[topic] = max(collected.drawn, self._channels.get(topic, 0))
        mean = collected.total / collected.drawn
        decibels = 10 * np.log10(np.maximum(mean, 1e-30))  # -300 dB stands for no power at all
        self._power.add(decibels[mean > 0])
        self._stamp_ns = collected.stamp_ns
        picture = Picture(f"{topic}/power", coloured(decibels, self._power.ends, "gray"))
        return Sheet(collected.stamp_ns, collected.received_ns, (picture,))

    def _paint_track(self, topic: str, message: Odometry, received_ns: int) -> Iterator[Sheet]:
        state = state_from_message(message, Frames(self._map_frame, message.child_frame_id))
        track = self._tracks.setdefault(topic.removesuffix("/odometry"), Track())
        waits_ns = track.add(state, received_ns)
        # The first height image, near which the origin is then, is waited for during 5 s of track.
        if waits_ns >= (200_000_000 if self._origin is not None else 5_000_000_000):
            yield from self._finish_tracks()

    def _finish_tracks(self) -> Iterator[Sheet]:
        """The pieces of the tracks that have not been drawn yet."""
        for path, track in self._tracks.items():
            for stamp_ns, places in track.pieces():
                notes = self._settle(places[0] * [1.0, 1.0, 0.0])
                line = Line(f"{WORLD}/{path}/track", self._placed(places))
                yield Sheet(stamp_ns, track.received_ns, (line, *notes))

    def _paint_accounts(self, _: str, message: DiagnosticArray, received_ns: int) -> Iterator[Sheet]:
        """The numbers of the nodes that process dwells, and why they left out messages."""
        drawings: list[Drawing] = []
        notes: dict[str, str] = {}
        for status in message.status:
            account = Account.of_status(status)
            if account.kind != STAGE:
                continue
            node, numbers = status.name, {name: getattr(account, name) for name in SERIES}
            known = {name: number for name, number in numbers.items() if math.isfinite(number)}
            drawings += [Number(SERIES[name].format(node), number) for name, number in known.items()]
            drawings.append(Number(LOST.format(node), float(sum(account.dropped.values()))))
            if account.last_drop and account.last_drop != self._reported.get(node):
                notes[node] = account.last_drop
                drawings.append(Note(TOLD.format(node), account.last_drop))
        if drawings:
            self._check_names(drawings)
            self._reported |= notes
            yield Sheet(self._stamp_ns, received_ns, tuple(drawings))

    def _settle(self, near: F64) -> list[Drawing]:
        """Choose the origin near a position in map, unless it has been chosen, and add a note of it."""
        if self._origin is not None:
            return []
        self._origin = np.round(near)
        east, north, up = self._origin
        return [
            Note(ORIGIN, f"The origin of the points is {east:.0f} m east, {north:.0f} m north, {up:.0f} m up in map.")
        ]

    def _placed(self, positions: F64) -> F32:
        """Positions in map relative to the origin, which has been chosen, in single precision."""
        return (positions - self._origin).astype(np.float32)

    def _check_names(self, drawings: Sequence[Drawing]) -> None:
        """Remember the names of drawings.

        Raises:
            Rejected: there are more than MOST_PATHS names, including these.
        """
        paths = self._paths.union(drawing.path for drawing in drawings)
        if len(paths) > MOST_PATHS:
            raise Rejected("too many names", f"There are more than {MOST_PATHS} time series of nodes to be drawn.")
        self._paths = paths


def _no_cloud(path: str) -> Cloud:
    """A cloud without points."""
    none = np.empty((0, 3), np.float32)
    return Cloud(path, none, none.astype(np.uint8), none[:, 0], none[:, 0], 0.0)
