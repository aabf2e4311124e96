"""The heights in the bag of a simulated flight and the truth: all that a report and pictures show of them."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.reader import BagReader
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.errors import Rejected, UserError
from sal_height.graph.catalogue import HEIGHTS, TRACKER
from sal_height.graph.reporting import PRESET, SEED
from sal_height.messages import field_from_message
from sal_height.messages.types import HeightImage
from sal_height.relief import GroundEstimate
from sal_height.runs.truth.ground_report import TrueGround, ground_of, ground_statistics, true_ground
from sal_height.runs.truth.report import mosaic, statistics
from sal_height.runs.truth.surface_report import (
    TOLERANCE_BEAMWIDTHS,
    Judged,
    height_beamwidth,
    judged,
    surface_statistics,
)
from sal_height.simulation import SimulatedFlight, flight_of, parse_preset

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Accuracy:
    """Heights with the truth, by prefix of the topics of their estimator.

    Attributes:
        heights: comparisons of the estimators with any height.
        grounds: estimate of the ground and the terrain, of estimators with any height but the tracked ones.
        statistics: entries of report.json on each height node of the run.
    """

    heights: Mapping[str, Judged]
    grounds: Mapping[str, tuple[GroundEstimate, TrueGround]]
    statistics: Mapping[str, Mapping[str, Any]]


def recorded_flight(reader: BagReader) -> SimulatedFlight | None:
    """The simulated flight that a bag is from; None if it is from no simulation, or from one that cannot be made again.

    It cannot be if, for example, the elevation model of its scene is no longer there.
    """
    if PRESET not in reader.custom_data:
        return None
    try:
        preset = parse_preset(json.loads(reader.custom_data[PRESET]), f"in bag {reader.path}")
        return flight_of(preset, int(reader.custom_data[SEED]))
    except (UserError, ValueError, KeyError):
        return None


def read_accuracy(bag: Path, flight: SimulatedFlight, stages: Sequence[str]) -> Accuracy:
    """Compare the heights in a bag with the truth.

    Args:
        bag: bag of a run or replay of the flight.
        flight: the flight.
        stages: names of nodes; only height nodes among them are compared.
    """
    wanted = [HEIGHTS[name] for name in stages if name in HEIGHTS]
    images = {prefix: found for prefix, found in read_images(bag).items() if prefix in wanted}
    surfaces = {dwell: flight.surface(dwell) for dwell in {one.dwell for found in images.values() for one in found}}
    heights = {prefix: judged(found, flight, surfaces) for prefix, found in images.items()}
    grounds = {}
    for prefix in images.keys() - {HEIGHTS[TRACKER]}:
        if estimate := _ground_of(prefix, images[prefix]):
            grounds[prefix] = estimate, true_ground(estimate, images[prefix], flight, surfaces)
    numbers = {}
    for prefix in wanted:
        # As subscribers see them: a height published with a sigma beyond all bounds is not valid.
        single = any(np.any(field_from_message(one).validity == HeightImage.OK) for one in images.get(prefix, ()))
        numbers[prefix] = statistics(mosaic(images[prefix], flight, surfaces) if single else None)
        if prefix in heights:
            numbers[prefix]["surfaces"] = surface_statistics(heights[prefix])
        if prefix in grounds:
            tolerance = TOLERANCE_BEAMWIDTHS * height_beamwidth(flight)
            numbers[prefix]["ground"] = ground_statistics(*grounds[prefix], tolerance)
    with_heights = {prefix: one for prefix, one in heights.items() if len(one.comparison.errors.sigma)}
    return Accuracy(with_heights, grounds, numbers)


def _ground_of(prefix: str, images: Sequence[HeightImage]) -> GroundEstimate | None:
    """Estimate the ground; None, with a warning, where heights are so far apart that it has too many cells."""
    try:
        return ground_of(images)
    except Rejected as error:
        _LOG.warning("The ground of %s is not reported: %s", prefix, error)
        return None


def read_images(bag: Path) -> dict[str, list[HeightImage]]:
    """The height images in a bag by the prefix of their estimator's topics; estimators without any are left out."""
    reader = BagReader(bag)
    images: dict[str, list[HeightImage]] = {}
    topics = [topic.name for topic in reader.topics.values() if topic.type_name == HEIGHT_TYPE]
    for message in reader.messages(topics) if topics else ():
        image = reader.decode(message.type_name, message.cdr)
        images.setdefault(image.estimator, []).append(image)
    return {prefix: images[prefix] for prefix in HEIGHTS.values() if prefix in images}
