"""`sal-height record`: write what is published to a bag."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import BAGS, DONE, FAILED, OutputFolder, command, complain, importing

EXAMPLES = """
  sal-height record                                 all topics, until Ctrl-C
  sal-height record /ml/height /sensor_info --out out/flight
  sal-height record --match '/ml/.*' --type nav_msgs/msg/Odometry
  sal-height record --split-mb 4000 --compression zstd
"""

Texts = Annotated[tuple[str, ...], Parameter(consume_multiple=False, show_default=False)]

app = command("record", BAGS, EXAMPLES, "no message arrived, or messages were left out")


@app.default
def record(
    *topics: Annotated[str, Parameter(name="TOPIC", show_default=False)],
    match: Annotated[Texts, Parameter(name="--match", metavar="PATTERN")] = (),
    type: Annotated[Texts, Parameter(name="--type", metavar="TYPE")] = (),  # noqa: A002 (the name of the option)
    exclude: Annotated[Texts, Parameter(name="--exclude", metavar="PATTERN")] = (),
    out: OutputFolder = None,
    compression: Literal["none", "lz4", "zstd"] = "none",
    split_mb: Annotated[float | None, Parameter(metavar="MB", validator=Number(gt=0, lte=1e9))] = None,
    split_s: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0, lte=1e9))] = None,
    domain: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=0, lte=232))] = None,
    seconds: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
) -> int:
    """Record what is published, until Ctrl-C, byte for byte.

    Without topics, patterns and types: every topic but those of ROS itself. The
    parameters of all nodes are recorded, too, so that a replay needs nothing
    else. At the end, a table shows how many messages of each topic are in the bag,
    and how many are not and why; the bag contains it, too.

    Args:
        topics: Topics to record.
        match: Record topics whose names match this regular expression; may be repeated.
        type: Record topics of this type, such as nav_msgs/msg/Odometry; may be repeated.
        exclude: Record no topic whose name matches this regular expression; may be repeated.
        out: Folder of the bag, new or empty. Default: out/recorded, or the next free of out/recorded_2, ….
        compression: Of the file; echoes are noise, and hardly get smaller.
        split_mb: Start a new file at this size; each can be read alone.
        split_s: Start a new file after this time.
        domain: ROS domain of the graph. Default: that of ROS_DOMAIN_ID, or else 0.
        seconds: End after this time. Default: at Ctrl-C.
    """
    import math

    with importing():
        from sal_height.runs.live import record as runs
        from sal_height.runs.live.live_table import showing

    parameters = {
        "topics": list(topics),
        "patterns": list(match),
        "types": list(type),
        "excluded": list(exclude),
        "compression": compression,
        "split_mb": split_mb,
        "split_s": split_s,
    }
    duration = math.inf if seconds is None else seconds
    with showing(runs.recorded_table) as show:
        done = runs.record(out, parameters, "environment" if domain is None else domain, duration, show)
    if done.left_out:
        complain([f"{done.left_out} messages are not in the bag; the table says why."])
        return FAILED
    if not done.received:
        complain(["No message was received; check the names of the topics, and the ROS domain (--domain)."])
        return FAILED
    return DONE
