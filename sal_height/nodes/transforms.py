"""The topics on which ROS says where frames are, and their messages, if there are any."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

try:
    from tf2_msgs.msg import TFMessage  # of a ROS installation: it is not on PyPI
except ImportError:
    TFMessage = None

__all__ = ["TF", "TF_QOS", "TF_STATIC", "TF_STATIC_QOS", "TFMessage"]

TF = "/tf"
"""Topic of the frames that move, of all nodes in whatever namespace."""

TF_STATIC = "/tf_static"
"""Topic of the frames that are fixed to others, of all nodes in whatever namespace."""

TF_QOS = QoSProfile(depth=100)
TF_STATIC_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
