"""Node psf_calibration: calibrates the sensor on the images (slc) of many dwells."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from rclpy._rclpy_pybind11 import RCLError

from sal_height import messages
from sal_height.calibration import CalibrationSettings, Calibrator, save_calibration
from sal_height.errors import Rejected, UserError
from sal_height.geometry import sphere_point
from sal_height.messages import ReceivedImage
from sal_height.messages.types import Calibration, ComplexImage, Time
from sal_height.nodes.dwell_stage import ChannelParameters, DwellStage
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import CALIBRATION, IMAGES, LATCHED_QOS, RESET, SENSOR_TOPICS
from sal_height.numeric import F64
from sal_height.sensor import Sensor
from sal_height.settings import setting

MOST_DWELLS = 1024
"""Greatest number of dwells for one calibration: 130 MB of pixels from 16 channels."""


class Parameters(ChannelParameters, CalibrationSettings):
    """Parameters of the node."""

    dwells: int = setting(
        64, "dwells that a calibration is made from; then the next calibration begins", minimum=1, maximum=MOST_DWELLS
    )
    dwell_step: int = setting(
        10,
        "use every n-th dwell only: receivers change slowly, and computing time is limited",
        minimum=1,
        maximum=1_000_000,
    )
    target: str = setting(
        "",
        "place of a reference target as E,N,H: arc distances east and north of the map's origin, and height, all in m; "
        "empty: there is none",
        read_only=True,
    )
    file: str = setting(
        "",
        "path of the .npz file that each calibration is written to; an existing file is replaced; empty: none",
        names_file=True,
    )


class PsfCalibration(DwellStage):
    """Estimates receivers and beams from the images of whatever is flown over, and publishes a calibration."""

    parameters = Parameters
    inputs: ClassVar[Topics] = {"sensor_info": SENSOR_TOPICS["sensor_info"], **IMAGES}
    outputs = CALIBRATION
    takes_images = True
    settable = True
    answers: ClassVar[Topics] = {**RESET, "~/save": "make a calibration of the dwells so far"}
    completes_file = True

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__("psf_calibration", ComplexImage, "slc", **node_arguments)
        self._calibrator: Calibrator | None = None
        try:
            self._target = _place(self.current_parameters().target)
        except UserError:
            super().destroy_node()
            raise
        self._dwells = 0
        self._made = False
        self._stamp = Time()
        self._ending = threading.Lock()  # the context may be shut down in another thread than the executor's
        self._calibration = self.offer(Calibration, "calibration", LATCHED_QOS)
        self.serve("~/save", self._save)
        self.context.on_shutdown(self.conclude)

    def check(self, message: ReceivedImage, sensor: Sensor) -> None:
        """Check the size of an image, and that no calibration has been applied to it."""
        messages.check_slc(message, sensor)
        applied = message.provenance.calibration_id
        if applied not in {"", sensor.calibration_id}:
            raise Rejected(
                "calibrated already",
                f"Dwell {message.dwell}, channel {message.channel}: calibration {applied!r} was applied to the "
                "image; calibration needs images as the sensor delivers them (parameter calibration of "
                "sar_compression).",
            )

    def process(self, images: list[ReceivedImage], sensor: Sensor, _: None) -> int:
        """Use the images of every n-th dwell; publish a calibration when there are enough of them."""
        parameters = self.current_parameters()
        self._dwells += 1
        if (self._dwells - 1) % parameters.dwell_step:
            return 0
        if self._calibrator is None or self._calibrator.sensor.config_hash != sensor.config_hash:
            self._calibrator = Calibrator(sensor, self._target, parameters)
        try:
            self._calibrator.add(messages.slc_from_messages(images))
        except Rejected as error:
            raise Rejected(error.reason, f"Dwell {images[0].dwell}: {error}") from error
        self._stamp = images[0].header.stamp
        return self._complete() if self._calibrator.dwells >= parameters.dwells else 0

    def forget_results(self) -> int:
        """Begin a new calibration with the next dwell."""
        self._calibrator, self._dwells = None, 0
        return 0

    def _save(self) -> tuple[bool, str]:
        """Make a calibration of the dwells so far."""

        def complete() -> str:
            if self._calibrator is None or not self._calibrator.dwells:
                return "no dwell was used yet"
            self._complete()
            return ""

        failure = self.wait_for(complete)
        return not failure, failure or self.current_parameters().file or "published"

    def conclude(self) -> None:
        """If no calibration was made yet, make one from the dwells so far. May be called twice."""
        with self._ending:
            self.finish()
            if self._calibrator and self._calibrator.dwells and not self._made:
                self._complete()

    def destroy_node(self) -> None:
        """Complete a pending calibration, then end the node."""
        self.conclude()
        super().destroy_node()

    def _complete(self) -> int:
        """Publish the calibration of the dwells so far and write its file; returns the number of messages."""
        calibrator, self._calibrator = self._calibrator, None
        if calibrator is None:
            return 0
        calibration, undetermined = calibrator.calibration()
        self._made = True
        for sentence in undetermined:
            self.get_logger().warning(sentence)
        with suppress(RCLError):  # the context may have ended: nobody is left to publish to
            self._calibration.publish(messages.calibration_to_message(calibration, self._stamp, undetermined))
        file = self.current_parameters().file
        if file:
            try:
                save_calibration(Path(file), calibration)
            except UserError as error:
                self.ignore("file", error)
        return 1


def _place(text: str) -> F64 | None:
    """Place of the reference target in the map, m; None: there is none.

    Raises:
        UserError: the text is not three numbers.
    """
    if not text:
        return None
    try:
        east, north, height = (float(number) for number in text.split(","))
    except ValueError as error:
        raise UserError(
            f"Parameter target is {text!r}; it must be three numbers, E,N,H in m, as in 12.5,-3,1.2, or empty."
        ) from error
    return sphere_point(east, north, height)


def main() -> int:
    """Console script."""
    return run_node(PsfCalibration)


if __name__ == "__main__":
    raise SystemExit(main())
