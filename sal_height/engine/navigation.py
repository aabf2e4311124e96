"""Stage navigation: makes the odometry of positions, velocities and attitudes that arrive on ports of their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from sal_height.engine.frames import PlacedOrigin
from sal_height.engine.mapper import ORIGIN_PORT
from sal_height.engine.results import Product, Remark
from sal_height.engine.settings import FrameSettings, MapOriginSettings
from sal_height.engine.stage import Port, Stage, StageSettings
from sal_height.errors import UserError
from sal_height.geometry import GEOID_SIGMA_M, LEVELS, UNKNOWN_LEVEL, Altitudes, Navigation, PlatformState, Sample
from sal_height.settings import setting
from sal_height.topics import MAP_ORIGIN, ODOMETRY


class Pose(NamedTuple):
    """Position and attitude of the body in map."""

    position: Sample
    attitude: Sample


class Fix(NamedTuple):
    """A satellite fix: position in a map with the origin that the settings give."""

    position: Sample


class Attitude(NamedTuple):
    """Attitude of the body against east, north and up where it is."""

    attitude: Sample


class Twist(NamedTuple):
    """A velocity, and whether it is in the axes of the body."""

    velocity: Sample
    in_body: bool


class NavigationSettings(FrameSettings, MapOriginSettings, StageSettings):
    """Settings of the stage."""

    position: str = setting(
        "pose",
        "source of position and attitude: pose is topic platform/pose; fix is the position on platform/fix and "
        "the attitude on platform/imu",
        choices=("pose", "fix"),
        read_only=True,
    )
    altitude_above: str = setting(
        "unknown",
        "level above which altitudes on platform/fix are: the ellipsoid (WGS 84), or the geoid (mean sea level), as "
        f"many receivers state them; unknown: heights are uncertain by {GEOID_SIGMA_M:g} m together",
        choices=LEVELS,
        read_only=True,
    )
    geoid_height_m: float = setting(
        0.0,
        "height of the geoid above the ellipsoid where the flight is, for altitudes above the geoid",
        unit="m",
        minimum=-120.0,
        maximum=100.0,
        read_only=True,
    )
    publish_tf: bool = setting(
        False,
        "publish the frame of the platform in the map on /tf, from the odometry; true only where the platform's own "
        "software does not",
        read_only=True,
    )
    velocity: str = setting(
        "twist",
        "source of the velocity: twist is topic platform/twist, positions are differences of positions",
        choices=("twist", "positions"),
        read_only=True,
    )
    longest_gap_s: float = setting(
        0.5,
        "longest time between two samples of a topic",
        unit="s",
        minimum=1e-3,
        maximum=60.0,
        read_only=True,
    )

    @property
    def altitudes(self) -> Altitudes:
        """The level of altitudes.

        Raises:
            UserError: the height of the geoid is not given, or is given though altitudes are not above it.
        """
        return Altitudes(self.altitude_above, self.geoid_height_m)


POSE_PORT = Port("platform/pose", Pose, "position and attitude, geometry_msgs/PoseStamped (position: pose)")
FIX_PORT = Port("platform/fix", Fix, "satellite fix, sensor_msgs/NavSatFix (position: fix)")
IMU_PORT = Port("platform/imu", Attitude, "attitude against east, north and up, sensor_msgs/Imu (position: fix)")
TWIST_PORT = Port("platform/twist", Twist, "velocity in map or body axes, geometry_msgs/TwistStamped (velocity: twist)")


class NavigationStage(Stage):
    """Merges what instruments of the platform measure into its odometry, one sample for each attitude.

    An attitude waits for the next position and velocity, so that odometry is published that much later. Odometry is in
    the axes of ROS, whatever those of the instruments are. Where the origin of map is known, it is published too.
    """

    usual_name = "navigation"
    about = "Merges what instruments of the platform measure into its odometry, one sample for each attitude."
    settings = NavigationSettings

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        if self._settings.position == "fix" and self._settings.origin is None:
            raise UserError(
                "Node navigation must know where on the earth to lay the map that fixes are placed in (position is "
                "fix); set origin_latitude_deg, origin_longitude_deg and origin_height_m to a position in the scene."
            )
        self._altitudes = self._settings.altitudes
        self._navigation = self._merge()

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        """The instruments that the settings name."""
        places = [FIX_PORT, IMU_PORT] if settings.position == "fix" else [POSE_PORT]
        return [*places, *([TWIST_PORT] if settings.velocity == "twist" else [])]

    @classmethod
    def described_inputs(cls) -> Sequence[Port]:
        """All ports that it accepts items on with some settings."""
        return [POSE_PORT, FIX_PORT, IMU_PORT, TWIST_PORT]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """The odometry, and the origin of the map."""
        return [Port(ODOMETRY, PlatformState, "state of the platform, nav_msgs/Odometry"), ORIGIN_PORT]

    def begin(self, stamp_ns: int) -> None:
        """Publish the origin of the map where it is known, and report altitudes of an unknown level."""
        if self._settings.position == "fix" and not self._altitudes.is_known:
            self.add(Remark(UNKNOWN_LEVEL))
            self.count("altitude above an unknown level")
        if (origin := self._settings.origin) is not None:
            self.add(Product(MAP_ORIGIN, PlacedOrigin(origin, stamp_ns, self._settings.map_frame)))

    def receive(self, port: str, item: Any) -> None:  # noqa: ARG002 (the kind says all)
        """Merge a sample."""
        if isinstance(item, Pose | Fix):
            self._navigation.add_position(item.position)
        if isinstance(item, Pose | Attitude):
            self._navigation.add_attitude(item.attitude)
        if isinstance(item, Twist):
            self._navigation.add_velocity(item.velocity, in_body=item.in_body)
        states, declined = self._navigation.take()
        for reason in declined:
            self.warn(reason.reason, reason)
        for state in states:
            self.add(Product(ODOMETRY, state))

    def forget(self) -> None:
        """Forget the samples so far."""
        self._navigation = self._merge()

    def _merge(self) -> Navigation:
        settings = self._settings
        return Navigation(
            settings.longest_gap_s,
            velocity_is_measured=settings.velocity == "twist",
            local_to=settings.origin if settings.position == "fix" else None,
        )
