"""Node psf_calibration: slc of many dwells → calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sal_height_msgs.msg import Calibration, ComplexImage

from sal_height import convert
from sal_height.calibration import save_calibration
from sal_height.calibrator import Calibrator
from sal_height.errors import Rejected
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.height_stage import processed_beams
from sal_height.nodes.parameters import parameter
from sal_height.nodes.program import run_node
from sal_height.nodes.stage import LATCHED_QOS
from sal_height.sensor import Sensor
from sal_height.waveform import spectrum_sensor


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    dwells: int = parameter(64, "dwells that a calibration is made of; then the next begins", minimum=1, maximum=4096)
    dwell_step: int = parameter(
        8, "of so many dwells one is taken in: receivers change slowly, and time is short", minimum=1, maximum=1_000_000
    )
    file: str = parameter(
        "", "file that each calibration is written to, .npz; one that is there is replaced; empty: none"
    )
    timeout_s: float = parameter(5.0, "wait for missing detectors, s", minimum=0.01, maximum=3600.0, read_only=True)


class PsfCalibration(DwellStage):
    """Measures receivers and beams on the images of whatever is flown over, and publishes what it found."""

    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__("psf_calibration", ComplexImage, "slc", **node_arguments)
        self._calibrator: Calibrator | None = None
        self._dwells = 0
        self._calibration = self.offer(Calibration, "calibration", LATCHED_QOS)

    def identity(self, message: ComplexImage) -> str:
        """The config_hash of the sensor info that the image was made with."""
        return str(message.provenance.config_hash)

    def check(self, message: ComplexImage, sensor: Sensor) -> None:
        """Size of an image, and that no calibration has been applied to it."""
        convert.check_slc(message, sensor)
        applied = message.provenance.calibration_id
        if applied not in {"", sensor.calibration_id}:
            raise Rejected(
                "calibrated already",
                f"Dwell {message.dwell}, detector {message.detector}: calibration {applied!r} was applied to the "
                "image; calibration needs images as the sensor delivers them (parameter calibration of "
                "sar_compression).",
            )

    def process(self, messages: list[ComplexImage], sensor: Sensor) -> int:
        """Take in the images of a dwell, or pass it by; publish a calibration if it is the last one needed."""
        parameters = self.current_parameters()
        self._dwells += 1
        if (self._dwells - 1) % parameters.dwell_step:
            return 0
        if self._calibrator is None or self._calibrator.sensor.config_hash != sensor.config_hash:
            beams = processed_beams(sensor, messages[0].provenance.parameters)
            self._calibrator = Calibrator(spectrum_sensor(sensor), beams)
        self._calibrator.add(*convert.slc_from_messages(messages))
        if self._calibrator.dwells < parameters.dwells:
            return 0
        calibration, undetermined = self._calibrator.calibration()
        self._calibrator = None
        for sentence in undetermined:
            self.get_logger().warning(sentence)
        if parameters.file:
            save_calibration(Path(parameters.file), calibration)
        self._calibration.publish(convert.calibration_to_message(calibration, messages[0].header.stamp, undetermined))
        return 1


def main() -> int:
    """Console script."""
    return run_node(PsfCalibration)


if __name__ == "__main__":
    raise SystemExit(main())
