"""Conversions that all messages share: times, samples, vectors, grids and apertures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sal_height.errors import Rejected, UserError
from sal_height.geometry import ROS_AXES, ApertureState, Axes, Grid, quaternion_of, rotation_matrix
from sal_height.messages.types import Aperture, ImageGrid, Point, Pose, Quaternion, Time, Vector3
from sal_height.numeric import C64, C128, F32, F64, U8
from sal_height.sensor import Sensor

MAP_FRAME = "map"
"""Usual name of the frame of positions: x east, y north, z up (REP-103)."""

BODY_FRAME = "base_link"
"""Usual name of the frame of the platform: x forward, y left, z up (REP-103)."""


class Frames(NamedTuple):
    """Names of the frames of positions and of the platform in the headers of messages, and how their axes point."""

    map: str = MAP_FRAME
    body: str = BODY_FRAME
    axes: Axes = ROS_AXES


USUAL = Frames()


def to_ns(stamp: Time) -> int:
    """Return the nanoseconds since the epoch that a Time message states."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def to_stamp(ns: int) -> Time:
    """Return the Time message that states these nanoseconds since the epoch."""
    sec, nanosec = divmod(ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def to_floats(samples: npt.NDArray[np.generic]) -> F32:
    """Return the value of a float32[] field that holds `samples`, real or complex, of any shape: a view of them."""
    single = np.ascontiguousarray(samples, dtype=np.complex64 if np.iscomplexobj(samples) else np.float32)
    return single.reshape(-1).view(np.float32)


def complex_pairs(values: npt.NDArray[np.complexfloating]) -> F64:
    """Return the value of a float64[] field that holds complex `values` of any shape: real, imaginary part in turn."""
    return np.ascontiguousarray(values, dtype=np.complex128).reshape(-1).view(np.float64)


def from_complex_pairs(pairs: Sequence[float], where: str) -> C128:
    """Read a float64[] field of real and imaginary parts in turn as complex128 numbers, shape (numbers,).

    Raises:
        UserError: the number of entries is odd; the sentence begins with `where`.
    """
    if len(pairs) % 2:
        raise UserError(f"{where} has {len(pairs)} entries; real and imaginary parts must come in pairs.")
    return np.array(pairs, dtype=np.float64).view(np.complex128)


def to_bytes(values: U8) -> U8:
    """Return the value of a uint8[] field that holds `values`: a view of them."""
    return np.ascontiguousarray(values, dtype=np.uint8).reshape(-1)


def complex_view(floats: Sequence[float] | F32, shape: tuple[int, ...]) -> C64:
    """Read a float32[] field as complex64 samples of `shape`, without a copy."""
    return np.asarray(floats, np.float32).view(np.complex64).reshape(shape)


def float_view(floats: Sequence[float], shape: tuple[int, ...]) -> F32:
    """Read a float32[] field as float32 numbers of `shape`, without a copy."""
    return np.asarray(floats, np.float32).reshape(shape)


FARTHEST = 1e7
"""Greatest distance from the origin of the map, m: what is farther, or higher, is no place that a platform sees."""

FASTEST = 1e5
"""Greatest speed of a platform, m/s: ten times that of satellites."""

FINEST = 1e-6
"""Least distance of pixels, m: finer than any wavelength."""


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


def aperture_from_message(message: Aperture) -> ApertureState:
    """Return the aperture that an Aperture message describes; a covariance that is not known is 0.

    Raises:
        Rejected: the covariance has another number of entries than 0 and 36.
    """
    q = message.pose.orientation
    return ApertureState(
        position=vector_of(message.pose.position),
        velocity=vector_of(message.velocity),
        rotation=rotation_matrix((q.x, q.y, q.z, q.w)),
        length=message.length,
        covariance=_covariance(message.pose_covariance, 6, "aperture.pose_covariance"),
        sliding=message.sliding,
    )


def _covariance(numbers: Sequence[float], size: int, where: str) -> F64:
    """A covariance of shape (size, size); one that is not known, of which there are no numbers, is 0.

    Raises:
        Rejected: it has another number of entries; the sentence begins with `where`.
    """
    if len(numbers) not in {0, size**2}:
        sentence = f"{where} has {len(numbers)} entries; it must have {size**2}, or none if it is not known."
        raise Rejected("wrong size", sentence)
    return np.array(numbers, dtype=np.float64).reshape(size, size) if len(numbers) else np.zeros((size, size))


def grid_to_message(grid: Grid) -> ImageGrid:
    """Return the ImageGrid that describes a grid."""
    return ImageGrid(
        origin=Point(**xyz(grid.origin)),
        row_direction=Vector3(**xyz(grid.row_direction)),
        col_direction=Vector3(**xyz(grid.col_direction)),
        row_spacing=grid.row_spacing,
        col_spacing=grid.col_spacing,
        rows=grid.rows,
        cols=grid.cols,
    )


def aperture_to_message(aperture: ApertureState) -> Aperture:
    """Return the Aperture message that describes an aperture; a covariance of 0 counts as not known."""
    x, y, z, w = quaternion_of(aperture.rotation)
    return Aperture(
        pose=Pose(position=Point(**xyz(aperture.position)), orientation=Quaternion(x=x, y=y, z=z, w=w)),
        pose_covariance=aperture.covariance.ravel() if aperture.covariance.any() else None,
        velocity=Vector3(**xyz(aperture.velocity)),
        length=aperture.length,
        sliding=aperture.sliding,
    )


def xyz(vector: F64) -> dict[str, float]:
    """Return the coordinates of a vector by name, as Point and Vector3 take them."""
    return dict(zip("xyz", map(float, vector), strict=True))


def vector_of(message: Point | Vector3) -> F64:
    """Return the coordinates of a Point or Vector3 as an array, shape (3,)."""
    return np.array([message.x, message.y, message.z])


def _numbers(message: Point | Vector3) -> tuple[float, float, float]:
    return message.x, message.y, message.z


def check_geometry(image_grid: ImageGrid, aperture: Aperture, where: str) -> None:
    """Check that the grid and the aperture of an image are finite and possible.

    Raises:
        Rejected: a value is not finite or beyond FARTHEST, a direction or the orientation has not the norm 1, a spacing
            is less than FINEST, the velocity is 0, or a covariance has a wrong number of entries; the sentence begins
            with `where`.
    """
    _covariance(aperture.pose_covariance, 6, f"{where}: aperture.pose_covariance")
    _covariance(aperture.velocity_covariance, 3, f"{where}: aperture.velocity_covariance")
    grid, q, velocity = image_grid, aperture.pose.orientation, _numbers(aperture.velocity)
    directions = _numbers(grid.row_direction), _numbers(grid.col_direction)
    places = *_numbers(grid.origin), *_numbers(aperture.pose.position), *velocity
    spacings = grid.row_spacing, grid.col_spacing
    if not all(abs(number) <= FARTHEST for number in (*places, *directions[0], *directions[1], *spacings)):
        raise Rejected(
            "not finite",
            f"{where}: grid or aperture has values that are NaN, infinite or beyond {FARTHEST:g} m, farther than "
            "any platform sees.",
        )
    norms = [math.hypot(*numbers) for numbers in (*directions, (q.x, q.y, q.z, q.w))]
    if not (all(abs(norm - 1) <= 0.01 for norm in norms) and min(spacings) >= FINEST):
        raise Rejected(
            "wrong geometry",
            f"{where}: row_direction, col_direction and orientation have the norms {np.round(norms, 3).tolist()}, the "
            f"spacings are {grid.row_spacing:g} and {grid.col_spacing:g} m; norms must be 1, spacings {FINEST:g} m or "
            "more.",
        )
    if not any(velocity):
        raise Rejected("wrong geometry", f"{where}: aperture.velocity is 0; a synthetic aperture needs motion.")


def check_finite(numbers: Iterable[float], what: str) -> None:
    """Check that all numbers of a message are finite.

    Raises:
        Rejected: one is not; the sentence begins with `what`.
    """
    if not all(map(math.isfinite, numbers)):
        raise Rejected("not finite", f"{what} has NaN or infinite values; all must be finite.")


def check_rotation(quaternion: Sequence[float], what: str) -> None:
    """Check that a quaternion is finite and of the norm 1, within a hundredth.

    Raises:
        Rejected: it is not; the sentence begins with `what`.
    """
    check_finite(quaternion, what)
    if not 0.99 < math.hypot(*quaternion) < 1.01:
        sentence = f"{what} has the orientation {list(quaternion)}; a rotation must have the norm 1."
        raise Rejected("no rotation", sentence)


def check_channel(channel: int, sensor: Sensor, where: str) -> None:
    """Check that the sensor has a channel of that number.

    Raises:
        Rejected: it has not; the sentence begins with `where`.
    """
    if channel >= sensor.detector_count:
        raise Rejected("unknown channel", f"{where}: SensorInfo has channels 0 to {sensor.detector_count - 1}.")
