"""`sal-height top`: state of the nodes of a running graph."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import DONE, FAILED, PROCESSING, command, complain, importing

EXAMPLES = """
  sal-height top                    nodes of the ROS domain of the environment
  sal-height top --domain 42        nodes of another domain
  sal-height top --seconds 5 > now.txt
"""

app = command("top", PROCESSING, EXAMPLES, "no node publishes /diagnostics")


@app.default
def top(
    *,
    domain: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=0, lte=232))] = None,
    seconds: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
) -> int:
    """Show the state of the nodes of a running graph, until Ctrl-C.

    A line for each node: its state, dwells received and processed per second,
    latency from a complete dwell to its product (median and 95th percentile),
    processors, memory, and the messages left out in the last minute, and in total,
    with the reason. Below are warnings and errors of nodes. It reads what the nodes
    publish on /diagnostics.

    Args:
        domain: ROS domain of the graph. Default: that of ROS_DOMAIN_ID, or else 0.
        seconds: End after this time. Default: at Ctrl-C.
    """
    import math
    import time

    with importing():
        from sal_height.graph.watch import watch
        from sal_height.runs.live.live_table import node_table, showing

    with showing(lambda book: node_table(book, time.monotonic(), "nodes")) as show:
        book = watch("environment" if domain is None else domain, math.inf if seconds is None else seconds, show)
    if not book.entries:
        complain(["No node publishes /diagnostics in this domain; is ROS_DOMAIN_ID, or --domain, right?"])
        return FAILED
    return DONE
