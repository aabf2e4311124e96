"""Complex images of a dwell, of one channel or of all, as their messages state them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sal_height.calibration import Calibration
from sal_height.doubts import Doubt, FitTest
from sal_height.engine.frame_items import Frame, fault_of_channel
from sal_height.engine.geometry_items import Aperture, are_equal, check_geometry
from sal_height.engine.provenance import Provenance
from sal_height.engine.results import DwellKey
from sal_height.errors import Rejected
from sal_height.geometry import Grid, PlatformState
from sal_height.imaging import Slc
from sal_height.numeric import F32
from sal_height.sensor import PhaseHistory, Sensor

AIR_REMOVED, AIR_LEFT = "removed", "left"
"""Values of `air_delay`."""


@dataclass(eq=False)
class Place:
    """Grid of the pixels of images, and aperture; the images of a dwell share it.

    Attributes:
        grid: pixels.
        aperture: aperture that they are seen from.
        is_checked: True if grid and aperture were found to be possible.
    """

    grid: Grid
    aperture: Aperture
    is_checked: bool = False


@dataclass(frozen=True, eq=False)
class ChannelImage:
    """The image of one channel.

    Attributes:
        key: sensor, number and stamp of the dwell.
        frame_id: name of the frame of the map.
        channel: number of the channel.
        place: grid and aperture.
        noise_power: E|n|^2 of one pixel; 0: not known.
        saturated_share: fraction of clipped samples; NaN: not known.
        samples: real and imaginary parts in turn, float32, shape (2 * rows * cols,).
        provenance: record of how it was made.
        air_delay: handling of the delay by the air, AIR_REMOVED or AIR_LEFT; empty: not known.
        order: place of the dwell in the order of processing.
        doubts: reasons to distrust it.
        fit: tests of the data.
        size: size of the message, bytes.
    """

    key: DwellKey
    frame_id: str
    channel: int
    place: Place
    noise_power: float
    saturated_share: float
    samples: F32
    provenance: Provenance
    air_delay: str = ""
    order: int = 0
    doubts: tuple[Doubt, ...] = ()
    fit: tuple[FitTest, ...] = ()
    size: int = 0

    def blank(self, channel: int) -> ChannelImage:
        """An image of zeros for a channel that is missing: estimators leave such a channel out as dead."""
        return replace(self, channel=channel, samples=np.zeros_like(self.samples))


@dataclass(frozen=True, eq=False)
class Source:
    """Data that images were compressed from, where they have not gone through a message.

    Workers of the live host do not return frames and odometry: both are empty there.

    Attributes:
        frames: frames of all channels.
        sensor: sensor that recorded them, with its mounting in the flight.
        states: odometry around the pulses.
        calibration: calibration that was applied; None: none.
        slc: images as they were formed, with what autofocus found.
        settings: settings of the compression.
    """

    frames: Sequence[Frame]
    sensor: Sensor
    states: list[PlatformState]
    calibration: Calibration | None
    slc: Slc
    settings: Any

    @property
    def pulses(self) -> PhaseHistory:
        """Times of the pulses, without samples; there must be frames."""
        first = self.frames[0]
        nothing = np.zeros((0, 0, 0), np.complex64)
        return PhaseHistory(first.key.stamp_ns, first.pulse_time, first.reference_range, nothing)


@dataclass(frozen=True, eq=False)
class Images:
    """The images of all channels of a dwell; attributes as of `ChannelImage`.

    Attributes:
        key: sensor, number and stamp of the dwell.
        frame_id: name of the frame of the map.
        slc: images, as readers of their messages receive them.
        place: grid and aperture.
        provenance: record of how they were made.
        air_delay: handling of the delay by the air, AIR_REMOVED or AIR_LEFT; empty: not known.
        order: place of the dwell in the order of processing.
        doubts: reasons to distrust them.
        fit: tests of the data.
        source: data that they were compressed from; None: not known, as where they arrived as messages.
    """

    key: DwellKey
    frame_id: str
    slc: Slc
    place: Place
    provenance: Provenance
    air_delay: str = ""
    order: int = 0
    doubts: tuple[Doubt, ...] = ()
    fit: tuple[FitTest, ...] = ()
    source: Source | None = None

    @classmethod
    def made_of(cls, key: DwellKey, frame_id: str, slc: Slc, provenance: Provenance, **others: object) -> Images:
        """Images that were compressed here, rounded as their messages are.

        Args:
            key: sensor, number and stamp of the dwell.
            frame_id: name of the frame of the map.
            slc: images.
            provenance: record of how they were made.
            others: further attributes.
        """
        place = Place(slc.grid, Aperture.of(slc.aperture), is_checked=True)
        rounded = Slc(
            images=slc.images,
            grid=slc.grid,
            aperture=place.aperture.state,
            noise_power=slc.noise_power,
            saturated_share=slc.saturated_share.astype(np.float32).astype(np.float64),
            azimuth_window=provenance.window("azimuth"),
            range_window=provenance.window("range"),
            placement=provenance.placement,
            residual_phase=provenance.residual_phase,
        )
        return cls(key, frame_id, rounded, place, provenance, doubts=slc.doubts, **others)  # type: ignore[arg-type]

    @classmethod
    def joined(cls, images: Sequence[ChannelImage]) -> Images:
        """The images of all channels, in order, that `check_image` has passed.

        Raises:
            Rejected: the channels differ in grid or aperture, or provenance states what cannot be.
        """
        first = images[0]
        for image in images[1:]:
            if image.place is not first.place and not (
                are_equal(image.place.grid, first.place.grid) and image.place.aperture == first.place.aperture
            ):
                raise Rejected(
                    "channels disagree",
                    f"Dwell {first.key.number}: channel {image.channel} has another grid or aperture than channel "
                    f"{first.channel}; those of all channels must be equal.",
                )
        grid, provenance = first.place.grid, first.provenance
        slc = Slc(
            images=np.stack([image.samples.view(np.complex64).reshape(grid.shape) for image in images]),
            grid=grid,
            aperture=first.place.aperture.state,
            noise_power=np.array([image.noise_power for image in images]),
            saturated_share=np.array([image.saturated_share for image in images]),
            azimuth_window=provenance.window("azimuth"),
            range_window=provenance.window("range"),
            placement=provenance.placement,
            residual_phase=provenance.residual_phase,
        )
        return cls(
            first.key,
            first.frame_id,
            slc,
            first.place,
            provenance,
            first.air_delay,
            first.order,
            first.doubts,
            first.fit,
        )

    def channels(self) -> list[ChannelImage]:
        """The image of each channel; samples are views."""
        powers, shares = self.slc.noise_power.tolist(), self.slc.saturated_share.tolist()
        return [
            ChannelImage(
                self.key,
                self.frame_id,
                channel,
                self.place,
                powers[channel],
                shares[channel],
                np.ascontiguousarray(pixels, np.complex64).reshape(-1).view(np.float32),
                self.provenance,
                self.air_delay,
                self.order,
                self.doubts,
                self.fit,
                pixels.nbytes,
            )
            for channel, pixels in enumerate(self.slc.images)
        ]

    @property
    def count(self) -> int:
        """Number of channels, each of which is a message."""
        return len(self.slc.images)

    @property
    def size(self) -> int:
        """Bytes of the samples."""
        return int(self.slc.images.nbytes)


def check_image(image: ChannelImage, sensor: Sensor) -> None:
    """Check that an image has the size that its grid states, and values that can be processed.

    Raises:
        Rejected: it has not; the message names the field, its value and what is allowed.
    """
    where = f"ComplexImage of dwell {image.key.number}, channel {image.channel}"
    if fault := fault_of_channel(image.channel, sensor):
        raise Rejected(fault[0], f"{where}: {fault[1]}")
    grid = image.place.grid
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
    if not image.place.is_checked:
        check_geometry(grid, image.place.aperture, where)
        image.place.is_checked = True


def check_images(images: Images, sensor: Sensor) -> None:
    """Check that the images of a dwell are of all channels of a sensor, as `check_image` does for one.

    Raises:
        Rejected: they are not.
    """
    if images.count != sensor.detector_count:
        raise Rejected(
            "wrong size",
            f"Images of dwell {images.key.number}: there are {images.count} channels; SensorInfo has "
            f"{sensor.detector_count}.",
        )
    slc, place = images.slc, images.place
    is_possible = (
        place.is_checked
        and slc.images.size > 0
        and slc.images.shape[1:] == place.grid.shape
        and bool(np.isfinite(slc.noise_power).all())
        and not np.isinf(slc.saturated_share).any()
    )
    if not is_possible:  # one by one, to say which and why
        for image in images.channels():
            check_image(image, sensor)


def applied_calibration(provenance: Provenance, sensor: Sensor) -> str:
    """Identity of the calibration that images were made with; empty: none but that in the sensor's description."""
    applied = provenance.calibration_id
    return "" if applied == sensor.calibration_id else applied


def count_messages(item: object) -> int:
    """Number of messages that an item is."""
    return item.count if isinstance(item, Images) else 1
