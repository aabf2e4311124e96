"""What a bag gives when rclpy publishes it to nodes: in a test, or as a program of its own on another host.

Usage as a program: bag_feeder.py BAG OUT [best_effort]. Heights are written as OUT/DWELL.cdr, and the last account of
every node as OUT/NODE.json.
"""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Callable
from pathlib import Path

from chain_fixture import same_heights
from helpers import publisher_of
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rosbags.rosbag2 import Reader

from sal_height.messages import deserialize, received_frame, serialize
from sal_height.messages.types import ChannelFrame, DiagnosticArray, HeightImage, Odometry, SensorInfo
from sal_height.nodes.accounts.account import DIAGNOSTICS, Account
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS

BAG = Path(__file__).parents[2] / "bags" / "version_3"
TIMEOUT_S = 120.0
KINDS = {
    "/sensor_info": (SensorInfo, LATCHED_QOS),
    "/platform/odometry": (Odometry, ODOMETRY_QOS),
    "/phase_history": (ChannelFrame, FRAMES_QOS),
}
HEIGHTS = "/ml/height"
NODES = ("sar_compression", "ml_height")


class Feeder:
    """Publishes a bag to sar_compression and ml_height, and keeps the heights that they publish.

    Attributes:
        heights: that have come.
        accounts: what every node has said of itself last.
    """

    def __init__(self, graph: Graph) -> None:
        self.heights: list[HeightImage] = []
        self.accounts: dict[str, Account] = {}
        self._graph, self._node = graph, graph.add(Node("feeder", context=graph.context))
        subscribe(self._node, HeightImage, HEIGHTS, self.heights.append, FRAMES_QOS)
        subscribe(self._node, DiagnosticArray, DIAGNOSTICS, self._keep, FRAMES_QOS)

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Run callbacks until a condition holds."""
        assert self._graph.spin_until(condition, TIMEOUT_S), f"waited in vain for {what}: {self.accounts}"

    def publish(self, bag: Path, *, reliable: bool = True) -> tuple[int, set[int]]:
        """Publish a bag as soon as the nodes are ready; how many frames it has, and the numbers of its dwells."""
        publishers = {}
        for topic, (kind, qos) in KINDS.items():
            offered = copy.copy(qos)
            if topic == "/phase_history" and not reliable:
                offered.reliability = ReliabilityPolicy.BEST_EFFORT
            publishers[topic] = publisher_of(self._node, kind, topic, offered)
        with Reader(bag) as reader:
            recorded = [(c.topic, cdr) for c, _, cdr in reader.messages() if c.topic in publishers]
        for latched in (True, False):
            for topic, cdr in recorded:
                if (topic == "/sensor_info") == latched:
                    publishers[topic].publish(cdr)
            self.wait(self._is_ready, "the nodes to be ready")
        frames = [received_frame(cdr) for topic, cdr in recorded if topic == "/phase_history"]
        return len(frames), {frame.key.number for frame in frames}

    def heights_of(self, bag: Path) -> dict[int, HeightImage]:
        """Heights of all dwells of a bag, which is published."""
        _, dwells = self.publish(bag)
        self.wait(lambda: dwells == {image.dwell for image in self.heights}, "heights")
        return {image.dwell: image for image in self.heights}

    def _is_ready(self) -> bool:
        """Whether the nodes are ready, and every topic of theirs has its subscriber, as its publisher knows."""
        if not all(name in self.accounts and self.accounts[name].ready for name in NODES):
            return False
        heard = {topic: count for name in NODES for topic, count in self.accounts[name].subscribers.items()}
        return heard["slc"] > 0 and heard[HEIGHTS.lstrip("/")] > 0

    def _keep(self, message: DiagnosticArray) -> None:
        self.accounts |= {status.name: Account.of_status(status) for status in message.status}


def read_heights(folder: Path) -> dict[int, HeightImage]:
    """Height images by dwell, from files with their CDR."""
    return {int(file.stem): deserialize(file.read_bytes(), HeightImage) for file in folder.glob("*.cdr")}


def assert_same(heights: dict[int, HeightImage], others: dict[int, HeightImage]) -> None:
    """Heights of all dwells agree value for value."""
    assert heights.keys() == others.keys()
    for dwell, image in heights.items():
        assert same_heights(image, others[dwell])
        assert (image.header, image.provenance) == (others[dwell].header, others[dwell].provenance)


def main() -> None:
    """Publish a bag until every message is accounted for, and write what has come of it."""
    bag, out, *options = sys.argv[1:]
    with Graph() as graph:
        feeder = Feeder(graph)
        frames, dwells = feeder.publish(Path(bag), reliable=not options)

        def is_settled() -> bool:
            """Whether no node holds anything: a dwell that lacks frames is given up seconds after the last one."""
            compression, heights = (feeder.accounts[name] for name in NODES)
            came = compression.received > 0 and heights.received == compression.published_on["slc"]
            return came and not (compression.waiting or heights.waiting)

        if not options:
            feeder.wait(lambda: dwells == {image.dwell for image in feeder.heights}, "heights")
            feeder.wait(lambda: feeder.accounts["sar_compression"].received == frames, "the account of all frames")
        feeder.wait(is_settled, "the nodes to be done")
        for image in feeder.heights:
            Path(out, f"{image.dwell}.cdr").write_bytes(serialize(image))
        for name, account in feeder.accounts.items():
            Path(out, f"{name}.json").write_text(json.dumps(dict(account.numbers)), encoding="utf-8")


if __name__ == "__main__":
    main()
