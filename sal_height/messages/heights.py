"""Conversion of height images and relief maps."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from sal_height.engine.frames import MAP_FRAME
from sal_height.engine.geometry_items import Aperture
from sal_height.engine.height_items import Heights, PackedSurface, packed
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.provenance import Provenance
from sal_height.engine.stage import DwellKey
from sal_height.geometry import ApertureState
from sal_height.messages.basics import aperture_to_message, grid_to_message, to_bytes, to_floats, to_ns, to_stamp
from sal_height.messages.products import doubt_fields, doubts_of, place_of, provenance_of, provenance_to_message
from sal_height.messages.types import ComplexImage, Header, HeightImage, ReliefLayer, ReliefMap
from sal_height.messages.types import Provenance as ProvenanceMessage
from sal_height.messages.types import Surface as SurfaceMessage
from sal_height.relief import HeightField

_LAYERS = tuple(layer.name for layer in fields(PackedSurface))

_NONE = Provenance()
"""Provenance of heights for which it does not matter."""


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


def relief_to_message(placed: PlacedRelief) -> ReliefMap:
    """Return the ReliefMap, of one layer, that describes a map."""
    relief = placed.relief
    rows, cols = relief.height.shape
    layer = ReliefLayer(
        name=placed.layer,
        height=to_floats(relief.height),
        sigma=to_floats(relief.sigma),
        disagreement=to_floats(relief.disagreement),
        kind=np.zeros(0, np.uint8) if relief.kind is None else to_bytes(relief.kind),
        count=relief.count.ravel(),
    )
    return ReliefMap(
        header=Header(stamp=to_stamp(placed.key.stamp_ns), frame_id=placed.frame_id),
        crs=placed.crs,
        dwell=placed.key.number,
        images=placed.images,
        estimator=placed.estimator,
        origin_east=relief.east,
        origin_north=relief.north,
        cell_size=relief.cell_size,
        rows=rows,
        cols=cols,
        layers=[layer],
        provenance=provenance_to_message(placed.provenance),
    )
