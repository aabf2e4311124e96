"""Quality of service of topics, by their content."""

from __future__ import annotations

from rclpy.qos import QoSProfile, ReliabilityPolicy

from sal_height.bag import qos
from sal_height.nodes.transport.qos import to_profile

FRAMES_QOS, ODOMETRY_QOS, LATCHED_QOS = map(to_profile, (qos.FRAMES, qos.ODOMETRY, qos.LATCHED))
"""Phase histories and images, platform states, and sensor info and the like."""

INSTRUMENT_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Instruments: a best-effort subscription receives from any publisher."""

LATCHED_KEPT = 8
"""Messages of a latched topic that wait until a node takes them; with fewer, one overwrites another in the meantime."""
