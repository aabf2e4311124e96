"""The tasks of a campaign: the heights of a bag are made on the chain host and judged.

Each task leaves its result in a folder of its own, at once and whole, and is not done again where it is there already.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.compare import compare_bags
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import ROUNDING
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.engine.height_items import Heights
from sal_height.engine.stage import Product
from sal_height.graph.catalogue import HEIGHTS, NodeParameters
from sal_height.graph.reporting import PARAMETERS
from sal_height.io import write_text
from sal_height.messages.kinds import write_heights
from sal_height.runs.chain.chain_runs import BagRun, Scheme, plan
from sal_height.runs.chain.entry import Part
from sal_height.runs.replay.judge import verdict_of
from sal_height.runs.truth.report import read_accuracy, read_images, recorded_flight

DONE = "done.json"
"""File in the folder of a part, or of a bag, with its result; it is written last."""


@dataclass(frozen=True)
class Case:
    """A bag and the parameters it is processed with.

    Attributes:
        bag: folder of the bag, or its file.
        folder: folder of its results.
        values: values of parameters that are varied, by "node.name".
        given: parameters of nodes that replace recorded ones, with those that are varied.
        estimators: names of those whose heights are made; none: as `chain_of` has it.
    """

    bag: Path
    folder: Path
    values: Mapping[str, Any]
    given: NodeParameters
    estimators: tuple[str, ...] = ()


def process_case(case: Case, jobs: int) -> dict[str, Any]:
    """Make the heights of a bag, track them and judge them, unless that is done; returns a row of the summary.

    Args:
        case: the bag, and how it is processed.
        jobs: dwells that are processed side by side.

    Raises:
        UserError: the bag cannot be used, a parameter is not allowed, or the heights cannot be written.
    """

    def make(new: Path) -> dict[str, Any]:
        scheme = plan(case.bag, case.given, case.estimators)
        topics = [f"{HEIGHTS[node]}/height" for node in scheme.stages if node in HEIGHTS]
        begun, images = time.monotonic(), 0
        run = BagRun(scheme, scheme.stages, jobs=jobs, wanted=topics)
        reader = Part(namespace=scheme.namespace).open(case.bag)
        custom_data = {**reader.custom_data, PARAMETERS: json.dumps(scheme.parameters)}
        with BagWriter(new / "bag", custom_data) as bag:
            for topic in topics:
                bag.add_topic(f"/{topic}", HEIGHT_TYPE)
            for made in run.results():
                if isinstance(made.result, Product) and isinstance(item := made.result.item, Heights):
                    time_ns = run.time_of(item.key)
                    for cdr in write_heights(item):
                        bag.write(f"/{made.result.port}", cdr, time_ns, time_ns)
                    images += 1
        losses = run.losses
        row = {
            "bag": str(case.bag),
            **case.values,
            "failure": "",
            "dwells": len(scheme.frames),
            "dropped": losses.dropped.total(),
            "drops": json.dumps(losses.dropped),
            "warnings": json.dumps([*scheme.warnings, *losses.sentences.values()]),
            "images": images,
            "seconds": time.monotonic() - begun,
        }
        return row | _judged(reader, new / "bag", scheme)

    return _once(case.folder, make)


def _judged(reader: BagReader, made: Path, scheme: Scheme) -> dict[str, Any]:
    """Columns on the heights: fraction, sigma, and comparison with those in the bag and with the truth."""
    recorded = [topic.name for topic in reader.topics.values() if topic.type_name == HEIGHT_TYPE and topic.count]
    compared = compare_bags(reader, BagReader(made), ROUNDING, recorded)
    columns: dict[str, Any] = {"against_recorded": verdict_of(compared) if compared else ""}
    for prefix, images in read_images(made).items():
        sigma = np.concatenate([image.surfaces[0].sigma for image in images if image.surfaces])
        known_sigma = np.isfinite(sigma)
        columns[f"{prefix}_with_height"] = float(np.mean(known_sigma)) if known_sigma.size else None
        columns[f"{prefix}_median_sigma_m"] = float(np.median(sigma[known_sigma])) if known_sigma.any() else None
    flight = recorded_flight(reader)
    if flight is None:
        return columns
    for prefix, numbers in read_accuracy(made, flight, list(scheme.stages)).statistics.items():
        for name in ACCURACY:
            columns[f"{prefix}_{name}"] = numbers.get(name)
    return columns


ACCURACY = ("valid", "two_scatterers", "bias_m", "rms_m", "s68_m", "sigma_m", "within_1_sigma", "beyond_5_sigma")
"""Numbers of the accuracy, as report.json has them, that the summary has of each estimator."""


def _once(folder: Path, make: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """Have a folder made unless it is done, and return its result.

    The folder is made next to its final name, and moved there once it is whole.
    """
    if is_done(folder):
        return known(folder)
    new = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    begun = time.monotonic()
    try:
        result = make(new)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    result.setdefault("seconds", time.monotonic() - begun)
    write_text(new / DONE, json.dumps(result, indent=2) + "\n")
    new.rename(folder)
    return result


def is_done(folder: Path) -> bool:
    """True if a folder has been made."""
    return (folder / DONE).is_file()


def known(folder: Path) -> dict[str, Any]:
    """Result in a folder that has been made."""
    found: dict[str, Any] = json.loads((folder / DONE).read_text(encoding="utf-8"))
    return found
