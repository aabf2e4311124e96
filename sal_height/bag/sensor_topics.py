"""The topics of sensors in a bag, each sensor in a namespace of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sal_height.bag.topics import FRAME_TYPE, SENSOR_TYPE, Topic
from sal_height.topics import ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC

FRAMES, IMAGES = PHASE_HISTORY, SLC
"""Topics with the samples of dwells, and with their images."""


@dataclass(frozen=True)
class SensorTopics:
    """Names of the topics of one sensor, also of those that the bag does not have.

    Attributes:
        namespace: namespace that they share, with a slash at both ends; ``/`` without one.
    """

    namespace: str

    @property
    def frames(self) -> str:
        """Topic of its frames."""
        return self.namespace + FRAMES

    @property
    def sensor_info(self) -> str:
        """Topic of its description."""
        return self.namespace + SENSOR_INFO

    @property
    def odometry(self) -> str:
        """Topic of the platform's odometry."""
        return self.namespace + ODOMETRY

    @property
    def images(self) -> str:
        """Topic of its focused images, with which a replay may start."""
        return self.namespace + IMAGES

    @property
    def names(self) -> list[str]:
        """The topics that the whole chain needs."""
        return [self.sensor_info, self.odometry, self.frames]


def sensors_in(topics: Mapping[str, Topic]) -> list[SensorTopics]:
    """The sensors whose frames or descriptions are among the topics of a bag, by name."""
    found = set()
    for suffix, type_name in ((FRAMES, FRAME_TYPE), (SENSOR_INFO, SENSOR_TYPE)):
        for name, topic in topics.items():
            if topic.type_name == type_name and name.endswith(f"/{suffix}"):
                found.add(SensorTopics(name.removesuffix(suffix)))
    return sorted(found, key=lambda sensor: sensor.namespace)
