"""Points for viewers, and the frame near them that they are relative to."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.qos import QoSProfile

from sal_height.messages.types import PointCloud2, TFMessage, TransformStamped
from sal_height.nodes.stage import FRAMES_QOS, Stage
from sal_height.nodes.transforms import TF, TF_QOS, has_transforms


class PlacedPoints:
    """Publishes clouds of points on PREFIX/points, each after its frame on PREFIX/frame, and on /tf where there is TF.

    Attributes:
        frame: name of the frame, that of the namespace and the prefix; it is another place with every cloud.
    """

    def __init__(self, stage: Stage, prefix: str, qos: QoSProfile = FRAMES_QOS) -> None:
        """Offer the topics of `stage` that begin with `prefix`."""
        self.frame = "_".join([*stage.get_namespace().split("/"), prefix, "origin"]).strip("_")
        self._points = stage.offer(PointCloud2, f"{prefix}/points", qos)
        self._frame = stage.offer(TransformStamped, f"{prefix}/frame", qos)
        self._tf = stage.offer(TFMessage, TF, TF_QOS) if has_transforms() else None

    def publish(
        self, place: Callable[[str], TransformStamped], points: Callable[[TransformStamped], PointCloud2]
    ) -> None:
        """Publish points if there is a subscription to them.

        Args:
            place: makes the frame of that name.
            points: makes the points in that frame.
        """
        if not self._points.subscribers:
            return
        frame = place(self.frame)
        self._frame.publish(frame)
        if self._tf:
            self._tf.publish(TFMessage(transforms=[frame]))
        self._points.publish(points(frame))
