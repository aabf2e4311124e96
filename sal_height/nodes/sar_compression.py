"""Node sar_compression: forms the images (slc) of all channels from phase_history and platform/odometry."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sal_height import __version__, messages
from sal_height.calibration import Calibration, load_calibration
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Motion, Mounting, PlatformState, Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.messages import Pose, ReceivedFrame
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import ChannelFrame, ComplexImage, Odometry, Provenance, TFMessage
from sal_height.nodes.account import CALIBRATIONS
from sal_height.nodes.air import (
    AIR_TOPICS,
    OTHER_CLOCK_S,
    USED_AIR,
    AirHistory,
    AirParameters,
    heard_air,
)
from sal_height.nodes.dwell_stage import ChannelParameters, DwellStage
from sal_height.nodes.held import HELD_CALIBRATIONS, Held
from sal_height.nodes.odometry import Arrival, OdometryHistory
from sal_height.nodes.parameters import FrameParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import IMAGES, LATCHED_QOS, ODOMETRY_QOS, SENSOR_TOPICS
from sal_height.nodes.static_frames import StaticFrames
from sal_height.nodes.transforms import TF_STATIC, TF_STATIC_QOS, has_transforms
from sal_height.pipeline import Compressor
from sal_height.rehearsal import once, rehearsed_slc
from sal_height.sensor import Sensor
from sal_height.settings import setting

HEARD = "topic"
"""Value of the parameter calibration: apply the calibration that comes on the topic calibration."""

NOT_TRUSTED = "autofocus found no phase error that it can trust; the image is focused with the odometry alone."


class Parameters(FrameParameters, AirParameters, ImageSettings, ChannelParameters):
    """Settings of the images, and what the node needs besides."""

    calibration: str = setting(
        "",
        "path of a calibration file, which is applied to the images and published on topic calibration; 'topic': apply "
        "the last calibration received on topic calibration; empty: none",
        read_only=True,
        names_file=True,
    )
    max_odometry_gap_s: float = setting(
        0.5, "longest time between two odometry samples during a dwell", unit="s", minimum=1e-6, maximum=3600.0
    )
    odometry_interval_s: float = setting(
        0.05,
        "longest time between two odometry samples that is no gap; in a gap the covariance of the pose grows by what "
        "the platform may have done meanwhile",
        unit="s",
        minimum=1e-6,
        maximum=3600.0,
    )
    acceleration_noise: float = setting(
        0.1,
        "acceleration that odometry does not show, for gaps",
        unit="m/s^2/sqrt(Hz)",
        minimum=0.0,
        maximum=1000.0,
    )
    turning_noise: float = setting(
        0.01,
        "angular acceleration that odometry does not show, for gaps",
        unit="rad/s^2/sqrt(Hz)",
        minimum=0.0,
        maximum=1000.0,
    )
    mounting_from_tf: bool = setting(
        False,
        "take the place of the sensor on the platform from /tf_static, where frame_id of its mounting is to be found, "
        "and not from sensor_info",
        read_only=True,
    )
    odometry_held_s: float = setting(
        100.0,
        "time for which odometry is held; a dwell must be complete within it",
        unit="s",
        minimum=1.0,
        maximum=86400.0,
        read_only=True,
    )

    @property
    def motion(self) -> Motion:
        """What gaps in the odometry leave open."""
        return Motion(self.acceleration_noise, self.turning_noise, self.odometry_interval_s)


class Supplies(NamedTuple):
    """What a dwell is compressed with besides its frames.

    Attributes:
        states: odometry from the last sample before the first pulse to the first after the last pulse.
        calibration: of the sensor's receivers; None: there is none.
        mounting: of the sensor on the platform.
        air: that was heard, as values of the parameters that state a measured one; None: none is to be heard.
    """

    states: list[PlatformState]
    calibration: Calibration | None
    mounting: Mounting
    air: Mapping[str, float] | None = None


class SarCompression(DwellStage):
    """Forms the images of all channels of a dwell, each with the same filter."""

    parameters = Parameters
    inputs: ClassVar[Topics] = {
        **SENSOR_TOPICS,
        **AIR_TOPICS,
        "calibration": "calibration to apply, only if the parameter calibration is topic",
        TF_STATIC: "frame of the sensor on the platform, only if the parameter mounting_from_tf is true",
    }
    outputs: ClassVar[Topics] = {
        **IMAGES,
        "calibration": "calibration of the file that the parameter calibration names",
    }
    settable = True
    niceness = 4

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, the calibration cannot be used, or transforms are
                wanted without tf2_msgs.
        """
        super().__init__("sar_compression", ChannelFrame, "phase_history", **node_arguments)
        self._odometry = OdometryHistory(self.current_parameters().odometry_held_s)
        self._last_pulse_ns = 0
        self._awaited_ns = math.inf
        """Earliest stamp of odometry that a dwell waits for, as far as known; infinity: none does."""
        self._compressor = Compressor()
        self._calibration: Calibration | None = None
        self._heard = Held[Calibration](HELD_CALIBRATIONS)
        """Calibrations that came on the topic, by config_hash of their sensor."""
        self._frames = StaticFrames()
        self._air = AirHistory()
        try:
            self._begin_calibration(self.current_parameters().calibration)
            if self.current_parameters().mounting_from_tf:
                self._begin_transforms()
        except UserError:
            self.destroy_node()
            raise
        self.listen(Odometry, "platform/odometry", self._on_odometry, ODOMETRY_QOS, read=messages.received_pose)
        self._air_inlets = {
            topic: self.listen(
                one.message_type, topic, functools.partial(self._on_air, topic), ODOMETRY_QOS, optional=True
            )
            for topic, one in messages.AIR.items()
        }
        self._slc = self.offer(ComplexImage, "slc")

    @property
    def is_ready(self) -> bool:
        """Whether it can work on a dwell, also as to the air if that is to be heard."""
        if not super().is_ready or self.current_parameters().air != messages.HEARD_AIR:
            return super().is_ready
        sensors = map(self._sensors.get, self._sensors)
        needed = {topic for sensor in sensors if sensor for topic in messages.needed_air(sensor.wavelength)}
        return all(self._air_inlets[topic].is_connected for topic in needed)

    def check(self, message: ReceivedFrame, sensor: Sensor) -> None:
        """Check size, samples and pulse times of a frame."""
        messages.check_frame(message, sensor)
        self._last_pulse_ns = max(self._last_pulse_ns, message.end_ns)

    def supplies(self, dwell: list[ReceivedFrame], sensor: Sensor) -> Supplies:
        """Odometry from before the first pulse to after the last without gaps, and calibration and air in force.

        Raises:
            Rejected: the odometry does not cover the pulses yet, or has a gap; the sensor's frame, or the air, is not
                known yet.
            UserError: the sensor's frame is nowhere on a platform.
        """
        frame = dwell[0]
        delay_ns = self.current_parameters().odometry_delay_ns
        states = self._odometry.around(frame.stamp_ns + delay_ns, frame.end_ns + delay_ns)
        gap = longest_gap_s(states)
        limit = self.current_parameters().max_odometry_gap_s
        if gap <= limit:
            air = heard_air(self._air, frame, sensor, states, self.current_parameters())
            if gap > self.current_parameters().odometry_interval_s:
                self.tally.note("odometry.bridged")
            return Supplies(states, self._calibration_for(sensor), self._mounting_of(sensor), air)
        self._awaited_ns = min(self._awaited_ns, frame.end_ns + delay_ns)
        found = f"there are {gap:g} s between two" if states else self._odometry_held(frame.stamp_ns)
        raise Rejected(
            "odometry gap",
            f"Dwell {frame.dwell}: platform/odometry must reach from its first pulse to its last with a sample "
            f"every {limit:g} s (max_odometry_gap_s); {found}.{self.source_warning}",
        )

    def _odometry_held(self, start_ns: int) -> str:
        """What odometry there is, relative to a dwell that it does not cover."""
        if self._odometry.span_ns is None:
            return "no sample has come (is its QoS compatible?)"
        first, last = ((stamp_ns - start_ns) * 1e-9 for stamp_ns in self._odometry.span_ns)
        held = f"samples are held from {first:.6g} s to {last:.6g} s after its first pulse"
        return f"{held}: frames and odometry have different clocks" if abs(first) > OTHER_CLOCK_S else held

    def rehearse(self, sensor: Sensor) -> None:
        """Compress made-up dwells."""
        settings = self.current_parameters()
        once(
            (sensor.digest, settings),
            lambda: rehearsed_slc(sensor, settings, Compressor(), np.random.default_rng(0)),
        )

    def forget(self) -> None:
        """Forget odometry, unfinished dwells, and the strip that dwells are blocks of."""
        self._odometry = OdometryHistory(self.current_parameters().odometry_held_s)
        self._last_pulse_ns, self._awaited_ns = 0, math.inf
        super().forget()

    def forget_results(self) -> int:
        """Begin a new strip."""
        self._compressor = Compressor()
        return 0

    def process(self, frames: list[ReceivedFrame], sensor: Sensor, supplies: Supplies) -> int:
        """Compress a dwell, or the columns that a block completes of a strip, and publish the image of each channel."""
        found = compress_dwell(frames, sensor, supplies, self._compressor, self.current_parameters(), self.get_name())
        slc, images = found or (None, [])
        for warning in warnings_of(frames[0].dwell, slc, self._compressor):
            self.ignore(warning.reason, warning)
        for image in images:
            self._slc.publish(image)
        return len(images)

    def _begin_calibration(self, source: str) -> None:
        """Load the calibration of a file and publish it, or listen to the topic; nothing if `source` is empty."""
        if source == HEARD:
            self.listen(CalibrationMessage, "calibration", self._on_calibration, LATCHED_QOS, optional=True)
        elif source:
            self._calibration = load_calibration(Path(source))
            stamp = messages.to_stamp(self.get_clock().now().nanoseconds)
            self.offer(CalibrationMessage, "calibration", LATCHED_QOS).publish(
                messages.calibration_to_message(self._calibration, stamp)
            )

    def _begin_transforms(self) -> None:
        """Listen to the frames on the platform.

        Raises:
            UserError: there are no such messages.
        """
        if not has_transforms():
            raise UserError(
                "Parameter mounting_from_tf needs the package tf2_msgs, which a ROS installation has and PyPI has not; "
                "source the installation, or state the mounting in sensor_info."
            )
        self.listen(TFMessage, TF_STATIC, self._on_transforms, TF_STATIC_QOS)

    def _on_transforms(self, message: Any) -> None:
        for transform in message.transforms:
            try:
                self._frames.add(transform)
            except UserError as error:
                self.ignore("transform", error)
        self.advance()

    def _mounting_of(self, sensor: Sensor) -> Mounting:
        """Where the sensor is on the platform.

        Raises:
            Rejected: its frame is not known yet.
            UserError: it is nowhere on a platform.
        """
        parameters = self.current_parameters()
        if not parameters.mounting_from_tf:
            return sensor.mounting
        name, body = sensor.mounting.frame_id, parameters.body_frame
        place = self._frames.place(name, body)
        if place is None:
            raise Rejected(
                "no mounting",
                f"Nothing on {TF_STATIC} says where {name!r} (sensor_info, mounting.frame_id) is in {body!r}; publish "
                "it, as static_transform_publisher does, or set mounting_from_tf to false.",
            )
        mounting = Mounting(name, tuple(place.translation.tolist()), tuple(place.rotation.as_quat().tolist()))
        return parameters.frames.axes.mounting(mounting)

    def _calibration_for(self, sensor: Sensor) -> Calibration | None:
        """The calibration to apply to a sensor's frames: that of the file, or its own if it was heard on the topic."""
        return self._calibration or self._heard.use(sensor.config_hash)

    def _on_calibration(self, message: CalibrationMessage) -> None:
        if calibration := self.read_calibration(message):
            self._heard.put(calibration.config_hash, calibration)
        self.tell(CALIBRATIONS)

    def _on_air(self, topic: str, message: Any) -> None:
        try:
            self._air.add(topic, messages.read_air(topic, message))
        except Rejected as error:
            self.ignore("air", error)

    def _on_odometry(self, pose: Pose) -> None:
        try:
            state = messages.state_of_pose(pose, self.current_parameters().frames)
        except Rejected as error:
            self.ignore("odometry", error)
            return
        if state.stamp_ns <= self._last_pulse_ns + self.current_parameters().odometry_delay_ns:
            self.note_progress()  # what dwells still wait for is on its way
        arrival = self._odometry.add(state)
        if arrival is Arrival.SET_ASIDE:
            self.ignore("odometry out of time", UserError(_out_of_time(state, self._odometry)))
        elif arrival is not Arrival.IN_ORDER:
            self.tally.note(f"odometry.{arrival.value}")
        if state.stamp_ns >= self._awaited_ns or arrival is not Arrival.IN_ORDER:
            self._awaited_ns = math.inf  # dwells that go on waiting will say so
            self.advance()


