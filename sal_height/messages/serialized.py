"""Images and heights as bytes: a provenance, which is the same for many dwells, is serialized once."""

from __future__ import annotations

from sal_height.engine.frames import MAP_FRAME
from sal_height.imaging import Slc
from sal_height.messages.codec import SHIPPED
from sal_height.messages.images import Labelled, slc_to_messages
from sal_height.messages.types import HeightImage, Provenance


def serialized_slc(
    slc: Slc, frame: Labelled, provenance: Provenance, map_frame: str = MAP_FRAME, air_delay: str = ""
) -> list[bytes]:
    """The bytes of one ComplexImage per channel, with the stamp and the dwell of `frame`, in `map_frame`.

    The provenance is one that is never changed.
    """
    images = slc_to_messages(slc, frame, provenance, map_frame=map_frame, air_delay=air_delay)
    return [SHIPPED.serialize(image, shared=True) for image in images]


def serialized_height(image: HeightImage) -> bytes:
    """The bytes of a height image whose provenance is never changed."""
    return SHIPPED.serialize(image, shared=True)
