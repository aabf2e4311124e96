"""`sal-height live`: process a sensor that does not wait."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    FAILED,
    GRAPH,
    PROCESSING,
    Flag,
    GraphOptions,
    NodeParameters,
    OutputFolder,
    Seed,
    bag_name,
    command,
    complain,
    importing,
    node_parameters,
    output_folder,
)

EXAMPLES = """
  sal-height live                        the lidar over a street, until Ctrl-C
  sal-height live --preset sal_stripmap --seconds 60
  sal-height live --bag out/sal_spotlight/bag --rate 0.5
  sal-height live --record phase_history --out out/flight
"""

app = command("live", PROCESSING, EXAMPLES, "no height came out")


@app.default
def live(
    *,
    preset: Annotated[str, Parameter(metavar="NAME|FILE")] = "sal_spotlight",
    bag: Annotated[Path | None, Parameter(metavar="BAG")] = None,
    rate: Annotated[float, Parameter(metavar="X", validator=Number(gt=0))] = 1.0,
    seconds: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
    dwells: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=1))] = None,
    budget: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
    one_process: Flag = False,
    seed: Seed = 1,
    graph: GraphOptions = GRAPH,
    out: OutputFolder = None,
    param: NodeParameters = (),
) -> int:
    """Process a sensor that does not wait, and show rate, latency and drops of every node.

    The sensor's dwells are simulated beforehand, or come from a bag. They are
    played at the sensor's pace, again and again with stamps that go on, until
    Ctrl-C. When dwells come faster than they are processed, the oldest are left
    out whole and counted. The output folder holds the bag of the heights, and
    report.json.

    Args:
        preset: Sensor, flight and scene to simulate: the name of a preset, or a YAML file.
        bag: Play this bag instead of a preset.
        rate: Seconds of the sensor in a second.
        seconds: End after this time. Default: at Ctrl-C.
        dwells: Number of dwells to simulate. Default: the preset's.
        budget: Longest time from a dwell to its heights, in seconds. Default: the preset's latency_budget_s, or
            three dwell intervals, but at least 0.2.
        one_process: Run all nodes in one process instead of one each.
        out: Output folder, new or empty. Default: out/live_PRESET, or the next free of out/live_PRESET_2, ….
    """
    import dataclasses
    import math

    from sal_height.runs.processes import use_one_thread

    if not one_process:
        use_one_thread()

    with importing():
        from rich.console import Console
        from rich.live import Live as Display

        from sal_height.runs.live import Live, Watched, live
        from sal_height.runs.live_table import live_table
        from sal_height.runs.sensor_bag import Feed
        from sal_height.simulation import load_preset

    parameters, execution = node_parameters(param), graph.execution(not one_process)
    if bag is None:
        loaded = load_preset(preset)
        folder = output_folder(out, f"live_{loaded.name}")
        changed = dataclasses.replace(loaded, dwells=dwells or loaded.dwells)
        played = Feed.simulated(changed, seed, folder / "sensor")
    else:
        folder = output_folder(out, f"live_{bag_name(bag)}")
        played = Feed.of_bag(bag)
    how = Live(rate, math.inf if seconds is None else seconds, budget or 0.0)
    console = Console()
    if console.is_terminal:
        with Display(console=console, auto_refresh=False) as display:
            seen = live(
                played,
                folder / "run",
                parameters,
                how,
                execution,
                lambda w: display.update(live_table(w), refresh=True),
            )
    else:

        def nothing(_: Watched) -> None:
            """A log is no place for a table that changes."""

        seen = live(played, folder / "run", parameters, how, execution, nothing)
        console.print(live_table(seen))
    print(f"see {folder}/run/report.json and {folder}/run/bag")
    if not seen.heights:
        complain(["No height came out; the table says where dwells were left out."])
        return FAILED
    return DONE
