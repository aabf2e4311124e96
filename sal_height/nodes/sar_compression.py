"""Node sar_compression: phase_history + platform/odometry → slc."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import Odometry
from sal_height_msgs.msg import ComplexImage, DetectorFrame, Provenance

from sal_height import __version__, compression, convert
from sal_height.dwell import Dwell
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Aperture, Grid
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.parameters import as_json, parameter
from sal_height.nodes.stage import ODOMETRY_QOS, run_node
from sal_height.sensor import Sensor
from sal_height.trajectory import PlatformState, Trajectory
from sal_height.windows import WINDOWS, broadening, noise_gain, window

HELD_STATES = 20_000
"""Odometry samples held: 100 s at 200 Hz."""

NEIGHBOURS = 4
"""Odometry samples used before and after the aperture."""


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
        """Odometry up to the last pulse."""
        frame = next(iter(dwell.items.values()))
        start = convert.to_ns(frame.header.stamp)
        end = start + round(frame.pulse_time[-1] * 1e9)
        if self._states and self._states[0].stamp_ns <= start and end <= self._states[-1].stamp_ns:
            return None
        return Rejected(
            "odometry gap", f"Dwell {dwell.key[0]}: platform/odometry does not cover its pulses from first to last."
        )

    def process(self, messages: list[DetectorFrame], sensor: Sensor) -> int:
        """Compress a dwell and publish the image of each detector."""
        parameters = self.current_parameters()
        history = convert.history_from_messages(messages)
        track = Trajectory(self._states_around(history.stamp_ns, float(history.pulse_times[-1])))
        aperture = track.aperture(history.stamp_ns, history.pulse_times)
        weights = window(parameters.range_window, sensor.frequency_count)
        reference = float(history.reference_range[len(history.reference_range) // 2])
        grid = _grid(parameters, sensor, aperture, reference, broadening(weights))
        antenna = track.positions(history.stamp_ns, history.pulse_times)
        slc = compression.backproject(history, antenna, sensor, weights, grid.pixels())
        gain = noise_gain(weights) / (sensor.pulse_count * sensor.frequency_count)
        provenance = Provenance(
            code_version=__version__,
            config_hash=sensor.config_hash,
            calibration_id=sensor.calibration_id,
            parameters=as_json(self.get_name(), parameters),
        )
        noise = [gain * power for power in sensor.noise_power]
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
            states = states[: bisect.bisect_left(states, state.stamp_ns, key=lambda s: s.stamp_ns)]
        self._states = [*states[-HELD_STATES:], state]
        self.advance()

    def _states_around(self, start_ns: int, seconds: float) -> list[PlatformState]:
        """The odometry samples in an aperture and a few beyond."""
        stamps = [state.stamp_ns for state in self._states]
        first = bisect.bisect_right(stamps, start_ns) - NEIGHBOURS
        last = bisect.bisect_left(stamps, start_ns + round(seconds * 1e9)) + NEIGHBOURS
        return self._states[max(0, first) : last]


def _grid(parameters: Parameters, sensor: Sensor, aperture: Aperture, reference: float, broadened: float) -> Grid:
    """Pixels of the image that the parameters ask for."""
    if parameters.image_plane == "ground":
        if not (parameters.rows and parameters.cols):
            raise UserError("Parameters rows and cols are 0; in the ground plane they must be given.")
        spacing = parameters.ground_spacing_m
        return compression.ground_plane_grid(sensor, aperture, reference, parameters.rows, parameters.cols, spacing)
    beam = sensor.beamwidth * reference
    cells = beam / compression.azimuth_resolution(sensor, aperture, reference)
    rows = parameters.rows or max(1, int(sensor.frequency_count / broadened))
    cols = parameters.cols or max(1, int(cells + 1e-6))
    return compression.slant_plane_grid(sensor, aperture, reference, rows, cols, broadened)


def main() -> int:
    """Console script."""
    return run_node(SarCompression)


if __name__ == "__main__":
    raise SystemExit(main())
