"""Layouts for other viewers: what they show is published by our nodes, in the types and fields that they take.

The viewers themselves are not part of the tests. Names of classes, panels and settings are those of RViz 2 in ROS 2
Jazzy and of Lichtblick, which has those of Foxglove.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

import sal_height
from sal_height.graph.catalogue import recorded_topics
from sal_height.graph.node_classes import NODES
from sal_height.messages import MAP_FRAME
from sal_height.messages.codec import SHIPPED
from sal_height.messages.views import POINT_FIELDS, RELIEF_POINT_FIELDS
from sal_height.nodes.accounts.account import DIAGNOSTICS
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph

CONFIG = Path(sal_height.__file__).parent / "config"
RVIZ = yaml.safe_load((CONFIG / "sal_height.rviz").read_text())["Visualization Manager"]
DISPLAYS = {display["Name"]: display for display in RVIZ["Displays"]}
FOXGLOVE = json.loads((CONFIG / "sal_height.foxglove.json").read_text())
PANELS = FOXGLOVE["configById"]

CLOUD, IMAGE, ODOMETRY = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry"

TYPES = {
    "rviz_default_plugins/Grid": "",
    "rviz_default_plugins/Image": IMAGE,
    "rviz_default_plugins/Odometry": ODOMETRY,
    "rviz_default_plugins/PointCloud2": CLOUD,
}
"""Message type that a display of RViz takes, by its class; empty: none."""

FIELDS = {"/tracked/points": POINT_FIELDS, "/map/points": RELIEF_POINT_FIELDS}
"""Fields of the points of a topic."""

Offers = dict[str, tuple[str, list[QoSProfile]]]


@pytest.fixture(scope="module")
def offered() -> Iterator[Offers]:
    """Type of every topic of our nodes, and the quality of service in which it is published."""
    with free_domain() as domain, Graph(domain) as graph:
        names = ("navigation", "sar_compression", "ml_height", "relief_tracker", "relief_mapper")
        nodes: list[Node] = [graph.add(NODES[name](context=graph.context)) for name in names]
        watcher, offers = nodes[0], {}
        for node in nodes:
            for topic, types in watcher.get_publisher_names_and_types_by_node(node.get_name(), "/"):
                profiles = [info.qos_profile for info in watcher.get_publishers_info_by_topic(topic)]
                offers[topic] = types[0], profiles
        yield offers


@pytest.mark.parametrize("name", [name for name, display in DISPLAYS.items() if TYPES[display["Class"]]])
def test_a_display_of_rviz_shows_what_is_published(name: str, offered: Offers) -> None:
    display = DISPLAYS[name]
    topic = display["Topic"]
    assert not topic["Value"].startswith("/"), "it would not follow the namespace of RViz"
    kind, profiles = offered[f"/{topic['Value']}"]
    assert kind == TYPES[display["Class"]]
    asked = QoSProfile(
        depth=topic["Depth"],
        history=HistoryPolicy[_enumerator(topic["History Policy"])],
        reliability=ReliabilityPolicy[_enumerator(topic["Reliability Policy"])],
        durability=DurabilityPolicy[_enumerator(topic["Durability Policy"])],
    )
    assert profiles
    for profile in profiles:
        assert qos_check_compatible(profile, asked)[0] != QoSCompatibility.ERROR  # a depth is not told
        latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert (asked.durability == DurabilityPolicy.TRANSIENT_LOCAL) == latched, "what came before would not be shown"


def _enumerator(text: str) -> str:
    return text.upper().replace(" ", "_")


def test_rviz_colours_points_by_a_field_that_they_have() -> None:
    assert RVIZ["Global Options"]["Fixed Frame"] == MAP_FRAME
    clouds = [display for display in DISPLAYS.values() if TYPES[display["Class"]] == CLOUD]
    assert {f"/{display['Topic']['Value']}" for display in clouds} == set(FIELDS)
    for display in clouds:
        assert display["Color Transformer"] == "Intensity"
        assert display["Channel Name"] in FIELDS[f"/{display['Topic']['Value']}"]
        assert display["Value"] == display["Enabled"]


def test_the_layout_of_foxglove_has_the_panels_that_it_places() -> None:
    def placed(part: Any) -> list[str]:
        if isinstance(part, str):
            return [part]
        assert part["direction"] in {"row", "column"}
        return placed(part["first"]) + placed(part["second"])

    assert sorted(placed(FOXGLOVE["layout"])) == sorted(PANELS)
    assert {panel.partition("!")[0] for panel in PANELS} == {"3D", "Image", "Plot", "DiagnosticSummary"}


def of_kind(kind: str) -> list[dict[str, Any]]:
    return [panel for name, panel in PANELS.items() if name.startswith(f"{kind}!")]


def test_panels_of_foxglove_show_what_is_published(offered: Offers) -> None:
    (scene,), (image,), (summary,) = (of_kind(kind) for kind in ("3D", "Image", "DiagnosticSummary"))
    assert scene["followTf"] == MAP_FRAME
    assert set(scene["topics"]) == set(FIELDS)
    for topic, settings in scene["topics"].items():
        assert offered[topic][0] == CLOUD
        assert settings["colorField"] in FIELDS[topic]
        assert settings["colorMode"] == "colormap"
    assert offered["/tf"][0] == "tf2_msgs/msg/TFMessage"
    assert offered[image["imageMode"]["imageTopic"]][0] == IMAGE
    shown = {topic for topic, settings in scene["topics"].items() if settings["visible"]}
    shown |= {image["imageMode"]["imageTopic"], DIAGNOSTICS, "/tf"}
    recorded = recorded_topics(["sar_compression", "ml_height", "relief_tracker"], {})
    assert shown <= {f"/{topic}" for topic in recorded}, "a bag of a run would show nothing"
    assert summary["topicToRender"] == DIAGNOSTICS
    assert offered[DIAGNOSTICS][0] == "diagnostic_msgs/msg/DiagnosticArray"


PATH = r"(/\w+)\.(\w+)\[:\]\{(\w+)=='(\w+)'\}\.(\w+)\[:\]\{(\w+)=='(\w+)'\}\.(\w+)"
"""Message path of a plot: a number of one node in the diagnostics."""


def kinds_of(name: str) -> dict[str, str]:
    """Types of the fields of a message on diagnostics."""
    return {field.name: field.kind for field in SHIPPED.layout(f"diagnostic_msgs/msg/{name}").fields}


def test_plots_of_foxglove_take_numbers_that_nodes_tell() -> None:
    plots = of_kind("Plot")
    shown = set()
    for path in (path for plot in plots for path in plot["paths"]):
        match = re.fullmatch(PATH, path["value"])
        assert match
        topic, statuses, name, node, values, key, number, value = match.groups()
        assert topic == DIAGNOSTICS
        assert node in NODES
        array, status = (kinds_of(kind) for kind in ("DiagnosticArray", "DiagnosticStatus"))
        assert (array[statuses], status[name]) == ("diagnostic_msgs/msg/DiagnosticStatus", "string")
        assert status[values] == "diagnostic_msgs/msg/KeyValue"
        assert {key, value} <= kinds_of("KeyValue").keys()
        shown.add(number)
    assert shown == {"latency_p95_ms", "offered_hz", "achieved_hz"}