def longest_gap_s(states: Sequence[PlatformState]) -> float:
    """The longest time between two samples of odometry, s; infinity: there are none."""
    return max(((later.stamp_ns - earlier.stamp_ns) * 1e-9 for earlier, later in pairwise(states)), default=math.inf)


def compress_dwell(
    frames: Sequence[ReceivedFrame],
    sensor: Sensor,
    supplies: Supplies,
    compressor: Compressor,
    parameters: Parameters,
    node: str = "sar_compression",
) -> tuple[Slc, list[bytes]] | None:
    """The images of all channels of a dwell, or of the columns that a block completes of a strip.

    Args:
        frames: of all channels, in their order.
        sensor: that took them.
        supplies: what else there is for the dwell.
        compressor: which has compressed the dwells before.
        parameters: of the node.
        node: its name, for the provenance.

    Returns:
        The images, and the message of each channel, serialized; None: of too few pulses as yet.

    Raises:
        UserError: the dwell cannot be compressed.
    """
    if supplies.mounting != sensor.mounting:
        sensor = replace(sensor, mounting=supplies.mounting)
    history, calibration = messages.history_from_messages(frames), supplies.calibration
    track = Trajectory(supplies.states, motion=parameters.motion)
    settings, stated = parameters, dict(parameters)
    if supplies.air is not None:
        settings = parameters.changed(air="measured", **supplies.air)
        stated[USED_AIR] = supplies.air
    slc = compressor.add(history, track, sensor, settings, calibration)
    if slc is None:
        return None
    provenance = Provenance(
        code_version=__version__,
        config_hash=sensor.config_hash,
        calibration_id=calibration.id if calibration else sensor.calibration_id,
        parameters=messages.with_stage([], node, {**stated, **messages.autofocus_values(slc)}),
        autofocus_phase=slc.autofocus_phase.astype(np.float32),
    )
    air_delay = ComplexImage.AIR_REMOVED if settings.atmosphere else ComplexImage.AIR_LEFT
    return slc, messages.serialized_slc(slc, frames[0], provenance, parameters.map_frame, air_delay)


def warnings_of(dwell: int, slc: Slc | None, compressor: Compressor) -> Iterator[Rejected]:
    """What to warn of in a dwell that has been compressed and is used all the same.

    Args:
        dwell: its number.
        slc: its images; None: those come with a later dwell.
        compressor: which has compressed it.
    """
    if slc is None:
        if compressor.shortfall:
            yield Rejected("strip incomplete", f"Dwell {dwell}: {compressor.shortfall}")
        return
    if slc.focus and not slc.focus.trusted:
        yield Rejected("autofocus", f"Dwell {dwell}: {NOT_TRUSTED}")
    if slc.doubt:
        yield Rejected("odometry", f"Dwell {dwell}: {slc.doubt}")


def _out_of_time(state: PlatformState, history: OdometryHistory) -> str:
    _, last_ns = history.span_ns or (0, 0)
    return (
        f"A sample is stamped {(state.stamp_ns - last_ns) * 1e-9:.6g} s after the latest one; it is used only if the "
        "next sample continues it, as when the clock has started anew."
    )


def main() -> int:
    """Console script."""
    return run_node(SarCompression)


if __name__ == "__main__":
    raise SystemExit(main())
