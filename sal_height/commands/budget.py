"""`sal-height budget`: what a sensor needs and gives, from its preset alone."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from cyclopts import Parameter

from sal_height.commands._options import (
    DONE,
    FAILED,
    THEORY,
    OutputFolder,
    allowed,
    command,
    complain,
    output_folder,
)

EXAMPLES = """
  sal-height budget sal_spotlight
  sal-height budget sal_spotlight --power 10
  sal-height budget xband_relief --backscatter-db -15 --loss-db 6 \\
    --noise-figure-db 4
  sal-height budget my_sensor.yaml
"""

app = command("budget", THEORY, EXAMPLES, "`sal-height run` refuses the preset; sentences on stderr say why")

Ratio: TypeAlias = Annotated[
    float, Parameter(metavar="DB", validator=allowed("from 0 to 100 (dB)", lambda value: 0 <= value <= 100))
]


@app.default
def budget(
    preset: str,
    /,
    *,
    power: Annotated[
        float | None,
        Parameter(metavar="W", validator=allowed("above 0, at most 1e9 (W)", lambda value: 0 < value <= 1e9)),
    ] = None,
    backscatter_db: Annotated[
        float | None,
        Parameter(metavar="DB", validator=allowed("from -80 to 40 (dB)", lambda value: -80 <= value <= 40)),
    ] = None,
    loss_db: Ratio = 0.0,
    noise_figure_db: Ratio = 0.0,
    out: OutputFolder = None,
) -> int:
    """Print the budget of a sensor: power, resolution, swath, pulses, data, accuracy.

    Nothing is simulated: all numbers are closed forms for level ground, abeam,
    in the middle of the beams. The transmitter lights up the beams of all
    detectors evenly and nothing else, and pixels are unweighted. CNR is that of
    one look of a detector that looks straight at the ground, as in presets, and
    sigma the Cramer-Rao bound of a pixel with the looks of the preset. A perfect
    receiver (noise figure 0 dB) has the noise k T at 290 K, or h f in light; of a
    lidar, the noise figure is one over the efficiency of detection.

    The group "sensitivity to uncorrected errors" gives the effect of an error of
    one unit, whether the preset has it or not, and "errors of this preset" the size
    of the preset's impairments and their effect on position and height where
    neither a parameter nor autofocus removes them. Random errors are rms, constant
    ones without their sign. The last line says whether autofocus is needed.

    The output folder holds budget.json and budget.png.

    Args:
        preset: Name of a preset or path of its YAML file.
        power: Mean transmitted power. Default: the power for the CNR of the preset.
        backscatter_db: Radar cross-section per area of ground, sigma0. Default: diffuse, albedo 0.3; of a radar, -10.
        loss_db: Losses of power in transmitter, air and receiver together.
        noise_figure_db: Noise of the receiver over that of a perfect one.
        out: Output folder, new or empty. Default: out/budget, or the next free of out/budget_2, ….
    """
    from sal_height.budget.budget import BUDGET, PICTURE, Assumptions
    from sal_height.budget.budget import budget as draw_up
    from sal_height.budget.budget_errors import budget_table
    from sal_height.simulation import load_preset

    folder = output_folder(out, "budget")
    described = load_preset(preset)
    assumed = Assumptions(
        power=power,
        backscatter=None if backscatter_db is None else 10 ** (backscatter_db / 10),
        loss=10 ** (loss_db / 10),
        noise_figure=10 ** (noise_figure_db / 10),
    )
    drawn = draw_up(described, assumed, folder)
    print(budget_table(drawn.entries), *drawn.notes, sep="\n")
    print(f"see {folder}/{BUDGET} and {folder}/{PICTURE}")
    complain(drawn.refusals)
    return FAILED if drawn.refusals else DONE
