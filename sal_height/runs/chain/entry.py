"""Entry of a replay into the chain of nodes: topics of the bag that are played, and the nodes that work on them."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from sal_height import messages
from sal_height.bag.described import FRAMES, IMAGES
from sal_height.bag.namespace import NamespacedReader, open_bag
from sal_height.bag.played import ALL, LATEST_NS, MOST, DwellRange
from sal_height.bag.reader import BagReader
from sal_height.elevation import ESTIMATORS
from sal_height.engine.compression import SENSOR
from sal_height.engine.movers import MOVERS
from sal_height.engine.registry import STAGES
from sal_height.engine.results import DwellKey
from sal_height.errors import UserError
from sal_height.graph.air import air_in
from sal_height.graph.catalogue import ADJUSTER, HEIGHTS, TRACKER, NodeParameters, suited
from sal_height.sensor import Sensor
from sal_height.topics import SENSOR_INFO

_LOG = logging.getLogger(__name__)

FROM_HEIGHTS = "heights"

ENTRIES = FRAMES, IMAGES, FROM_HEIGHTS
"""Entries of a replay: the phase history, the complex images, or the heights in the bag."""

MAPPER = "relief_mapper"

HOW = {
    FRAMES: "record it with the node recorder or `sal-height record` while the sensor runs",
    IMAGES: "`sal-height run` and `sal-height replay` record the complex images with --record slc",
    FROM_HEIGHTS: "`sal-height run`, `sal-height replay` and `sal-height record` record heights",
}
"""Advice on recording the topics that a replay starts with."""


@dataclass(frozen=True)
class Part:
    """Part of a bag that is replayed.

    Attributes:
        entry: name of the entry, one of ENTRIES.
        first: number of the first dwell.
        last: number of the last dwell.
        start_s: earliest start of a dwell, s after that of the first one in the bag.
        end_s: latest start of a dwell, likewise.
        namespace: namespace of the topics in the bag; None: the one with the topics that are played, or no namespace.
    """

    entry: str = FRAMES
    first: int = 0
    last: int = MOST
    start_s: float = 0.0
    end_s: float = math.inf
    namespace: str | None = None

    def open(self, bag: Path, renamed: Mapping[str, str] = MappingProxyType({})) -> NamespacedReader:
        """Read a bag in its namespace, with other names of topics by those that are recorded.

        Raises:
            UserError: the bag cannot be used, or several namespaces have what is played, or that of the name has not.
        """
        heights = [f"{name}/height" for name in ESTIMATORS]
        return open_bag(bag, self.namespace, heights if self.entry == FROM_HEIGHTS else [self.entry], renamed)

    def dwells_of(self, recorded: Sequence[DwellKey]) -> DwellRange:
        """The dwells that are played, of those in a bag, in its order.

        Raises:
            UserError: the part is empty.
        """
        if replace(self, entry=FRAMES, namespace=None) == WHOLE:
            return ALL
        origin_ns = recorded[0].stamp_ns if recorded else 0
        end_ns = LATEST_NS if math.isinf(self.end_s) else min(LATEST_NS, origin_ns + round(self.end_s * 1e9))
        chosen = DwellRange(self.first, self.last, origin_ns + round(self.start_s * 1e9), end_ns)
        if not any(dwell in chosen for dwell in recorded):
            numbers = [dwell.number for dwell in recorded] or [0]
            length_s = max(((dwell.stamp_ns - origin_ns) * 1e-9 for dwell in recorded), default=0.0)
            raise UserError(
                f"No dwell of the bag is in this range; its {len(recorded)} dwells have the numbers {min(numbers)} to "
                f"{max(numbers)} and begin from 0 to {length_s:.6g} s."
            )
        return chosen


WHOLE = Part()
"""All dwells, from the phase history on."""


@dataclass(frozen=True)
class ReplayNodes:
    """The nodes of a replay.

    Attributes:
        entry: name of the entry, one of ENTRIES.
        makers: nodes whose heights there are, made here or in the bag.
        stages: nodes that process, in their order.
        dwells: number of dwells in the bag.
        dwell_topics: topics of the bag that the dwells are on.
        air: topics of the bag with air data.
    """

    entry: str
    makers: list[str]
    stages: list[str]
    dwells: int
    dwell_topics: list[str]
    air: Sequence[str] = ()

    def played(self, parameters: NodeParameters) -> list[str]:
        """Topics that are played to nodes with these parameters.

        Raises:
            UserError: a node reads heights that are not among those in the bag.
        """
        if self.entry != FROM_HEIGHTS:
            return [*SENSOR, *self.air] if self.entry == FRAMES else [SENSOR_INFO, IMAGES]
        prefixes = dict.fromkeys(parameters.get(name, {}).get("estimator", "ml") for name in self.stages)
        topics = [f"{prefix}/height" for prefix in prefixes if prefix != HEIGHTS[TRACKER]]
        if lost := [topic for topic in topics if f"/{topic}" not in self.dwell_topics]:
            raise UserError(f"The bag has no heights on {lost[0]}; it has {', '.join(self.dwell_topics)}.")
        return topics


def chain_of(reader: BagReader, entry: str, estimators: Collection[str]) -> ReplayNodes:
    """The nodes that replay a bag from an entry on.

    Args:
        reader: reader of the bag.
        entry: name of the entry, one of ENTRIES.
        estimators: names of those whose heights are made, as of `suited`; empty: those whose heights the bag has, or
            else all that suit the sensor and need not be requested.

    Raises:
        UserError: the bag lacks what is to be played, an estimator does not suit it, or there is nothing to make.
    """
    makers_of = {prefix: node for node, prefix in HEIGHTS.items() if node != TRACKER}
    recorded = [name for name in makers_of if _count(reader, f"/{name}/height")]
    if entry == FROM_HEIGHTS:
        if not recorded:
            raise _lacking(reader, "heights of an estimator, such as /ml/height", entry)
        if estimators:
            raise UserError("Option --estimators has no meaning with --from heights: no estimator works there.")
        topics = [f"/{name}/height" for name in recorded]
        makers = [makers_of[name] for name in recorded]
        return ReplayNodes(entry, makers, [TRACKER, MAPPER], max(_count(reader, topic) for topic in topics), topics)
    sensor, dwells = contents(reader, entry)
    if recorded and _count(reader, f"/{MOVERS}"):
        recorded.append(MOVERS)
    height_nodes = suited(sensor, estimators or recorded)
    if entry == IMAGES and not height_nodes:
        raise UserError(f"Bag {reader.path} is of a sensor with one detector: of its images no heights can be made.")
    if entry == IMAGES and ADJUSTER in height_nodes:
        if HEIGHTS[ADJUSTER] in estimators:
            raise UserError("Heights are adjusted with the odometry; replay from phase_history to make them.")
        height_nodes.remove(ADJUSTER)
    first = ["sar_compression"] if entry == FRAMES else []
    stages = [*first, *((*height_nodes, TRACKER) if height_nodes else ())]
    return ReplayNodes(entry, height_nodes, stages, dwells, [f"/{entry}"], air_in(reader))


def contents(reader: BagReader, entry: str = FRAMES) -> tuple[Sensor, int]:
    """The sensor of a bag, and the number of its dwells on topic `entry`, phase_history or slc.

    Raises:
        UserError: there is no sensor info that is valid, or nothing on that topic.
    """
    for name in (SENSOR_INFO, entry):
        if not _count(reader, f"/{name}"):
            raise _lacking(reader, f"messages on /{name}", entry)
    first = next(reader.messages([f"/{SENSOR_INFO}"]))
    sensor = messages.sensor_from_message(reader.decode(first.type_name, first.cdr))
    return sensor, -(-reader.topics[f"/{entry}"].count // sensor.detector_count)


def check_given(given: NodeParameters, chain: ReplayNodes) -> None:
    """Refuse parameters of nodes that do not work in a replay that does not start with the phase history.

    Raises:
        UserError: there are such.
    """
    if chain.entry != FRAMES and (idle := [name for name in given if name in STAGES and name not in chain.stages]):
        raise UserError(
            f"Node {idle[0]} does not work in a replay from {chain.entry}; set parameters of {', '.join(chain.stages)}."
        )


def _count(reader: BagReader, topic: str) -> int:
    return reader.topics[topic].count if topic in reader.topics else 0


def _lacking(reader: BagReader, what: str, entry: str) -> UserError:
    return UserError(f"Bag {reader.path} has no {what}; it cannot be replayed from {entry}: {HOW[entry]}.")
