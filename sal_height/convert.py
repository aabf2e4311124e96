"""Messages to arrays and back. Reading samples is a view; writing them costs one block copy."""

from __future__ import annotations

import array
import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from nav_msgs.msg import Odometry
from sal_height_msgs import msg as messages
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from sal_height.beam_table import BeamTable
from sal_height.errors import Rejected, UserError
from sal_height.estimate import Validity
from sal_height.focusing import Slc
from sal_height.geometry import EARTH_RADIUS, Aperture, Grid, above_place
from sal_height.height import HeightField, Surface
from sal_height.phase_history import PhaseHistory
from sal_height.sensor import Sensor
from sal_height.trajectory import PlatformState

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

MAP_FRAME = "map"
BODY_FRAME = "base_link"

LONGEST_DWELL = 3600.0
"""Longest time from a frame's stamp to its last pulse, s."""

GREATEST_RANGE = 1e8
"""Greatest reference range of a frame, m."""


# Time


def to_ns(stamp: Time) -> int:
    """Nanoseconds since the epoch."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def to_stamp(ns: int) -> Time:
    """Time message of nanoseconds since the epoch."""
    sec, nanosec = divmod(ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


# Samples


def to_floats(samples: npt.NDArray[np.generic]) -> array.array[float]:
    """A float32[] field's value holding `samples` (real or complex, any shape): one block copy.

    rosidl takes an array.array as it is, but converts numpy arrays element by element.
    """
    single = np.ascontiguousarray(samples, dtype=np.complex64 if np.iscomplexobj(samples) else np.float32)
    floats = array.array("f")
    floats.frombytes(single.reshape(-1).view(np.uint8).data)
    return floats


def to_bytes(values: npt.NDArray[np.uint8]) -> array.array[int]:
    """A uint8[] field's value holding `values`."""
    return array.array("B", values.tobytes())


def complex_view(floats: Sequence[float], shape: tuple[int, ...]) -> ComplexArray:
    """Read a float32[] field as complex samples of `shape`, without copying."""
    return np.frombuffer(memoryview(floats), np.complex64).reshape(shape)  # type: ignore[arg-type]


