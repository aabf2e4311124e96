"""Node sar_compression: phase_history + platform/odometry → slc."""

from __future__ import annotations

import bisect
from itertools import pairwise
from pathlib import Path
from typing import Any

from nav_msgs.msg import Odometry
from sal_height_msgs.msg import Calibration as CalibrationMessage
from sal_height_msgs.msg import ComplexImage, DetectorFrame, Provenance

from sal_height import __version__, messages
from sal_height.calibration import Calibration, load_calibration
from sal_height.errors import Rejected, UserError
from sal_height.geometry import PlatformState, Trajectory
from sal_height.imaging import ImageSettings
from sal_height.nodes.dwell import Dwell
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.program import run_node
from sal_height.nodes.stage import LATCHED_QOS, ODOMETRY_QOS
from sal_height.pipeline import Compressor
from sal_height.sensor import Sensor
from sal_height.settings import setting

HELD_STATES = 20_000
"""Odometry samples held: 100 s at 200 Hz."""

HEARD = "topic"
"""Value of the parameter calibration for that which comes on the topic."""

NOT_TRUSTED = "autofocus found nothing that it could trust, the image is as navigation focuses it."


class Parameters(ImageSettings):
    """Settings of the images, and what the node needs besides."""

    calibration: str = setting(
        "",
        "path of a calibration file, which is applied to the images and published on topic calibration; 'topic': apply "
        "the last calibration received on topic calibration; empty: none",
        read_only=True,
    )
    max_odometry_gap_s: float = setting(
        0.5, "longest time between two odometry samples during a dwell", unit="s", minimum=1e-6, maximum=3600.0
    )
    timeout_s: float = setting(
        5.0,
        "longest wait for the missing channels or odometry of a dwell",
        unit="s",
        minimum=0.01,
        maximum=3600.0,
        read_only=True,
    )


class SarCompression(DwellStage):
    """Focuses the frames of all detectors of a dwell with one and the same filter."""

    parameters = Parameters
    settable = True

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, or the calibration cannot be used.
        """
        super().__init__("sar_compression", DetectorFrame, "phase_history", **node_arguments)
        self._states: list[PlatformState] = []
        self._compressor = Compressor()
        self._calibration: Calibration | None = None
        self._begin_calibration(self.current_parameters().calibration)
        self.listen(Odometry, "platform/odometry", self._on_odometry, ODOMETRY_QOS)
        self._slc = self.offer(ComplexImage, "slc")

    def check(self, message: DetectorFrame, sensor: Sensor) -> None:
        """Size, numbers and pulse times of a frame."""
        messages.check_frame(message, sensor)

    def missing(self, dwell: Dwell[DetectorFrame]) -> Rejected | None:
        """Odometry from before the first pulse to after the last, without gaps."""
        frame = next(iter(dwell.items.values()))
        start_ns = messages.to_ns(frame.header.stamp)
        limit = self.current_parameters().max_odometry_gap_s
        stamps = [state.stamp_ns for state in self._states_around(start_ns, frame.pulse_time[-1])]
        gaps = [(later - earlier) * 1e-9 for earlier, later in pairwise(stamps)]
        if gaps and max(gaps) <= limit:
            return None
        return Rejected(
            "odometry gap",
            f"Dwell {dwell.key[0]}: platform/odometry must reach from its first pulse to its last with a sample every "
            f"{limit:g} s (max_odometry_gap_s); "
            + (f"there are {max(gaps):g} s between two." if gaps else "it does not (is its QoS compatible?)."),
        )

    def process(self, frames: list[DetectorFrame], sensor: Sensor) -> int:
        """Compress a dwell, or what a block completes of a strip, and publish the image of each detector."""
        parameters = self.current_parameters()
        history, calibration = messages.history_from_messages(frames), self._calibration_for(sensor)
        track = Trajectory(self._states_around(history.stamp_ns, float(history.pulse_times[-1])))
        slc = self._compressor.add(history, track, sensor, parameters, calibration)
        if slc is None:
            return 0
        if slc.focus and not slc.focus.trusted:
            self.ignore("autofocus", UserError(f"Dwell {frames[0].dwell}: {NOT_TRUSTED}"))
        provenance = Provenance(
            code_version=__version__,
            config_hash=sensor.config_hash,
            calibration_id=calibration.id if calibration else sensor.calibration_id,
            parameters=messages.as_json(self.get_name(), parameters),
            autofocus_phase=slc.autofocus_phase.tolist(),
        )
        images = messages.slc_to_messages(slc, frames[0], provenance)
        for image in images:
            self._slc.publish(image)
        return len(images)

    def _begin_calibration(self, source: str) -> None:
        """Load the calibration of a file and publish it, or listen to the topic; nothing if `source` is empty."""
        if source == HEARD:
            self.listen(CalibrationMessage, "calibration", self._on_calibration, LATCHED_QOS)
        elif source:
            self._calibration = load_calibration(Path(source))
            stamp = self.get_clock().now().to_msg()
            self.offer(CalibrationMessage, "calibration", LATCHED_QOS).publish(
                messages.calibration_to_message(self._calibration, stamp)
            )

    def _calibration_for(self, sensor: Sensor) -> Calibration | None:
        """The calibration to apply to a sensor's frames: that of the file, or its own if it was heard on the topic."""
        calibration = self._calibration
        heard = self.current_parameters().calibration == HEARD
        if calibration is None or (heard and calibration.config_hash != sensor.config_hash):
            return None
        return calibration

    def _on_calibration(self, message: CalibrationMessage) -> None:
        try:
            self._calibration = messages.calibration_from_message(message)
        except UserError as error:
            self.ignore("calibration", error)

    def _on_odometry(self, message: Odometry) -> None:
        try:
            state = messages.state_from_message(message)
        except Rejected as error:
            self.ignore("odometry", error)
            return
        states = self._states
        if states and state.stamp_ns <= states[-1].stamp_ns:
            # A clock that starts anew, or a sample that comes twice: what is later than this one is obsolete.
            states = states[: bisect.bisect_left(states, state.stamp_ns, key=_stamp)]
        self._states = [*states[-HELD_STATES:], state]
        self.advance()

    def _states_around(self, start_ns: int, seconds: float) -> list[PlatformState]:
        """The odometry samples from the last before an aperture to the first after it; none if it is not covered."""
        states = self._states
        end_ns = start_ns + round(seconds * 1e9)
        first = bisect.bisect_right(states, start_ns, key=_stamp) - 1
        last = bisect.bisect_left(states, end_ns, key=_stamp)
        return states[first : last + 1] if 0 <= first < last < len(states) else []


def _stamp(state: PlatformState) -> int:
    return state.stamp_ns


def main() -> int:
    """Console script."""
    return run_node(SarCompression)


if __name__ == "__main__":
    raise SystemExit(main())
