"""Program `live_host`: nodes that process, in one process with workers, as `sal-height live` starts them."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from sal_height.workers.processes import ONE_THREAD, use_one_thread

USAGE = """usage: {program} NODE[=KIND] ... [--ros-args -r NODE:TOPIC:=OTHER -p NODE:PARAMETER:=VALUE ...]

Runs the named nodes in one process, which receives every frame once and has worker processes
compress dwells and estimate heights. Each is a node of its own, with the topics, parameters and
services that its own program has: see KIND --help. In a namespace, parameters of one node are
set by a file of --params-file with a section /**/NODE. KIND is the name of the program, if NODE
is another name.

  {program} sar_compression ml_height relief_tracker relief_mapper
  {program} sar_compression ml_height coarse=ml_height --ros-args -r coarse:ml/height:=coarse/height

KIND is one of {kinds}.
"""


def main() -> int:
    """Console script; the arguments before those of ROS name the nodes.

    Returns:
        The exit status: 0, 1 if a node ended with a failure, or 2 with a message on stderr if the arguments cannot be
        used.
    """
    if any(os.environ.get(name) is None for name in ONE_THREAD):
        use_one_thread()  # which has an effect before NumPy is imported only, so that what follows is imported later
    from rclpy.utilities import remove_ros_args  # noqa: PLC0415

    from sal_height.nodes.processing import PROCESSING, rank  # noqa: PLC0415
    from sal_height.nodes.program import run_host  # noqa: PLC0415

    asked = remove_ros_args(sys.argv)[1:]
    if {"--help", "-h"} & set(asked):
        sys.stdout.write(USAGE.format(program=Path(sys.argv[0]).name, kinds=", ".join(PROCESSING)))
        return 0
    members = []
    for word in asked:
        name, _, kind = word.partition("=")
        if (kind or name) not in PROCESSING or not re.fullmatch(r"[A-Za-z_]\w*", name):
            sys.stderr.write(f"{word!r} is not NODE or NODE=KIND; KIND is one of {', '.join(PROCESSING)}.\n")
            return 2
        members.append((kind or name, name))
    if len({name for _, name in members}) < max(1, len(members)):
        sys.stderr.write("Name the nodes to run, each once, such as: sar_compression ml_height.\n")
        return 2
    members.sort(key=lambda member: rank(member[0]))
    nodes = [(PROCESSING[kind], ["--ros-args", "-r", f"__node:={name}"]) for kind, name in members]
    return run_host(nodes, [sys.argv[0], *sys.argv[1 + len(asked) :]])


if __name__ == "__main__":
    raise SystemExit(main())
