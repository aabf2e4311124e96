"""Conversion of images, heights and relief maps, and of their position, provenance and doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np

from sal_height.doubts import Doubt, FitTest
from sal_height.engine.frames import MAP_FRAME
from sal_height.engine.geometry_items import Aperture
from sal_height.engine.height_items import Heights, PackedSurface, packed
from sal_height.engine.image_items import ChannelImage, Images, Place, check_image
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.provenance import Provenance, Same
from sal_height.engine.results import DwellKey
from sal_height.geometry import ApertureState
from sal_height.imaging import Slc
from sal_height.messages.basics import (
    aperture_of,
    aperture_to_message,
    grid_from_message,
    grid_to_message,
    to_bytes,
    to_floats,
    to_ns,
    to_stamp,
)
from sal_height.messages.codec import deserialize, serialize
from sal_height.messages.parameters import named_values, shared_parameter
from sal_height.messages.types import Aperture as ApertureMessage
from sal_height.messages.types import ChannelFrame, ComplexImage, Header, HeightImage, ImageGrid, ReliefLayer, ReliefMap
from sal_height.messages.types import Doubt as DoubtMessage
from sal_height.messages.types import FitTest as FitTestMessage
from sal_height.messages.types import Provenance as ProvenanceMessage
from sal_height.messages.types import Surface as SurfaceMessage
from sal_height.relief import HeightField
from sal_height.sensor import Sensor


@lru_cache(8)  # the images of a dwell share theirs
def _place_of(grid: bytes, aperture: bytes) -> Place:
    """Grid and aperture from their serialized messages."""
    return Place(grid_from_message(deserialize(grid, ImageGrid)), aperture_of(deserialize(aperture, ApertureMessage)))


def place_of(message: Any) -> Place:
    """Grid and aperture of an image; those of equal numbers are the same object.

    Raises:
        Rejected: the covariance of the pose has neither 36 entries nor none.
    """
    return _place_of(serialize(message.grid), serialize(message.aperture))


@lru_cache(16)
def _provenance_of(shared: Same[Any]) -> Provenance:
    message = shared.one
    return Provenance(
        message.code_version,
        message.config_hash,
        message.calibration_id,
        {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in named_values(message.parameters)
            if value is not None
        },
        np.array(message.autofocus_phase, np.float32),
    )


def provenance_of(message: Any) -> Provenance:
    """A provenance; that of the same message is the same object.

    Raises:
        Rejected: a value is of a type that ROS parameters do not have.
    """
    return _provenance_of(Same(message))


@lru_cache(16)
def _provenance_message(shared: Same[Provenance]) -> Any:
    one = shared.one
    return ProvenanceMessage(
        code_version=one.code_version,
        config_hash=one.config_hash,
        calibration_id=one.calibration_id,
        parameters=[shared_parameter(name, value) for name, value in one.parameters.items()],
        autofocus_phase=one.autofocus_phase,
    )


def provenance_to_message(provenance: Provenance) -> Any:
    """The message of a provenance; that of the same object is the same object."""
    return _provenance_message(Same(provenance))


def doubts_of(message: Any) -> dict[str, Any]:
    """Order, doubts and fit of a product, as attributes of its item."""
    return {
        "order": message.order,
        "doubts": tuple(
            Doubt(one.name, one.sentence, one.channel, one.size, one.unit, one.p_value) for one in message.doubts
        ),
        "fit": tuple(
            FitTest(one.name, one.channel, one.statistic, one.p_value, one.size, one.sigma, one.unit)
            for one in message.fit
        ),
    }


def doubt_fields(item: Images | ChannelImage | Heights) -> dict[str, Any]:
    """Order, doubts and fit of an item, as fields of its message."""
    return {
        "order": item.order,
        "doubts": [DoubtMessage(**one._asdict()) for one in item.doubts],
        "fit": [FitTestMessage(**one._asdict()) for one in item.fit],
    }


def received_image(cdr: bytes) -> ChannelImage:
    """Read the bytes of a ComplexImage; samples are a view of them, equal geometries and provenances one object.

    Raises:
        BrokenMessage: the bytes are not a ComplexImage.
        Rejected: an error of `image_of`.
    """
    return image_of(deserialize(cdr, ComplexImage, shared=True), len(cdr))


def image_of(message: ComplexImage, size: int = 0) -> ChannelImage:
    """Return the image that a ComplexImage describes; `size`: bytes of the serialized message.

    Raises:
        Rejected: its provenance has a value of a type that ROS parameters do not have, or the covariance of its pose
            has neither 36 entries nor none.
    """
    provenance = provenance_of(message.provenance)
    return ChannelImage(
        DwellKey(provenance.config_hash, message.dwell, to_ns(message.header.stamp)),
        message.header.frame_id,
        message.channel,
        place_of(message),
        message.noise_power,
        message.saturated_share,
        np.asarray(message.samples, np.float32),
        provenance,
        message.air_delay,
        **doubts_of(message),
        size=size,
    )


def images_to_messages(images: Images) -> list[ComplexImage]:
    """Return the ComplexImage of each channel; they share grid, aperture and provenance, which must not be changed."""
    shared = _place_to_messages(images.place)
    return [_image_to_message(image, shared) for image in images.channels()]


def _place_to_messages(place: Place) -> tuple[ImageGrid, ApertureMessage]:
    return grid_to_message(place.grid), aperture_to_message(place.aperture)


def _image_to_message(image: ChannelImage, place: tuple[ImageGrid, ApertureMessage]) -> ComplexImage:
    grid, aperture = place
    return ComplexImage(
        header=Header(stamp=to_stamp(image.key.stamp_ns), frame_id=image.frame_id),
        dwell=image.key.number,
        channel=image.channel,
        grid=grid,
        aperture=aperture,
        noise_power=image.noise_power,
        saturated_share=image.saturated_share,
        air_delay=image.air_delay,
        samples=image.samples,
        provenance=provenance_to_message(image.provenance),
        **doubt_fields(image),
    )


def slc_to_messages(
    slc: Slc,
    frame: ChannelFrame | ComplexImage,
    provenance: ProvenanceMessage,
) -> list[ComplexImage]:
    """Return one ComplexImage for each channel, with the labels of `frame`.

    They share one provenance, which must not be changed, and have views of the pixels.

    Args:
        slc: images of all channels.
        frame: frame with the stamp and the dwell.
        provenance: provenance of the images.
    """
    key, place = DwellKey("", frame.dwell, to_ns(frame.header.stamp)), Place(slc.grid, Aperture.of(slc.aperture))
    images = Images(key, MAP_FRAME, slc, place, Provenance())
    made = [_image_to_message(one, _place_to_messages(place)) for one in images.channels()]
    for one in made:
        one.provenance = provenance
    return made


def check_slc(image: ComplexImage, sensor: Sensor) -> None:
    """Check that an image has the size that its grid states, and values that can be processed.

    Raises:
        Rejected: it has not; the text names the field, its value and the allowed values.
    """
    check_image(image_of(image), sensor)


def slc_from_messages(images: Sequence[ComplexImage]) -> Slc:
    """Return the images of all channels of a dwell, in order, from messages that `check_slc` has passed.

    Raises:
        Rejected: the channels differ in grid or aperture, or provenance states impossible values.
    """
    return Images.joined([image_of(image) for image in images]).slc


def recorded_window(provenance: ProvenanceMessage, axis: str) -> str:
    """Return the name of the window that images were made with, which their provenance, never changed, records.

    It is "rectangular" if the provenance does not name a window of `numeric.WINDOWS`.

    Args:
        provenance: provenance of the images.
        axis: axis of the window, "range" or "azimuth".
    """
    return provenance_of(provenance).window(axis)


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
