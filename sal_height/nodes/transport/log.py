"""Warnings in the log of a node, as fast as messages arrive."""

from __future__ import annotations

import math
import time

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity
from rclpy.node import Node


def log_warning(node: Node, sentence: str) -> None:
    """Log a warning of a node.

    Its logger would search all modules for the line of the caller: that takes 15 ms, and the first time 300 ms, in
    which messages are lost.
    """
    logger = node.get_logger()
    if logger.is_enabled_for(LoggingSeverity.WARN):
        rclpy_implementation.rclpy_logging_rcutils_log(LoggingSeverity.WARN, logger.name, sentence, "", __file__, 0)


class RareWarnings:
    """Warnings of a node that may be due for each message: at most one in a second is logged.

    The throttle of rclpy's logger takes .3 ms or more for each of them, logged or not.
    """

    def __init__(self, node: Node) -> None:
        """Start with no warning."""
        self._node, self._logged_at = node, -math.inf

    def log(self, sentence: str) -> None:
        """Log a warning, unless one was logged less than a second ago."""
        if time.monotonic() - self._logged_at >= 1.0:
            self._logged_at = time.monotonic()
            log_warning(self._node, sentence)
