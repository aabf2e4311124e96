"""Arrangement of the views: points on the left, images next to them, and the numbers of the nodes below."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sal_height.view.colours import EMPTY
from sal_height.view.painter import WORLD, Subject

BEST_FIRST = ("tracked", "adjusted", "ml", "capon", "music", "canopy_ground", "sum_difference", "monopulse")
"""Estimators in the order in which their tabs stand; the first one that is there is shown."""

EYE = np.radians(30.0), np.radians(35.0)
"""Direction from which the points are seen: angle from that of the sensor, and above the horizon, rad."""


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
