"""`sal-height batch`: process many bags, with several settings if wanted, on all processors or a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    FAILED,
    INTERRUPTED,
    PROCESSING,
    Estimators,
    command,
    complain,
    node_parameters,
)
from sal_height.tables import counted

EXAMPLES = """
  sal-height batch flights/*/bag --out out/campaign
  sal-height batch flights/*/bag --out out/looks \\
    --param ml_height.range_looks=1,2,4
  sal-height batch flights/*/bag --out out/campaign \\
    --scheduler tcp://cluster:8786
"""

app = command("batch", PROCESSING, EXAMPLES, "a bag could not be processed, or dwells were left out")


@app.default
def batch(
    bags: Annotated[tuple[Path, ...], Parameter(name="BAG", show_default=False)],
    /,
    *,
    out: Annotated[Path, Parameter(metavar="DIR")],
    param: Annotated[
        tuple[str, ...], Parameter(metavar="NODE.NAME=VALUE,…", consume_multiple=False, show_default=False)
    ] = (),
    estimators: Estimators = (),
    workers: Annotated[int, Parameter(metavar="N", validator=Number(gte=0), show_default=False)] = 0,
    scheduler: Annotated[str, Parameter(metavar="ADDRESS", show_default=False)] = "",
    dwells: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=1), show=False)] = None,
) -> int:
    """Make the heights of many recorded bags again, side by side.

    The same heights as those of `sal-height replay`, value for value, but without
    nodes and without ROS: each worker of Dask processes a bag at a time, a single
    bag is processed by several. The heights are tracked, compared with those in the
    bag, and with the truth if the flight was simulated.

    Several values of a parameter, with commas between them, are tried in turn, each
    with those of other parameters, and compared in comparison.png.

    The output folder holds a bag with the heights of each BAG and a table,
    summary.parquet: a row for each bag and setting. After an interruption, or when
    a failed bag is to be completed, the same command continues where it ended.

    Args:
        bags: Folders of bags, or .mcap files.
        out: Output folder: new, empty, or that of the same campaign.
        param: Set a parameter of a node, to one value or several with commas between them; may be repeated.
        workers: Processes on this machine. Default: one for each processor.
        scheduler: Address of a Dask cluster that does the work instead; it must see the same files.
        dwells: Has no effect any more.
    """
    from sal_height.graph.reporting import campaign_table
    from sal_height.runs.campaign.batch import SUMMARY, Campaign, Workers, run_campaign

    given, varied = _settings(param)
    if dwells is not None:
        complain(["Option --dwells has no effect any more: the dwells of a bag are processed side by side."])
    campaign = Campaign(bags, given, varied, estimators)
    try:
        rows = run_campaign(campaign, out, Workers(workers, scheduler))
    except KeyboardInterrupt:
        print(f"interrupted; the same command goes on with {out}")
        return INTERRUPTED
    print(f"{campaign_table(rows, list(varied))}\nsee {out / SUMMARY}")
    failed = [f"Bag {row['bag']}: {row['failure']}" for row in rows if row["failure"]]
    lost = [
        f"Bag {row['bag']}: {counted(row['dropped'], 'dwell')} left out: {row['drops']}."
        for row in rows
        if row.get("dropped")
    ]
    complain([*failed, *lost])
    return FAILED if failed or lost else DONE


def _settings(assignments: Sequence[str]) -> tuple[dict[str, dict[str, Any]], dict[str, list[Any]]]:
    """Parameters with one value, by node and name, and those with several, by "node.name"."""
    given: dict[str, dict[str, Any]] = {}
    varied: dict[str, list[Any]] = {}
    for text in assignments:
        name, separator, values = text.partition("=")
        each = [node_parameters([f"{name}{separator}{value}"]) for value in _split(values)]
        for node, of_node in each[0].items():
            for key in of_node:
                if len(each) > 1:
                    varied[f"{node}.{key}"] = [one[node][key] for one in each]
                else:
                    given.setdefault(node, {})[key] = of_node[key]
    return given, varied


def _split(text: str) -> list[str]:
    """The values in a text with commas between them; those in brackets are parts of one."""
    return [text] if text.startswith("[") else text.split(",")
