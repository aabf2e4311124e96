"""Frames of the platform on /tf and of its sensor on /tf_static, of a node that publishes odometry."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from sal_height.engine.stage import StageSettings
from sal_height.messages.codec import BrokenMessage, deserialize
from sal_height.messages.transforms import platform_transform, sensor_transform
from sal_height.messages.types import Odometry, SensorInfo, TFMessage
from sal_height.nodes.managed import Topics
from sal_height.nodes.transport.qos import ODOMETRY_QOS, TF_STATIC_QOS
from sal_height.nodes.worker import WorkerNode
from sal_height.settings import setting
from sal_height.topics import ODOMETRY, SENSOR_INFO, TF, TF_STATIC

FRAME_TOPICS: Topics = {
    TF: "frame of the platform in the map, if the parameter publish_tf is true",
    TF_STATIC: "frame of the sensor on the platform, latched, if the parameter publish_tf is true",
}


class SourceSettings(StageSettings):
    """Parameters of a node that publishes what a sensor and its platform would."""

    publish_tf: bool = setting(
        True,
        "publish the frame of the platform in the map on /tf, from its odometry, and that of the sensor on the "
        "platform on /tf_static; false where another node does",
        read_only=True,
    )


class PlatformFrames:
    """Publishes the frames that follow from what a source publishes."""

    def __init__(self, node: WorkerNode) -> None:
        """Offer the topics if the parameter publish_tf of the node is true."""
        is_asked = node.current_parameters().publish_tf
        self._moving = node.offer(TFMessage, TF, ODOMETRY_QOS) if is_asked else None
        self._fixed = node.offer(TFMessage, TF_STATIC, TF_STATIC_QOS) if is_asked else None

    def follow(self, topic: str, message: Any) -> None:
        """Publish the frame of odometry, while somebody subscribes, or of the description of a sensor.

        Args:
            topic: topic of the source, without namespace.
            message: its message, or the bytes of one; those that cannot be decoded are passed over.
        """
        with suppress(BrokenMessage):
            if topic == ODOMETRY and self._moving:
                self._moving.publish_if_heard(lambda: platform_transform(_plain(message, Odometry)))
            elif topic == SENSOR_INFO and self._fixed:
                self._fixed.publish(sensor_transform(_plain(message, SensorInfo)))


def _plain(message: Any, kind: type[Any]) -> Any:
    return deserialize(message, kind) if isinstance(message, bytes) else message
