"""The tasks of a campaign: a bag is planned, its parts are processed, and what they made is put together and judged.

Each task leaves its result in a file of its own, at once and whole, and is not done again where it is there already.
"""

from __future__ import annotations

import json
import shutil
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.compare import compare_bags
from sal_height.bag.reader import BagReader, LogTimes
from sal_height.bag.tolerance import ROUNDING
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.io import write_text
from sal_height.nodes.cues import Cue
from sal_height.nodes.playlist import FRAMES
from sal_height.runs.accuracy import read_accuracy, read_images
from sal_height.runs.catalogue import ADJUSTER, DETECTOR, NodeParameters, consumers
from sal_height.runs.entry import Part, chain_of, sensors_of
from sal_height.runs.judge import verdict_of
from sal_height.runs.offline import process, track
from sal_height.runs.recorded_dwells import InForce, Losses, Work
from sal_height.runs.replay import recorded_flight
from sal_height.runs.replay_parameters import processing_of
from sal_height.runs.reporting import PARAMETERS

DONE = "done.json"
"""File in the folder of a part, or of a bag, that says what became of it; where it is, all else is."""


@dataclass(frozen=True)
class Case:
    """A bag and the parameters it is processed with.

    Attributes:
        bag: folder of the bag, or its file.
        folder: where its results belong.
        values: of parameters that are varied, by "node.name".
        given: parameters of nodes that replace recorded ones, with those that are varied.
        estimators: names of those whose heights are made; none: as `chain_of` has it.
    """

    bag: Path
    folder: Path
    values: Mapping[str, Any]
    given: NodeParameters
    estimators: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scheme:
    """How a bag is processed.

    Attributes:
        namespace: of its topics.
        stages: nodes that work on it.
        parameters: of all nodes at the first dwell, by node and name.
        cues: what happens before later dwells.
        works: parts that can be processed on their own, in the order of their dwells.
        warnings: sentences on what cannot be done as in flight.
    """

    namespace: str
    stages: tuple[str, ...]
    parameters: NodeParameters
    cues: tuple[Cue, ...]
    works: tuple[Work, ...]
    warnings: tuple[str, ...]


def plan(case: Case, most_dwells: int, *, for_heights: bool = True) -> Scheme:
    """Find out how a bag is to be processed, in parts of so many dwells at most; a strip is one part.

    A bag of one detector is refused, unless its heights are not asked for.

    Raises:
        UserError: the bag cannot be used, or a parameter is not allowed.
    """
    part = Part()
    reader = part.open(case.bag)
    chain = chain_of(reader, FRAMES, case.estimators)
    makers, stages = (
        [name for name in names if name not in (ADJUSTER, DETECTOR)] for names in (chain.makers, chain.stages)
    )
    if for_heights and not makers:
        raise UserError(f"Bag {case.bag} is of a sensor with one detector, of which no heights can be made.")
    processing = processing_of(reader, chain, part, consumers(makers), case.given, names_dwells=True)
    if not processing.frames:
        raise UserError(
            f"Bag {case.bag} has no readable frame on topic {FRAMES}; see `sal-height bag check {case.bag}`."
        )
    dwells = list(processing.frames)
    sensors, _ = sensors_of(reader)
    size = len(dwells) if any(sensor.mode == "stripmap" for sensor in sensors.values()) else most_dwells
    in_force, come = InForce(processing.values, processing.cues), list[str]()
    works = []
    for begin in range(0, len(dwells), size):
        chosen = dwells[begin : begin + size]
        within = dict.fromkeys(chosen[1:])
        come += in_force.go_on_to(chosen[0])
        works.append(
            Work(
                case.bag,
                reader.namespace,
                tuple(makers),
                in_force.values(),
                tuple(cue for cue in processing.cues if cue.dwell in within),
                tuple(come),
                frozenset(chosen),
                LogTimes(
                    min(processing.frames[dwell].first_ns for dwell in chosen),
                    max(processing.frames[dwell].last_ns for dwell in chosen),
                ),
            )
        )
        for dwell in within:
            come += in_force.go_on_to(dwell)
    return Scheme(
        reader.namespace,
        tuple(stages),
        processing.values,
        tuple(processing.cues),
        tuple(works),
        tuple(processing.warnings),
    )


