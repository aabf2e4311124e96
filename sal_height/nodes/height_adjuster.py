"""Node height_adjuster: moves the heights of an estimator to where earlier dwells saw the same ground.

From <estimator>/height it makes adjusted/height, without the errors of navigation and mounting that overlapping dwells
have told so far, the odometry without them (adjusted/odometry), and the mounting as it should be (adjusted/mounting).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sal_height import messages
from sal_height.adjustment import (
    MOST_POINTS,
    UNKNOWN_GROUND,
    AdjustmentSettings,
    ObservedDwell,
    PoseError,
    Pulses,
    References,
    Terrain,
    Window,
    corrected_aperture,
    corrected_heights,
    corrected_mounting,
    corrected_states,
    describe_ground,
    mounting_covariance,
    placement_in_strip,
    read_targets,
)
from sal_height.elevation import ESTIMATORS
from sal_height.errors import Rejected, UserError
from sal_height.geometry import (
    GREATEST_POSE,
    GREATEST_VELOCITY,
    ApertureState,
    Mounting,
    PlatformState,
    Trajectory,
    known_covariance,
)
from sal_height.messages import Pose
from sal_height.messages.types import HeightImage, Odometry, PoseWithCovarianceStamped
from sal_height.nodes.dwell_stage import DwellParameters, DwellStage
from sal_height.nodes.height_outlets import HeightOutlets
from sal_height.nodes.odometry import Arrival, OdometryHistory
from sal_height.nodes.parameters import FrameParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import LATCHED_QOS, ODOMETRY_QOS, SENSOR_TOPICS, height_topics, payload_bytes
from sal_height.numeric import F64
from sal_height.rehearsal import once, rehearse_adjustment
from sal_height.relief import HeightField
from sal_height.sensor import Sensor
from sal_height.settings import setting, settings_of
from sal_height.simulation.dem import read_elevation_model

PREFIX = "adjusted"
"""Prefix of the topics, and value of HeightImage.estimator."""

ADJUSTED_ODOMETRY = f"{PREFIX}/odometry"
"""Topic of the odometry without the errors that were found."""

ODOMETRY_HELD_S = 2e5
"""Time for which odometry is held, longer than between passes: that of a pass may come before the last heights of the
pass before. Memory is limited by the number of samples."""

LONGEST_DELAY_S = 100.0
"""Delay of the odometry's stamps up to which one that a provenance states is believed."""

BETWEEN_NS = 1_000_000_000
"""Longest time between dwells whose odometry is told as well."""

POSE_ERROR = "pose_error"
"""Name in the provenance, beside the node's parameters, of the error of the pose that was removed."""

KNOWN = "boresight_sigma_rad", "lever_arm_sigma_m", "odometry_delay_sigma_s"
"""Parameters that the compression has as well, whose values there count if they are not 0."""


class Parameters(FrameParameters, DwellParameters, AdjustmentSettings):
    """Parameters of the node."""

    estimator: str = setting(
        "ml",
        "estimator whose heights are adjusted; they come on topic <estimator>/height",
        choices=tuple(ESTIMATORS),
        read_only=True,
    )
    window_dwells: int = setting(
        200,
        "latest dwells that are held to be compared with; what earlier ones told of navigation and mounting stays",
        minimum=1,
        maximum=10_000,
    )
    window_points: int = setting(
        MOST_POINTS,
        "heights of all dwells that are held, at most; each takes 200 bytes",
        minimum=1000,
        maximum=1_000_000_000,
    )
    terrain: str = setting(
        "",
        "path of an elevation model of known ground, .tif or .npz, around the origin of map; empty: none",
        read_only=True,
        names_file=True,
    )
    terrain_sigma_m: float = setting(
        0.1, "standard deviation of its heights", unit="m", minimum=1e-4, maximum=1000.0, read_only=True
    )
    targets: str = setting(
        "",
        "path of a CSV file of targets at known places in map, with the columns east_m, north_m, height_m and, if it "
        "is not 0.01, sigma_m; empty: none",
        read_only=True,
        names_file=True,
    )