def float_view(floats: Sequence[float], shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Read a float32[] field as reals of `shape`, without copying."""
    return np.frombuffer(memoryview(floats), np.float32).reshape(shape)  # type: ignore[arg-type]


# Sensor


def sensor_to_message(sensor: Sensor, stamp: Time) -> messages.SensorInfo:
    """SensorInfo of a sensor."""
    return messages.SensorInfo(
        header=Header(stamp=stamp, frame_id=BODY_FRAME),
        name=sensor.name,
        config_hash=sensor.config_hash,
        calibration_id=sensor.calibration_id,
        look_side=sensor.look_side,
        mode=sensor.mode,
        waveform=sensor.waveform,
        chirp_rate=sensor.chirp_rate,
        pulse_duration=sensor.pulse_duration,
        sampling_rate=sensor.sampling_rate,
        wavelength=sensor.wavelength,
        bandwidth=sensor.bandwidth,
        sample_count=sensor.sample_count,
        pulse_count=sensor.pulse_count,
        pulse_repetition_frequency=sensor.pulse_repetition_frequency,
        aperture=sensor.aperture,
        pattern=sensor.pattern,
        detector_size=list(sensor.detector_size),
        detector_rotation=sensor.detector_rotation,
        beam_tables=[messages.BeamTable(**dataclasses.asdict(table)) for table in sensor.beam_tables],
        elevation_boresights=list(sensor.elevation_boresights),
        noise_power=list(sensor.noise_power),
        channel_matrix_real=[entry.real for row in sensor.channel_matrix for entry in row],
        channel_matrix_imaginary=[entry.imag for row in sensor.channel_matrix for entry in row],
        matrix_in_antenna=sensor.matrix_in_antenna,
        full_scale=sensor.full_scale,
    )


def sensor_from_message(message: messages.SensorInfo) -> Sensor:
    """The sensor a SensorInfo describes.

    Raises:
        UserError: a value out of its range, or no config_hash.
    """
    if not message.config_hash:
        raise UserError(f"SensorInfo {message.name!r} has no config_hash; frames and products need one to refer to.")
    return Sensor(
        name=message.name,
        look_side=int(message.look_side),
        mode=message.mode,
        waveform=message.waveform,
        chirp_rate=message.chirp_rate,
        pulse_duration=message.pulse_duration,
        sampling_rate=message.sampling_rate,
        wavelength=message.wavelength,
        bandwidth=message.bandwidth,
        sample_count=message.sample_count,
        pulse_count=message.pulse_count,
        pulse_repetition_frequency=message.pulse_repetition_frequency,
        aperture=message.aperture,
        pattern=message.pattern,
        detector_size=(float(message.detector_size[0]), float(message.detector_size[1])),
        detector_rotation=message.detector_rotation,
        beam_tables=tuple(
            BeamTable(tuple(table.elevation), tuple(table.azimuth), tuple(table.real), tuple(table.imaginary))
            for table in message.beam_tables
        ),
        elevation_boresights=tuple(message.elevation_boresights),
        noise_power=tuple(message.noise_power),
        channel_matrix=_matrix_from_message(message),
        matrix_in_antenna=message.matrix_in_antenna,
        full_scale=message.full_scale,
        calibration_id=message.calibration_id,
        config_hash=message.config_hash,
    )


def _matrix_from_message(message: messages.SensorInfo) -> tuple[tuple[complex, ...], ...]:
    real, imaginary = message.channel_matrix_real, message.channel_matrix_imaginary
    if len(real) != len(imaginary):
        raise UserError(
            f"SensorInfo {message.name!r} has {len(real)} entries of channel_matrix_real and {len(imaginary)} of "
            "channel_matrix_imaginary; there must be as many."
        )
    entries = [complex(*parts) for parts in zip(real, imaginary, strict=True)]
    width = max(1, len(message.elevation_boresights))
    return tuple(tuple(entries[first : first + width]) for first in range(0, len(entries), width))


# Platform


def state_to_message(state: PlatformState, stamp: Time) -> Odometry:
    """Odometry of a platform state (pose of base_link in map, twist in base_link)."""
    message = Odometry(header=Header(stamp=stamp, frame_id=MAP_FRAME), child_frame_id=BODY_FRAME)
    message.pose.pose.position = Point(**_xyz(state.position))
    message.pose.pose.orientation = Quaternion(**dict(zip("xyzw", state.orientation.tolist(), strict=True)))
    message.pose.covariance = state.covariance.ravel()
    body_velocity = Rotation.from_quat(state.orientation).inv().apply(state.velocity)
    message.twist.twist.linear = Vector3(**_xyz(body_velocity))
    return message


def state_from_message(message: Odometry) -> PlatformState:
    """The platform state an Odometry describes.

    Raises:
        Rejected: other frames than map and base_link, values that are not finite, or an orientation that is no
            rotation.
    """
    frames = (message.header.frame_id, message.child_frame_id)
    if frames != (MAP_FRAME, BODY_FRAME):
        raise Rejected(
            "wrong frames",
            f"Odometry is of {frames[1]!r} in {frames[0]!r}; it must be of {BODY_FRAME!r} in {MAP_FRAME!r} (ENU, FLU).",
        )
    pose, twist = message.pose.pose, message.twist.twist.linear
    orientation = np.array([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])
    position, body_velocity = _vector(pose.position), _vector(twist)
    if not np.all(np.isfinite(np.concatenate([orientation, position, body_velocity]))):
        raise Rejected("not finite", "Odometry has a value that is NaN or infinite; all must be finite.")
    if not 0.99 < np.linalg.norm(orientation) < 1.01:
        raise Rejected("no rotation", f"Odometry orientation {orientation} has not the norm 1 of a rotation.")
    return PlatformState(
        stamp_ns=to_ns(message.header.stamp),
        position=position,
        orientation=orientation,
        velocity=np.asarray(Rotation.from_quat(orientation).apply(body_velocity)),
        covariance=np.array(message.pose.covariance).reshape(6, 6),
    )


# Phase history


def history_to_messages(history: PhaseHistory, sensor: Sensor, dwell: int, stamp: Time) -> list[messages.DetectorFrame]:
    """One DetectorFrame per detector."""
    return [
        messages.DetectorFrame(
            header=Header(stamp=stamp, frame_id=BODY_FRAME),
            dwell=dwell,
            detector=detector,
            config_hash=sensor.config_hash,
            pulse_count=samples.shape[0],
            sample_count=samples.shape[1],
            pulse_time=history.pulse_times.tolist(),
            reference_range=history.reference_range.tolist(),
            samples=to_floats(samples),
        )
        for detector, samples in enumerate(history.samples)
    ]


def check_frame(frame: messages.DetectorFrame, sensor: Sensor) -> None:
    """Make sure a frame can be processed with `sensor`.

    Raises:
        Rejected: it cannot; the sentence names the field, the value and what is allowed.
    """
    where = f"DetectorFrame of dwell {frame.dwell}, detector {frame.detector}"
    _check_detector(frame.detector, sensor, where)
    expected = (sensor.pulse_count, sensor.sample_count)
    if (frame.pulse_count, frame.sample_count) != expected:
        raise Rejected(
            "contradicts sensor info",
            f"{where}: {frame.pulse_count} pulses x {frame.sample_count} samples, SensorInfo says "
            f"{expected[0]} x {expected[1]}.",
        )
    wanted = {"samples": 2 * expected[0] * expected[1], "pulse_time": expected[0], "reference_range": expected[0]}
    for field, count in wanted.items():
        if len(getattr(frame, field)) != count:
            raise Rejected(
                "wrong size", f"{where}: {field} has {len(getattr(frame, field))} entries instead of {count}."
            )
    for field in wanted:
        if not np.all(np.isfinite(np.frombuffer(getattr(frame, field), "f4" if field == "samples" else "f8"))):
            raise Rejected("not finite", f"{where}: {field} has NaN or infinite entries; all must be finite.")
    times = np.asarray(frame.pulse_time)
    if np.any(np.diff(times) < 0) or times[0] < 0 or not times[0] < times[-1] <= LONGEST_DWELL:
        raise Rejected(
            "wrong pulse times",
            f"{where}: pulse_time runs from {times[0]:g} to {times[-1]:g} s; it must not decrease, and lie between 0 "
            f"and {LONGEST_DWELL:g} s.",
        )
    ranges = np.asarray(frame.reference_range)
    if not np.all((ranges > 0) & (ranges <= GREATEST_RANGE)):
        raise Rejected(
            "wrong reference range",
            f"{where}: reference_range runs from {ranges.min():g} to {ranges.max():g} m; it must be greater than 0 and "
            f"at most {GREATEST_RANGE:g} m.",
        )


def history_from_messages(frames: Sequence[messages.DetectorFrame]) -> PhaseHistory:
    """Phase history of the checked frames of all detectors of a dwell, in the order of detectors.

    Raises:
        Rejected: the detectors disagree on pulse times or reference ranges.
    """
    first = frames[0]
    for frame in frames[1:]:
        if frame.pulse_time != first.pulse_time or frame.reference_range != first.reference_range:
            raise Rejected(
                "detectors disagree",
                f"Dwell {first.dwell}: detector {frame.detector} has other pulse times or reference ranges than "
                f"detector {first.detector}; all must share them.",
            )
    shape = (first.pulse_count, first.sample_count)
    return PhaseHistory(
        stamp_ns=to_ns(first.header.stamp),
        pulse_times=np.array(first.pulse_time),
        reference_range=np.array(first.reference_range),
        samples=np.stack([complex_view(frame.samples, shape) for frame in frames]),
    )


# Images


def slc_to_messages(
    slc: Slc, saturated_shares: Array, frame: messages.DetectorFrame, provenance: messages.Provenance
) -> list[messages.ComplexImage]:
    """One ComplexImage per detector, with the stamp and dwell of `frame`; shares as of `saturation`."""
    return [
        messages.ComplexImage(
            header=Header(stamp=frame.header.stamp, frame_id=MAP_FRAME),
            dwell=frame.dwell,
            detector=detector,
            grid=_grid_to_message(slc.grid),
            aperture=_aperture_to_message(slc.aperture),
            noise_power=slc.noise_power[detector],
            saturated_share=float(saturated_shares[detector]),
            samples=to_floats(image),
            provenance=provenance,
        )
        for detector, image in enumerate(slc.images)
    ]


def check_slc(image: messages.ComplexImage, sensor: Sensor) -> None:
    """Make sure an image can be processed with `sensor`.

    Raises:
        Rejected: it cannot; the sentence names the field, the value and what is allowed.
    """
    where = f"ComplexImage of dwell {image.dwell}, detector {image.detector}"
    _check_detector(image.detector, sensor, where)
    count = 2 * image.grid.rows * image.grid.cols
    if len(image.samples) != count or count == 0:
        raise Rejected(
            "wrong size",
            f"{where}: samples has {len(image.samples)} entries, {image.grid.rows} x {image.grid.cols} complex "
            f"pixels need {count}.",
        )
    if not np.all(np.isfinite([image.noise_power, image.saturated_share])):
        raise Rejected(
            "not finite", f"{where}: noise_power or saturated_share is NaN or infinite; both must be finite."
        )
    _check_geometry(image.grid, image.aperture, where)


def slc_from_messages(images: Sequence[messages.ComplexImage]) -> tuple[ComplexArray, Grid, Aperture, Array]:
    """Images (detectors, rows, cols), grid, aperture and noise powers of the checked images of all detectors.

    Raises:
        Rejected: the detectors disagree on grid or aperture.
    """
    first = images[0]
    for image in images[1:]:
        if image.grid != first.grid or image.aperture != first.aperture:
            raise Rejected(
                "detectors disagree",
                f"Dwell {first.dwell}: detector {image.detector} has another grid or aperture than detector "
                f"{first.detector}; all must share them.",
            )
    grid = grid_from_message(first.grid)
    slc = np.stack([complex_view(image.samples, grid.shape) for image in images])
    return slc, grid, aperture_from_message(first.aperture), np.array([image.noise_power for image in images])


def height_to_message(
    field: HeightField,
    aperture: Aperture,
    looks: tuple[int, int],
    estimator: str,
    source: messages.ComplexImage | messages.HeightImage,
    provenance: messages.Provenance,
) -> messages.HeightImage:
    """HeightImage with the stamp and dwell of its `source`."""
    image = messages.HeightImage(
        header=source.header,
        dwell=source.dwell,
        estimator=estimator,
        grid=_grid_to_message(field.grid),
        aperture=_aperture_to_message(aperture),
        range_looks=looks[0],
        azimuth_looks=looks[1],
        earth_radius=EARTH_RADIUS,
        validity=to_bytes(field.validity),
        provenance=provenance,
    )
    for prefix, surface in (("", field.first), ("second_", field.second)):
        if surface:
            offset = surface.positions - field.grid.origin
            values = (surface.height, surface.sigma, surface.cnr_db, offset[..., 0], offset[..., 1])
            for name, numbers in zip(("height", "sigma", "cnr_db", "east", "north"), values, strict=True):
                setattr(image, prefix + name, to_floats(numbers))
    return image


def field_from_message(image: messages.HeightImage) -> HeightField:
    """The heights that a HeightImage holds, without second scatterers.

    Raises:
        Rejected: they cannot be used; the sentence names the field, the value and what is allowed.
    """
    where = f"HeightImage of dwell {image.dwell}"
    if image.header.frame_id != MAP_FRAME:
        raise Rejected("wrong frames", f"{where} is in {image.header.frame_id!r}; it must be in {MAP_FRAME!r} (ENU).")
    grid, names = grid_from_message(image.grid), ("height", "sigma", "cnr_db", "east", "north", "validity")
    count = grid.rows * grid.cols
    for name in names:
        if len(getattr(image, name)) != count or count == 0:
            raise Rejected(
                "wrong size",
                f"{where}: {name} has {len(getattr(image, name))} entries, {grid.rows} x {grid.cols} pixels need "
                f"{count} (at least 1).",
            )
    _check_geometry(image.grid, image.aperture, where)
    if image.earth_radius != EARTH_RADIUS:
        raise Rejected(
            "wrong earth radius", f"{where}: earth_radius is {image.earth_radius:.10g} m; it must be {EARTH_RADIUS} m."
        )
    validity = np.array(image.validity, dtype=np.uint8).reshape(grid.shape)
    usable = np.isin(validity, (Validity.OK, Validity.TWO_SCATTERERS, Validity.INTERPOLATED))
    height, sigma, cnr_db, east, north = (
        float_view(getattr(image, name), grid.shape).astype(np.float64) for name in names[:-1]
    )
    if not np.all(np.isfinite(np.stack([height, sigma, east, north])[:, usable])):
        raise Rejected("not finite", f"{where}: a usable pixel's height, sigma, east or north is NaN or infinite.")
    if not np.all(sigma[usable] > 0):
        raise Rejected(
            "wrong sigma", f"{where}: a usable pixel's sigma is {sigma[usable].min():g} m; it must be greater than 0."
        )
    positions = above_place(grid.origin[0] + east, grid.origin[1] + north, height)
    positions[~usable] = np.nan
    height, sigma = (np.where(usable, values, np.nan) for values in (height, sigma))
    return HeightField(grid, validity, Surface(height, sigma, cnr_db, positions), None)


def height_picture(image: messages.HeightImage) -> Image:
    """The heights as a 32FC1 image, NaN where not valid: for any image viewer."""
    return float_picture(float_view(image.height, (image.grid.rows, image.grid.cols)), image.header)


def float_picture(values: npt.NDArray[np.float32], header: Header) -> Image:
    """An array (rows, cols) as a 32FC1 image."""
    rows, cols = values.shape
    data = array.array("B", values.tobytes())
    return Image(header=header, height=rows, width=cols, encoding="32FC1", step=4 * cols, data=data)


def height_points(field: HeightField, image: messages.HeightImage) -> PointCloud2:
    """All scatterers as points x, y, z in map with height, sigma and cnr_db: for any point-cloud viewer."""
    points = np.concatenate([_points(surface) for surface in (field.first, field.second) if surface])
    return point_cloud(points, ("x", "y", "z", "height", "sigma", "cnr_db"), image.header)


def point_cloud(points: npt.NDArray[np.float32], names: Sequence[str], header: Header) -> PointCloud2:
    """Points of shape (points, fields) whose fields have these `names`."""
    return PointCloud2(
        header=header,
        height=1,
        width=len(points),
        fields=[PointField(name=n, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, n in enumerate(names)],
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=array.array("B", points.tobytes()),
        is_dense=True,
    )


def _points(surface: Surface) -> npt.NDArray[np.float32]:
    """Position, height, sigma and CNR of the scatterers of a surface, shape (scatterers, 6)."""
    seen = np.isfinite(surface.height)
    columns = [*surface.positions[seen].T, surface.height[seen], surface.sigma[seen], surface.cnr_db[seen]]
    return np.ascontiguousarray(np.stack(columns, axis=-1), dtype=np.float32)


def grid_from_message(message: messages.ImageGrid) -> Grid:
    """The grid an ImageGrid describes."""
    return Grid(
        origin=_vector(message.origin),
        row_direction=_vector(message.row_direction),
        col_direction=_vector(message.col_direction),
        row_spacing=message.row_spacing,
        col_spacing=message.col_spacing,
        rows=message.rows,
        cols=message.cols,
    )


def aperture_from_message(message: messages.Aperture) -> Aperture:
    """The aperture an Aperture message describes."""
    q = message.pose.pose.orientation
    return Aperture(
        position=_vector(message.pose.pose.position),
        velocity=_vector(message.velocity),
        rotation=Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(),
        length=message.length,
        covariance=np.array(message.pose.covariance).reshape(6, 6),
        sliding=message.sliding,
    )


def _grid_to_message(grid: Grid) -> messages.ImageGrid:
    return messages.ImageGrid(
        origin=Point(**_xyz(grid.origin)),
        row_direction=Vector3(**_xyz(grid.row_direction)),
        col_direction=Vector3(**_xyz(grid.col_direction)),
        row_spacing=grid.row_spacing,
        col_spacing=grid.col_spacing,
        rows=grid.rows,
        cols=grid.cols,
    )


def _aperture_to_message(aperture: Aperture) -> messages.Aperture:
    message = messages.Aperture(velocity=Vector3(**_xyz(aperture.velocity)), length=aperture.length)
    message.sliding = aperture.sliding
    message.pose.pose.position = Point(**_xyz(aperture.position))
    quaternion = Rotation.from_matrix(aperture.rotation).as_quat().tolist()
    message.pose.pose.orientation = Quaternion(**dict(zip("xyzw", quaternion, strict=True)))
    message.pose.covariance = aperture.covariance.ravel()
    return message


def _xyz(vector: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, vector), strict=True))


def _vector(message: Point | Vector3) -> Array:
    return np.array([message.x, message.y, message.z])


def _check_geometry(image_grid: messages.ImageGrid, aperture: messages.Aperture, where: str) -> None:
    """Make sure that the pixels of an image lie somewhere, and that something flew past them.

    Raises:
        Rejected: they do not; the sentence begins with `where`.
    """
    grid = grid_from_message(image_grid)
    numbers = [grid.origin, grid.row_direction, grid.col_direction, _vector(aperture.pose.pose.position)]
    numbers += [_vector(aperture.velocity), np.array([grid.row_spacing, grid.col_spacing])]
    if not np.all(np.isfinite(np.concatenate(numbers))):
        raise Rejected("not finite", f"{where}: grid or aperture is NaN or infinite; all must be finite.")
    q = aperture.pose.pose.orientation
    norms = [np.linalg.norm(v) for v in (grid.row_direction, grid.col_direction, [q.x, q.y, q.z, q.w])]
    if not (np.allclose(norms, 1, atol=0.01) and grid.row_spacing > 0 and grid.col_spacing > 0):
        raise Rejected(
            "wrong geometry",
            f"{where}: directions and orientation must have norm 1, spacings be greater than 0.",
        )
    if not np.linalg.norm(_vector(aperture.velocity)) > 0:
        raise Rejected("wrong geometry", f"{where}: aperture.velocity is 0; a synthetic aperture needs motion.")


def _check_detector(detector: int, sensor: Sensor, where: str) -> None:
    if detector >= sensor.detector_count:
        raise Rejected("unknown detector", f"{where}: SensorInfo has detectors 0 to {sensor.detector_count - 1}.")