def process_part(work: Work, folder: Path) -> None:
    """Make the heights of a part in the new folder `folder`, unless they are there.

    Raises:
        UserError: the bag cannot be read, or the heights cannot be written.
    """

    def make(new: Path) -> dict[str, Any]:
        return vars(process(work, new / "bag"))

    _once(folder, make)


def conclude_bag(case: Case, scheme: Scheme, parts: Sequence[Path]) -> dict[str, Any]:
    """Put the heights of the parts of a bag together, track them, and judge them; returns a row of the summary.

    Raises:
        UserError: a bag cannot be read or written.
    """

    def make(new: Path) -> dict[str, Any]:
        losses, results = Losses(), [known(part) for part in parts]
        for one in results:
            dropped, of_messages, warned = (Counter(one.get(name, {})) for name in ("dropped", "messages", "warned"))
            losses.add(Losses(dropped, of_messages, warned, one["sentences"]))
        reader = Part(namespace=scheme.namespace).open(case.bag)
        custom_data = {**reader.custom_data, PARAMETERS: json.dumps(scheme.parameters)}
        begun = time.monotonic()
        with BagWriter(new / "bag", custom_data) as bag:
            images, lost_there = track([part / "bag" for part in parts], scheme.parameters, scheme.cues, bag)
        losses.add(lost_there)
        row = {
            "bag": str(case.bag),
            **case.values,
            "failure": "",
            "dwells": sum(len(work.dwells) for work in scheme.works),
            "dropped": losses.dropped.total(),
            "drops": json.dumps(losses.dropped),
            "warnings": json.dumps([*scheme.warnings, *losses.sentences.values()]),
            "images": images,
            "seconds": sum(one["seconds"] for one in results) + time.monotonic() - begun,
        }
        return row | _judged(reader, new / "bag", scheme)

    return _once(case.folder, make)


def _judged(reader: BagReader, made: Path, scheme: Scheme) -> dict[str, Any]:
    """Columns on the heights: their share and sigma, and how they compare with those in the bag and with the truth."""
    recorded = [topic.name for topic in reader.topics.values() if topic.type_name == HEIGHT_TYPE and topic.count]
    compared = compare_bags(reader, BagReader(made), ROUNDING, recorded)
    columns: dict[str, Any] = {"against_recorded": verdict_of(compared) if compared else ""}
    for prefix, images in read_images(made).items():
        sigma = np.concatenate([image.surfaces[0].sigma for image in images if image.surfaces])
        held = np.isfinite(sigma)
        columns[f"{prefix}_with_height"] = float(np.mean(held)) if held.size else None
        columns[f"{prefix}_median_sigma_m"] = float(np.median(sigma[held])) if held.any() else None
    flight = recorded_flight(reader)
    if flight is None:
        return columns
    for prefix, numbers in read_accuracy(made, flight, scheme.stages).statistics.items():
        for name in ACCURACY:
            columns[f"{prefix}_{name}"] = numbers.get(name)
    return columns


ACCURACY = ("valid", "two_scatterers", "bias_m", "rms_m", "s68_m", "sigma_m", "within_1_sigma", "beyond_5_sigma")
"""Numbers of the accuracy, as report.json has them, that the summary has of each estimator."""


def _once(folder: Path, make: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """Have a folder made, and return what is known of it: from the file in it if there is one.

    The folder is made beside its place, and moved there once it is whole.
    """
    if is_done(folder):
        return known(folder)
    new = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    begun = time.monotonic()
    result = make(new)
    result.setdefault("seconds", time.monotonic() - begun)
    write_text(new / DONE, json.dumps(result, indent=2) + "\n")
    new.rename(folder)
    return result


def parts_of(case: Case) -> Path:
    """Folder of the parts of a case, until it is done."""
    return case.folder.with_name(f"{case.folder.name}.parts")


def is_done(folder: Path) -> bool:
    """Whether a folder has been made."""
    return (folder / DONE).is_file()


def known(folder: Path) -> dict[str, Any]:
    """What is known of a folder that has been made."""
    found: dict[str, Any] = json.loads((folder / DONE).read_text(encoding="utf-8"))
    return found
