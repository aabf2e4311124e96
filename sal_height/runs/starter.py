"""Starts the nodes of an ensemble in copies of itself and ends, for a process that cannot be copied and adopts them."""

from __future__ import annotations

import json
import sys

from sal_height.errors import UserError
from sal_height.runs.ensemble import Member, copy_for
from sal_height.runs.processes import Forked, give_up


def main() -> int:
    """Start the nodes argv[2] (JSON) for the process argv[1], and write their numbers into the pipe argv[3].

    Returns:
        The exit status; 2: one cannot be started, and the others have been ended.
    """
    parent, members, pipe = int(sys.argv[1]), json.loads(sys.argv[2]), int(sys.argv[3])
    processes: list[Forked] = []
    try:
        for member in members:
            processes.append(copy_for(Member(**member), parent))  # noqa: PERF401 (one may fail)
    except UserError as error:
        for process in processes:
            process.kill()
            process.wait(30.0)  # lest the other process adopts it
        sys.stderr.write(f"{error}\n")
        return 2
    give_up(processes, pipe)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
