"""The Rerun viewer: what is drawn goes to a window, to a browser or into a file."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.elevation import Validity
from sal_height.errors import UserError
from sal_height.io import writing
from sal_height.view.drawings import (
    EMPTY,
    VALIDITY_COLOURS,
    Classes,
    Cloud,
    Drawing,
    Line,
    Note,
    Number,
    Picture,
    Sheet,
)
from sal_height.view.painter import WORLD, Subject
from sal_height.view.viewer import Viewer, open_window, serve_page

BEST_FIRST = ("tracked", "adjusted", "ml", "capon", "music", "canopy_ground", "sum_difference", "monopulse")
"""Estimators in the order in which their tabs stand; the first one that is there is shown."""

EYE = np.radians(30.0), np.radians(35.0)
"""Direction from which the points are seen: angle from that of the sensor, and above the horizon, rad."""

VERSION = "0.41"
"""Version of Rerun, whose interface changes from one version to the next."""

STAMP, CLOCK = "stamp", "clock"
"""Timelines: the time of the sensor, and that at which messages arrived."""

STUCK_S, LOOK_S = 30.0, 0.5
"""A viewer that takes nothing for so long is ended."""

HAND_OVER_S = 60.0
"""Longest time that what was drawn last takes to the viewer."""


def blueprint(subject: Subject, history_s: float) -> Any:
    """The arrangement of the views for what has been drawn.

    Args:
        subject: description of all drawings.
        history_s: seconds before the time shown whose points are seen; infinity: all.
    """
    import rerun.blueprint as rrb  # noqa: PLC0415 (slow, and optional)

    estimators = sorted(subject.estimators, key=_rank)
    tabs = [_of_estimator(rrb, path, subject, history_s) for path in estimators]
    above: Any = rrb.Tabs(*tabs, active_tab=0) if tabs else _points(rrb, WORLD, WORLD, subject, history_s)
    below = rrb.Horizontal(
        rrb.TimeSeriesView(name="dwells offered and achieved (1/s)", origin="/rates"),
        rrb.TimeSeriesView(name="latency (ms)", origin="/latency"),
        rrb.Tabs(
            rrb.TimeSeriesView(name="messages left out", origin="/drops"),
            rrb.TextLogView(name="why", origin="/messages"),
            active_tab=0,
        ),
    )
    return rrb.Blueprint(
        rrb.Vertical(above, below, row_shares=[3, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="stamp", play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def _rank(path: str) -> tuple[int, str]:
    name = path.rpartition("/")[2]
    return (BEST_FIRST.index(name) if name in BEST_FIRST else len(BEST_FIRST)), path


def _of_estimator(rrb: Any, path: str, subject: Subject, history_s: float) -> Any:
    """The points of an estimator next to its images, and the images of power."""
    images = [f"{path}/{name}" for name in ("height", "sigma", "validity")]
    images += [f"{power}/power" for power in subject.powers if _namespace(power) == _namespace(path)]
    views = [rrb.Spatial2DView(name=i.rpartition("/")[2], origin=f"/{i}", background=EMPTY) for i in images]
    images_view = rrb.Vertical(*views) if subject.are_wide else rrb.Horizontal(*views)
    title = "height and sigma"
    if subject.spans:
        heights, sigmas = map(_range_text, subject.spans)
        title = f"height in colours from {heights}; sigma from {sigmas}"
    points = _points(rrb, f"{WORLD}/{path}", title, subject, history_s)
    return rrb.Horizontal(points, images_view, column_shares=[3, 2], name=path)


def _range_text(span: tuple[float, float]) -> str:
    """A span as the title of a view says it."""
    low, high = span
    digits = max(0, 2 - math.floor(math.log10(high - low)))
    return f"{low:.{digits}f} to {high:.{digits}f} m"


def _points(rrb: Any, path: str, name: str, subject: Subject, history_s: float) -> Any:
    """The points of an estimator, and all tracks."""
    import rerun as rr  # noqa: PLC0415 (slow, and optional)

    begin = (
        rr.TimeRangeBoundary.cursor_relative(seconds=-history_s)
        if math.isfinite(history_s)
        else rr.TimeRangeBoundary.infinite()
    )
    seen = [
        rrb.VisibleTimeRange(timeline, start=begin, end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0))
        for timeline in ("stamp", "clock")
    ]
    tracks = sorted({f"/{WORLD}/{_platform(estimator)}/**" for estimator in subject.estimators} or {f"/{WORLD}/**"})
    return rrb.Spatial3DView(
        name=name,
        origin=f"/{WORLD}",
        contents=[f"/{path}/**", *tracks],
        time_ranges=seen,
        background=EMPTY,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=_eye(rrb, subject) if subject.size else None,
    )


def _eye(rrb: Any, subject: Subject) -> Any:
    """The position from which all points are seen, at 2.1 times half the diagonal of their box."""
    middle, (east, north), (aside, above) = np.array(subject.middle), subject.sensor, EYE
    level = [np.cos(aside) * east - np.sin(aside) * north, np.sin(aside) * east + np.cos(aside) * north]
    towards = np.array([*np.multiply(np.cos(above), level), np.sin(above)])
    position = middle + 2.1 * subject.size * towards
    return rrb.EyeControls3D(position=position, look_target=middle, eye_up=(0.0, 0.0, 1.0))


def _namespace(path: str) -> str:
    """The part of a path before its last name."""
    return path.rpartition("/")[0]


def _platform(path: str) -> str:
    """Path of the platform in the namespace of an estimator."""
    return f"{_namespace(path)}/platform".strip("/")


def rerun() -> Any:
    """The package of the viewer, which takes half a second to import.

    Raises:
        UserError: it is not installed.
    """
    try:
        import rerun as package  # noqa: PLC0415 (slow, and optional)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in {"rerun", "rerun_bindings", "pyarrow"}:
            raise
        raise UserError(
            f"Command view needs the Python module {error.name}, which is not installed; install the Rerun viewer "
            f'with: pip install "rerun-sdk~={VERSION}.0".'
        ) from error
    return package


class Screen:
    """A recording in the viewer, to which drawings are added.

    Attributes:
        recording: recording of the package of the viewer.
        is_open: function that is True while somebody may still look at it.
        page: address for browsers; empty: it is no page.
    """

    def __init__(self, name: str, history_s: float) -> None:
        """Begin an empty recording.

        Args:
            name: name in the list of the viewer.
            history_s: seconds before the time shown whose points are seen; infinity: all.

        Raises:
            UserError: Rerun is not installed.
        """
        self._rr = rerun()
        self._history_s = history_s
        self.is_open: Callable[[], bool] = lambda: True
        self.page = ""
        self._waiting_since: float | None = None
        self.recording = self._rr.RecordingStream("sal_height", send_properties=True)
        self.recording.set_log_time_enabled(False)
        self.recording.send_recording_name(name)

    def begin(self) -> None:
        """Log properties that do not change."""
        rr = self._rr
        classes = [(int(v), v.name.lower().replace("_", " "), VALIDITY_COLOURS[v]) for v in Validity]
        self.recording.log("/", rr.AnnotationContext(classes), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def show(self, sheet: Sheet) -> None:
        """Add drawings; it waits while the viewer has too much to take."""
        with self._waiting():
            self.recording.reset_time()
            if sheet.stamp_ns is not None:
                self.recording.set_time(STAMP, timestamp=np.datetime64(sheet.stamp_ns, "ns"))
            self.recording.set_time(CLOCK, timestamp=np.datetime64(sheet.received_ns, "ns"))
            for drawing in sheet.drawings:
                parts = [part for part in drawing.path.split("/") if part]  # names of others may have empty ones
                self.recording.log(parts, *self._parts(drawing))

    def waits_s(self) -> float:
        """For how long the viewer has been waited for, s."""
        since = self._waiting_since
        return 0.0 if since is None else time.monotonic() - since

    def disconnect(self) -> None:
        """End the recording."""
        with self._waiting():
            self.recording.disconnect()

    @contextmanager
    def _waiting(self) -> Iterator[None]:
        self._waiting_since = time.monotonic()
        try:
            yield
        finally:
            self._waiting_since = None

    def arrange(self, subject: Subject) -> None:
        """Arrange the views for what has been drawn."""
        self.recording.send_blueprint(blueprint(subject, self._history_s))

    def hand_over(self) -> None:
        """Wait until the viewer has received all, but not for one that has been closed."""
        with suppress(RuntimeError):
            self.recording.flush(timeout_sec=HAND_OVER_S)

    def _parts(self, drawing: Drawing) -> tuple[Any, ...]:
        """Archetypes of the package of the viewer, which make one entity."""
        rr = self._rr
        match drawing:
            case Picture():
                return (rr.Image(drawing.pixels),)
            case Classes():
                return (rr.SegmentationImage(drawing.values),)
            case Cloud():
                how = {"radii": [drawing.radius], "point_shading": rr.components.PointShading.Flat}
                points = rr.Points3D(drawing.places, colors=drawing.colours, **how)
                return points, rr.AnyValues(height_m=drawing.height, sigma_m=drawing.sigma)
            case Line():
                width = rr.Radius.ui_points(1.5)
                return (rr.LineStrips3D([drawing.places], colors=[(255, 255, 255)], radii=[width]),)
            case Number():
                return (rr.Scalars([drawing.value]),)
            case Note():
                return (rr.TextLog(drawing.text, level="WARN"),)


@contextmanager
def file_screen(path: Path, name: str, history_s: float) -> Iterator[Screen]:
    """A recording that is a file, which has its name once it is complete; `name` and `history_s` as of `Screen`.

    Raises:
        UserError: Rerun is not installed, or the file exists or cannot be written.
    """
    screen = Screen(name, history_s)
    if path.exists():
        raise UserError(f"File {path} exists already; name another with --save, or remove it.")
    unfinished = path.with_name(f".{path.name}.part")
    with writing(path):
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        unfinished.touch()  # the viewer's package would not report the reason
    try:
        screen.recording.save(unfinished)
        screen.begin()
        yield screen
        screen.recording.flush(timeout_sec=HAND_OVER_S)
        screen.recording.disconnect()
        with writing(path):
            unfinished.replace(path)
    except BaseException:
        screen.recording.disconnect()
        with suppress(OSError):
            unfinished.unlink()
        raise


@contextmanager
def window_screen(memory_mb: int, name: str, history_s: float) -> Iterator[Screen]:
    """A recording in a window, which stays open; `name` and `history_s` as of `Screen`.

    Raises:
        UserError: Rerun is not installed, or no window can be opened.
    """
    screen = Screen(name, history_s)
    viewer = open_window(memory_mb)
    with _connected(screen, viewer):
        yield screen


@contextmanager
def page_screen(port: int | None, memory_mb: int, name: str, history_s: float) -> Iterator[Screen]:
    """A recording in a page for browsers of this machine.

    Args:
        port: port of the page; None: any.
        memory_mb: size of the data that are kept for browsers that connect later, MB.
        name: name, as of `Screen`.
        history_s: seconds of points that are shown, as of `Screen`, s.

    Raises:
        UserError: Rerun is not installed, or the port is in use.
    """
    screen = Screen(name, history_s)
    viewer, screen.page = serve_page(port, memory_mb)
    with viewer, _connected(screen, viewer):
        yield screen


@contextmanager
def _connected(screen: Screen, viewer: Viewer) -> Iterator[None]:
    """Send the recording to a viewer, which has received all of it in the end.

    Raises:
        UserError: the viewer has ended by an error, or had to be ended because it took nothing.
    """
    over = threading.Event()

    def end_what_is_stuck() -> None:
        """The package waits for the viewer without end, and nobody could interrupt it."""
        while not over.wait(LOOK_S):
            if screen.waits_s() > STUCK_S:
                viewer.kill()

    watch = threading.Thread(target=end_what_is_stuck, name="watch", daemon=True)
    screen.is_open = viewer.is_open
    screen.recording.connect_grpc(viewer.address)
    watch.start()
    try:
        screen.begin()
        yield
        screen.hand_over()
        viewer.check()
    finally:
        screen.disconnect()
        over.set()
        watch.join()
