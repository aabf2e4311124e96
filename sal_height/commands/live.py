"""`sal-height live`: process a sensor that does not wait."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    FAILED,
    GRAPH,
    PROCESSING,
    Estimators,
    Flag,
    GraphOptions,
    NodeParameters,
    OutputFolder,
    command,
    complain,
    importing,
    node_parameters,
    output_folder,
)
from sal_height.errors import UserError
from sal_height.io import bag_name

if TYPE_CHECKING:
    from sal_height.graph.plan import Processes
    from sal_height.runs.live.sensor_bag import Feed

EXAMPLES = """
  sal-height live                        the lidar over a street, until Ctrl-C
  sal-height live --preset sal_stripmap --seconds 60
  sal-height live --bag out/sal_spotlight/bag --rate 0.5
  sal-height live --preset sal_passes --estimators ml,adjusted
  sal-height live --record phase_history --out out/flight
  sal-height live flight.yaml --supervise    nodes for a sensor of your own
"""

app = command("live", PROCESSING, EXAMPLES, "no height was estimated, or the recorder has lost messages")


@app.default
def live(
    config: Annotated[Path | None, Parameter(name="CONFIG", show_default=False)] = None,
    /,
    *,
    preset: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None,
    bag: Annotated[Path | None, Parameter(metavar="BAG")] = None,
    rate: Annotated[float | None, Parameter(metavar="X", validator=Number(gt=0))] = None,
    seconds: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
    dwells: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=1))] = None,
    budget: Annotated[float | None, Parameter(metavar="S", validator=Number(gt=0))] = None,
    one_process: Flag = False,
    separate: Flag = False,
    supervise: Flag = False,
    seed: Annotated[int | None, Parameter(metavar="S", validator=Number(gte=0, lt=2**31))] = None,
    graph: GraphOptions = GRAPH,
    out: OutputFolder = None,
    param: NodeParameters = (),
    estimators: Estimators = (),
) -> int:
    """Process a sensor that does not wait, and show rate, latency and drops of every node.

    Without CONFIG, the sensor's dwells are simulated beforehand, or come from a
    bag. They are played at the sensor's pace, repeatedly with increasing stamps,
    until Ctrl-C. When dwells arrive faster than they are processed, the oldest are
    left out whole and counted. The output folder holds the bag of
    the heights, report.json, and latency.png, which shows the latency of every
    node over time.

    With CONFIG, the nodes that it lists are started for a sensor of your own,
    in the ROS domain of the environment; docs/live.md describes the file.

    Args:
        config: YAML file with nodes, their parameters, topics and namespaces.
        preset: Sensor, flight and scene to simulate: the name of a preset, or a YAML file. Default: sal_spotlight.
        bag: Play this bag instead of a preset.
        rate: Seconds of the sensor in a second. Default: 1.
        seconds: End after this time. Default: at Ctrl-C.
        dwells: Number of dwells to simulate. Default: the preset's.
        budget: Longest time from a dwell to its heights, s. Default: the preset's, or 3 dwell intervals, at least 0.2.
        one_process: Run all nodes in one process, without workers.
        separate: Run each node in a process of its own, instead of all that process dwells in one with workers.
        supervise: Start processes again that have ended, after half a second at first and 30 s at most.
        seed: Seed of the random numbers. Default: 1.
        out: Output folder, new or empty. Default: out/live_PRESET, or the next free of out/live_PRESET_2, ….
    """
    import math
    import time

    from sal_height.workers.processes import prepare_for_messages, use_one_thread

    if supervise and one_process:
        raise UserError("Options --supervise and --one-process exclude each other: nodes in one process end together.")
    processes = _processes(one_process, separate, "Options --one-process and --separate exclude each other.")
    end_s = math.inf if seconds is None else seconds
    if config is not None:
        simulating = {"--preset": preset, "--bag": bag, "--rate": rate, "--dwells": dwells, "--budget": budget}
        _refuse_beside_config(
            {
                **simulating,
                "--seed": seed,
                "--out": out,
                "--param": param,
                "--record": graph.record,
                "--estimators": estimators,
            }
        )
        return _attend(config, processes, supervise, end_s, graph)
    prepare_for_messages()
    if processes != "one":
        use_one_thread()

    with importing():
        from sal_height.runs.live.live import Live, live
        from sal_height.runs.live.live_table import live_table, showing
        from sal_height.runs.live.record import messages_left_out

    feed, folder = _feed(preset or "sal_spotlight", bag, dwells, 1 if seed is None else seed, out, estimators)
    how = Live(rate or 1.0, end_s, budget or 0.0, supervise)
    with showing(lambda watched: live_table(watched, time.monotonic())) as show:
        seen = live(feed, folder / "run", node_parameters(param), how, graph.execution(processes), show)
    from sal_height.runs.live.latency_picture import (  # brings Matplotlib, which nodes need not carry
        LATENCIES,
        draw_run,
    )

    drawn = f"{folder}/run/{LATENCIES}, " if seen.heights and draw_run(folder / "run") else ""
    print(f"see {drawn}{folder}/run/report.json and {folder}/run/bag")
    if not seen.heights:
        complain(["No height was estimated; the table says where dwells were left out."])
        return FAILED
    if lost := messages_left_out(folder / "run" / "bag"):
        complain([f"{lost} messages are not in the bag; 'sal-height bag check {folder}/run/bag' says why."])
        return FAILED
    return DONE


def _feed(
    preset: str, bag: Path | None, dwells: int | None, seed: int, out: Path | None, estimators: tuple[str, ...]
) -> tuple[Feed, Path]:
    """The sensor that is played, from a bag or else simulated, and the output folder."""
    import dataclasses

    from sal_height.runs.live.sensor_bag import Feed
    from sal_height.simulation import load_preset

    if bag is not None:
        folder = output_folder(out, f"live_{bag_name(bag)}")
        return Feed.of_bag(bag, estimators), folder
    loaded = load_preset(preset)
    folder = output_folder(out, f"live_{loaded.name}")
    changed = dataclasses.replace(loaded, dwells=dwells or loaded.dwells, estimators=estimators or loaded.estimators)
    return Feed.simulated(changed, seed, folder / "sensor"), folder


def _refuse_beside_config(options: Mapping[str, object]) -> None:
    """Refuse options that say how a sensor is simulated or what is recorded: a configuration says it itself.

    Raises:
        UserError: one is given.
    """
    if given := [name for name, value in options.items() if value not in (None, ())]:
        raise UserError(
            f"Option {given[0]} is for a sensor that is simulated or played from a bag; a configuration names "
            f"nodes and "
            "their parameters in its file."
        )


def _processes(one_process: bool, separate: bool, refusal: str) -> Processes:
    """The processes that options or keys ask for.

    Raises:
        UserError: they contradict each other, with the message `refusal`.
    """
    if one_process and separate:
        raise UserError(refusal)
    return "one" if one_process else "each" if separate else "host"


def _attend(config: Path, asked: Processes, supervise: bool, seconds: float, graph: GraphOptions) -> int:
    """Run the nodes of a configuration.

    Args:
        config: its file.
        asked: processes that the options ask for; "host": those that the file asks for.
        supervise: True if processes are started again that have ended.
        seconds: duration, s.
        graph: further options.
    """
    import dataclasses
    import time

    from sal_height.runs.live.deployment import load_deployment
    from sal_height.workers.processes import prepare_for_messages, use_one_thread

    deployment = load_deployment(config)
    refusal = f"Configuration {config}: one_process and separate exclude each other."
    stated = _processes(deployment.one_process, deployment.separate, refusal)
    processes = stated if asked == "host" else asked
    if supervise and processes == "one":
        raise UserError(f"Configuration {config}: one_process excludes --supervise: nodes in one process end together.")
    prepare_for_messages()
    if processes != "one":
        use_one_thread()

    with importing():
        from sal_height.runs.live.deployment import members_of
        from sal_height.runs.live.live_table import attend, node_table, showing

    try:
        members = members_of(deployment)
    except UserError as error:
        raise UserError(f"Configuration {config}: {error}") from error
    execution = graph.execution(processes)
    if graph.domain is None:
        execution = dataclasses.replace(execution, domain="environment")
    with showing(lambda seen: node_table(seen.book, time.monotonic(), f"{seen.elapsed_s:.0f} s")) as show:
        seen = attend(members, execution, seconds, supervise, show)
    if not seen.has_worked:
        sentence = (
            "No node has processed or recorded anything; the table says what each waits for. The sensor must publish "
            "in the same ROS domain, in the namespace and on the topics that the configuration names."
        )
        complain([sentence])
        return FAILED
    return DONE