@dataclass(frozen=True)
class ReceivedHeights:
    """A height image as the only message of its dwell.

    Attributes:
        image: the message.
    """

    image: HeightImage
    channel: ClassVar[int] = 0

    @property
    def dwell(self) -> int:
        """Number of the dwell."""
        return int(self.image.dwell)

    @property
    def stamp_ns(self) -> int:
        """Of the frames that it was made of, ns."""
        return messages.to_ns(self.image.header.stamp)

    @property
    def config_hash(self) -> str:
        """Identity of the sensor."""
        return str(self.image.provenance.config_hash)

    @property
    def size(self) -> int:
        """Bytes of its arrays."""
        return payload_bytes(self.image)


class Adjusted(NamedTuple):
    """What became of a dwell.

    Attributes:
        field: its heights where they are.
        aperture: from which they are seen.
        off: how far off that was.
        states: odometry during the dwell.
        mounting: of the sensor.
        mounting_covariance: of its lever arm, m^2, and of its rotation, rad^2, both in the axes of the platform.
        is_compared: whether the dwell was seen to show ground that others show, or that is known.
        is_first: whether the flight, or what it is adjusted with, begins anew with it.
    """

    field: HeightField
    aperture: ApertureState
    off: PoseError
    states: list[PlatformState]
    mounting: Mounting
    mounting_covariance: F64
    is_compared: bool
    is_first: bool


class Adjuster:
    """Adjusts the heights of one dwell after the other, of one sensor at a time."""

    def __init__(self, references: References = UNKNOWN_GROUND) -> None:
        """Begin without dwells."""
        self._references = references
        self._window: Window | None = None
        self._made_for: Hashable = None
        self._epoch_ns = self._latest_ns = 0

    def adjust(
        self,
        image: HeightImage,
        field: HeightField,
        sensor: Sensor,
        states: list[PlatformState],
        parameters: Parameters,
    ) -> Adjusted:
        """Adjust the heights of a dwell, which is later than all before, to those of earlier ones.

        Another sensor, or other settings, begin anew.

        Args:
            image: the heights.
            field: the same as arrays.
            sensor: that took them.
            states: odometry around it, without the delay of its stamps.
            parameters: of the node.

        Raises:
            UserError: they cannot be adjusted.
        """
        stage = messages.held_stages(image.provenance).get("sar_compression", {})
        settings = _settings_of(parameters, stage)
        stamp_ns = messages.to_ns(image.header.stamp)
        _check_mounting(stage)
        limits = parameters.window_dwells, parameters.window_points
        made_for = sensor.digest, settings, limits
        if made_for != self._made_for:
            self._window = None
        is_first = self._window is None
        if self._window is None:
            self._window = Window(sensor.mounting, settings, *limits, self._references)
            self._made_for, self._epoch_ns, self._latest_ns = made_for, stamp_ns, stamp_ns
        if stamp_ns < self._latest_ns:
            late_s = (self._latest_ns - stamp_ns) * 1e-9
            raise Rejected(
                "out of order",
                f"Dwell {image.dwell} is {late_s:.3g} s older than one before it; dwells must be in order.",
            )
        self._latest_ns = stamp_ns
        pulses = Pulses(Trajectory(states), stamp_ns, np.array([0.0, _length_s(image, sensor)]), self._epoch_ns)
        dwell = _observed(image, field, stage, pulses, sensor)
        try:
            off = self._window.add(dwell)
        except Exception:
            self._window = None  # begin anew rather than go on with a part
            raise
        adjustment = self._window.adjustment
        if adjustment.contradicts_ground:
            self._references, self._window = self._references.without_terrain(), None
            raise Rejected(
                "known ground",
                f"{describe_ground(adjustment.ground_off[0])}; it counts no more after dwell {image.dwell}, and the "
                "next dwell is adjusted as the first one.",
            )
        seconds = [(state.stamp_ns - self._epoch_ns) * 1e-9 for state in states]
        return Adjusted(
            corrected_heights(field, dwell, off),
            corrected_aperture(dwell, off),
            off,
            corrected_states(states, seconds, adjustment, sensor.mounting, settings),
            corrected_mounting(sensor.mounting, adjustment),
            mounting_covariance(sensor.mounting, adjustment),
            self._window.latest_is_compared,
            is_first,
        )


