"""Conversion of single-look complex images."""

from __future__ import annotations

from collections.abc import Sequence

from sal_height.engine.frames import MAP_FRAME
from sal_height.engine.geometry_items import Aperture
from sal_height.engine.image_items import ChannelImage, Images, Place, check_image
from sal_height.engine.provenance import Provenance
from sal_height.engine.stage import DwellKey
from sal_height.imaging import Slc
from sal_height.messages.basics import aperture_to_message, grid_to_message, to_floats, to_ns, to_stamp
from sal_height.messages.codec import deserialize
from sal_height.messages.products import (
    doubt_fields,
    doubts_of,
    place_of,
    provenance_of,
    provenance_to_message,
)
from sal_height.messages.types import ChannelFrame, ComplexImage, Header
from sal_height.messages.types import Provenance as ProvenanceMessage
from sal_height.sensor import Sensor


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
        to_floats(message.samples),
        provenance,
        message.air_delay,
        **doubts_of(message),
        size=size,
    )


def image_to_message(image: ChannelImage) -> ComplexImage:
    """Return the ComplexImage that describes an image."""
    return ComplexImage(
        header=Header(stamp=to_stamp(image.key.stamp_ns), frame_id=image.frame_id),
        dwell=image.key.number,
        channel=image.channel,
        grid=grid_to_message(image.place.grid),
        aperture=aperture_to_message(image.place.aperture),
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
    map_frame: str = MAP_FRAME,
    air_delay: str = "",
) -> list[ComplexImage]:
    """Return one ComplexImage for each channel, with the labels of `frame`.

    They share one provenance, which must not be changed, and have views of the pixels.

    Args:
        slc: images of all channels.
        frame: frame with the stamp and the dwell.
        provenance: provenance of the images.
        map_frame: name of the frame of positions.
        air_delay: state of the air delay, ComplexImage.AIR_REMOVED or AIR_LEFT; empty: not known.
    """
    key, place = DwellKey("", frame.dwell, to_ns(frame.header.stamp)), Place(slc.grid, Aperture.of(slc.aperture))
    made = [image_to_message(one) for one in Images(key, map_frame, slc, place, Provenance(), air_delay).channels()]
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
