"""Packages that only some commands need: extras of the installation, and ROS 2."""

from __future__ import annotations

from importlib import import_module
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
        raise UserError(f"{doing} needs {package}; install it with: pip install 'sal_height[{extra}]'.") from error


def is_of_ros(module: str) -> bool:
    """True if a module belongs to ROS 2 or is one of the message packages."""
    top = module.partition(".")[0]
    return top.startswith(("rcl", "rosidl", "ament")) or top.endswith(("_msgs", "_interfaces", "_srvs"))


def how_to_install_ros(module: str, command: str) -> str:
    """Message for the user of a command that needs a module of ROS 2, which is not installed."""
    top = module.partition(".")[0]
    if top == "sal_height_msgs":
        how = "install the messages of sal_height, from its repository, with: pip install ./msg_defs"
    else:
        how = 'install ROS 2 with: pip install "ros-jazzy-rclpy[fastrtps]" ros-jazzy-common-interfaces'
    return f"Command {command} needs the Python module {top}, which is not installed; {how}."
