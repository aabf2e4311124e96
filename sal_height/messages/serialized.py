"""Images and heights as bytes: what images of a dwell share is serialized once, a provenance once for many dwells."""

from __future__ import annotations

import copy

import numpy as np
from rclpy.serialization import serialize_message
from sal_height_msgs import msg as messages

from sal_height.imaging import Slc
from sal_height.messages.basics import MAP_FRAME
from sal_height.messages.images import Labelled, slc_to_messages
from sal_height.messages.received import (
    NOISE,
    UINT,
    channel_offset,
    end_of_heights,
    end_of_provenance,
    noise_offset,
    provenance_bytes,
)


def serialized_slc(
    slc: Slc, frame: Labelled, provenance: messages.Provenance, map_frame: str = MAP_FRAME
) -> list[bytes]:
    """The bytes of one ComplexImage per channel, with the stamp and the dwell of `frame`, in `map_frame`.

    They are those of the first channel but for the channel's number, noise power, saturated share and samples.
    """
    first = serialize_message(slc_to_messages(slc, frame, provenance, 1, map_frame)[0])
    channel, noise = channel_offset(first), noise_offset(first)
    start = noise + NOISE.size
    pixels = np.ascontiguousarray(slc.images, dtype="<c8").reshape(len(slc.images), -1)
    end = start + pixels[0].nbytes
    before, between = first[:channel], first[channel + 4 : noise]
    tail = first[end : end_of_provenance(first, end)]
    numbers = zip(slc.noise_power.tolist(), slc.saturated_share.tolist(), pixels, strict=True)
    return [
        b"".join(
            (
                before,
                UINT.pack(n),
                between,
                NOISE.pack(power, share, 2 * samples.size),
                samples.view(np.uint8).data,
                tail,
            )
        )
        for n, (power, share, samples) in enumerate(numbers)
    ]


def serialized_height(image: messages.HeightImage) -> bytes:
    """The bytes of a height image whose provenance is never changed."""
    bare = copy.copy(image)
    bare.provenance = messages.Provenance()
    cdr = serialize_message(bare)
    head = cdr[: end_of_heights(cdr)]
    return head + provenance_bytes(image.provenance, len(head))
