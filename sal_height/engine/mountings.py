"""Mountings of sensors on the platform: of their descriptions, of /tf_static or of a recorded flight."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

from sal_height.engine.frames import StaticFrames, StaticTransform
from sal_height.engine.settings import FrameSettings
from sal_height.engine.stage import Port
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Mounting
from sal_height.sensor import Sensor
from sal_height.settings import setting
from sal_height.topics import TF_STATIC

NO_MOUNTING = "no mounting"
"""Reason for which a dwell waits."""

_USED = "used_mounting"
"""Prefix of the names, in addition to the parameters of the compression, of a mounting not that of sensor_info."""


TRANSFORM_PORT = Port(
    TF_STATIC,
    StaticTransform,
    "frame of the sensor on the platform, only if the parameter mounting_from_tf is true",
    latched=True,
)


class MountingSourceSettings(FrameSettings):
    """Source of the mounting."""

    mounting_from_tf: bool = setting(
        False,
        "take the place of the sensor on the platform from /tf_static, where frame_id of its mounting is to be found, "
        "and not from sensor_info",
        read_only=True,
    )


class Mountings:
    """The mountings that apply to sensors, as far as they are known."""

    def __init__(self) -> None:
        self._frames = StaticFrames()
        self._of_flight: dict[str, Mounting] = {}

    def add(self, transform: StaticTransform) -> None:
        """Keep the pose of a frame in another one.

        Raises:
            UserError: it is no such pose, or there are too many frames.
        """
        self._frames.add(transform)

    def state(self, sensor: str, mounting: Mounting) -> None:
        """Use a mounting for a sensor (config_hash), as a flight did, before any other."""
        self._of_flight[sensor] = mounting

    def of(self, sensor: Sensor, settings: MountingSourceSettings) -> Mounting:
        """Mounting of a sensor: the one that a flight used, or else that of the static transforms or its description.

        Raises:
            Rejected: its frame is not known yet.
            UserError: it is nowhere on a platform.
        """
        if sensor.config_hash in self._of_flight:
            return self._of_flight[sensor.config_hash].known_as(sensor.mounting)
        if not settings.mounting_from_tf:
            return sensor.mounting
        name, body = sensor.mounting.frame_id, settings.body_frame
        place = self._frames.place(name, body)
        if place is None:
            raise Rejected(
                NO_MOUNTING,
                f"Nothing on {TF_STATIC} says where {name!r} (sensor_info, mounting.frame_id) is in {body!r}; publish "
                "it, as static_transform_publisher does, or set mounting_from_tf to false.",
            )
        mounting = Mounting(name, tuple(place.translation.tolist()), tuple(place.rotation.as_quat().tolist()))
        found: Mounting = settings.frames.axes.mounting(mounting)
        return found.known_as(sensor.mounting)


@lru_cache(maxsize=8)
def mounted(sensor: Sensor, mounting: Mounting) -> Sensor:
    """A sensor that is elsewhere on the platform."""
    return replace(sensor, mounting=mounting)


def stated_mounting(mounting: Mounting) -> dict[str, Any]:
    """The entry of a provenance that states a mounting, in addition to the parameters of the compression."""
    values = {
        "frame_id": mounting.frame_id,
        "lever_arm": list(mounting.lever_arm),
        "rotation": list(mounting.rotation),
    }
    return {_USED: values}


def mounting_in(stage: Mapping[str, Any]) -> Mounting | None:
    """The mounting that a provenance states of the compression; None: that of the sensor's description."""
    names = [f"{_USED}.{name}" for name in ("frame_id", "lever_arm", "rotation")]
    if any(name not in stage for name in names):
        return None
    frame_id, lever_arm, rotation = (stage[name] for name in names)
    with suppress(UserError, TypeError):
        return Mounting(str(frame_id), tuple(lever_arm), tuple(rotation))
    return None
