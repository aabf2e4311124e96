"""Packages that only some commands need: extras of the installation, and ROS 2."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from sal_height.errors import UserError


def import_extra(module: str, doing: str, extra: str = "formats") -> Any:
    """Return a module of a package that is an extra.

    Args:
        module: name of the module, such as "sarkit.sicd".
        doing: purpose of the module, as the start of a message, such as "Reading a.nitf".
        extra: name of the extra.

    Raises:
        UserError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise UserError(f"{doing} needs {how_to_install(package, extra)}") from error


def how_to_install(package: str, extra: str) -> str:
    """End of a message that names a package which is not installed, and the extra that installs it."""
    return f"{package}; install it with: pip install 'sal_height[{extra}]'."


def is_of_ros(module: str) -> bool:
    """True if a module belongs to ROS 2 or is one of the message packages."""
    top = module.partition(".")[0]
    return top.startswith(("rcl", "rosidl", "ament")) or top.endswith(("_msgs", "_interfaces", "_srvs"))


def lacking_of_ros() -> str:
    """First module that nodes need and that is not installed; empty: all are."""
    return next((name for name in ("rclpy", "sal_height_msgs") if find_spec(name) is None), "")


def how_to_install_ros(module: str, command: str) -> str:
    """Message for the user of a command that needs a module of ROS 2, which is not installed."""
    return (
        f"Command {command} needs ROS 2 and the messages of sal_height, and module {module.partition('.')[0]} is not "
        "installed; install both with: pip install '.[ros]' ./msg_defs (in the repository of sal_height), or: pip "
        "install 'sal_height[ros]' and the wheel of sal_height_msgs that is published with it."
    )
