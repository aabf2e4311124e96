"""`sal-height salvage`: recover the intact messages of a damaged bag."""

from __future__ import annotations

from sal_height.commands._options import BAGS, DONE, Bag, OutputFolder, bag_name, command, output_folder

EXAMPLES = """
  sal-height salvage damaged/bag --out out/recovered
"""

app = command("salvage", BAGS, EXAMPLES)


@app.default
def salvage(bag: Bag, /, *, out: OutputFolder = None) -> int:
    """Recover the intact messages of a bag that is damaged or whose recording was cut off.

    Args:
        out: Folder of the new bag, new or empty. Default: out/salvage_BAG, or the next free of out/salvage_BAG_2, ….
    """
    from sal_height.bag.salvage import salvage as recover

    folder = output_folder(out, f"salvage_{bag_name(bag)}")
    count = recover(bag, folder)
    print(f"{count} messages recovered in {folder}")
    return DONE
