"""Conversions that all messages share: times, samples, vectors, grids and apertures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from sal_height.engine.geometry_items import Aperture
from sal_height.errors import Rejected, UserError
from sal_height.geometry import ApertureState, Grid
from sal_height.messages.types import Aperture as ApertureMessage
from sal_height.messages.types import Header, ImageGrid, Point, Pose, Quaternion, Time, Vector3
from sal_height.numeric import C64, C128, F32, F64, U8


def to_ns(stamp: Time) -> int:
    """Return the nanoseconds since the epoch that a Time message states."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def to_stamp(ns: int) -> Time:
    """Return the Time message that states these nanoseconds since the epoch."""
    sec, nanosec = divmod(ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def header_of(stamp_ns: int, frame_id: str) -> Header:
    """Return the header with a stamp in nanoseconds since the epoch."""
    return Header(stamp=to_stamp(stamp_ns), frame_id=frame_id)


def to_floats(samples: npt.NDArray[np.generic]) -> F32:
    """Return the value of a float32[] field with `samples`, real or complex, of any shape: a view of them."""
    single = np.ascontiguousarray(samples, dtype=np.complex64 if np.iscomplexobj(samples) else np.float32)
    return single.reshape(-1).view(np.float32)


def complex_pairs(values: npt.NDArray[np.complexfloating]) -> F64:
    """Return the value of a float64[] field with complex `values` of any shape: real, imaginary part in turn."""
    return np.ascontiguousarray(values, dtype=np.complex128).reshape(-1).view(np.float64)


def from_complex_pairs(pairs: Sequence[float], where: str) -> C128:
    """Read a float64[] field of real and imaginary parts in turn as complex128 numbers, shape (numbers,).

    Raises:
        UserError: the number of entries is odd; the text begins with `where`.
    """
    if len(pairs) % 2:
        raise UserError(f"{where} has {len(pairs)} entries; real and imaginary parts must be in pairs.")
    return np.array(pairs, dtype=np.float64).view(np.complex128)


def to_bytes(values: U8) -> U8:
    """Return the value of a uint8[] field with `values`: a view of them."""
    return np.ascontiguousarray(values, dtype=np.uint8).reshape(-1)


def complex_view(floats: Sequence[float] | F32, shape: tuple[int, ...]) -> C64:
    """Read a float32[] field as complex64 samples of `shape`, without a copy."""
    return np.asarray(floats, np.float32).view(np.complex64).reshape(shape)


def float_view(floats: Sequence[float], shape: tuple[int, ...]) -> F32:
    """Read a float32[] field as float32 numbers of `shape`, without a copy."""
    return np.asarray(floats, np.float32).reshape(shape)


def grid_from_message(message: ImageGrid) -> Grid:
    """Return the grid that an ImageGrid describes."""
    return Grid(
        origin=vector_of(message.origin),
        row_direction=vector_of(message.row_direction),
        col_direction=vector_of(message.col_direction),
        row_spacing=message.row_spacing,
        col_spacing=message.col_spacing,
        rows=message.rows,
        cols=message.cols,
    )


def aperture_of(message: ApertureMessage) -> Aperture:
    """Return the aperture that an Aperture message describes; a covariance that is not known is 0.

    Raises:
        Rejected: the covariance has another number of entries than 0 and 36.
    """
    q, covariance = message.pose.orientation, message.pose_covariance
    if len(covariance) not in {0, 36}:
        raise Rejected(
            "wrong size",
            f"aperture.pose_covariance has {len(covariance)} entries; it must have 36, or none if it is not known.",
        )
    return Aperture(
        position=vector_of(message.pose.position),
        orientation=(q.x, q.y, q.z, q.w),
        velocity=vector_of(message.velocity),
        length=message.length,
        covariance=np.array(covariance, np.float64).reshape(6, 6) if len(covariance) else np.zeros((6, 6)),
        sliding=bool(message.sliding),
    )


def aperture_from_message(message: ApertureMessage) -> ApertureState:
    """Return the aperture that an Aperture message describes, with its rotation as a matrix.

    Raises:
        Rejected: the covariance has another number of entries than 0 and 36.
    """
    return aperture_of(message).state


def grid_to_message(grid: Grid) -> ImageGrid:
    """Return the ImageGrid that describes a grid."""
    return ImageGrid(
        origin=Point(**xyz(grid.origin)),
        row_direction=Vector3(**xyz(grid.row_direction)),
        col_direction=Vector3(**xyz(grid.col_direction)),
        row_spacing=float(grid.row_spacing),
        col_spacing=float(grid.col_spacing),
        rows=grid.rows,
        cols=grid.cols,
    )


def aperture_to_message(aperture: Aperture) -> ApertureMessage:
    """Return the Aperture message that describes an aperture; a covariance of 0 counts as not known."""
    pose = Pose(position=Point(**xyz(aperture.position)), orientation=Quaternion(*aperture.orientation))
    return ApertureMessage(
        pose=pose,
        pose_covariance=aperture.covariance.ravel() if aperture.covariance.any() else np.zeros(0),
        velocity=Vector3(**xyz(aperture.velocity)),
        length=aperture.length,
        sliding=bool(aperture.sliding),
    )


def xyz(vector: F64) -> dict[str, float]:
    """Return the coordinates of a vector by name, as arguments of Point and Vector3."""
    return dict(zip("xyz", map(float, vector), strict=True))


def vector_of(message: Point | Vector3) -> F64:
    """Return the coordinates of a Point or Vector3 as an array, shape (3,)."""
    return np.array([message.x, message.y, message.z])


def numbers_of(message: Point | Vector3) -> tuple[float, float, float]:
    """Return the coordinates of a Point or Vector3."""
    return message.x, message.y, message.z


def check_finite(numbers: Iterable[float], what: str) -> None:
    """Check that all numbers of a message are finite.

    Raises:
        Rejected: one is not; the text begins with `what`.
    """
    if not all(map(math.isfinite, numbers)):
        raise Rejected("not finite", f"{what} has NaN or infinite values; all must be finite.")


def check_rotation(quaternion: Sequence[float], what: str) -> None:
    """Check that a quaternion is finite and of the norm 1, within a hundredth.

    Raises:
        Rejected: it is not; the text begins with `what`.
    """
    check_finite(quaternion, what)
    if not 0.99 < math.hypot(*quaternion) < 1.01:
        sentence = f"{what} has the orientation {list(quaternion)}; a rotation must have the norm 1."
        raise Rejected("no rotation", sentence)
