"""Stage height_adjuster: moves the heights of an estimator to where earlier dwells saw the same ground.

From <estimator>/height it makes adjusted/height, without the errors of navigation and mounting that overlapping dwells
have shown so far, the odometry without them (adjusted/odometry), and the mounting as it should be (adjusted/mounting).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from sal_height.adjustment import (
    MOST_POINTS,
    AdjustmentSettings,
    AdjustmentWindow,
    ObservedDwell,
    PoseError,
    PulseTrack,
    References,
    Terrain,
    corrected_aperture,
    corrected_heights,
    corrected_mounting,
    corrected_states,
    describe_ground,
    mounting_covariance,
    placement_in_strip,
)
from sal_height.elevation import BEAM_PITCH, ESTIMATORS
from sal_height.engine.air import USED_AIR
from sal_height.engine.compression import ODOMETRY_PORT
from sal_height.engine.dwells import SENSOR_PORT, SENSORS_KEPT, DwellStage, WholeDwell
from sal_height.engine.frame_items import LONGEST_DWELL
from sal_height.engine.gathering import Dwell
from sal_height.engine.geometry_items import Aperture, check_geometry
from sal_height.engine.height_items import Heights, heights_port, packed
from sal_height.engine.heights import HEIGHTS_ABOUT
from sal_height.engine.kept import RecentValues
from sal_height.engine.mapper import ADJUSTED as PREFIX
from sal_height.engine.settings import DwellSettings, FrameSettings
from sal_height.engine.stage import DwellKey, Event, FileInput, Job, Notice, Port, Product, Result
from sal_height.engine.track import Arrival, OdometryHistory, accuracy_stated, motion_stated, without_delay
from sal_height.errors import Rejected, UserError
from sal_height.geometry import (
    ApertureState,
    Mounting,
    PlatformState,
    Trajectory,
)
from sal_height.imaging import MEASURED_AIR
from sal_height.numeric import F64
from sal_height.pipeline import range_covariance
from sal_height.rehearsal import once, rehearse_adjustment
from sal_height.relief import HeightField
from sal_height.sensor import AS_DESCRIBED, Sensor, deviation_of
from sal_height.settings import setting, settings_of
from sal_height.topics import ODOMETRY

ADJUSTED_ODOMETRY, ADJUSTED_MOUNTING = f"{PREFIX}/odometry", f"{PREFIX}/mounting"
"""Ports of the odometry without the errors that were found, and of the mounting."""

ODOMETRY_KEPT_S = 2e5
"""Time for which odometry is kept, longer than between passes: that of a pass may arrive before the last heights of the
pass before. Memory is limited by the number of samples."""

KNOWN = "boresight_sigma_rad", "lever_arm_sigma_m", "odometry_delay_sigma_s"
"""Settings that the compression has as well, whose values there count unless they are SAYS_NOTHING."""

SAYS_NOTHING = None, 0.0, AS_DESCRIBED
"""Values of standard deviations of the compression that state nothing for the adjustment."""

POSE_ERROR = "pose_error"
"""Name in the provenance, in addition to the settings, of the error of the pose that was removed."""

TERRAIN, TARGETS = "terrain", "targets"
"""Names of files."""


class AdjusterSettings(FrameSettings, DwellSettings, AdjustmentSettings):
    """Settings of the stage."""

    estimator: str = setting(
        "ml",
        "estimator whose heights are adjusted; they are received on topic <estimator>/height",
        choices=tuple(ESTIMATORS),
        read_only=True,
    )
    window_dwells: int = setting(
        200,
        "latest dwells that are kept for comparison; the information of earlier ones on navigation and mounting stays",
        minimum=1,
        maximum=10_000,
    )
    window_points: int = setting(
        MOST_POINTS,
        "most heights of all dwells that are kept; each takes 200 bytes",
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
        "path of a CSV file of targets at known positions in map, with the columns east_m, north_m, height_m "
        "and, if it "
        "is not 0.01, sigma_m; empty: none",
        read_only=True,
        names_file=True,
    )


class PlacedMounting(NamedTuple):
    """The pose of the sensor in the axes of the platform.

    Attributes:
        mounting: mounting of the sensor.
        covariance: covariance of lever arm (m^2) and rotation (rad^2) in the axes of the platform, shape (6, 6).
        stamp_ns: stamp of the dwell that it was estimated with, ns.
        body_frame: name of the platform's frame.
    """

    mounting: Mounting
    covariance: F64
    stamp_ns: int
    body_frame: str


@dataclass(frozen=True, eq=False)
class AdjustedDwell:
    """Adjustment of a dwell.

    Attributes:
        field: adjusted heights.
        aperture: adjusted aperture from which they are seen.
        off: error of the pose that was removed.
        states: adjusted odometry during the dwell.
        mounting: adjusted mounting of the sensor.
        mounting_covariance: covariance of lever arm (m^2) and rotation (rad^2) in the axes of the platform.
        is_compared: True if the dwell shows ground that others show, or that is known.
        is_first: True if the flight, or its adjustment, starts again with this dwell.
    """

    field: HeightField
    aperture: ApertureState
    off: PoseError
    states: list[PlatformState]
    mounting: Mounting
    mounting_covariance: F64
    is_compared: bool
    is_first: bool


class FlightAdjuster:
    """Adjusts the heights of one dwell of a sensor after the other.

    Attributes:
        published_ns: stamp of the latest odometry that was published, ns.
    """

    def __init__(self, references: References) -> None:
        """Start without dwells."""
        self.published_ns = 0
        self._references = references
        self._window: AdjustmentWindow | None = None
        self._made_for: Hashable = None
        self._epoch_ns = self._latest_ns = 0

    def adjust(
        self, heights: Heights, sensor: Sensor, states: list[PlatformState], settings: AdjusterSettings
    ) -> AdjustedDwell:
        """Adjust the heights of a dwell, which is later than all before, to those of earlier ones.

        Another description of the sensor, or other settings, start again.

        Args:
            heights: heights of the dwell.
            sensor: sensor that recorded it.
            states: odometry around it, without the delay of its stamps.
            settings: settings of the stage.

        Raises:
            UserError: they cannot be adjusted.
        """
        stage, stamp_ns = heights.provenance.compression, heights.key.stamp_ns
        known = _known(settings, stage).described(sensor)
        _check_mounting(stage)
        limits = settings.window_dwells, settings.window_points
        made_for = sensor.digest, known, limits
        if made_for != self._made_for:
            self._window = None
        is_first = self._window is None
        if self._window is None:
            self._window = AdjustmentWindow(sensor.mounting, known, *limits, self._references)
            self._made_for, self._epoch_ns, self._latest_ns = made_for, stamp_ns, stamp_ns
        if stamp_ns < self._latest_ns:
            late_s = (self._latest_ns - stamp_ns) * 1e-9
            raise Rejected(
                "out of order",
                f"Dwell {heights.key.number} is {late_s:.3g} s older than one before it; dwells must be in order.",
            )
        self._latest_ns = stamp_ns
        track = Trajectory(
            states, motion=motion_stated(stage).with_assumed, accuracy=accuracy_stated(stage).with_assumed
        )
        pulses = PulseTrack(track, stamp_ns, np.array([0.0, length_s(heights, sensor)]), self._epoch_ns)
        dwell = _observed(heights, pulses, sensor)
        try:
            off = self._window.add(dwell)
        except Exception:
            self._window = None  # start again rather than go on with a part
            raise
        adjustment = self._window.adjustment
        if adjustment.contradicts_ground:
            self._references, self._window = self._references.without_terrain(), None
            raise Rejected(
                "known ground",
                f"{describe_ground(adjustment.ground_off[0])}; it counts no more after dwell {heights.key.number}, and "
                "the next dwell is adjusted as the first one.",
            )
        seconds = [(state.stamp_ns - self._epoch_ns) * 1e-9 for state in states]
        ranges = range_covariance(dwell.aperture, heights.field.grid.middle, sensor, _with_used_air(stage))
        return AdjustedDwell(
            corrected_heights(heights.field, dwell, off, pitch_in_heights(heights, sensor), ranges),
            corrected_aperture(dwell, off, ranges),
            off,
            corrected_states(states, seconds, adjustment, sensor.mounting, known),
            corrected_mounting(sensor.mounting, adjustment),
            mounting_covariance(sensor.mounting, adjustment),
            self._window.latest_is_compared,
            is_first,
        )


def length_s(heights: Heights, sensor: Sensor) -> float:
    """Time from the first pulse of a dwell to one pulse spacing past its last, s; of a strip that of a block."""
    if sensor.mode == "stripmap":
        return sensor.pulse_count / sensor.pulse_repetition_frequency
    return heights.aperture.length / float(np.linalg.norm(heights.aperture.velocity))


def pitch_in_heights(heights: Heights, sensor: Sensor) -> float:
    """Relative standard deviation of the angles between the beams that the covariances of heights contain."""
    entry = ESTIMATORS.get(heights.estimator)
    stated = heights.provenance.stages.get(entry.node, {}).get("beam_pitch_sigma") if entry else None
    if not isinstance(stated, float):
        return 0.0
    return deviation_of(stated, sensor.uncertainty.beam_pitch, BEAM_PITCH).sigma


class HeightAdjuster(DwellStage):
    """Moves the heights of each dwell to where earlier dwells saw the same ground, with the error that is left.

    A dwell that cannot be adjusted is passed on as it is, and counted.
    """

    usual_name = "height_adjuster"
    about = "Moves the heights of each dwell to where earlier dwells saw the same ground, with the error that is left."
    settings = AdjusterSettings
    dwell_port = "{estimator}/height"

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._references = _references_of(self._settings, self._files)
        self._history = OdometryHistory(ODOMETRY_KEPT_S)
        self._needed_ns = 0
        self._latest = RecentValues[list[int]](SENSORS_KEPT, lambda: [0, 0])
        """End (ns) and number of the last dwell of each sensor that became a job, by config_hash."""
        # The heavy side.
        self._adjusters = RecentValues[FlightAdjuster](SENSORS_KEPT, partial(FlightAdjuster, self._references))

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        """Heights of an estimator, their sensor, and the odometry."""
        return [SENSOR_PORT, ODOMETRY_PORT, heights_port(settings.estimator)]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """Adjusted heights, odometry and mounting."""
        return [
            Port(f"{PREFIX}/height", Heights, HEIGHTS_ABOUT),
            Port(
                ADJUSTED_ODOMETRY,
                PlatformState,
                "state of the platform in dwells, and between those that follow each other, without the errors found, "
                "nav_msgs/Odometry",
            ),
            Port(
                ADJUSTED_MOUNTING,
                PlacedMounting,
                "pose of the sensor in the axes of the platform without the error found, "
                "geometry_msgs/PoseWithCovarianceStamped, latched",
                latched=True,
            ),
        ]

    @classmethod
    def files(cls, settings: Any) -> Sequence[FileInput]:
        """Known ground."""
        wanted = (
            FileInput(TERRAIN, "elevation model", settings.terrain),
            FileInput(TARGETS, TARGETS, settings.targets),
        )
        return [one for one in wanted if one.path]

    def channels_of(self, sensor: Sensor) -> int:  # noqa: ARG002 (the height image is all)
        """One message is a dwell."""
        return 1

    def channel_of(self, message: Heights) -> int:  # noqa: ARG002
        """The only one."""
        return 0

    def check(self, message: Heights, sensor: Sensor) -> None:
        """Check the geometry of a height image; the pixels are read when it is processed."""
        check_geometry(message.grid, message.aperture, message.where)
        if not 0 < (seconds := length_s(message, sensor)) <= LONGEST_DWELL:
            raise Rejected(
                "wrong geometry",
                f"{message.where}: at its velocity aperture.length takes {seconds:g} s; more than 0 and at most "
                f"{LONGEST_DWELL:g} s are allowed.",
            )

    def supplies(self, key: DwellKey, messages: list[Heights], sensor: Sensor) -> list[PlatformState]:
        """Odometry, without the delay of its stamps, from before the dwell to after it.

        It starts before the end of the dwell that this one follows; the first dwell of a bag played again follows none.

        Raises:
            Rejected: it does not cover the dwell yet.
        """
        delay_ns, end_ns = _delay_ns(messages[0]), _end_ns(messages[0], sensor)
        latest_ns, latest_dwell = self._latest.of(key.sensor)
        between_ns = 1_000_000_000  # longest time between dwells whose odometry is published as well
        follows = 0 <= key.stamp_ns - latest_ns <= between_ns and key.number > latest_dwell
        begin_ns = latest_ns if follows else key.stamp_ns
        states = self._history.around(begin_ns + delay_ns, end_ns + delay_ns)
        if states:
            return [without_delay(state, delay_ns) for state in states]
        self._needed_ns = end_ns + delay_ns
        raise Rejected(
            "odometry gap",
            f"Dwell {key.number}: {ODOMETRY} must reach from its first pulse to its last to adjust its heights."
            f"{self.describe_sources()}",
        )

    def note_job(self, whole: WholeDwell) -> None:
        """The next dwell may follow this one."""
        self._latest.of(whole.key.sensor)[:] = _end_ns(whole.messages[0], whole.sensor), whole.key.number
        self._latest.take_surplus()

    def is_hopeless(self, dwell: Dwell[Heights], missing: Rejected) -> bool:  # noqa: ARG002
        """True if odometry that a dwell waits for will not arrive."""
        heights, delay_ns = dwell.messages[0], _delay_ns(dwell.messages[0])
        start_ns, end_ns = dwell.key.stamp_ns + delay_ns, _end_ns(heights, dwell.sensor) + delay_ns
        return not self._history.may_cover(start_ns, end_ns, self._none_before.get(ODOMETRY, start_ns))

    def series_of(self, whole: WholeDwell) -> str | None:  # noqa: ARG002
        """Dwells are compared with those before."""
        return self.name

    def receive_other(self, port: str, item: PlatformState) -> None:  # noqa: ARG002 (it is the only one)
        """Accept odometry."""
        _, latest_ns = self._history.span_ns or (0, 0)
        arrival = self._history.add(item)
        if arrival is Arrival.RESTARTED and item.stamp_ns < latest_ns:  # the clock started again, and the flight too
            super().forget()
        elif arrival is not Arrival.IN_ORDER:
            self.count(f"odometry.{arrival.value}")
        if item.stamp_ns <= self._needed_ns:
            self.note_progress()  # what heights wait for is on its way
        elif self._needed_ns:
            self._needed_ns = 0  # heights that still wait set it again
            self.hand_over_complete()

    def forget(self) -> None:
        """Forget odometry, and the dwells so far."""
        self._history, self._needed_ns = OdometryHistory(ODOMETRY_KEPT_S), 0
        self._latest.take_all()
        super().forget()

    def forget_work(self) -> Iterator[Result]:
        """Adjust the next dwell of each sensor as the first one."""
        self._adjusters.take_all()
        yield from ()

    def rehearse_for(self, sensor: Sensor, settings: Any) -> None:  # noqa: ARG002
        """Adjust made-up heights."""
        once(sensor.digest, lambda: rehearse_adjustment(sensor, np.random.default_rng(0)))

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        """Adjust the heights of a dwell."""
        heights, settings = whole.messages[0], job.settings
        heights.check_frame(settings.map_frame)
        yield from heights.notices()
        adjuster = self._adjusters.of(whole.key.sensor)
        self._adjusters.take_surplus()
        try:
            found = adjuster.adjust(heights, whole.sensor, whole.supplies, settings)
        except UserError as error:
            reason = error.reason if isinstance(error, Rejected) else "not adjusted"
            yield Notice(reason, str(UserError(f"{error} Its heights are passed on as they are.")), whole.key)
            provenance = heights.provenance.derived(self.name, settings)
            yield Product(f"{PREFIX}/height", replace(heights, estimator=PREFIX, provenance=provenance))
            return
        yield Event("dwells compared with others" if found.is_compared else "dwells that nothing recognises")
        if found.is_first:
            yield Event("flights begun")
        yield from self._platform(heights, found, adjuster, settings)
        stated = {**dict(settings), POSE_ERROR: found.off.error.tolist()}
        yield Product(
            f"{PREFIX}/height",
            replace(
                heights,
                estimator=PREFIX,
                aperture=Aperture.of(found.aperture),
                provenance=heights.provenance.derived(self.name, stated),
                **packed(found.field),
            ),
        )

    def _platform(
        self, heights: Heights, found: AdjustedDwell, adjuster: FlightAdjuster, settings: AdjusterSettings
    ) -> Iterator[Result]:
        """Odometry that was not published yet, with the stamps that it had, and the mounting."""
        delay_ns = _delay_ns(heights)
        for state in found.states:
            if (stamp_ns := state.stamp_ns + delay_ns) > adjuster.published_ns:
                yield Product(ADJUSTED_ODOMETRY, replace(state, stamp_ns=stamp_ns))
                adjuster.published_ns = stamp_ns
        yield Product(
            ADJUSTED_MOUNTING,
            PlacedMounting(found.mounting, found.mounting_covariance, heights.key.stamp_ns, settings.frames.body),
        )


def _known(settings: AdjusterSettings, stage: Mapping[str, Any]) -> AdjustmentSettings:
    """Prior knowledge: values of mounting and delay that the compression states, and otherwise the settings.

    Raises:
        UserError: a value that it states is not allowed.
    """
    values = {name: getattr(settings, name) for name in settings_of(AdjustmentSettings)}
    return AdjustmentSettings(
        **{**values, **{name: stage[name] for name in KNOWN if stage.get(name) not in SAYS_NOTHING}}
    )


def _with_used_air(stage: Mapping[str, Any]) -> Mapping[str, Any]:
    """Parameters of the compression with the air that it received, if it did."""
    return {**stage, "air": MEASURED_AIR, **stage[USED_AIR]} if USED_AIR in stage else stage


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


def _observed(heights: Heights, pulses: PulseTrack, sensor: Sensor) -> ObservedDwell:
    """The heights of a dwell, or of an image of a strip, as an adjustment reads them.

    Args:
        heights: heights of the dwell.
        pulses: pulses of the dwell, or of the block that completed the image.
        sensor: sensor that recorded them.

    Raises:
        Rejected: there are too few, or their positions are not known.
    """
    aperture, placement = heights.aperture.state, heights.provenance.placement
    if not aperture.sliding:
        return ObservedDwell.seen_from(aperture, heights.field, placement, pulses.stated, sensor)
    placement = placement_in_strip(placement, phase_removed=len(heights.provenance.autofocus_phase) > 0)
    stated = pulses.stated_abeam(aperture, sensor.mounting)
    return ObservedDwell.seen_from(aperture, heights.field, placement, stated, sensor)


def _references_of(settings: AdjusterSettings, files: Mapping[str, Any]) -> References:
    """Known ground."""
    targets = files.get(TARGETS, ())
    if TERRAIN not in files:
        return References(targets)
    return References(targets, Terrain(files[TERRAIN], settings.terrain_sigma_m))


def _end_ns(heights: Heights, sensor: Sensor) -> int:
    """Time one pulse spacing past the last pulse of a dwell, ns."""
    return heights.key.stamp_ns + round(1e9 * length_s(heights, sensor))


def _delay_ns(heights: Heights) -> int:
    """Delay of the odometry's stamps that the provenance of a dwell states, ns."""
    delay_s = heights.provenance.compression.get("odometry_delay_s", 0.0)
    longest_delay_s = 100.0  # delay of the odometry's stamps up to which one that a provenance states is believed
    return round(1e9 * delay_s) if isinstance(delay_s, float) and abs(delay_s) <= longest_delay_s else 0
