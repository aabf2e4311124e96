"""Node sar_compression: phase_history + platform/odometry → slc."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from nav_msgs.msg import Odometry
from sal_height_msgs.msg import ComplexImage, DetectorFrame, Provenance

from sal_height import __version__, compression, convert
from sal_height.backprojection import backproject
from sal_height.dwell import Dwell
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Aperture, Grid
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.parameters import as_json, parameter
from sal_height.nodes.program import run_node
from sal_height.nodes.stage import ODOMETRY_QOS
from sal_height.processing import Processing
from sal_height.sensor import Sensor
from sal_height.trajectory import PlatformState, Trajectory
from sal_height.waveform import range_compressed
from sal_height.windows import WINDOWS, broadening

HELD_STATES = 20_000
"""Odometry samples held: 100 s at 200 Hz."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    image_plane: str = parameter(
        "slant", "plane of the image: slant (range and Doppler) or ground (horizontal)", choices=("slant", "ground")
    )
    rows: int = parameter(0, "pixels in range; 0: all of the range window (slant)", minimum=0, maximum=65536)
    cols: int = parameter(0, "pixels in azimuth; 0: one beamwidth (slant)", minimum=0, maximum=65536)
    ground_spacing_m: float = parameter(1.0, "pixel spacing in the ground plane, m", minimum=1e-6, maximum=1e6)
    range_window: str = parameter("taylor", "window over the bandwidth", choices=tuple(sorted(WINDOWS)))
    azimuth_window: str = parameter("rectangular", "window over the aperture", choices=tuple(sorted(WINDOWS)))
    max_odometry_gap_s: float = parameter(
        0.5, "longest time between two odometry samples during a dwell, s", minimum=1e-6, maximum=3600.0
    )
    timeout_s: float = parameter(
        5.0, "wait for missing detectors or odometry, s", minimum=0.01, maximum=3600.0, read_only=True
    )


class SarCompression(DwellStage):
    """Focuses the frames of all detectors of a dwell with one and the same filter."""

    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__("sar_compression", DetectorFrame, "phase_history", **node_arguments)
        self._states: list[PlatformState] = []
        self.listen(Odometry, "platform/odometry", self._on_odometry, ODOMETRY_QOS)
        self._slc = self.offer(ComplexImage, "slc")

    def check(self, message: DetectorFrame, sensor: Sensor) -> None:
        """Size, numbers and pulse times of a frame."""
        convert.check_frame(message, sensor)

    def missing(self, dwell: Dwell[DetectorFrame]) -> Rejected | None:
        """Odometry from before the first pulse to after the last, without gaps."""
        frame = next(iter(dwell.items.values()))
        start_ns = convert.to_ns(frame.header.stamp)
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

    def process(self, messages: list[DetectorFrame], sensor: Sensor) -> int:
        """Compress a dwell and publish the image of each detector."""
        parameters = self.current_parameters()
        history = convert.history_from_messages(messages)
        history, sensor = range_compressed(history, sensor)
        track = Trajectory(self._states_around(history.stamp_ns, float(history.pulse_times[-1])))
        aperture = track.aperture(history.stamp_ns, history.pulse_times)
        processing = Processing(parameters.range_window, parameters.azimuth_window)
        reference = float(history.reference_range[len(history.reference_range) // 2])
        grid = _grid(parameters, sensor, aperture, reference, broadening(processing.range_weights(sensor.sample_count)))
        antenna = track.positions(history.stamp_ns, history.pulse_times)
        slc = backproject(history, antenna, sensor, processing, grid)
        provenance = Provenance(
            code_version=__version__,
            config_hash=sensor.config_hash,
            calibration_id=sensor.calibration_id,
            parameters=as_json(self.get_name(), parameters),
        )
        noise = compression.slc_noise_power(sensor, processing, len(antenna))
        images = convert.slc_to_messages(slc, grid, aperture, noise, messages[0], provenance)
        for image in images:
            self._slc.publish(image)
        return len(images)

    def _on_odometry(self, message: Odometry) -> None:
        try:
            state = convert.state_from_message(message)
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


def _grid(parameters: Parameters, sensor: Sensor, aperture: Aperture, reference: float, broadened: float) -> Grid:
    """Pixels of the image that the parameters ask for."""
    if parameters.image_plane == "ground":
        if not (parameters.rows and parameters.cols):
            raise UserError("Parameters rows and cols are 0; in the ground plane they must be given.")
        spacing = parameters.ground_spacing_m
        return compression.ground_plane_grid(sensor, aperture, reference, parameters.rows, parameters.cols, spacing)
    all_rows, all_cols = compression.slant_plane_size(sensor, aperture, reference, broadened)
    rows, cols = parameters.rows or all_rows, parameters.cols or all_cols
    return compression.slant_plane_grid(sensor, aperture, reference, rows, cols, broadened)


def main() -> int:
    """Console script."""
    return run_node(SarCompression)


if __name__ == "__main__":
    raise SystemExit(main())
