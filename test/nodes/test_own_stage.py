"""The stage of docs/stages.md: a node, a row of top, a step of a chain; recorded, and made again from the record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from example_stage import Coverage, CoverageStage
from rclpy.parameter import Parameter

from sal_height.bag.reader import BagReader
from sal_height.engine.chain import Chain
from sal_height.engine.results import Product
from sal_height.messages import kinds
from sal_height.messages.codec import SHIPPED
from sal_height.messages.types import HeightImage, KeyValue
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.host import node_of
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import class_of
from sal_height.nodes.transport.qos import FRAMES_QOS

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "version_2"


def write_coverage(coverage: Coverage, _settings: Any) -> list[bytes]:
    return [SHIPPED.serialize(KeyValue(key=f"dwell {coverage.key.number}", value=str(coverage.fraction)))]


def read_nothing(_cdr: bytes, _settings: Any) -> list[Any]:
    raise NotImplementedError


@pytest.fixture(autouse=True)
def written_as_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = kinds.Kind("diagnostic_msgs/msg/KeyValue", read_nothing, write_coverage)
    monkeypatch.setitem(kinds.KINDS, Coverage, kind)  # type: ignore[arg-type]


def by_calls(bag: Path) -> list[bytes]:
    """What a chain makes of the heights of a bag, as messages."""
    settings = CoverageStage.settings()
    chain = Chain([CoverageStage(settings)], [settings])
    made: list[bytes] = []
    for recorded in BagReader(bag).messages(["/ml/height"]):
        for item in kinds.kind_of_topic("ml/height").read(recorded.cdr, settings):
            for one in chain.feed("ml/height", item):
                assert isinstance(one.result, Product)
                made += write_coverage(one.result.item, settings)
    return made


def test_the_code_is_that_of_the_docs() -> None:
    code = (ROOT / "test" / "engine" / "example_stage.py").read_text()
    assert code[code.index("from __future__") :] in (ROOT / "docs" / "stages.md").read_text()


def test_a_node_and_a_chain_make_the_same(graph: Graph, tmp_path: Path) -> None:
    node = graph.add(node_of(CoverageStage)(context=graph.context))
    images = graph.add(Recorder(tmp_path / "bag", context=graph.context, parameter_overrides=_topics()))
    source = node.create_publisher(class_of(HeightImage), "ml/height", FRAMES_QOS)
    assert graph.spin_until(lambda: "/coverage" in images.recorded and source.get_subscription_count() == 2, 20)
    heights = [recorded.cdr for recorded in BagReader(BAG).messages(["/ml/height"])]
    for cdr in heights:
        source.publish(cdr)
    assert graph.spin_until(lambda: images.recorded["/coverage"] == len(heights) > 0, 20)
    account: Account = node.account()
    assert (account.received, account.processed, account.published_on["coverage"]) == (2, 2, 2)
    assert account.numbers["in"] == 2  # what top shows
    images.close_bag()
    made = [recorded.cdr for recorded in BagReader(tmp_path / "bag").messages(["/coverage"])]
    assert made == by_calls(BAG) == by_calls(tmp_path / "bag")


def _topics() -> list[Any]:
    return [Parameter("topics", value=["coverage", "ml/height"]), Parameter("node_parameters", value=False)]
