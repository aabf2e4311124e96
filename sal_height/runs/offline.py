"""Dwells of a bag processed without a graph: by the functions of its nodes, with the same heights, byte for byte."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from sal_height import messages
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import ALWAYS, BagMessage, BagReader, LogTimes
from sal_height.bag.stamps import stamp_ns_of
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.elevation import ESTIMATORS
from sal_height.errors import UserError
from sal_height.nodes.cues import Cue, DwellKey
from sal_height.nodes.height import height_image
from sal_height.nodes.relief_tracker import PREFIX, Tracker
from sal_height.pipeline import heights
from sal_height.runs.catalogue import TRACKER, NodeParameters
from sal_height.runs.recorded_dwells import (
    AIR_TOPICS,
    COMPRESSION,
    GAP,
    TAKEN,
    Compressed,
    InForce,
    Losses,
    RecordedDwells,
    Work,
)

MARGIN_NS = 2_000_000_000
"""Odometry of a dwell is looked for so long before its first frame and after its last one; then in the whole bag."""

MAKERS = {estimator.node: estimator for estimator in ESTIMATORS.values()}


def process(work: Work, folder: Path) -> Losses:
    """Make the heights of the dwells of a work, into a new bag `folder`.

    Raises:
        UserError: the bag cannot be read or written, or it cannot be processed without a graph.
    """
    near = LogTimes(max(0, work.times.first_ns - MARGIN_NS), work.times.last_ns + MARGIN_NS)
    losses = _process(work, near, folder)
    if losses.dropped[f"{COMPRESSION}: {GAP}"]:  # odometry may be elsewhere
        shutil.rmtree(folder)
        losses = _process(work, ALWAYS, folder)
    return losses


def track(
    heights_of: Sequence[Path], parameters: NodeParameters, cues: Sequence[Cue], out: BagWriter
) -> tuple[int, Losses]:
    """Copy the heights of all dwells to one bag, with those that the tracker makes of them.

    Args:
        heights_of: bags with the heights, in the order of their dwells.
        parameters: of all nodes at the first dwell.
        cues: what happens before later dwells.
        out: the bag to write to.

    Returns:
        The number of height images in the bag, and what the tracker left out.

    Raises:
        UserError: a bag cannot be read or written.
    """
    images, losses, in_force, tracker = 0, Losses(), InForce(parameters, cues), Tracker()
    tracked, source = f"/{PREFIX}/height", f"/{in_force.of(TRACKER).estimator}/height"
    out.add_topic(tracked, HEIGHT_TYPE)
    for bag in heights_of:
        reader = BagReader(bag)
        for topic in reader.topics:
            if not out.has_any(topic):
                out.add_topic(topic, HEIGHT_TYPE)
        for one in reader.messages():
            out.write(one.topic, one.cdr, one.log_time_ns, one.publish_time_ns)
            images += 1
            if one.topic != source:
                continue
            origin = messages.height_origin(one.cdr)
            in_force.go_on_to(DwellKey(origin.dwell, origin.stamp_ns))
            try:
                image, _, _ = tracker.track(messages.received_height(one.cdr), in_force.of(TRACKER))
            except UserError as error:
                losses.drop(TRACKER, error)
                continue
            out.write(tracked, messages.serialize(image), one.log_time_ns, one.publish_time_ns)
            images += 1
    return images, losses


def _process(work: Work, times: LogTimes, folder: Path) -> Losses:
    """Make the heights of what was recorded at some times."""
    reader = NamespacedReader(work.bag, work.namespace)
    with BagWriter(folder) as bag:
        making = _Making(work, reader, bag)
        making.hear_air(_air_before(work, reader, times))
        for recorded in reader.messages(TAKEN, times):
            making.take(recorded)
        making.end()
    return making.losses


def _air_before(work: Work, reader: BagReader, times: LogTimes) -> list[BagMessage]:
    """The messages on the air that were recorded before `times`, from the one on that the first dwell needs."""
    needed_ns = min(dwell.stamp_ns for dwell in work.dwells) - messages.AIR_LATENCY_NS
    held = {topic for topic in AIR_TOPICS if topic in reader.topics and reader.topics[topic].count}
    found: list[BagMessage] = []
    reach_ns, end_ns = MARGIN_NS, times.first_ns
    while held and end_ns > reader.begin_ns:
        begin_ns = max(reader.begin_ns, times.first_ns - reach_ns)
        found = [*reader.messages(held, LogTimes(begin_ns, end_ns - 1)), *found]
        if {one.topic for one in found if stamp_ns_of(one.cdr) <= needed_ns} == held:
            break
        reach_ns, end_ns = 4 * reach_ns, begin_ns
    return found


class _Making(RecordedDwells):
    """The dwells of a work, of which heights are made."""

    def __init__(self, work: Work, reader: BagReader, bag: BagWriter) -> None:
        """Have the heights written to `bag`; raises as its base."""
        super().__init__(work, reader)
        self._bag = bag
        for node in work.makers:
            bag.add_topic(_topic(node), HEIGHT_TYPE)

    def made(self, compressed: Compressed) -> None:
        """Make the heights, and write them."""
        for node in self.work.makers:
            try:
                cdr = self._heights(node, compressed)
            except UserError as error:
                self.losses.drop(node, error)
                continue
            self._bag.write(_topic(node), cdr, compressed.time_ns, compressed.time_ns)

    def _heights(self, node: str, compressed: Compressed) -> bytes:
        """The message with the heights that a node makes of the images of a dwell, serialized.

        Raises:
            UserError: there are none.
        """
        images, sensor = compressed.images, compressed.sensor
        for image in images:
            messages.check_slc(image, sensor)
        parameters, slc = self.in_force.of(node), messages.slc_from_messages(images)
        estimated = heights(slc, sensor, MAKERS[node], parameters, compressed.calibration)
        return messages.serialized_height(height_image(estimated, slc, images, sensor, MAKERS[node], parameters))


def _topic(node: str) -> str:
    return f"/{MAKERS[node].name}/height"
