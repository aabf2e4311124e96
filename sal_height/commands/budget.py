"""`sal-height budget`: what a sensor needs and gives, from its preset alone."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import DONE, THEORY, OutputFolder, command, output_folder

EXAMPLES = """
  sal-height budget sal_spotlight
  sal-height budget sal_spotlight --power 10
  sal-height budget xband_relief --backscatter-db -15 --loss-db 6 \\
    --noise-figure-db 4
  sal-height budget my_sensor.yaml
"""

app = command("budget", THEORY, EXAMPLES)

Ratio: TypeAlias = Annotated[float, Parameter(metavar="DB", validator=Number(gte=0, lte=100))]


@app.default
def budget(
    preset: str,
    /,
    *,
    power: Annotated[float | None, Parameter(metavar="W", validator=Number(gt=0, lte=1e9))] = None,
    backscatter_db: Annotated[float | None, Parameter(metavar="DB", validator=Number(gte=-80, lte=40))] = None,
    loss_db: Ratio = 0.0,
    noise_figure_db: Ratio = 0.0,
    out: OutputFolder = None,
) -> int:
    """Print the budget of a sensor: power, resolution, swath, pulses, data, accuracy.

    Nothing is simulated: all numbers are closed forms for level ground, abeam,
    in the middle of the beams. The transmitter lights up the beams of all
    detectors evenly and nothing else, and pixels are unweighted. CNR is that of
    one look of a detector that looks straight at the ground, as in presets, and
    sigma the Cramer-Rao bound of a pixel with the looks of the preset.

    The last group says what errors cost that nobody tells the processor.

    The output folder holds budget.json and budget.png.

    Args:
        preset: Name of a preset or path of its YAML file.
        power: Mean power transmitted. Default: what gives the CNR of the preset.
        backscatter_db: Radar cross-section per area of ground (sigma0). Default: of a diffuse surface that scatters
            0.3 of the light; of a radar, -10.
        loss_db: Losses of power in transmitter, air and receiver together.
        noise_figure_db: By how much the receiver is noisier than a perfect one, whose noise is k T at 290 K, or in
            light h f; of a lidar, one over the efficiency of detection.
        out: Output folder, new or empty. Default: out/budget, or the next free of out/budget_2, ….
    """
    from sal_height.runs.budget import BUDGET, PICTURE, Assumptions, budget_table
    from sal_height.runs.budget import budget as draw_up
    from sal_height.simulation import load_preset

    folder = output_folder(out, "budget")
    described = load_preset(preset)
    assumed = Assumptions(
        power=power,
        backscatter=None if backscatter_db is None else 10 ** (backscatter_db / 10),
        loss=10 ** (loss_db / 10),
        noise_figure=10 ** (noise_figure_db / 10),
    )
    print(budget_table(draw_up(described, assumed, folder)))
    print(f"see {folder}/{BUDGET} and {folder}/{PICTURE}")
    return DONE
