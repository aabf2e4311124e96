"""Commands work where neither ROS nor what only POSIX systems have is installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import sal_height

ROS = (
    "rclpy",
    "rosidl_runtime_py",
    "ament_index_python",
    "sal_height_msgs",
    "builtin_interfaces",
    "std_msgs",
    "std_srvs",
)
ROS += ("diagnostic_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "tf2_msgs")

OF_POSIX = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
"""Modules that Windows lacks; Python's own libraries do without."""

WITHOUT = """
import contextlib, os, signal, socket, sys
with contextlib.suppress(ImportError):
    import psutil  # of the viewer, which takes on Linux what only POSIX has
sys.modules.update(dict.fromkeys({modules!r}))  # as modules that are not installed
for module, names in (
    (os, "fork forkpty killpg nice posix_fadvise register_at_fork sched_getaffinity sched_setscheduler setpriority"),
    (signal, "SIGHUP SIGALRM pthread_sigmask"),
    (socket, "recv_fds send_fds"),
):
    for name in names.split():
        delattr(module, name)
"""
"""A start of Python, also of processes that are spawned, without what Windows lacks: macOS lacks some of it, too."""

PROGRAM = Path(__file__).with_name("commands_without_ros.py")

WITH_BLANK_PICTURES = """
import runpy, sys
from blank_pictures import blank_pictures

with blank_pictures():
    runpy.run_path(sys.argv[1], run_name="__main__")
"""


def run_program(program: list[str], site: Path) -> subprocess.CompletedProcess[str]:
    """Run a Python program without ROS and POSIX."""
    (site / "sitecustomize.py").write_text(WITHOUT.format(modules=(*ROS, *OF_POSIX)), encoding="utf-8")
    folders = site, Path(sal_height.__path__[0]).parent, Path(__file__).parents[1]
    path = os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, *program]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=600, env=environment)  # noqa: S603 (our own code)


def test_commands_work_without_ros_and_posix(tmp_path: Path) -> None:
    result = run_program(["-c", WITH_BLANK_PICTURES, str(PROGRAM)], tmp_path)
    assert result.returncode == 0, result.stderr[-5000:]
    assert "Module rclpy is not installed: the dwells are processed without nodes" in result.stderr
    assert "Command live needs ROS 2" in result.stderr


@pytest.mark.parametrize(
    "missing", ["import rclpy", "import fcntl", "import os; os.fork", "import signal; signal.SIGHUP"]
)
def test_what_is_blocked_is_missing(missing: str, tmp_path: Path) -> None:
    """Or else the other test would prove nothing."""
    assert run_program(["-c", missing], tmp_path).returncode == 1
