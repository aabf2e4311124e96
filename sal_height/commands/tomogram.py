"""`sal-height tomogram`: plot a vertical cut through vegetation."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    MEASURING,
    Bag,
    Jobs,
    OutputFolder,
    RangeByAzimuth,
    command,
    output_folder,
)
from sal_height.io import bag_name

EXAMPLES = """
  sal-height run --preset woods --record slc --out out/woods
  sal-height tomogram out/woods/bag
  sal-height tomogram out/woods/bag --looks 1x10 --row 12
"""

app = command("tomogram", MEASURING, EXAMPLES)


@app.default
def tomogram(
    bag: Bag,
    /,
    *,
    looks: RangeByAzimuth = None,
    row: Annotated[int | None, Parameter(metavar="N", validator=Number(gte=0))] = None,
    jobs: Jobs = 1,
    out: OutputFolder = None,
) -> int:
    """Plot reflectivity against height and along-track distance, and the ground under the canopy.

    The bag must contain the images of all channels (topic slc), or the phase
    history for them. The cut goes through the pixels of one range. The panels show
    the regularised inversion of the channels' covariance, Capon's spectrum, and
    MUSIC's pseudo-spectrum; the ground where canopy_ground detects it; and the true
    ground and top of the canopy if the flight was simulated.

    The output folder holds tomogram.png.

    Args:
        looks: Pixels averaged in range and azimuth. Default: 1x20.
        row: Row of the cut, counted in averaged pixels from the nearest range. Default: the middle one.
        out: Output folder, new or empty. Default: out/tomogram_BAG, or the next free of out/tomogram_BAG_2, ….
    """
    from sal_height.runs.products.tomogram import tomogram as draw

    folder = output_folder(out, f"tomogram_{bag_name(bag)}")
    detected = draw(bag, folder, looks or (1, 20), row, jobs)
    print(f"ground detected in {detected or 'none of the'} pixels; see {folder}/tomogram.png")
    return DONE
