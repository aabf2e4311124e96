"""The topics of a node that makes heights."""

from __future__ import annotations

from sal_height import messages
from sal_height.messages.types import HeightImage, Image
from sal_height.nodes.placed_points import PlacedPoints
from sal_height.nodes.stage import Stage
from sal_height.relief import HeightField


class HeightOutlets:
    """Publishes heights on PREFIX/height, and a picture and points of them while somebody listens (`height_topics`)."""

    def __init__(self, stage: Stage, prefix: str) -> None:
        """Offer the topics of `stage` that begin with `prefix`."""
        self._height = stage.offer(HeightImage, f"{prefix}/height")
        self._image = stage.offer(Image, f"{prefix}/image")
        self._points = PlacedPoints(stage, prefix)

    def publish(self, image: HeightImage, field: HeightField, serialized: bytes | None = None) -> None:
        """Publish a height image.

        Args:
            image: the message.
            field: the same as arrays.
            serialized: the same as bytes, if they are at hand.
        """
        self._image.publish_if_heard(lambda: messages.height_picture(image))
        self._points.publish(
            lambda name: messages.frame_near(field.grid.origin, image.header, name),
            lambda frame: messages.height_points(field, frame),
        )
        self._height.publish(image if serialized is None else serialized)
