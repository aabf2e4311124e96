"""Heights of a bag made without a graph, beside those in the bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sal_height.bag.compare import compare_bags
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import EXACT, Tolerances
from sal_height.runs.campaign.batch import Case, process_case


def make(bag: Path, folder: Path, jobs: int = 1, **given: Any) -> dict[str, Any]:
    """Process a bag, so many dwells at a time; its row of the summary, the heights are in folder/made/bag."""
    return process_case(Case(bag, folder / "made", {}, given), jobs)


def compared(
    bag: Path, folder: Path, jobs: int = 1, tolerances: Tolerances = EXACT, **given: Any
) -> dict[str, tuple[str, int]]:
    """Verdict on each topic of heights in a bag, and number of images, when they are made by so many jobs."""
    make(bag, folder, jobs, **given)
    golden = BagReader(bag)
    held = [topic for topic in golden.topics if topic.endswith("/height")]
    found = compare_bags(golden, BagReader(folder / "made" / "bag"), tolerances, held)
    return {topic: (one.verdict, one.matched) for topic, one in found.items()}
