"""The page of the topics: what every node takes and gives, as its class says it and as it has it once it runs."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from sal_height.graph.node_classes import NODES
from sal_height.nodes.accounts.usage import ACCOUNTS, LEFT_OUT, LIFE_CYCLE
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from tools.reference.markdown import page, plain, table

BAG = str(Path(__file__).parents[2] / "bags" / "version_3")

TRIED: Mapping[str, list[dict[str, Any]]] = {
    "simulator": [{"preset": "small", "period_s": 0.0}],
    "player": [{"bag": BAG, "clock": "paced"}],
    "paced_player": [{"bag": BAG}],
    "navigation": [
        {"velocity": "twist", "publish_tf": True},
        {"position": "fix", "origin_latitude_deg": 48.1, "origin_longitude_deg": 11.3, "origin_height_m": 560.0},
    ],
    "sar_compression": [{"calibration": "topic", "mounting_from_tf": True}],
    "recorder": [],
}
"""Parameters with which nodes have all their topics. Others have them by default; the recorder has none of its own."""

OWN = "sal_height_msgs"

HEAD = """# Topics and services

`tools/reference` makes this page: it starts the nodes and lists the topics that they then have, beside what their
classes say of them; a test fails if it is out of date. Names are relative to the namespace of the node unless they
begin with a slash, and can be remapped. Types without a package are those of `sal_height_msgs`, which
[messages.md](messages.md) describes. Services are of type `std_srvs/Trigger`, but `~/change_state`, which is of type
`lifecycle_msgs/ChangeState`. The parameters of the nodes are in [parameters.md](../parameters.md).

Quality of service is what a publisher offers and a subscription asks for; the number is the depth of its history.
*Latched* is reliable with transient-local durability: who comes late receives the last messages. All others are
volatile. [Quality of service](../live_host.md#quality-of-service) says what happens if publishers
offer less, and how to set it."""

ALL_NODES = """## Every node

Each of the nodes below has these, too; the recorder has the first two topics only."""

Direction: TypeAlias = Literal["in", "out"]


@dataclass(frozen=True)
class End:
    """Entry of a node on a topic: the type of its messages, and the quality of service."""

    type_name: str
    quality: str


ANY = End("any", "as offered")
"""Topics of the recorder."""

Ends: TypeAlias = dict[tuple[Direction, str], End]
"""Of one or more nodes, by the name of the topic in the root namespace."""


def document() -> str:
    """The text of docs/reference/topics.md.

    Raises:
        LookupError: a class says that its node has a topic, and no node that was started has it.
    """
    found = ends_of_nodes()
    known = {key: end for ends in found.values() for key, end in ends.items()}
    sections = [_section(name, node, known | found[name]) for name, node in NODES.items()]
    return page([HEAD, ALL_NODES, _topics("out", ACCOUNTS | LEFT_OUT, known), _services(LIFE_CYCLE), *sections])


@cache
def ends_of_nodes() -> Mapping[str, Ends]:
    """Entries of every node on its topics."""
    with free_domain() as domain, Graph(domain) as graph:
        return {name: ends_of(graph, node, TRIED.get(name, [{}])) for name, node in NODES.items()}


def ends_of(graph: Graph, make: type[Any], many_values: Iterable[Mapping[str, Any]]) -> Ends:
    """Entries of a node on its topics, if it is started with each of these parameters in turn."""
    ends: Ends = {}
    for values in many_values:
        overrides = [Parameter(key, value=value) for key, value in values.items()]
        node: Node = make(context=graph.context, parameter_overrides=overrides)
        ends |= {("out", publisher.topic_name): _end(publisher) for publisher in node.publishers}
        ends |= {("in", subscription.topic_name): _end(subscription) for subscription in node.subscriptions}
        if make.takes_heights:
            ends["in", "/<estimator>/height"] = ends["in", f"/{node.current_parameters().estimator}/height"]
        node.destroy_node()
    return ends


def _end(endpoint: Publisher | Subscription) -> End:
    kind = endpoint.msg_type
    package = kind.__module__.partition(".")[0]
    return End(f"{package}/msg/{kind.__name__}", _quality(endpoint.qos_profile))


def _quality(qos: QoSProfile) -> str:
    """Quality of service in a few words."""
    depth = "all" if qos.history == HistoryPolicy.KEEP_ALL else f"{qos.depth}"
    if qos.reliability != ReliabilityPolicy.RELIABLE:
        return f"best effort, {depth}"
    return f"{'latched' if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL else 'reliable'}, {depth}"


def _section(name: str, node: type[Any], known: Ends) -> str:
    parts = [
        f"## {name}",
        " ".join((inspect.getdoc(node) or "").partition("\n\n")[0].split()),
        _titled("Takes:", _topics("in", node.inputs, known)),
        _titled("Gives:", _topics("out", node.outputs, known)),
        _titled("Services:", _services(node.answers)),
    ]
    return "\n\n".join(part for part in parts if part)


def _titled(title: str, text: str) -> str:
    return f"{title}\n\n{text}" if text else ""


def _topics(direction: Direction, topics: Mapping[str, str], known: Ends) -> str:
    if not topics:
        return ""
    rows = []
    for topic, text in topics.items():
        end = ANY if topic == "<topics>" else _known(direction, topic, known)
        rows.append((f"`{topic}`", _type(end.type_name), end.quality, plain(text)))
    return table(("topic", "type", "quality of service", "what it is"), rows)


def _known(direction: Direction, topic: str, known: Ends) -> End:
    name = topic if topic.startswith("/") else f"/{topic}"
    if (direction, name) not in known:
        raise LookupError(f"A class says that its node has topic {topic}, and no node has; TRIED may lack a parameter.")
    return known[direction, name]


def _services(services: Mapping[str, str]) -> str:
    return "\n".join(f"- `{service}`: {plain(text)}" for service, text in services.items())


def _type(name: str) -> str:
    """A type as code, which leads to its description if it is one of ours."""
    package, _, message = name.rpartition("/msg/")
    if package == OWN:
        return f"[`{message}`](messages.md#{message.lower()})"
    return f"`{package}/{message}`" if package else name