def _settings_of(parameters: Parameters, stage: Mapping[str, Any]) -> AdjustmentSettings:
    """What is known beforehand: what the compression states of mounting and delay, and else the parameters.

    Raises:
        UserError: what it states is not allowed.
    """
    values = {name: getattr(parameters, name) for name in settings_of(AdjustmentSettings)}
    return AdjustmentSettings(**{**values, **{name: stage[name] for name in KNOWN if stage.get(name)}})


def _check_mounting(stage: Mapping[str, Any]) -> None:
    """Make sure that images were made with the mounting of the sensor's description.

    Raises:
        Rejected: they were not.
    """
    if stage.get("mounting_from_tf"):
        raise Rejected(
            "mounting from tf",
            "The mounting of the sensor is that on /tf_static (sar_compression.mounting_from_tf); heights are adjusted "
            "with that in sensor_info only.",
        )


def _observed(
    image: HeightImage, field: HeightField, stage: Mapping[str, Any], pulses: Pulses, sensor: Sensor
) -> ObservedDwell:
    """The heights of a dwell, or of an image of a strip, as an adjustment takes them.

    Args:
        image: the heights.
        field: the same as arrays.
        stage: what their provenance says of sar_compression.
        pulses: of the dwell, or of the block that completed the image.
        sensor: that took them.

    Raises:
        Rejected: there are too few, or nothing says where they lie.
    """
    aperture, placement = messages.aperture_from_message(image.aperture), messages.placement_of(stage)
    if not aperture.sliding:
        return ObservedDwell.seen_from(aperture, field, placement, pulses.stated, sensor)
    placement = placement_in_strip(placement, phase_removed=len(image.provenance.autofocus_phase) > 0)
    return ObservedDwell.seen_from(aperture, field, placement, pulses.stated_abeam(aperture, sensor.mounting), sensor)


def _length_s(image: HeightImage, sensor: Sensor) -> float:
    """Time from the first pulse of a dwell to one pulse spacing past its last, s; of a strip that of a block."""
    if sensor.mode == "stripmap":
        return sensor.pulse_count / sensor.pulse_repetition_frequency
    velocity = image.aperture.velocity
    return float(image.aperture.length) / math.hypot(velocity.x, velocity.y, velocity.z)


