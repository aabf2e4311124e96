"""Warnings in the log of a node, as fast as messages arrive."""

from __future__ import annotations

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
