"""A stage that works on the images of all channels of a dwell, and knows the calibrations that they were made with."""

from __future__ import annotations

from typing import Any, ClassVar

from sal_height import messages
from sal_height.calibration import Calibration
from sal_height.errors import Rejected
from sal_height.messages import ReceivedImage
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import ComplexImage
from sal_height.nodes.account import CALIBRATIONS
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.held import HELD_CALIBRATIONS, Held
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import CALIBRATION, IMAGES, LATCHED_QOS, SENSOR_TOPICS
from sal_height.sensor import Sensor


class ImageStage(DwellStage):
    """Takes the images of all channels of a dwell, with the calibration that they were made with."""

    inputs: ClassVar[Topics] = {"sensor_info": SENSOR_TOPICS["sensor_info"], **IMAGES, **CALIBRATION}
    takes_images = True
    settable = True

    def __init__(self, name: str, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(name, ComplexImage, "slc", **node_arguments)
        self._calibrations = Held[Calibration](HELD_CALIBRATIONS)
        self.listen(CalibrationMessage, "calibration", self._on_calibration, LATCHED_QOS, optional=True)

    def check(self, message: ReceivedImage, sensor: Sensor) -> None:
        """Size of an image; single bad pixels are marked as such."""
        messages.check_slc(message, sensor)

    def supplies(self, dwell: list[ReceivedImage], sensor: Sensor) -> Calibration | None:
        """The calibration that the images were made with: it may have changed the beams."""
        return self._calibration_of(dwell[0], sensor)

    def _calibration_of(self, image: ReceivedImage, sensor: Sensor) -> Calibration | None:
        """The calibration that an image was made with; None: the sensor's own, or none.

        Raises:
            Rejected: it has not come.
        """
        applied = applied_calibration(image, sensor)
        calibration = self._calibrations.use(applied) if applied else None
        if applied and calibration is None:
            raise Rejected(
                "no calibration",
                f"Dwell {image.dwell}: its images were made with calibration {applied!r}, which has not come on topic "
                "calibration (transient local).",
            )
        return calibration

    def _on_calibration(self, message: CalibrationMessage) -> None:
        if calibration := self.read_calibration(message):
            self._calibrations.put(calibration.id, calibration)
        self.tell(CALIBRATIONS)


def applied_calibration(image: ReceivedImage, sensor: Sensor) -> str:
    """Identity of the calibration that an image was made with; empty: none but that in its sensor's description."""
    applied = image.provenance.calibration_id
    return "" if applied == sensor.calibration_id else applied
