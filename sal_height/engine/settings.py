"""Settings that several stages share."""

from __future__ import annotations

import math

from sal_height.engine.frames import BODY_FRAME, MAP_FRAME, Frames
from sal_height.engine.stage import StageSettings
from sal_height.geometry import BODY_AXES, MAP_AXES, ROS_AXES, Axes, Origin
from sal_height.settings import Settings, setting


class DwellSettings(StageSettings):
    """Settings of every stage that waits for what belongs to a dwell."""

    timeout_s: float = setting(
        5.0,
        "longest wait for what a dwell lacks; it counts while the node has nothing else to do, or once the sensor has "
        "moved on by as much",
        unit="s",
        minimum=0.01,
        maximum=3600.0,
    )
    max_unfinished_dwells: int = setting(
        8, "unfinished dwells that are kept before the oldest is given up", minimum=1, maximum=10_000
    )


class ChannelSettings(DwellSettings):
    """Settings of every stage that accepts one message of each channel."""

    missing_channels: str = setting(
        "refuse",
        "how a dwell is handled whose channels have not all arrived in time: refuse drops it, proceed processes "
        "the other "
        "channels as if these were dead",
        choices=("refuse", "proceed"),
    )
    min_channels: int = setting(
        2, "smallest number of channels to proceed with if others are missing", minimum=1, maximum=128
    )


def processing_of(settings: Settings) -> tuple[tuple[str, object], ...]:
    """Names and values of the settings that a dwell is processed with: without those of waiting (`ChannelSettings`)."""
    return tuple((name, value) for name, value in settings if name not in ChannelSettings.model_fields)


class MapFrameSettings(Settings):
    """The setting of stages that read or make what is located in the map."""

    map_frame: str = setting(
        MAP_FRAME, "name of the frame of the map (x east, y north, z up) in headers", read_only=True
    )


class FrameSettings(MapFrameSettings):
    """Settings of stages that read or make states of the platform."""

    body_frame: str = setting(
        BODY_FRAME, "name of the frame of the platform (x forward, y left, z up) in headers", read_only=True
    )
    map_axes: str = setting(
        ROS_AXES.map,
        "how the axes x, y, z of the received positions and attitudes point: enu is east, north, up, ned is north, "
        "east, down",
        choices=tuple(MAP_AXES),
        read_only=True,
    )
    body_axes: str = setting(
        ROS_AXES.body,
        "how the axes x, y, z of the platform in received messages point: flu is forward, left, up, frd is "
        "forward, right, down",
        choices=tuple(BODY_AXES),
        read_only=True,
    )

    @property
    def frames(self) -> Frames:
        """Names and axes of the frames of odometry that arrives."""
        return Frames(self.map_frame, self.body_frame, Axes(self.map_axes, self.body_axes))


class MapOriginSettings(Settings):
    """Settings of stages that must know where on the earth the map is."""

    origin_latitude_deg: float = setting(
        0.0,
        "latitude of the map's origin; if it and the longitude are 0, they are not given",
        unit="deg",
        minimum=-90.0,
        maximum=90.0,
        read_only=True,
    )
    origin_longitude_deg: float = setting(
        0.0, "longitude of the map's origin", unit="deg", minimum=-180.0, maximum=180.0, read_only=True
    )
    origin_height_m: float = setting(
        0.0,
        "height of the map's origin above the WGS-84 ellipsoid",
        unit="m",
        minimum=-1000.0,
        maximum=10_000.0,
        read_only=True,
    )

    @property
    def origin(self) -> Origin | None:
        """The origin of the map; None: it is not given."""
        if not (self.origin_latitude_deg or self.origin_longitude_deg):
            return None
        latitude, longitude = math.radians(self.origin_latitude_deg), math.radians(self.origin_longitude_deg)
        return Origin(latitude, longitude, self.origin_height_m)