class HeightAdjuster(DwellStage):
    """Moves the heights of each dwell to where earlier dwells saw the same ground, with the error that is left.

    A dwell that cannot be adjusted is passed on as it is, and counted.
    """

    parameters = Parameters
    inputs: ClassVar[Topics] = {
        "sensor_info": SENSOR_TOPICS["sensor_info"],
        "platform/odometry": SENSOR_TOPICS["platform/odometry"],
        "<estimator>/height": "heights of the estimator that the parameter names",
    }
    outputs: ClassVar[Topics] = {
        **height_topics(PREFIX),
        ADJUSTED_ODOMETRY: "state of the platform in dwells, and between those that follow each other, without the "
        "errors found, nav_msgs/Odometry",
        f"{PREFIX}/mounting": "pose of the sensor in the axes of the platform without the error found, "
        "geometry_msgs/PoseWithCovarianceStamped, latched",
    }
    product = PREFIX
    takes_heights = True
    settable = True

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, or a file of known ground cannot be read.
        """
        super().__init__("height_adjuster", HeightImage, "{estimator}/height", **node_arguments)
        parameters = self.current_parameters()
        try:
            self._references = _references_of(parameters)
        except UserError:
            super().destroy_node()
            raise
        self._adjuster = Adjuster(self._references)
        self._history = OdometryHistory(ODOMETRY_HELD_S)
        self._needed_ns = self._supplied_ns = self._supplied_dwell = self._told_ns = 0
        self._heights = HeightOutlets(self, PREFIX)
        self._odometry = self.offer(Odometry, ADJUSTED_ODOMETRY, ODOMETRY_QOS)
        self._mounting = self.offer(PoseWithCovarianceStamped, f"{PREFIX}/mounting", LATCHED_QOS)
        self.listen(Odometry, "platform/odometry", self._on_odometry, ODOMETRY_QOS, read=messages.received_pose)

    def rehearse(self, sensor: Sensor) -> None:
        """Adjust made-up heights."""
        once(sensor.digest, lambda: rehearse_adjustment(sensor, np.random.default_rng(0)))

    def decode(self, cdr: bytes) -> ReceivedHeights:
        """The heights that these bytes are."""
        return ReceivedHeights(messages.received_height(cdr))

    def channels_of(self, sensor: Sensor) -> int:  # noqa: ARG002 (the height image is all)
        """One message is a dwell."""
        return 1

    def check(self, message: ReceivedHeights, sensor: Sensor) -> None:
        """Geometry of a height image; the pixels are read when its turn comes."""
        image, where = message.image, f"HeightImage of dwell {message.dwell}"
        messages.check_geometry(image.grid, image.aperture, where)
        if not 0 < (length_s := _length_s(image, sensor)) <= messages.LONGEST_DWELL:
            raise Rejected(
                "wrong geometry",
                f"{where}: at its velocity aperture.length takes {length_s:g} s; more than 0 and at most "
                f"{messages.LONGEST_DWELL:g} s are allowed.",
            )

    def supplies(self, dwell: list[ReceivedHeights], sensor: Sensor) -> list[PlatformState]:
        """Odometry, without the delay of its stamps, from before the dwell to after it.

        It begins before the end of the dwell that this one follows; a played bag that begins anew is elsewhere.

        Raises:
            Rejected: it does not cover the dwell yet.
        """
        image, start_ns = dwell[0].image, dwell[0].stamp_ns
        delay_ns = _delay_ns(image)
        end_ns = start_ns + round(1e9 * _length_s(image, sensor))
        follows = 0 <= start_ns - self._supplied_ns <= BETWEEN_NS and image.dwell > self._supplied_dwell
        states = self._history.around((self._supplied_ns if follows else start_ns) + delay_ns, end_ns + delay_ns)
        if states:
            self._supplied_ns, self._supplied_dwell = end_ns, image.dwell
            return [_supplied(state, delay_ns) for state in states]
        self._needed_ns = end_ns + delay_ns
        raise Rejected(
            "odometry gap",
            f"Dwell {image.dwell}: platform/odometry must reach from its first pulse to its last to adjust its heights."
            f"{self.source_warning}",
        )

    def process(self, dwell: list[ReceivedHeights], sensor: Sensor, states: list[PlatformState]) -> int:
        """Adjust and publish the heights of a dwell."""
        image, parameters = dwell[0].image, self.current_parameters()
        field = messages.field_from_message(image, parameters.map_frame)
        if bad := messages.bad_pixels(image, field):
            self.ignore("bad pixels", messages.bad_pixel_warning(image, bad))
        try:
            found = self._adjuster.adjust(image, field, sensor, states, parameters)
        except UserError as error:
            reason = error.reason if isinstance(error, Rejected) else "not adjusted"
            self.ignore(reason, UserError(f"{error} Its heights are passed on as they are."))
            self._heights.publish(self._passed_on(image, parameters), field)
        else:
            self.tally.note("dwells compared with others" if found.is_compared else "dwells that nothing recognises")
            if found.is_first:
                self.tally.note("flights begun")
            self._publish_platform(image, found)
            self._heights.publish(self._moved(image, found, parameters), found.field)
        return 1

    def _passed_on(self, image: HeightImage, parameters: Parameters) -> HeightImage:
        """The heights as they came."""
        passed = copy.copy(image)
        passed.estimator = PREFIX
        passed.provenance = messages.derived(image.provenance, self.get_name(), parameters)
        return passed

    def _moved(self, image: HeightImage, found: Adjusted, parameters: Parameters) -> HeightImage:
        """The heights where they are."""
        told = {**dict(parameters), POSE_ERROR: found.off.error.tolist()}
        provenance = messages.derived(image.provenance, self.get_name(), told)
        looks = image.range_looks, image.azimuth_looks
        return messages.height_to_message(found.field, found.aperture, looks, PREFIX, image, provenance)

    def forget(self) -> None:
        """Forget odometry, and the dwells so far."""
        self._history, self._supplied_ns, self._supplied_dwell = OdometryHistory(ODOMETRY_HELD_S), 0, 0
        super().forget()

    def forget_results(self) -> int:
        """Adjust the next dwell as the first one."""
        self._adjuster, self._told_ns = Adjuster(self._references), 0
        return 0

    def _publish_platform(self, image: HeightImage, found: Adjusted) -> None:
        """Publish odometry that was not published yet, with the stamps that it had, and the mounting."""
        frames, delay_ns = self.current_parameters().frames, _delay_ns(image)
        for state in found.states:
            if (stamp_ns := state.stamp_ns + delay_ns) > self._told_ns:
                self._odometry.publish(messages.state_to_message(state, messages.to_stamp(stamp_ns), frames))
                self._told_ns = stamp_ns
        self._mounting.publish(
            messages.mounting_to_pose(found.mounting, found.mounting_covariance, image.header.stamp, frames.body)
        )

    def _on_odometry(self, pose: Pose) -> None:
        try:
            state = messages.state_of_pose(pose, self.current_parameters().frames)
        except Rejected as error:
            self.ignore("odometry", error)
            return
        _, latest_ns = self._history.span_ns or (0, 0)
        arrival = self._history.add(state)
        if arrival is Arrival.RESTARTED and state.stamp_ns < latest_ns:  # the clock began anew, and so does the flight
            super().forget()
        elif arrival is not Arrival.IN_ORDER:
            self.tally.note(f"odometry.{arrival.value}")
        if state.stamp_ns <= self._needed_ns:
            self.note_progress()  # what heights wait for is on its way


def _references_of(parameters: Parameters) -> References:
    """Known ground.

    Raises:
        UserError: the elevation model or the file of targets cannot be read.
    """
    targets = read_targets(Path(parameters.targets)) if parameters.targets else ()
    if not parameters.terrain:
        return References(targets)
    heights = read_elevation_model(Path(parameters.terrain)).heights
    return References(targets, Terrain(heights, parameters.terrain_sigma_m))


def _supplied(state: PlatformState, delay_ns: int) -> PlatformState:
    """A state without the delay of its stamp, whose covariances can be calculated with."""
    return replace(
        state,
        stamp_ns=state.stamp_ns - delay_ns,
        covariance=known_covariance(state.covariance, GREATEST_POSE),
        velocity_covariance=known_covariance(state.velocity_covariance, GREATEST_VELOCITY),
    )


def _delay_ns(image: HeightImage) -> int:
    """By which the odometry of a dwell is stamped too late, as its provenance says, ns."""
    stage = messages.held_stages(image.provenance).get("sar_compression", {})
    delay_s = stage.get("odometry_delay_s", 0.0)
    return round(1e9 * delay_s) if isinstance(delay_s, float) and abs(delay_s) <= LONGEST_DELAY_S else 0


def main() -> int:
    """Console script."""
    return run_node(HeightAdjuster)


if __name__ == "__main__":
    raise SystemExit(main())
