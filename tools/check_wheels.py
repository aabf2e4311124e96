"""Check that PyPI has wheels of all pinned packages, and of ROS with all that it needs, for another kind of machine.

`python tools/check_wheels.py [aarch64] [3.12]`; prints what has none, and ends with status 1 if that is more than
EXPECTED. Nothing is installed.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"

ROS = ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"]
"""Requirements that are tried with all that they require in turn."""

BASELINES = ("manylinux_2_28", "manylinux_2_27", "manylinux_2_17", "manylinux2014")

EXPECTED = {
    "cyclonedds": "only a test of other DDS implementations uses it, which skips",
    "empy": "pure Python, which pip builds anywhere",
    "finufft": "pip builds it from source by a C++ compiler, in minutes",
    "ROS": "PyPI has its wheels for x86_64 only: nodes need an installation of ROS 2 there, and colcon",
}
"""Packages without wheels, and why that does not matter."""


def main(machine: str = "aarch64", python: str = "3.12") -> int:
    """Check one kind of machine with one version of Python."""
    pins = [line for line in CONSTRAINTS.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]
    missing = {pin.partition("==")[0] for pin in pins if not exist([pin, "--no-deps"], machine, python)}
    if not exist([*ROS, "--constraint", str(CONSTRAINTS)], machine, python):
        missing.add("ROS")
    for name in sorted(missing):
        print(f"{name} has no wheel for {machine}: {EXPECTED.get(name, 'it has to be built from source')}")
    print(f"{len(pins)} pinned packages, and ROS: {len(missing)} without wheels for {machine} and Python {python}")
    return int(not missing <= EXPECTED.keys())


def exist(requirements: list[str], machine: str, python: str) -> bool:
    """True if pip would install the requirements there from wheels alone."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        command += ["--only-binary=:all:", "--python-version", python, "--target", folder]
        command += [word for baseline in BASELINES for word in ("--platform", f"{baseline}_{machine}")]
        return subprocess.run([*command, *requirements], capture_output=True, check=False).returncode == 0  # noqa: S603


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
