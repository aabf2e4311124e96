"""`sal-height import-gotcha`: convert AFRL Gotcha phase history to a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sal_height.commands._options import BAGS, DONE, OutputFolder, command, output_folder

EXAMPLES = """
  sal-height import-gotcha pass1/HH/data_3dsar_pass1_az00*_HH.mat \\
    --out out/gotcha
  sal-height replay out/gotcha
"""

app = command("import-gotcha", BAGS, EXAMPLES)


@app.default
def import_gotcha(
    files: Annotated[tuple[Path, ...], Parameter(name="FILE", required=True)] = (), /, *, out: OutputFolder = None
) -> int:
    """Convert AFRL Gotcha phase history to a bag, which sal-height replay focuses.

    Args:
        files: Consecutive files data_3dsar_*.mat of one pass and polarisation.
        out: Folder of the new bag, new or empty. Default: out/gotcha, or the next free of out/gotcha_2, ….
    """
    from sal_height.runs.gotcha import import_gotcha as convert

    folder = output_folder(out, "gotcha")
    pulses = convert(list(files), folder)
    print(f"{pulses} pulses in {folder}; focus them with: sal-height replay {folder}")
    return DONE
