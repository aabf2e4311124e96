"""The nodes that process: one for each stage of the engine."""

from __future__ import annotations

import sys
from collections.abc import Mapping

from sal_height.engine.registry import STAGES
from sal_height.nodes.host import StageNode, node_of
from sal_height.nodes.program import run_node
from sal_height.nodes.scripts import node_of_script

PROCESSING: Mapping[str, type[StageNode]] = {
    name: node_of(stage, settable=name != "navigation") for name, stage in STAGES.items()
}
"""Classes of the processing nodes by the usual name of the node."""


def rank(kind: str) -> tuple[bool, int]:
    """Place of a node of a kind among those that end together: what makes something before what uses it."""
    return PROCESSING[kind].completes_file, list(PROCESSING).index(kind)


def main() -> int:
    """Console script of all processing nodes; the name of the script is that of the node."""
    return run_node(PROCESSING[node_of_script()])


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in PROCESSING:
        sys.exit(f"The node to be started must be named first; allowed are {', '.join(PROCESSING)}.")
    sys.argv.pop(0)
    raise SystemExit(main())
