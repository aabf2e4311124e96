"""The topics on which ROS states the poses of frames, and a check that their messages are installed."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

from sal_height.errors import UserError
from sal_height.messages.types import TFMessage
from sal_height.nodes.transport.message_types import class_of

TF = "/tf"
"""Topic of the frames that move, of all nodes in whatever namespace."""

TF_QOS = QoSProfile(depth=100)
TF_STATIC_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def has_transforms() -> bool:
    """True if there is the package tf2_msgs, which a ROS installation has and PyPI has not."""
    try:
        return bool(class_of(TFMessage))
    except UserError:
        return False
