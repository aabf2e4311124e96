"""Conversion of height images, and the images and point clouds that viewers show of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sal_height.elevation import ORDERS, USABLE, Validity, scatterer_count
from sal_height.errors import Rejected, UserError
from sal_height.geometry import ApertureState, Grid, above_place
from sal_height.messages.basics import (
    FARTHEST,
    MAP_FRAME,
    aperture_from_message,
    aperture_to_message,
    check_geometry,
    float_view,
    grid_from_message,
    grid_to_message,
    to_bytes,
    to_floats,
    vector_of,
    xyz,
)
from sal_height.messages.types import (
    ComplexImage,
    Header,
    HeightImage,
    Image,
    PointCloud2,
    PointField,
    Provenance,
    TransformStamped,
    Vector3,
)
from sal_height.messages.types import Surface as SurfaceMessage
from sal_height.numeric import F32, F64, Bool
from sal_height.relief import HeightField, Surface, covariances_from_sigma, folded, is_covariance, unfolded

LAYERS = ("height", "sigma", "cnr_db", "east", "north")
"""Names of the fields of a Surface message that have a number per pixel, always."""

OPTIONAL = {"spread": 1, "covariance": 6, "common_covariance": 6}
"""Its other fields, with their numbers per pixel; they may be empty."""

_USABLE = np.zeros(256, np.bool_)
_USABLE[list(USABLE)] = True

POINT_FIELDS = (
    *("x", "y", "z", "height", "sigma", "cnr_db", "spread", "surface"),
    *("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu"),
)
"""Fields of the points of a height image: place in the frame of the cloud (m), the layers of Surface, the number of the
surface, strongest first, and the covariance of the place with that from the pose, m^2."""


def height_to_message(
    field: HeightField,
    aperture: ApertureState,
    looks: tuple[int, int],
    estimator: str,
    source: ComplexImage | HeightImage,
    provenance: Provenance,
) -> HeightImage:
    """Return the HeightImage of a field of heights, with the stamp and the dwell of its `source`."""
    image = HeightImage(
        header=source.header,
        dwell=source.dwell,
        estimator=estimator,
        grid=grid_to_message(field.grid),
        aperture=aperture_to_message(aperture),
        range_looks=looks[0],
        azimuth_looks=looks[1],
        validity=to_bytes(field.validity),
        provenance=provenance,
    )
    image.surfaces = [_surface_to_message(surface, field.grid) for surface in field.surfaces]
    if field.order_probability is not None:
        image.order_probability = to_floats(field.order_probability)
    return image


def _surface_to_message(surface: Surface, grid: Grid) -> SurfaceMessage:
    offset = surface.positions - grid.origin
    values = (surface.height, surface.sigma, surface.cnr_db, offset[..., 0], offset[..., 1])
    message = SurfaceMessage(**{name: to_floats(numbers) for name, numbers in zip(LAYERS, values, strict=True)})
    message.spread = to_floats(surface.spread)
    if np.isfinite(surface.own_covariance[..., 0, 0]).any():
        message.covariance = to_floats(folded(surface.own_covariance))
    if surface.common_covariance is not None:
        message.common_covariance = to_floats(folded(surface.common_covariance))
    return message


def field_from_message(image: HeightImage, map_frame: str = MAP_FRAME) -> HeightField:
    """Return the surfaces of a HeightImage.

    A pixel that is usable by its validity but one of whose scatterers has no finite height, sigma, east or north, a
    sigma that is not greater than 0, or a matrix that is no covariance, gets the validity MISSING_DATA; `bad_pixels`
    counts them. Images of older versions tell no covariance: it then follows from sigma and the pose.

    Raises:
        Rejected: the image cannot be used; the sentence names the field, its value and what is allowed.
    """
    where = f"HeightImage of dwell {image.dwell}"
    if image.header.frame_id != map_frame:
        raise Rejected(
            "wrong frames",
            f"{where} is in {image.header.frame_id!r}; it must be in {map_frame!r} (parameter map_frame).",
        )
    if not image.surfaces:
        raise Rejected("wrong size", f"{where} has no surface; it must have at least one.")
    grid = grid_from_message(image.grid)
    _check_sizes(image, grid, where)
    check_geometry(image.grid, image.aperture, where)
    validity = np.array(image.validity, dtype=np.uint8).reshape(grid.shape)
    held = np.where(validity == Validity.INTERPOLATED, 1, scatterer_count(validity))
    aperture = aperture_from_message(image.aperture)
    surfaces = _surfaces_from_messages(image.surfaces, grid, aperture)
    number = np.arange(len(image.surfaces))[:, None, None]
    sound = (held <= len(image.surfaces)) & (_is_sound(surfaces) | (held <= number)).all(axis=0)
    validity[~sound] = Validity.MISSING_DATA
    held[~sound] = 0
    probability = float_view(image.order_probability, (*grid.shape, ORDERS)) if len(image.order_probability) else None
    return HeightField(
        grid,
        validity,
        surfaces.where(held > number).each(),
        None if probability is None else probability.astype(np.float64),
    )


def _check_sizes(image: HeightImage, grid: Grid, where: str) -> None:
    """Every array has as many entries as the grid needs.

    Raises:
        Rejected: one has not.
    """
    count = grid.rows * grid.cols
    sizes = {"validity": (len(image.validity), count)}
    if len(image.order_probability):
        sizes["order_probability"] = len(image.order_probability), ORDERS * count
    for number, surface in enumerate(image.surfaces):
        for name in LAYERS:
            sizes[f"surfaces[{number}].{name}"] = len(getattr(surface, name)), count
        for name, each in OPTIONAL.items():
            if size := len(getattr(surface, name)):
                sizes[f"surfaces[{number}].{name}"] = size, each * count
    for name, (size, needed) in sizes.items():
        if size != needed or count == 0:
            raise Rejected(
                "wrong size",
                f"{where}: {name} has {size} entries, {grid.rows} x {grid.cols} pixels need {needed} (at least 1).",
            )


def _surfaces_from_messages(surfaces: Sequence[SurfaceMessage], grid: Grid, aperture: ApertureState) -> Surface:
    """Surfaces seen from `aperture`, arrays of shape (surfaces, rows, cols, ...).

    Spread that is not told is 0, covariance that is not told follows from sigma.
    """
    shape = len(surfaces), *grid.shape
    height, sigma, cnr_db, east, north, spread = np.zeros((6, *shape))
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        for number, message in enumerate(surfaces):
            for name, layer in zip((*LAYERS, "spread"), (height, sigma, cnr_db, east, north, spread), strict=True):
                if len(numbers := getattr(message, name)):
                    layer[number] = float_view(numbers, grid.shape)
    positions = above_place(grid.origin[0] + east, grid.origin[1] + north, height)
    own = _covariances([message.covariance for message in surfaces], grid)
    told = [message.common_covariance for message in surfaces]
    common = _covariances(told, grid) if any(map(len, told)) else None
    for number, message in enumerate(surfaces):
        if not len(message.covariance) and np.isfinite(sigma[number]).any():
            own[number], by_pose = covariances_from_sigma(sigma[number], positions[number], aperture)
            if by_pose is not None:
                common = np.zeros_like(own) if common is None else common
                common[number] = by_pose
    return Surface(height, sigma, cnr_db, positions, spread, own, common)


def _is_sound(surface: Surface) -> Bool:
    """Where surfaces can be used: place, height, sigma and the covariances are possible values, same shape."""
    sound = surface.is_determined & (surface.spread >= 0) & (surface.spread <= FARTHEST)
    sound &= np.abs(surface.height) <= FARTHEST
    for covariance in (surface.own_covariance, surface.common_covariance):
        if covariance is not None:
            sound &= is_covariance(covariance) & ~(np.abs(covariance) > FARTHEST**2).any(axis=(-2, -1))
    return sound


def _covariances(triangles: Sequence[Sequence[float]], grid: Grid) -> F64:
    """Symmetric matrices, shape (surfaces, rows, cols, 3, 3), from their upper triangles; of none told they are 0."""
    numbers = np.zeros((len(triangles), *grid.shape, OPTIONAL["covariance"]), np.float32)
    for surface, triangle in zip(numbers, triangles, strict=True):
        if len(triangle):
            surface[...] = float_view(triangle, surface.shape)
    return unfolded(numbers)


def bad_pixels(image: HeightImage, field: HeightField) -> int:
    """Return the number of pixels that are usable by their validity in `image` but masked in `field`, made of it."""
    said = _USABLE[np.asarray(image.validity, np.uint8)]
    return int(np.count_nonzero(said & ~_USABLE[field.validity.ravel()]))


def bad_pixel_warning(image: HeightImage, count: int) -> UserError:
    """Return the warning that says how many pixels of a height image were masked."""
    return UserError(
        f"HeightImage of dwell {image.dwell}: {count} of {len(image.validity)} pixels are usable by their validity, "
        f"but their height, sigma, spread, east, north or covariance is not finite or beyond {FARTHEST:g} m, sigma is "
        "not greater than 0, or a covariance is not positive semidefinite; they are left out."
    )


def height_picture(image: HeightImage) -> Image:
    """Return the heights of the first surface as a 32FC1 image for image viewers, NaN where they are not valid."""
    return float_picture(float_view(image.surfaces[0].height, (image.grid.rows, image.grid.cols)), image.header)


def float_picture(values: F32, header: Header) -> Image:
    """Return an array (rows, cols) as a 32FC1 image."""
    rows, cols = values.shape
    data = np.ascontiguousarray(values).reshape(-1).view(np.uint8)
    return Image(header=header, height=rows, width=cols, encoding="32FC1", step=4 * cols, data=data)


def frame_near(origin: F64, header: Header, name: str) -> TransformStamped:
    """Return a frame called `name` with the axes of the header's frame and its origin at `origin`, m.

    Points are published relative to a frame near them: single precision has 4 mm at 50 km.
    """
    near = TransformStamped(header=header, child_frame_id=name)
    near.transform.translation = Vector3(**xyz(origin))
    return near


def height_points(field: HeightField, frame: TransformStamped) -> PointCloud2:
    """Return all scatterers as a cloud of points in `frame` for viewers, with the fields POINT_FIELDS."""
    origin = vector_of(frame.transform.translation)
    points = np.concatenate([_points(surface, number, origin) for number, surface in enumerate(field.surfaces)])
    return point_cloud(points, POINT_FIELDS, frame)


def point_cloud(points: F32, names: Sequence[str], frame: TransformStamped) -> PointCloud2:
    """Return points of shape (points, fields) as a cloud in `frame` whose fields have these `names`."""
    return PointCloud2(
        header=Header(stamp=frame.header.stamp, frame_id=frame.child_frame_id),
        height=1,
        width=len(points),
        fields=[PointField(name=n, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, n in enumerate(names)],
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=points.reshape(-1).view(np.uint8),
        is_dense=True,
    )


def _points(surface: Surface, number: int, origin: F64) -> F32:
    """Return the scatterers of a surface as points relative to `origin`, shape (scatterers, POINT_FIELDS)."""
    seen = np.isfinite(surface.height)
    layers = (surface.height, surface.sigma, surface.cnr_db, surface.spread)
    columns = [*(surface.positions[seen] - origin).T, *(layer[seen] for layer in layers)]
    covariance = folded(surface.covariance[seen])
    which = np.full(len(covariance), number)
    return np.ascontiguousarray(np.column_stack([*columns, which, covariance]), dtype=np.float32)
