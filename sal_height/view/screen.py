"""The Rerun viewer: what is drawn goes to a window, to a browser or into a file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from sal_height.elevation import Validity
from sal_height.errors import UserError
from sal_height.io import writing
from sal_height.view.colours import VALIDITY_COLOURS
from sal_height.view.drawings import Classes, Cloud, Drawing, Line, Note, Number, Picture, Sheet
from sal_height.view.layout import blueprint
from sal_height.view.painter import Subject
from sal_height.view.viewer import Viewer, open_window, serve_page

VERSION = "0.41"
"""Version of Rerun, whose interface changes from one version to the next."""

STAMP, CLOCK = "stamp", "clock"
"""Timelines: the time of the sensor, and that at which messages arrived."""

STUCK_S, LOOK_S = 30.0, 0.5
"""A viewer that takes nothing for so long is ended."""

HAND_OVER_S = 60.0
"""Longest time that what was drawn last takes to the viewer."""

Parts: TypeAlias = tuple[Any, ...]
"""Archetypes of the package of the viewer, which make one entity."""

LINE_COLOUR = (255, 255, 255)


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
        self._makers: dict[type, Callable[[Any], Parts]] = {
            Picture: self._picture,
            Classes: self._classes,
            Cloud: self._cloud,
            Line: self._line,
            Number: self._number,
            Note: self._note,
        }

    def begin(self) -> None:
        """Log properties that do not change."""
        rr = self._rr
        classes = [(int(v), v.name.lower().replace("_", " "), VALIDITY_COLOURS[v]) for v in Validity]
        self.recording.log("/", rr.AnnotationContext(classes), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def show(self, sheet: Sheet) -> None:
        """Add drawings; it waits while the viewer has too much to take."""
        with self._waiting():
            self._show(sheet)

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

    def _show(self, sheet: Sheet) -> None:
        self.recording.reset_time()
        if sheet.stamp_ns is not None:
            self.recording.set_time(STAMP, timestamp=np.datetime64(sheet.stamp_ns, "ns"))
        self.recording.set_time(CLOCK, timestamp=np.datetime64(sheet.received_ns, "ns"))
        for drawing in sheet.drawings:
            self.recording.log(path_of(drawing), *self._makers[type(drawing)](drawing))

    def arrange(self, subject: Subject) -> None:
        """Arrange the views for what has been drawn."""
        self.recording.send_blueprint(blueprint(subject, self._history_s))

    def hand_over(self) -> None:
        """Wait until the viewer has received all, but not for one that has been closed."""
        with suppress(RuntimeError):
            self.recording.flush(timeout_sec=HAND_OVER_S)

    def _picture(self, picture: Picture) -> Parts:
        return (self._rr.Image(picture.pixels),)

    def _classes(self, classes: Classes) -> Parts:
        return (self._rr.SegmentationImage(classes.values),)

    def _cloud(self, cloud: Cloud) -> Parts:
        flat = self._rr.components.PointShading.Flat
        points = self._rr.Points3D(cloud.places, colors=cloud.colours, radii=[cloud.radius], point_shading=flat)
        return points, self._rr.AnyValues(height_m=cloud.height, sigma_m=cloud.sigma)

    def _line(self, line: Line) -> Parts:
        width = self._rr.Radius.ui_points(1.5)
        return (self._rr.LineStrips3D([line.places], colors=[LINE_COLOUR], radii=[width]),)

    def _number(self, number: Number) -> Parts:
        return (self._rr.Scalars([number.value]),)

    def _note(self, note: Note) -> Parts:
        return (self._rr.TextLog(note.text, level="WARN"),)


def path_of(drawing: Drawing) -> list[str]:
    """The parts of the path of a drawing, any text; names of others may have empty ones."""
    return [part for part in drawing.path.split("/") if part]


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
