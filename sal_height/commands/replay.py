"""`sal-height replay`: process a recorded bag again and compare the heights."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    FAILED,
    GRAPH,
    INTERRUPTED,
    PROCESSING,
    Bag,
    DwellRange,
    Estimators,
    Flag,
    GraphOptions,
    Jobs,
    NodeParameters,
    OutputFolder,
    Tolerance,
    command,
    complain,
    node_parameters,
    output_folder,
    repeated,
)
from sal_height.io import bag_name

EXAMPLES = """
  sal-height replay out/sal_spotlight/bag
  sal-height replay out/sal_spotlight/bag --param ml_height.objective=numerator
  sal-height replay out/sal_spotlight/bag --estimators ml,capon
  sal-height replay out/sal_spotlight/bag --against golden/bag
  sal-height replay out/sal_spotlight/bag --tolerance tolerances.yaml
  sal-height replay out/sal_spotlight/bag --jobs 2
  sal-height replay out/sal_spotlight/bag --dwells 10:19
  sal-height replay out/sal_spotlight/bag --from heights
  sal-height replay out/sal_spotlight/bag --record slc --record ml/points
  sal-height replay out/sal_spotlight/bag --clock paced --rate 4
  sal-height replay out/sal_spotlight/bag --clock burst --loop 3
  sal-height replay out/sal_spotlight/bag --remap ml/height:=/north/height
  sal-height replay out/sal_spotlight/bag \\
    --param sar_compression.calibration=out/calibrated/calibration.npz
"""

app = command(
    "replay",
    PROCESSING,
    EXAMPLES,
    "messages were dropped that were not in flight, no image was made, or heights are missing or extra; with "
    "--against, or without --param, also: heights differ by more than the tolerance",
)


Clock: TypeAlias = Annotated[
    Literal["lockstep", "paced", "burst"],
    Parameter(
        help="When messages are played. lockstep: a dwell when the one before is processed; paced: at the times of "
        "their stamps, with the topic /clock; both with use_sim_time in all nodes. burst: as fast as they can be "
        "published; what nodes cannot buffer is dropped and counted.",
    ),
]

Loop: TypeAlias = Annotated[
    int,
    Parameter(
        metavar="N",
        validator=Number(gte=1, lte=1_000_000_000),
        help="Play the bag N times, with --clock paced or burst; stamps go on, dwells keep their numbers. Only the "
        "heights of the first time are compared.",
    ),
]

Remap: TypeAlias = Annotated[
    tuple[str, ...],
    repeated(
        "OLD:=NEW",
        help="Give topic OLD the name NEW, as in ROS: a topic of the bag that nodes know as NEW, or else a topic of "
        "the nodes, which is published and recorded as NEW then. May be repeated.",
    ),
]


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
    dwells: DwellRange = None,
    start: Annotated[float, Parameter(metavar="S", validator=Number(gte=0))] = 0.0,
    end: Annotated[float | None, Parameter(metavar="S", validator=Number(gte=0))] = None,
    entry: Annotated[Literal["phase_history", "slc", "heights"], Parameter(name="--from")] = "phase_history",
    namespace: Annotated[str | None, Parameter(metavar="NAME")] = None,
    clock: Clock = "lockstep",
    rate: Annotated[float | None, Parameter(metavar="R", validator=Number(gte=1e-6, lte=1e6))] = None,
    loop: Loop = 1,
    remap: Remap = (),
    jobs: Jobs | None = None,
    processes: Flag = False,
) -> int:
    """Play a recorded bag through the same nodes and compare the heights with those recorded.

    The output folder holds the new bag and report.json. A bag with one detector
    is focused only; its images are recorded, drawn and measured. Without
    --estimators, heights are made by those that made the recorded ones.

    Every value of every pixel is compared: equal, within the tolerance, or changed.
    The default tolerance is the rounding difference between processors. Where ROS
    is not installed, a replay runs without nodes, as with --jobs.

    Args:
        dwells: Play only dwells of these numbers, both included.
        start: Play only dwells that start at least this long after the first one of the bag, in seconds.
        end: Play only dwells that start at most this long after the first one, in seconds. Default: all.
        entry: Begin with the complex images (slc) or the heights in the bag. Heights go to tracker and mapper alone.
        namespace: Play the topics of this namespace. Needed only if several have what is played.
        rate: Speed of the playback over that of the sensor, with --clock paced. Default: 1.
        jobs: Process N dwells side by side, without nodes: same heights, but no diagnostics.
        processes: Has no effect any more: nodes of a replay share a process. Use --jobs 2 for long bags.
        against: Bag with the heights to compare with. Default: those of BAG.
        out: Output folder, new or empty. Default: out/replay_BAG, or the next free of out/replay_BAG_2, ….
    """
    from sal_height.workers.processes import use_one_blas_thread

    if jobs:
        use_one_blas_thread()

    from sal_height.bag.played import MOST
    from sal_height.bag.tolerance import ROUNDING, read_tolerances
    from sal_height.graph.reporting import comparison_table, images_table, results_table
    from sal_height.runs.chain.entry import Part
    from sal_height.runs.replay.bag_replay import Against, Playing
    from sal_height.runs.replay.bag_replay import replay as play_again

    if processes:
        complain(["Option --processes has no effect on a replay; --jobs 2 processes two dwells side by side."])
    first, last = dwells or (0, MOST)
    part = Part(entry, first, last, start, math.inf if end is None else end, namespace)
    playing = Playing(clock, rate, loop)
    folder = output_folder(out, f"replay_{bag_name(bag)}")
    golden = Against(against, read_tolerances(tolerance) if tolerance else ROUNDING)
    execution = graph.execution()
    result = play_again(bag, folder, node_parameters(param), execution, golden, estimators, part, playing, remap, jobs)
    print(images_table(result.images) if result.images else results_table(result.outcome, result.accuracy))
    if result.compared:
        print(f"\n{comparison_table(result.compared)}")
    print("".join(f"{sentence}\n" for sentence in result.outcome.losses_as_flown), end="")
    print(f"{'interrupted; ' if result.outcome.interrupted else ''}see {folder}/report.json and {folder}/bag")
    if result.outcome.interrupted:
        return INTERRUPTED
    shortfalls = result.shortfalls(changed=bool(param) and not against)
    complain(shortfalls)
    return FAILED if shortfalls else DONE
