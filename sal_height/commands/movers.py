"""`sal-height movers`: what moves in the strips or dwells of a bag."""

from __future__ import annotations

from sal_height.commands._options import (
    DONE,
    PROCESSING,
    Bag,
    Jobs,
    NodeParameters,
    OutputFolder,
    Settings,
    command,
    complain,
    node_parameters,
    output_folder,
    settings_values,
)
from sal_height.io import bag_name

EXAMPLES = """
  sal-height run --preset sal_movers
  sal-height movers out/sal_movers/bag
  sal-height run --preset sal_spotlight
  sal-height movers out/sal_spotlight/bag
  sal-height movers BAG --set false_alarm_rate=1e-5 --set prominence_db=15
  sal-height movers BAG --set fastest_mps=0
"""

app = command("movers", PROCESSING, EXAMPLES)


@app.default
def movers(
    bag: Bag, /, *, set_: Settings = (), param: NodeParameters = (), jobs: Jobs = 1, out: OutputFolder = None
) -> int:
    """Find movers in the strips or dwells of a bag: position, height and radial velocity.

    The image of a mover is displaced in azimuth by range times radial velocity over
    speed. Its position in the beam gives its velocity, and with it position and
    height, except for multiples of the velocity that the pulses cannot distinguish
    from zero. At metres per second, up to fastest_mps, a mover migrates through
    rows of the image while the beam passes, or from one spotlight dwell to the
    next, which gives its speed without ambiguity. Spotlight dwells must overlap;
    they are compressed again with all Doppler frequencies, unless --param
    sar_compression.cols says otherwise. The rate of false alarms is
    false_alarm_rate at most. The output folder holds report.json.

    Args:
        out: Output folder, new or empty. Default: out/movers_BAG, or the next free of out/movers_BAG_2, ….
    """
    from sal_height.workers.processes import use_one_blas_thread

    use_one_blas_thread()

    from sal_height.runs.products.movers import find_in_bag, movers_table

    folder = output_folder(out, f"movers_{bag_name(bag)}")
    summary, warnings = find_in_bag(bag, folder, node_parameters(param), settings_values(set_), jobs)
    print(movers_table(summary))
    complain(warnings)
    print(f"see {folder}/report.json")
    return DONE
