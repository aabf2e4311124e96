"""Conversion of height images, and the images and point clouds that viewers show of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from sal_height.engine.frames import MAP_FRAME
from sal_height.engine.geometry_items import Aperture
from sal_height.engine.height_items import Heights, PackedSurface, packed
from sal_height.engine.provenance import Provenance, flat_values
from sal_height.engine.stage import DwellKey
from sal_height.errors import Rejected, UserError
from sal_height.geometry import ApertureState
from sal_height.messages.basics import aperture_to_message, grid_to_message, to_ns, to_stamp, vector_of, xyz
from sal_height.messages.parameters import shared_parameter, value_of
from sal_height.messages.products import doubt_fields, doubts_of, place_of, provenance_of, provenance_to_message
from sal_height.messages.types import (
    ComplexImage,
    Header,
    HeightImage,
    Image,
    Parameter,
    PointCloud2,
    PointField,
    TransformStamped,
    Vector3,
)
from sal_height.messages.types import Provenance as ProvenanceMessage
from sal_height.messages.types import Surface as SurfaceMessage
from sal_height.numeric import F32, F64
from sal_height.relief import HeightField, Surface, folded
from sal_height.settings import Settings


def with_stage(before: Sequence[Parameter], stage: str, values: Settings | Mapping[str, Any]) -> list[Parameter]:
    """The value of Provenance.parameters with the parameters of one more stage.

    Args:
        before: parameters of the earlier stages; those of `stage` among them are replaced.
        stage: name of the node, which is the part before the first dot in the names of its parameters.
        values: values of the parameters, by name. Nested mappings make names with further dots; None is left out.
    """
    kept = [parameter for parameter in before if not parameter.name.startswith(f"{stage}.")]
    return kept + [shared_parameter(name, value) for name, value in flat_values(values, f"{stage}.").items()]


def stages_of(parameters: Sequence[Parameter]) -> dict[str, dict[str, Any]]:
    """The values in a Provenance.parameters by stage and name of the parameter.

    Raises:
        Rejected: a value is of a type that ROS parameters do not have.
    """
    stages: dict[str, dict[str, Any]] = {}
    for parameter in parameters:
        stage, _, name = parameter.name.partition(".")
        try:
            stages.setdefault(stage, {})[name] = value_of(parameter.value)
        except UserError as error:
            sentence = (
                f"Provenance.parameters has {parameter.name!r} of type {parameter.value.type}; 0 to 9 are allowed."
            )
            raise Rejected("wrong provenance", sentence) from error
    return stages


_LAYERS = tuple(layer.name for layer in fields(PackedSurface))

_NONE = Provenance()
"""Provenance of heights for which it does not matter."""

POINT_FIELDS = (
    *("x", "y", "z", "height", "sigma", "cnr_db", "spread", "surface"),
    *("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu"),
)
"""Fields of the points of a height image: position in the frame of the cloud (m), the layers of Surface, the number of
the surface, strongest first, and the covariance of the position with that from the pose, m^2."""


def heights_of(message: HeightImage) -> Heights:
    """Return the heights that a HeightImage describes.

    Raises:
        Rejected: its provenance has a value of a type that ROS parameters do not have, or the covariance of its pose
            has neither 36 entries nor none.
    """
    return _heights_of(message, provenance_of(message.provenance))


def _heights_of(message: HeightImage, provenance: Provenance) -> Heights:
    place = place_of(message)
    return Heights(
        DwellKey(provenance.config_hash, message.dwell, to_ns(message.header.stamp)),
        message.header.frame_id,
        message.estimator,
        place.grid,
        place.aperture,
        (message.range_looks, message.azimuth_looks),
        np.asarray(message.validity, np.uint8),
        tuple(
            PackedSurface(**{name: np.asarray(getattr(one, name), np.float32) for name in _LAYERS})
            for one in message.surfaces
        ),
        np.asarray(message.order_probability, np.float32),
        provenance,
        **doubts_of(message),
    )


def heights_to_message(heights: Heights) -> HeightImage:
    """Return the HeightImage that describes heights."""
    return HeightImage(
        header=Header(stamp=to_stamp(heights.key.stamp_ns), frame_id=heights.frame_id),
        dwell=heights.key.number,
        estimator=heights.estimator,
        grid=grid_to_message(heights.grid),
        aperture=aperture_to_message(heights.aperture),
        range_looks=heights.looks[0],
        azimuth_looks=heights.looks[1],
        validity=heights.validity,
        surfaces=[SurfaceMessage(**{name: getattr(one, name) for name in _LAYERS}) for one in heights.surfaces],
        order_probability=heights.order_probability,
        provenance=provenance_to_message(heights.provenance),
        **doubt_fields(heights),
    )


def height_to_message(
    field: HeightField,
    aperture: ApertureState,
    looks: tuple[int, int],
    estimator: str,
    source: ComplexImage | HeightImage,
    provenance: ProvenanceMessage,
) -> HeightImage:
    """Return the HeightImage of a field of heights, with the stamp and the dwell of its `source`."""
    key = DwellKey("", source.dwell, to_ns(source.header.stamp))
    seen, made = Aperture.of(aperture), packed(field)
    heights = Heights(key, source.header.frame_id, estimator, aperture=seen, looks=looks, provenance=_NONE, **made)
    image = heights_to_message(heights)
    image.provenance = provenance
    return image


def field_from_message(image: HeightImage, map_frame: str = MAP_FRAME) -> HeightField:
    """Return the surfaces of a HeightImage; `Heights.field` states which parts are left out.

    Raises:
        Rejected: the image cannot be used; the text names the field, its value and the allowed values.
    """
    heights = _heights_of(image, _NONE)
    heights.check_frame(map_frame)
    return heights.field


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
