"""Stage height_adjuster: moves the heights of an estimator to where earlier dwells saw the same ground.

From <estimator>/height it makes adjusted/height, without the errors of navigation and mounting that overlapping dwells
have shown so far, the odometry without them (adjusted/odometry), and the mounting as it should be (adjusted/mounting).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from sal_height.adjustment import References, Terrain
from sal_height.elevation import ESTIMATORS
from sal_height.engine.compression import ODOMETRY_PORT
from sal_height.engine.dwells import SENSOR_PORT, SENSORS_KEPT, DwellStage, WholeDwell
from sal_height.engine.flight_adjuster import AdjustedDwell, FlightAdjuster, WindowSettings, length_s
from sal_height.engine.frame_items import LONGEST_DWELL
from sal_height.engine.gathering import Dwell
from sal_height.engine.geometry_items import Aperture, check_geometry
from sal_height.engine.height_items import Heights, heights_port, packed
from sal_height.engine.heights import HEIGHTS_ABOUT
from sal_height.engine.kept import RecentValues
from sal_height.engine.mapper import ADJUSTED as PREFIX
from sal_height.engine.results import DwellKey, Event, Notice, Product, Result
from sal_height.engine.settings import DwellSettings, FrameSettings
from sal_height.engine.stage import FileInput, Job, Port
from sal_height.engine.track import Arrival, OdometryHistory, without_delay
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Mounting, PlatformState
from sal_height.numeric import F64
from sal_height.rehearsal import once, rehearse_adjustment
from sal_height.sensor import Sensor
from sal_height.settings import setting
from sal_height.topics import ODOMETRY

ADJUSTED_ODOMETRY, ADJUSTED_MOUNTING = f"{PREFIX}/odometry", f"{PREFIX}/mounting"
"""Ports of the odometry without the errors that were found, and of the mounting."""

ODOMETRY_KEPT_S = 2e5
"""Time for which odometry is kept, longer than between passes: that of a pass may arrive before the last heights of the
pass before. Memory is limited by the number of samples."""

POSE_ERROR = "pose_error"
"""Name in the provenance, in addition to the settings, of the error of the pose that was removed."""

TERRAIN, TARGETS = "terrain", "targets"
"""Names of files."""


class AdjusterSettings(FrameSettings, DwellSettings, WindowSettings):
    """Settings of the stage."""

    estimator: str = setting(
        "ml",
        "estimator whose heights are adjusted; they are received on topic <estimator>/height",
        choices=tuple(ESTIMATORS),
        read_only=True,
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
