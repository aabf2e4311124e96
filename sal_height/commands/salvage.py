"""`sal-height salvage`: another name of `sal-height bag recover`."""

from __future__ import annotations

from sal_height.commands._options import BAGS, Bag, OutputFolder, command, output_folder
from sal_height.commands.bag import LOST, recover_bag
from sal_height.io import bag_name

EXAMPLES = """
  sal-height salvage damaged/bag --out out/recovered
"""

app = command("salvage", BAGS, EXAMPLES, LOST)


@app.default
def salvage(bag: Bag, /, *, out: OutputFolder = None) -> int:
    """Recover the intact messages of a bag, as `sal-height bag recover` does.

    Args:
        out: Folder of the new bag, new or empty. Default: out/salvage_BAG, or the next free of out/salvage_BAG_2, ….
    """
    return recover_bag(bag, output_folder(out, f"salvage_{bag_name(bag)}"))
