"""`sal-height run`: simulate a flight and process it with the graph."""

from __future__ import annotations

import dataclasses
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from sal_height.commands._options import (
    DONE,
    FAILED,
    GRAPH,
    INTERRUPTED,
    PROCESSING,
    SHIPPED_PRESETS,
    Estimators,
    Flag,
    GraphOptions,
    Jobs,
    NodeParameters,
    OutputFolder,
    Place,
    RangeByAzimuth,
    Seed,
    command,
    complain,
    node_parameters,
    output_folder,
)
from sal_height.extras import how_to_install
from sal_height.tables import counted

if TYPE_CHECKING:
    from sal_height.simulation import Preset

EXAMPLES = """
  sal-height run                             simulate the lidar over a street
  sal-height run --preset xband_relief --dwells 8
  sal-height run --cnr-db 10 --looks 4x2 --out out/noisy
  sal-height run --param ml_height.objective=numerator
  sal-height run --preset small --estimators ml,capon,music
"""

app = command("run", PROCESSING, EXAMPLES, "no valid height was produced, or messages were dropped")


@app.default
def run(
    *,
    preset: Annotated[
        str, Parameter(metavar="NAME|FILE", help=f"One of {', '.join(SHIPPED_PRESETS)}, or a YAML file.")
    ] = "sal_spotlight",
    scene: Annotated[str | None, Parameter(metavar="NAME|PATH")] = None,
    dwells: Annotated[int | None, Parameter(metavar="N")] = None,
    cnr_db: Annotated[float | None, Parameter(metavar="X")] = None,
    looks: RangeByAzimuth = None,
    origin: Place = None,
    seed: Seed = 1,
    processes: Flag = False,
    graph: GraphOptions = GRAPH,
    out: OutputFolder = None,
    param: NodeParameters = (),
    estimators: Estimators = (),
    jobs: Jobs | None = None,
) -> int:
    """Simulate a flight, process it with the graph of nodes, and compare the heights with the truth.

    The output folder holds the recorded bag, report.json, height.png, errors.png,
    ground.png, scene3d.png, profile.png and relief_map.tif, and doubts.png if a
    dwell is in doubt. The command ends with a table of the errors of all surfaces
    that each estimator publishes: bias, the sigma that all pixels share, s68 (half
    the width between 16 % and 84 % of the errors), and the percentages within 1 and
    beyond 5 sigma. With an origin, the map is in UTM. Where ROS is not installed,
    a run processes the dwells without nodes, as with --jobs.

    Args:
        scene: Terrain: street, woods, village, jacksboro_fault, or a DEM as .tif or .npz file. Default: the preset's.
        dwells: Number of dwells. Default: the preset's.
        cnr_db: Single-look CNR in dB of a detector pointed at the ground. Default: the preset's.
        looks: Pixels averaged in range x azimuth, for example 2x2. Default: the preset's.
        origin: Origin of the map on WGS 84, in degrees and m. Default: that of the scene's file, or the preset's.
        processes: Has no effect any more: the nodes of a run share a process.
        jobs: Process N dwells side by side, without nodes: same heights, but no diagnostics.
        out: Output folder, new or empty. Default: out/PRESET, or the next free of out/PRESET_2, ….
    """
    from sal_height.graph.reporting import RELIEF_MAP, achieved, results_table
    from sal_height.runs.truth.simulate import run as simulate
    from sal_height.simulation import load_preset

    changed = _changed(
        load_preset(preset),
        {
            "scene": scene,
            "dwells": dwells,
            "cnr_db": cnr_db,
            "looks": looks,
            "origin": origin,
            "estimators": estimators or None,
        },
    )
    if processes:
        complain(["Option --processes has no effect on a run any more: its nodes share a process."])
    folder = output_folder(out, changed.name)
    result = simulate(changed, seed, folder, node_parameters(param), graph.execution(), jobs)
    outcome = result.outcome
    print(results_table(outcome, result.accuracy.statistics))
    if sentence := achieved(result.accuracy.statistics):
        print(sentence)
    interrupted = " (interrupted)" if outcome.interrupted else ""
    pictures = ("scene3d.png", "height.png", "errors.png", "ground.png", "profile.png", "doubts.png")
    left = (folder / name for name in (*pictures, RELIEF_MAP, "report.json", "bag"))
    first, *others = [str(path) for path in left if path.exists()]
    print(f"{counted(outcome.dwells, 'dwell')}{interrupted}; look first at {first}, then at {', '.join(others)}")
    if not find_spec("rasterio"):
        complain([f"{RELIEF_MAP} is left out: it needs {how_to_install('rasterio', 'dem')}"])
    if outcome.interrupted:
        return INTERRUPTED
    complain(outcome.losses)
    if not (folder / "height.png").is_file():
        complain([f"No valid height was produced; see {folder}/report.json for the reasons."])
        return FAILED
    return FAILED if outcome.losses else DONE


def _changed(preset: Preset, options: dict[str, object]) -> Preset:
    """The preset with the options that were given in place of its own values, validated again."""
    from sal_height.simulation import parse_preset

    given = {name: value for name, value in options.items() if value is not None}
    return parse_preset(dataclasses.asdict(preset) | given, f"{preset.name} with the options given")
