"""What the height nodes share: slc → <estimator>/height, image and points. A new estimator derives from this."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from sal_height_msgs.msg import Calibration as CalibrationMessage
from sal_height_msgs.msg import ComplexImage, HeightImage
from sensor_msgs.msg import Image, PointCloud2

from sal_height import messages
from sal_height.beams import Beams, column_squint
from sal_height.calibration import Calibration
from sal_height.elevation import (
    LOOK_WINDOWS,
    ElevationEstimate,
    Looks,
    Window,
    live_detectors,
    look_grid,
    moving_squint,
    windowed_looks,
    without_saturated,
)
from sal_height.errors import Rejected, UserError
from sal_height.imaging import image_beams
from sal_height.nodes.dwell import Dwell
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.stage import LATCHED_QOS
from sal_height.numeric import C64, C128, F64, Index
from sal_height.relief import height_field
from sal_height.sensor import MAX_SHARE, Channels, Sensor, whitened_channels, with_powers
from sal_height.settings import Settings, setting

HELD_CALIBRATIONS = 4
"""Calibrations held: images made with one may come after the next."""


class HeightParameters(Settings):
    """Parameters that every height node has."""

    range_looks: int = setting(2, "pixels averaged in range", minimum=1, maximum=4096)
    azimuth_looks: int = setting(2, "pixels averaged in azimuth", minimum=1, maximum=4096)
    range_step: int = setting(
        0,
        "pixels from one height to the next in range; less than range_looks: the averages overlap; 0: as range_looks",
        minimum=0,
        maximum=4096,
    )
    azimuth_step: int = setting(
        0,
        "pixels from one height to the next in azimuth; less than azimuth_looks: the averages overlap; "
        "0: as azimuth_looks",
        minimum=0,
        maximum=4096,
    )
    look_window: str = setting(
        "boxcar", "weights of the pixels that are averaged, in range and azimuth", choices=tuple(LOOK_WINDOWS)
    )
    min_cnr_db: float = setting(5.0, "lowest CNR of a valid pixel", unit="dB", minimum=-60.0, maximum=100.0)
    radial_velocity_mps: float = setting(
        0.0,
        "radial velocity of the targets of interest, positive if they recede; heights and places are right for "
        "targets of this velocity only",
        unit="m/s",
        minimum=-1000.0,
        maximum=1000.0,
    )
    max_saturated_share: float = setting(
        MAX_SHARE,
        "highest share of clipped samples in a channel; above it, all heights of the dwell are marked SATURATED",
        minimum=0.0,
        maximum=1.0,
    )
    timeout_s: float = setting(
        5.0, "longest wait for the missing channels of a dwell", unit="s", minimum=0.01, maximum=3600.0, read_only=True
    )

    @property
    def windows(self) -> tuple[Window, Window]:
        """Looks in range and azimuth."""
        return (
            Window.named(self.look_window, self.range_looks, self.range_step),
            Window.named(self.look_window, self.azimuth_looks, self.azimuth_step),
        )

    @property
    def min_cnr(self) -> float:
        """Least CNR of a valid pixel, power ratio."""
        return float(10 ** (self.min_cnr_db / 10))


def live_channels(slc: C64, sensor: Sensor) -> Index:
    """Numbers of the channels that are not dead (`looks.live_detectors`).

    Raises:
        Rejected: there are fewer than two, or one is missing of channels that are mixtures of detectors.
    """
    live = live_detectors(slc)
    if len(live) < len(slc) and sensor.is_mixed:
        dead = sorted(set(range(len(slc))) - set(live.tolist()))
        raise Rejected(
            "dead channels",
            f"Channels {dead} have no finite sample other than 0 in the images; the detectors cannot be told apart "
            "without one of the channels that the channel matrix of SensorInfo mixes them into.",
        )
    return live


def _saturated(share: float, parameters: HeightParameters) -> str:
    return (
        f"{share:.3g} of a channel's samples are clipped; heights need {parameters.max_saturated_share:g} or less "
        "(max_saturated_share)."
    )


class HeightStage(DwellStage):
    """Turns the images of all detectors of a dwell into one height image; its parameters are HeightParameters."""

    estimator: str
    """Name of the estimator: prefix of the topics, HeightImage.estimator."""

    def __init__(self, name: str, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__(name, ComplexImage, "slc", **node_arguments)
        self._calibrations: dict[str, Calibration] = {}
        self.listen(CalibrationMessage, "calibration", self._on_calibration, LATCHED_QOS)
        self._height = self.offer(HeightImage, f"{self.estimator}/height")
        self._image = self.offer(Image, f"{self.estimator}/image")
        self._points = self.offer(PointCloud2, f"{self.estimator}/points")

    def channels(self, noise_covariance: C128, channel_matrix: C128) -> Channels:
        """The channels that the estimator takes, from those of the sensor: of equal noise (`channels.whitening`)."""
        return whitened_channels(noise_covariance, channel_matrix)

    @abstractmethod
    def estimate(
        self, looks: Looks, beams: Beams, squint: F64, noise_powers: F64, parameters: Any
    ) -> ElevationEstimate:
        """Elevation of every pixel, by the core's estimator; looks, beams and noise powers are of `channels`."""

    def identity(self, message: ComplexImage) -> str:
        """The config_hash of the sensor info that the image was made with."""
        return str(message.provenance.config_hash)

    def check(self, message: ComplexImage, sensor: Sensor) -> None:
        """Size of an image; single bad pixels are marked as such."""
        messages.check_slc(message, sensor)

    def missing(self, dwell: Dwell[ComplexImage]) -> Rejected | None:
        """The calibration that the images were made with: it may have changed the beams."""
        image = next(iter(dwell.items.values()))
        try:
            self._width_factor(image, self.sensor_of(image))
        except Rejected as error:
            return error
        return None

    def process(self, images: list[ComplexImage], sensor: Sensor) -> int:
        """Estimate the heights of a dwell and publish them."""
        parameters = self.current_parameters()
        seen = messages.slc_from_messages(images)
        slc, slc_grid, aperture, noise_powers = seen.images, seen.grid, seen.aperture, seen.noise_power
        live = live_channels(slc, sensor)
        slc = slc if len(live) == len(slc) else slc[live]
        noise = with_powers(sensor.noise_covariance, noise_powers)[np.ix_(live, live)]
        channels = self.channels(noise, sensor.mixing[np.ix_(live, live)])
        before = images[0].provenance
        beams = image_beams(sensor, seen.azimuth_window).widened(self._width_factor(images[0], sensor))
        beams = beams.detectors(live).combined(channels.matrix)
        down, across = parameters.windows
        looks = windowed_looks(slc, down, across, beams.is_complex, channels.transform)
        grid = look_grid(slc_grid, down, across)
        velocity, speed = parameters.radial_velocity_mps, np.linalg.norm(aperture.velocity)
        squint = moving_squint(column_squint(grid, aperture, sensor.beams, sensor.look_side), velocity, speed)
        estimate = self.estimate(looks, beams, squint, channels.noise_powers, parameters)
        share = max(images[channel].saturated_share for channel in live)
        if share > parameters.max_saturated_share:
            estimate = without_saturated(estimate)
            self.ignore("saturated", UserError(f"Dwell {images[0].dwell}: {_saturated(share, parameters)}"))
        field = height_field(estimate, looks, slc_grid, grid, aperture, sensor.look_side, velocity)
        provenance = messages.derived(before, self.get_name(), parameters)
        number_of_looks = (parameters.range_looks, parameters.azimuth_looks)
        image = messages.height_to_message(field, aperture, number_of_looks, self.estimator, images[0], provenance)
        self._image.publish(messages.height_picture(image))
        self._points.publish(messages.height_points(field, image))
        self._height.publish(image)
        return 1

    def _width_factor(self, image: ComplexImage, sensor: Sensor) -> float:
        """Width of the beams over that described, as the calibration has it that the image was made with.

        Raises:
            Rejected: it is not known here.
        """
        applied = image.provenance.calibration_id
        if applied in {"", sensor.calibration_id}:
            return 1.0
        calibration = self._calibrations.get(applied)
        if calibration is None:
            raise Rejected(
                "no calibration",
                f"Dwell {image.dwell}: its images were made with calibration {applied!r}, which has not come on topic "
                "calibration (transient local).",
            )
        return calibration.width_factor

    def _on_calibration(self, message: CalibrationMessage) -> None:
        try:
            calibration = messages.calibration_from_message(message)
        except UserError as error:
            self.ignore("calibration", error)
            return
        held = [*self._calibrations.values(), calibration][-HELD_CALIBRATIONS:]
        self._calibrations = {one.id: one for one in held}
