"""`sal-height passes`: heights of bright points, from several passes over the same ground."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sal_height.commands._options import (
    DONE,
    PROCESSING,
    Jobs,
    NodeParameters,
    OutputFolder,
    Places,
    Settings,
    command,
    complain,
    metres,
    node_parameters,
    one_word,
    output_folder,
    settings_values,
)

EXAMPLES = """
  sal-height import gotcha pass1/*.mat --out out/pass1
  sal-height passes out/pass1 out/pass2 out/pass3 out/pass4
  sal-height passes out/pass? --tie 3.95,3,1.02 --compare -3.5,3,1.02
  sal-height passes out/pass? --estimator capon --set highest_m=12
"""

app = command("passes", PROCESSING, EXAMPLES)


@app.default
def passes(
    bags: Annotated[tuple[Path, ...], Parameter(name="BAG", show_default=False)],
    /,
    *,
    estimator: Annotated[str, Parameter(metavar="NAME")] = "ml",
    tie: Places = (),
    compare: Places = (),
    centre: Annotated[
        tuple[float, float] | None,
        one_word(
            "EAST,NORTH",
            lambda token: metres(token, "EAST,NORTH", "10,-3"),
            allow_leading_hyphen=True,
            negative=(),
        ),
    ] = None,
    jobs: Jobs = 1,
    set_: Settings = (),
    param: NodeParameters = (),
    out: OutputFolder = None,
) -> int:
    """Make heights of bright points from several passes over the same ground.

    The passes are a sparse array in elevation, whose channels are their images.
    Errors of phase and position between the passes are estimated from bright
    points, except for a height that is common to all points: it is that of
    reference points (--tie), or else the median of the points is set to ground_m.
    Passes of another band, of other ground or whose phase cannot be tied are left
    out.

    The output folder holds report.json, passes.png and a bag with the heights of
    the points, for `sal-height export`.

    Args:
        bags: Folders of bags, or their .mcap files; of one pass each, three or more.
        estimator: Estimator of elevation: ml or capon.
        tie: A reflector at a known position in map that all heights refer to; may be repeated.
        compare: A reflector at a known position in map that heights are compared with; may be repeated.
        centre: Middle of the scene. Default: where the passes look.
        out: Output folder, new or empty. Default: out/passes, or the next free of out/passes_2, ….
    """
    import numpy as np

    from sal_height.passes import ReferencePoint
    from sal_height.runs.products.passes import heights_of_bags
    from sal_height.runs.products.passes_report import passes_table

    references = [ReferencePoint(np.array(place), ties=True) for place in tie]
    references += [ReferencePoint(np.array(place)) for place in compare]
    folder = output_folder(out, "passes")
    given, wanted = node_parameters(param), settings_values(set_)
    summary, warnings = heights_of_bags(bags, folder, estimator, given, wanted, references, centre, jobs)
    print(passes_table(summary))
    complain(warnings)
    print(f"see {folder}/passes.png and {folder}/report.json")
    return DONE
