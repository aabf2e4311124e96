"""Heights as a LAS or LAZ point cloud (ASPRS LAS 1.4 R15): every surface of every pixel is a return."""

from __future__ import annotations

import bisect
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.elevation import Validity
from sal_height.errors import UserError
from sal_height.exports.heights import DwellHeights, RecordedHeights, probability_of_order
from sal_height.extras import import_extra
from sal_height.geometry import Projection
from sal_height.io import writing_whole
from sal_height.numeric import Bool

GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
LEAP_SECONDS = tuple(
    round((datetime(year, month, 1, tzinfo=UTC) - GPS_EPOCH).total_seconds())
    for year, month in (
        *((1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7)),
        *((1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1)),
    )
)
"""Seconds of UTC since GPS_EPOCH, leap seconds left out, before which one was inserted (IERS Bulletin C)."""

EXTRA_DIMENSIONS = (
    ("sigma", np.float32, "standard deviation of height [m]"),
    ("cnr_db", np.float32, "of one look [dB]"),
    ("spread", np.float32, "of heights in the pixel [m]"),
    ("order_probability", np.float32, "of as many returns; NaN unknown"),
    ("dwell", np.uint32, "number of the dwell"),
    ("validity", np.uint8, "HeightImage.validity"),
)
"""Name, type and description, of which LAS has 32 characters."""


def write_las(heights: RecordedHeights, path: Path) -> int:
    """Write every surface of every pixel of every dwell as a point; returns the number of points.

    Returns of a pixel are in the order of their power, the strongest first. Heights that the relief tracker has
    interpolated have the flag "synthetic". Points have no coordinate system where the origin of the map is not known.
    A file with the suffix .laz is compressed. It appears under its name when it is complete.

    Raises:
        UserError: the package laspy is not installed, the suffix is another one, there is no height, or the file cannot
            be written.
    """
    laspy, suffix = import_extra("laspy", f"Writing {path}"), path.suffix.lower()
    if suffix not in {".las", ".laz"}:
        raise UserError(f"File {path} has the suffix {path.suffix!r}; a point cloud is written as .las or .laz.")
    header, count = _header(laspy, heights.projection), 0
    with writing_whole(path) as file, ExitStack() as closing:
        writer = None
        for dwell in heights.dwells("las"):
            there = np.stack([np.isfinite(surface.height) for surface in dwell.field.surfaces])
            if not there.any():
                continue
            positions = np.stack([surface.positions for surface in dwell.field.surfaces])[there]
            coordinates = heights.coordinates(positions)
            if writer is None:
                header.offsets = np.round(coordinates.mean(axis=0), -3)
                writer = laspy.LasWriter(file, header, do_compress=suffix == ".laz", closefd=False)
                closing.callback(writer.close)
            points = laspy.ScaleAwarePointRecord.zeros(len(coordinates), header=header)
            points.x, points.y, points.z = coordinates.T
            _describe(points, dwell, there)
            writer.write_points(points)
            count += len(points)
        if writer is None:
            raise UserError(f"Topic {heights.topic} of bag {heights.reader.path} has no valid height.")
    return count


def gps_time(stamp_ns: int) -> float:
    """Adjusted standard GPS time, s, of a time in UTC, ns since 1970."""
    since = stamp_ns * 1e-9 - GPS_EPOCH.timestamp()
    adjustment_s = 1_000_000_000  # adjusted standard GPS time is GPS time less this
    return since + bisect.bisect_right(LEAP_SECONDS, since) - adjustment_s


def _header(laspy: Any, projection: Projection | None) -> Any:
    # Point format 6 has returns, flags and GPS time; LAS 1.4 needs it for a system in well-known text.
    header = laspy.LasHeader(version="1.4", point_format=6)
    scale = 1e-4  # step of coordinates, m: a 32-bit number of them reaches 214 km to either side
    header.scales = np.full(3, scale)
    header.system_identifier, header.generating_software = "sal_height", "sal_height"
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = True
    for name, kind, description in EXTRA_DIMENSIONS:
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind, description))
    if projection is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(projection.wkt1))
    return header


def _describe(points: Any, dwell: DwellHeights, there: Bool) -> None:
    """Set all of points but their coordinates.

    Args:
        points: points, one for each surface with a height.
        dwell: heights of the points.
        there: True for surfaces that have a height, shape (surfaces, rows, cols).
    """
    surfaces = dwell.field.surfaces
    number = np.broadcast_to(np.arange(1, len(surfaces) + 1)[:, None, None], there.shape)
    validity = np.broadcast_to(dwell.field.validity, there.shape)[there]
    points.return_number = number[there]
    points.number_of_returns = np.broadcast_to(there.sum(axis=0), there.shape)[there]
    points.gps_time = np.full(len(points), gps_time(dwell.stamp_ns))
    points.synthetic = validity == Validity.INTERPOLATED
    for name in ("sigma", "cnr_db", "spread"):
        points[name] = np.stack([getattr(surface, name) for surface in surfaces])[there]
    points["order_probability"] = np.broadcast_to(probability_of_order(dwell.field), there.shape)[there]
    points["dwell"], points["validity"] = np.full(len(points), dwell.dwell), validity
