"""`sal-height replay`: process a recorded bag again and compare the heights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sal_height.commands._options import (
    DONE,
    FAILED,
    GRAPH,
    INTERRUPTED,
    PROCESSING,
    Bag,
    Estimators,
    GraphOptions,
    NodeParameters,
    OutputFolder,
    Tolerance,
    bag_name,
    command,
    complain,
    node_parameters,
    output_folder,
)

EXAMPLES = """
  sal-height replay out/sal_spotlight/bag
  sal-height replay out/sal_spotlight/bag --param ml_height.objective=numerator
  sal-height replay out/sal_spotlight/bag --estimators ml,capon
  sal-height replay out/sal_spotlight/bag --against golden/bag
  sal-height replay out/sal_spotlight/bag --tolerance tolerances.yaml
  sal-height replay out/sal_spotlight/bag --record slc --record ml/points
  sal-height replay out/sal_spotlight/bag \\
    --param sar_compression.calibration=out/calibrated/calibration.npz
"""

app = command(
    "replay",
    PROCESSING,
    EXAMPLES,
    "messages were dropped, no image came out, or heights are missing or extra; with --against, or without --param, "
    "also: heights differ by more than the tolerance",
)


@app.default
def replay(
    bag: Bag,
    /,
    *,
    against: Annotated[Path | None, Parameter(metavar="GOLDEN", show_default=False)] = None,
    tolerance: Tolerance = None,
    graph: GraphOptions = GRAPH,
    out: OutputFolder = None,
    param: NodeParameters = (),
    estimators: Estimators = (),
) -> int:
    """Play a recorded bag through the same nodes and compare the heights with those recorded.

    The output folder holds the new bag and report.json. A bag with one detector
    is focused only; its images are recorded, drawn and measured. Without
    --estimators, heights are made by those that made the recorded ones.

    Every value of every pixel is compared: equal, within the tolerance, or changed.
    The default tolerance is what processors differ by in rounding.

    Args:
        against: Bag with the heights to compare with. Default: those of BAG.
        out: Output folder, new or empty. Default: out/replay_BAG, or the next free of out/replay_BAG_2, ….
    """
    from sal_height.bag.tolerance import ROUNDING, read_tolerances
    from sal_height.runs.replay import Against
    from sal_height.runs.replay import replay as play_again
    from sal_height.runs.tables import comparison_table, images_table, results_table

    folder = output_folder(out, f"replay_{bag_name(bag)}")
    golden = Against(against, read_tolerances(tolerance) if tolerance else ROUNDING)
    result = play_again(bag, folder, node_parameters(param), graph.execution(), golden, estimators)
    print(images_table(result.images) if result.images else results_table(result.outcome, result.accuracy))
    if result.compared:
        print(f"\n{comparison_table(result.compared)}")
    print(f"{'interrupted; ' if result.outcome.interrupted else ''}see {folder}/report.json and {folder}/bag")
    if result.outcome.interrupted:
        return INTERRUPTED
    shortfalls = result.shortfalls(changed=bool(param) and not against)
    complain(shortfalls)
    return FAILED if shortfalls else DONE
