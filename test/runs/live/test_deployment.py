"""Configurations of `sal-height live`: what they start, and what is refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import assert_one_sentence
from rclpy.parameter import Parameter

from sal_height.commands import main
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.live.deployment import load_deployment, members_of

WHOLE = """
namespace: aircraft/lidar
nodes:
  recorder:
    parameters: {directory: bag, topics: [ml/height, tracked/height]}
  sar_compression:
    parameters:
      rows: 96
      max_odometry_gap_s: 1
      use_sim_time: true
      qos_overrides./platform/odometry.subscription.reliability: best_effort
    remap: {platform/odometry: /nav/odometry}
  near:
    node: ml_height
    parameters: {range_looks: 2}
    remap: {ml/height: near/height}
  far:
    node: ml_height
    namespace: /elsewhere
  relief_tracker:
  bare: {node: monopulse, namespace: ""}
"""


def written(text: str, folder: Path) -> Path:
    file = folder / "flight.yaml"
    file.write_text(text)
    return file


def test_a_configuration_names_nodes_parameters_topics_and_namespaces(tmp_path: Path) -> None:
    members = {member.name: member for member in members_of(load_deployment(written(WHOLE, tmp_path)))}
    assert list(members) == ["recorder", "sar_compression", "near", "far", "relief_tracker", "bare"]
    assert members["near"].kind == "ml_height"
    assert members["near"].namespace == members["relief_tracker"].namespace == "/aircraft/lidar"
    assert (members["far"].namespace, members["bare"].namespace) == ("/elsewhere", "")
    assert members["sar_compression"].parameters["max_odometry_gap_s"] == 1.0
    assert members["recorder"].arguments == [
        *("--ros-args", "-r", "__node:=recorder", "-r", "__ns:=/aircraft/lidar", "-p", 'directory:="bag"'),
        *("-p", 'topics:=["ml/height", "tracked/height"]'),
    ]


def test_nodes_take_the_names_and_values_of_their_configuration(tmp_path: Path, graph: Graph) -> None:
    """In this process; a run of `sal-height live` in another test has each in one of its own."""
    members = {member.name: member for member in members_of(load_deployment(written(WHOLE, tmp_path)))}
    member = members["near"]
    values = [Parameter(key, value=value) for key, value in member.parameters.items()]
    node = graph.add(member.node(context=graph.context, parameter_overrides=values, cli_args=member.names))
    assert node.get_fully_qualified_name() == "/aircraft/lidar/near"
    assert node.get_parameter("range_looks").value == 2
    names = {name for name, _ in node.get_publisher_names_and_types_by_node("near", "/aircraft/lidar")}
    assert "/aircraft/lidar/near/height" in names
    assert "/aircraft/lidar/ml/height" not in names


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nodes: [", ["not valid YAML"]),
        ("nodes: [ml_height]", ["nodes is ", "it must be a mapping"]),
        ("namespace: /a", ["nodes is missing"]),
        ("nodes: {}", ["There are no nodes", "ml_height"]),
        ("nodes: {ml_height: 3}", ["nodes.ml_height is 3"]),
        ("nodes: {ml_height: {param: {}}}", ["nodes.ml_height.param is not a known key"]),
        ("nodes: {ml_heigt: }", ["no node 'ml_heigt' (did you mean 'ml_height'?)"]),
        ("nodes: {far: {node: capon}}", ["no node 'capon'", "allowed are"]),
        ("nodes: {my-node: {node: ml_height}}", ["Node name 'my-node'", "letters, digits and underscores"]),
        ("nodes: {ml_height: {namespace: a//b}}", ["Node ml_height: namespace is 'a//b'", "/aircraft/lidar"]),
        (
            "nodes: {near: {node: ml_height, parameters: {range_lookz: 2}}}",
            ["Node near has no parameter 'range_lookz'"],
        ),
        ("nodes: {ml_height: {parameters: {range_looks: two}}}", ["Node ml_height", "range_looks is 'two'", "whole"]),
        ("nodes: {ml_height: {parameters: {use_sim_time: 1}}}", ["use_sim_time is 1", "true or false"]),
        ("nodes: {ml_height: {parameters: {qos_overrides./slc.depth: [1]}}}", ["qos_overrides./slc.depth is [1]"]),
        ("nodes: {ml_height: {remap: {scl: /slc}}}", ["Node ml_height has no topic 'scl' (did you mean 'slc'?)"]),
        ("nodes: {ml_height: {remap: [slc]}}", ["nodes.ml_height.remap", "it must be a mapping"]),
        ("one_process: maybe\nnodes: {ml_height: }", ["one_process is 'maybe'"]),
    ],
)
def test_what_a_configuration_may_not_say(
    text: str, said: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(text, tmp_path)
    assert main(["live", str(file)]) == 2
    complaint = capsys.readouterr().err.removeprefix("sal-height: ").removesuffix("\n")
    assert_one_sentence(complaint, f"Configuration {file}", *said)


def test_topics_that_a_parameter_names_can_be_renamed(tmp_path: Path) -> None:
    text = "nodes: {relief_mapper: {remap: {capon/height: /heights}, parameters: {estimator: capon}}}"
    (member,) = members_of(load_deployment(written(text, tmp_path)))
    assert member.remappings == {"capon/height": "/heights"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--preset", "small"], "Option --preset is for a sensor that is simulated"),
        (["--param", "ml_height.range_looks=2"], "Option --param is for"),
        (["--record", "slc"], "Option --record is for"),
        (["--seed", "0"], "Option --seed is for"),
        (["--estimators", "ml,adjusted"], "Option --estimators is for"),
        (["--supervise", "--one-process"], "exclude each other"),
    ],
)
def test_options_that_a_configuration_excludes(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["live", str(written(WHOLE, tmp_path)), *words]) == 2
    assert said in capsys.readouterr().err


def test_nodes_of_one_process_cannot_be_supervised(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written("one_process: true\nnodes: {ml_height: }", tmp_path)
    assert main(["live", str(file), "--supervise"]) == 2
    assert "one_process excludes --supervise" in capsys.readouterr().err


def test_a_configuration_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml cannot be read; it must be a YAML file" in capsys.readouterr().err
