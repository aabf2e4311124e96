"""Height images from airborne synthetic-aperture lidar and multi-beam radar: a core free of ROS, and ROS 2 nodes."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

__all__ = ["__version__", "open_heights"]


def __getattr__(name: str) -> Any:
    """`open_heights`, which needs ROS and extras, is imported on first use."""
    if name != "open_heights":
        raise AttributeError(f"Module {__name__} has no attribute {name!r}.")
    return import_module("sal_height.exports").open_heights
