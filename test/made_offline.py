"""Heights of a bag made without a graph, beside those in the bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sal_height.bag.compare import compare_bags
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import EXACT, Tolerances
from sal_height.runs.campaign import Case, conclude_bag, plan, process_part


def make(bag: Path, folder: Path, most_dwells: int, **given: Any) -> dict[str, Any]:
    """Process a bag in parts of so many dwells; returns its row of the summary, its heights are in folder/made/bag."""
    case = Case(bag, folder / "made", {}, given)
    scheme = plan(case, most_dwells)
    parts = [folder / f"part_{number}" for number in range(len(scheme.works))]
    for work, part in zip(scheme.works, parts, strict=True):
        process_part(work, part)
    return conclude_bag(case, scheme, parts)


def compared(
    bag: Path, folder: Path, most_dwells: int = 1, tolerances: Tolerances = EXACT, **given: Any
) -> dict[str, tuple[str, int]]:
    """Verdict on each topic of heights in a bag, and number of images, when they are made in such parts."""
    make(bag, folder, most_dwells, **given)
    golden = BagReader(bag)
    held = [topic for topic in golden.topics if topic.endswith("/height")]
    found = compare_bags(golden, BagReader(folder / "made" / "bag"), tolerances, held)
    return {topic: (one.verdict, one.matched) for topic, one in found.items()}
