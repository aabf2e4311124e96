"""Conversion of single-look complex images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, TypeAlias

import numpy as np

from sal_height.errors import Rejected
from sal_height.imaging import Slc
from sal_height.messages.autofocus import placement_of, residual_phase_of
from sal_height.messages.basics import (
    MAP_FRAME,
    aperture_from_message,
    aperture_to_message,
    check_channel,
    check_geometry,
    complex_view,
    grid_from_message,
    grid_to_message,
    to_floats,
)
from sal_height.messages.provenance import held_stages
from sal_height.messages.received import ReceivedImage
from sal_height.messages.types import ComplexImage, Header, Provenance
from sal_height.numeric import WINDOWS
from sal_height.sensor import Sensor

Image: TypeAlias = ComplexImage | ReceivedImage
"""An image, as a message or as received."""


class Labelled(Protocol):
    """What says which dwell it is of: a frame or an image, as a message or as received."""

    @property
    def header(self) -> Header:
        """Stamp and name of a frame of coordinates."""

    @property
    def dwell(self) -> int:
        """Number of the dwell."""


def slc_to_messages(
    slc: Slc,
    frame: Labelled,
    provenance: Provenance,
    map_frame: str = MAP_FRAME,
    air_delay: str = "",
) -> list[ComplexImage]:
    """Return one ComplexImage for each channel, with the labels of `frame`.

    They share one grid, one aperture and one provenance, which are to be left as they are, and have views of the
    pixels.

    Args:
        slc: images of all channels.
        frame: has the stamp and the dwell.
        provenance: how they were made.
        map_frame: name of the frame of positions.
        air_delay: ComplexImage.AIR_REMOVED or AIR_LEFT; empty: not known.
    """
    grid, aperture, stamp = grid_to_message(slc.grid), aperture_to_message(slc.aperture), frame.header.stamp
    return [
        ComplexImage(
            header=Header(stamp=stamp, frame_id=map_frame),
            dwell=frame.dwell,
            channel=channel,
            grid=grid,
            aperture=aperture,
            noise_power=float(slc.noise_power[channel]),
            saturated_share=float(slc.saturated_share[channel]),
            air_delay=air_delay,
            samples=to_floats(image),
            provenance=provenance,
        )
        for channel, image in enumerate(slc.images)
    ]


def check_slc(image: Image, sensor: Sensor) -> None:
    """Check that an image has the size that its grid states, and values that can be processed.

    Raises:
        Rejected: it has not; the sentence names the field, its value and what is allowed.
    """
    where = f"ComplexImage of dwell {image.dwell}, channel {image.channel}"
    check_channel(image.channel, sensor, where)
    grid = image.grid
    count = 2 * grid.rows * grid.cols
    if len(image.samples) != count or count == 0:
        raise Rejected(
            "wrong size",
            f"{where}: samples has {len(image.samples)} entries, {grid.rows} x {grid.cols} complex pixels need "
            f"{count}.",
        )
    if not math.isfinite(image.noise_power) or math.isinf(image.saturated_share):
        raise Rejected(
            "not finite",
            f"{where}: noise_power is {image.noise_power}, saturated_share {image.saturated_share}; both must be "
            "finite (saturated_share may be NaN: not known).",
        )
    if not (isinstance(image, ReceivedImage) and image.geometry.checked):
        check_geometry(grid, image.aperture, where)
    if isinstance(image, ReceivedImage):
        image.geometry.checked = True


def slc_from_messages(images: Sequence[Image]) -> Slc:
    """Return the images of all channels of a dwell, in order, from messages that `check_slc` has passed.

    Raises:
        Rejected: the channels differ in grid or aperture, or provenance says what cannot be.
    """
    first = images[0]
    for image in images[1:]:
        shared = image.grid is first.grid and image.aperture is first.aperture
        if not shared and (image.grid != first.grid or image.aperture != first.aperture):
            raise Rejected(
                "channels disagree",
                f"Dwell {first.dwell}: channel {image.channel} has another grid or aperture than channel "
                f"{first.channel}; those of all channels must be equal.",
            )
    grid = grid_from_message(first.grid)
    stage = held_stages(first.provenance).get("sar_compression", {})
    return Slc(
        images=np.stack([complex_view(image.samples, grid.shape) for image in images]),
        grid=grid,
        aperture=aperture_from_message(first.aperture),
        noise_power=np.array([image.noise_power for image in images]),
        saturated_share=np.array([image.saturated_share for image in images]),
        azimuth_window=recorded_window(first.provenance, "azimuth"),
        range_window=recorded_window(first.provenance, "range"),
        placement=placement_of(stage),
        residual_phase=residual_phase_of(stage),
    )


def recorded_window(provenance: Provenance, axis: str) -> str:
    """Return the name of the window that images were made with, which their provenance, never changed, records.

    It is "rectangular" if the provenance does not name a window of `numeric.WINDOWS`.

    Args:
        provenance: of the images.
        axis: "range" or "azimuth".
    """
    name = held_stages(provenance).get("sar_compression", {}).get(f"{axis}_window")
    return name if isinstance(name, str) and name in WINDOWS else "rectangular"
