"""The example of a flight starts the same nodes in each of its forms: `sal-height live`, launch file, document."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter

import sal_height
from sal_height.graph.ensemble import Member
from sal_height.graph.node_classes import NODES
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.live.deployment import load_deployment, members_of
from sal_height.workers.processes import ONE_THREAD

PACKAGE = Path(sal_height.__file__).parent
FLIGHT = PACKAGE / "config" / "flight.yaml"
LAUNCH = ET.parse(PACKAGE / "launch" / "flight.launch.xml").getroot()  # noqa: S314 (our own file)
DEFAULTS = {entry.attrib["name"]: entry.attrib["default"] for entry in LAUNCH.iter("arg")}
MEMBERS = {member.name: member for member in members_of(load_deployment(FLIGHT))}


@dataclass
class Started:
    """What the launch file says of a node, as launch_ros starts it."""

    kind: str
    namespace: str
    remappings: dict[str, str]
    arguments: list[str]
    options: dict[str, str] = field(default_factory=dict)


def filled(text: str, values: dict[str, str]) -> str:
    """A text with the substitutions that our file uses."""
    text = re.sub(r"\$\(var (\w+)\)", lambda match: values[match[1]], text)
    text = text.replace("$(find-pkg-share sal_height)", str(PACKAGE))
    assert "$(" not in text
    return text


def started(**changed: str) -> dict[str, Started]:
    """The nodes by name, with arguments in the order of launch_ros: names, values for all, its own, topics."""
    values = {name: filled(text, {}) for name, text in DEFAULTS.items()} | changed
    (group,) = LAUNCH.findall("group")
    namespace = filled(group.find("push-ros-namespace").attrib["namespace"], values)
    common = [(entry.attrib["name"], filled(entry.attrib["value"], values)) for entry in group.findall("set_parameter")]
    nodes = {}
    for node in group.findall("node"):
        if filled(node.get("if", "true"), values) != "true":
            continue
        words = ["-r", f"__ns:=/{namespace}"]
        words += [word for key, value in common for word in ("-p", f"{key}:={value}")]
        for entry in node.findall("param"):
            if "from" in entry.attrib:
                words += ["--params-file", filled(entry.attrib["from"], values)]
            else:
                assert entry.attrib["type"] == "str"
                words += ["-p", f'{entry.attrib["name"]}:="{filled(entry.attrib["value"], values)}"']
        topics = {entry.attrib["from"]: filled(entry.attrib["to"], values) for entry in node.findall("remap")}
        words += [word for old, new in topics.items() for word in ("-r", f"{old}:={new}")]
        assert node.attrib["pkg"] == "sal_height"
        for name, kind in hosted(node).items():
            own = {old.removeprefix(f"{name}:"): new for old, new in topics.items() if old.startswith(f"{name}:")}
            arguments = ["--ros-args", "-r", f"__node:={name}", *words]
            nodes[name] = Started(kind, f"/{namespace}", own, arguments, dict(node.attrib))
    return nodes


def hosted(node: ET.Element) -> dict[str, str]:
    """Names and kinds of the nodes of a process."""
    if node.attrib["exec"] != "live_host":
        return {node.attrib["name"]: node.attrib["exec"]}
    words = [word.partition("=") for word in node.attrib["args"].split()]
    return {name: kind or name for name, _, kind in words}


def values_of(node: Node) -> dict[str, Any]:
    return {name: parameter.value for name, parameter in node._parameters.items()}  # also those that have no value


def topics_of(node: Node) -> set[str]:
    """Full names of the topics of a node, and whether it publishes them."""
    published, subscribed = list(node.publishers), list(node.subscriptions)
    return {f"out {entry.topic_name}" for entry in published} | {f"in {entry.topic_name}" for entry in subscribed}


def test_the_document_shows_the_file() -> None:
    text = (Path(__file__).parents[2] / "docs" / "live.md").read_text()
    assert text.partition("```yaml\n")[2].partition("```")[0] == FLIGHT.read_text()


def test_the_launch_file_starts_the_nodes_of_the_flight() -> None:
    nodes = started()
    assert sorted(nodes) == sorted(MEMBERS)
    for name, member in MEMBERS.items():
        of_member = (member.kind, member.namespace, member.remappings)
        assert (nodes[name].kind, nodes[name].namespace, nodes[name].remappings) == of_member


@pytest.mark.parametrize("name", MEMBERS)
def test_a_node_has_the_same_parameters_and_topics_by_either_way(
    name: str, graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is made twice, with real parsing of names, values and parameter files by ROS."""
    monkeypatch.chdir(tmp_path)
    member, arguments = MEMBERS[name], started()[name].arguments
    seen = []
    for overrides, words in ((_overrides(member), member.names), ([], arguments)):
        node = member.node(context=graph.context, parameter_overrides=overrides, cli_args=words)
        try:
            seen.append((node.get_fully_qualified_name(), values_of(node), topics_of(node)))
        finally:
            node.destroy_node()
    assert seen[0] == seen[1]
    given = {key: seen[1][1][key] for key in member.parameters}
    assert given == member.parameters


def _overrides(member: Member) -> list[Parameter]:
    return [Parameter(key, value=value) for key, value in member.parameters.items()]


def test_every_section_of_the_parameter_file_is_of_a_node() -> None:
    sections = yaml.safe_load((PACKAGE / "config" / "flight_parameters.yaml").read_text())
    assert {section.removeprefix("/**/") for section in sections} <= set(MEMBERS)


def test_the_example_states_nothing_of_a_place_or_of_a_sensor() -> None:
    """Maps have local coordinates, and images the size that suits the sensor, until the user says otherwise."""
    stated = {f"{name}.{key}" for name, member in MEMBERS.items() for key in member.parameters}
    assert not [name for name in stated if "origin" in name or name.startswith("sar_compression.")]


def test_parameters_reach_nodes_of_another_namespace_and_of_none(graph: Graph) -> None:
    for namespace in ("aircraft/lidar", ""):
        words = started(namespace=namespace)["coarse"].arguments
        node = NODES["ml_height"](context=graph.context, cli_args=words)
        assert node.get_parameter("range_looks").value == MEMBERS["coarse"].parameters["range_looks"]
        node.destroy_node()


def test_arguments_of_the_launch_file_reach_the_nodes(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert all(entry.attrib["description"].endswith(".") for entry in LAUNCH.iter("arg"))
    assert "recorder" not in started(record="false")
    nodes = started(directory="2026", use_sim_time="true", odometry="/odom", params_file=str(FLIGHT))
    assert nodes["sar_compression"].remappings == {"platform/odometry": "/odom"}
    assert all(str(FLIGHT) in node.arguments for node in nodes.values())
    words = started(directory="2026", use_sim_time="true")["recorder"].arguments
    recorder = NODES["recorder"](context=graph.context, cli_args=words)
    assert (recorder.get_parameter("directory").value, recorder.get_parameter("use_sim_time").value) == ("2026", True)
    recorder.destroy_node()
    assert (tmp_path / "2026").is_dir()


def test_nodes_come_back_end_in_time_and_share_the_processors() -> None:
    for node in started().values():
        assert node.options["respawn"] == "true"
        assert "sigkill_timeout" in node.options or not NODES[node.kind].completes_file
    environment = {entry.attrib["name"]: entry.attrib["value"] for entry in LAUNCH.iter("set_env")}
    assert environment == {name: f"$(env {name} {count})" for name, count in ONE_THREAD.items()}
