"""`sal-height adjust`: errors of navigation and mounting, from passes that overlap."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    FAILED,
    PROCESSING,
    Bag,
    Jobs,
    NodeParameters,
    OutputFolder,
    Places,
    Settings,
    command,
    complain,
    node_parameters,
    output_folder,
    settings_values,
)
from sal_height.errors import UserError
from sal_height.io import bag_name

EXAMPLES = """
  sal-height run --preset sal_passes
  sal-height adjust out/sal_passes/bag --out out/adjusted
  sal-height replay out/adjusted/bag
  sal-height adjust BAG --target 3.95,3,1.02 --target -3.5,3,1.02
  sal-height adjust BAG --terrain ground.tif --terrain-sigma 0.1
"""

LEAST_SIGMA_M, DEFAULT_SIGMA_M, MOST_SIGMA_M = 1e-4, 0.1, 1000.0
"""Standard deviation of the heights of an elevation model, as of the node height_adjuster (terrain_sigma_m)."""

app = command(
    "adjust",
    PROCESSING,
    EXAMPLES,
    "nothing was found: no dwell could be compared, with another one or with known ground, and Doppler centroids do "
    "not give the mounting either; report and bag say what was known beforehand",
)


@app.default
def adjust(
    bag: Bag,
    /,
    *,
    estimator: Annotated[str, Parameter(metavar="NAME")] = "ml",
    target: Places = (),
    targets: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    terrain: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    terrain_sigma: Annotated[
        float | None, Parameter(metavar="M", show_default=False, validator=Number(gte=LEAST_SIGMA_M, lte=MOST_SIGMA_M))
    ] = None,
    set_: Settings = (),
    param: NodeParameters = (),
    jobs: Jobs = 1,
    out: OutputFolder = None,
) -> int:
    """Find errors of navigation and mounting, so that heights of overlapping dwells agree.

    The heights of all dwells, or of all images of strips, are made again and
    compared where they show the same ground: best in passes flown to and fro, which
    see it from both sides. From that, the Doppler centroids and the stated odometry
    and mounting, the command estimates
      navigation   errors of position, velocity and attitude over time
      mounting     boresight, lever arm and delay, and the pitch of the beams
    with their covariance. It reports what cannot be determined: without known
    ground, a common offset of all dwells is that of the odometry.

    The output folder holds a bag with the corrected odometry, to be replayed;
    report.json and adjustment.png. Errors of the mounting that were found are part
    of that odometry; the report has the mounting as it should be described. If no
    dwell could be compared, the bag has the odometry as it was.

    Args:
        estimator: Whose heights are compared.
        target: A point target at a known place in map; may be repeated.
        targets: CSV file of more, with the columns east_m, north_m, height_m and, if it is not 0.01, sigma_m.
        terrain: Elevation model of known ground, as .tif or .npz, around the origin of map.
        terrain_sigma: Standard deviation of its heights. Default: 0.1 m.
        out: Output folder, new or empty. Default: out/adjust_BAG, or the next free of out/adjust_BAG_2, ….
    """
    from sal_height.workers.processes import use_one_blas_thread

    use_one_blas_thread()

    from sal_height.adjustment import References, Target, Terrain, read_targets
    from sal_height.geometry.elevation_model import read_elevation_model
    from sal_height.runs.products.adjust import adjust_bag
    from sal_height.runs.products.adjustment_report import adjustment_table, determines_nothing, has_comparisons

    if terrain_sigma is not None and not terrain:
        raise UserError("Option --terrain-sigma has no meaning without --terrain, whose heights it is about.")
    ground = Terrain(read_elevation_model(terrain).heights, terrain_sigma or DEFAULT_SIGMA_M) if terrain else None
    known = (*(Target(*place) for place in target), *(read_targets(targets) if targets else ()))
    references = References(known, ground)
    folder = output_folder(out, f"adjust_{bag_name(bag)}")
    given, wanted = node_parameters(param), settings_values(set_)
    summary, warnings = adjust_bag(bag, folder, estimator, given, wanted, references, jobs)
    print(adjustment_table(summary))
    complain(warnings)
    corrected = f"heights with the corrected odometry: sal-height replay {folder}/bag"
    kept = f"{folder}/bag has the odometry as it was"
    print(f"see {folder}/adjustment.png; {corrected if has_comparisons(summary) else kept}")
    return FAILED if determines_nothing(summary) else DONE
