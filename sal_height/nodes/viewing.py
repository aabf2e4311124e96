"""Views of products: pictures and clouds of points, made only while somebody subscribes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from sal_height.engine.height_items import Heights
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.stage import Port
from sal_height.geometry import PlatformState
from sal_height.messages import state_to_message, to_stamp, views
from sal_height.messages.transforms import platform_transform
from sal_height.messages.types import Image, PointCloud2, TFMessage, TransformStamped
from sal_height.nodes.managed import Topics
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.nodes.worker import WorkerNode
from sal_height.topics import TF


class _Points:
    """Points and a picture of a product, and the frame near them that the points are relative to.

    Single precision has 4 mm at 50 km. The frame is that of the namespace and the prefix; it is elsewhere with every
    cloud, and is on /tf too.
    """

    picture_about: str
    points_about: str
    frame_about: str
    qos = FRAMES_QOS

    def __init__(self, node: WorkerNode, port: Port) -> None:
        """Offer the topics of the views of a port of a node."""
        prefix = port.name.rpartition("/")[0]
        self._name = views.origin_frame(prefix, node.get_namespace())
        self._picture = node.offer(Image, f"{prefix}/image", self.qos)
        self._points = node.offer(PointCloud2, f"{prefix}/points", self.qos)
        self._frame = node.offer(TransformStamped, f"{prefix}/frame", self.qos)
        self._tf = node.offer(TFMessage, TF, ODOMETRY_QOS)

    @classmethod
    def topics(cls, port: Port) -> Mapping[str, str]:
        """The topics of the views of a port, with their content."""
        prefix = port.name.rpartition("/")[0]
        return {
            f"{prefix}/image": cls.picture_about,
            f"{prefix}/points": cls.points_about,
            f"{prefix}/frame": cls.frame_about,
        }

    def picture(self, item: Any) -> Any:
        """The picture."""
        raise NotImplementedError

    def placed_points(self, item: Any, name: str) -> tuple[Any, Any]:
        """The frame of that name near the points, and the points in it."""
        raise NotImplementedError

    def publish(self, item: Any) -> None:
        """Publish picture and points, each if there is a subscription to it."""
        self._picture.publish_if_heard(lambda: self.picture(item))
        self.publish_points(item)

    def publish_points(self, item: Any) -> None:
        """Publish the points if there is a subscription to them."""
        if not self._points.subscribers:
            return
        frame, points = self.placed_points(item, self._name)
        self._frame.publish(frame)
        self._tf.publish(TFMessage(transforms=[frame]))
        self._points.publish(points)


class HeightViewer(_Points):
    """Picture and points of a height image."""

    picture_about = "picture of the heights, made while somebody subscribes"
    points_about = "the heights as points, made while somebody subscribes"
    frame_about = "the frame that the points are in, near them"

    def picture(self, item: Heights) -> Any:
        """The heights of the first surface."""
        return views.height_picture(item)

    def placed_points(self, item: Heights, name: str) -> tuple[Any, Any]:
        """All scatterers."""
        return views.height_points(item, name)


class ReliefViewer(_Points):
    """Picture and points of a map, latched."""

    picture_about = "picture of the map, latched"
    points_about = "the map as points, latched, made while somebody subscribes"
    frame_about = "the frame that the points are in, near them, latched"
    qos = LATCHED_QOS

    def picture(self, item: PlacedRelief) -> Any:
        """The heights, north up."""
        return views.relief_picture(item)

    def publish(self, item: PlacedRelief) -> None:
        """Publish the picture always, for it is latched, and points if somebody subscribes: a second for millions."""
        self._picture.publish(self.picture(item))
        self.publish_points(item)

    def placed_points(self, item: PlacedRelief, name: str) -> tuple[Any, Any]:
        """The cells that were seen."""
        return views.relief_points(item, name)


class OdometryViewer:
    """The frame of the platform in the map, on /tf, made while somebody subscribes."""

    topics: ClassVar[Topics] = {TF: "frame of the platform in the map, if the parameter publish_tf is true"}

    def __init__(self, node: WorkerNode) -> None:
        """Offer the topic of a node."""
        self._node = node
        self._tf = node.offer(TFMessage, TF, ODOMETRY_QOS)

    def publish(self, item: PlatformState) -> None:
        """Publish the frame, if there is a subscription."""
        self._tf.publish_if_heard(lambda: platform_transform(self._odometry(item)))

    def _odometry(self, item: PlatformState) -> Any:
        return state_to_message(item, to_stamp(item.stamp_ns), self._node.current_parameters().frames)


VIEWERS: Mapping[type, Any] = {Heights: HeightViewer, PlacedRelief: ReliefViewer}
"""Publishers of the views of a product, by the class of its items."""


def view_topics(ports: Sequence[Port]) -> Topics:
    """The topics of the views of ports, with their content."""
    return {
        name: about
        for port in ports
        if (viewer := VIEWERS.get(port.kind))
        for name, about in viewer.topics(port).items()
    }
