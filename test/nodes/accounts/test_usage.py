"""Executables of nodes: --help says what a node does, and what has no effect is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence
from programs import PROCESSING as PROGRAMS
from programs import Program
from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.nodes.accounts.usage import check_arguments, check_overrides, usage
from sal_height.nodes.playing.player import Player
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.program import run_node
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.simulator import Simulator
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.nodes.worker import WorkerNode
from sal_height.settings import settings_of
from sal_height.topics import TF

BAG = str(Path(__file__).parents[3] / "bags" / "version_3")

NODES: dict[type[Any], dict[str, Any]] = {
    **{node: {} for name, node in PROCESSING.items() if name != "navigation"},
    PROCESSING["sar_compression"]: {"calibration": "topic", "mounting_from_tf": True},
    Simulator: {"preset": "small", "period_s": 0.0},
    Player: {"bag": BAG, "clock": "paced"},
}
"""Nodes and the parameters that they need or with which they have all their topics."""


@pytest.mark.parametrize("node", [*NODES, PROCESSING["navigation"], Recorder], ids=lambda node: node.__name__)
def test_help_names_what_the_node_does_its_topics_and_its_parameters(
    node: type[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["/usr/bin/program", "--help"])
    assert run_node(node) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("usage: program [--ros-args -p ")
    for topic in {*node.inputs, *node.outputs}:
        assert f"\n  {topic}: " in printed
    assert ("\n  losses: " in printed) == issubclass(node, WorkerNode)
    words = " ".join(printed.split())
    for entry in settings_of(node.parameters).values():
        assert f"{entry.name} = " in words
        assert " ".join(entry.text.split()) in words


def test_help_shows_default_unit_and_range() -> None:
    printed = " ".join(usage(PROCESSING["sar_compression"], "sar_compression").split())
    assert (
        "max_odometry_gap_s = 0.5 longest time between two odometry samples during a dwell [s]; "
        "it must be a number from 1e-06 to 3600" in printed
    )
    assert "odometry_buffer_s = 100.0" in printed


@pytest.mark.parametrize("node", NODES, ids=lambda node: node.__name__)
def test_the_topics_and_services_that_help_names_are_those_of_the_node(graph: Graph, node: type[WorkerNode]) -> None:
    overrides = [Parameter(name, value=value) for name, value in NODES[node].items()]
    made = graph.add(node(context=graph.context, parameter_overrides=overrides))
    ours = {name.lstrip("/") for name, _ in made.get_topic_names_and_types()} - {"rosout", "parameter_events", "tf"}
    named = {*node.inputs, *node.outputs, "losses", "diagnostics", "progress", f"{made.get_name()}/transition_event"}
    named = {name.lstrip("/") for name in named if name != TF}
    assert ours == {name.replace("<estimator>", "ml") for name in named}
    services = {
        name
        for name, (kind,) in made.get_service_names_and_types()
        if not kind.startswith(("rcl_interfaces/", "lifecycle_msgs/", "type_description_interfaces/"))
    }
    assert services == {name.replace("~", f"/{made.get_name()}") for name in node.answers}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("objectiv", "Node ml_height has no parameter 'objectiv' (did you mean 'objective'?); allowed are "),
        ("qos_overrides./slk.subscription.depth", "did you mean 'qos_overrides./slc.subscription.depth'?"),
    ],
)
def test_a_misspelt_parameter_is_refused_and_the_closest_is_named(graph: Graph, name: str, words: str) -> None:
    misspelt = ["--ros-args", "-p", f"{name}:=1"]
    node = graph.add(PROCESSING["ml_height"](context=graph.context, cli_args=misspelt))
    with pytest.raises(UserError) as refusal:
        check_overrides(node)
    assert_one_sentence(str(refusal.value), words)


def test_parameters_that_exist_are_not_refused(graph: Graph) -> None:
    given = [Parameter("use_sim_time", value=True), Parameter("qos_overrides./slc.subscription.depth", value=5)]
    node = graph.add(PROCESSING["ml_height"](context=graph.context, parameter_overrides=given))
    check_overrides(node)
    (subscription,) = (one for one in node.subscriptions if one.topic_name == "/slc")
    assert subscription.qos_profile.depth == 5
    assert FRAMES_QOS.depth == 256  # that of other topics and nodes


def test_an_argument_that_is_none_of_ros_is_refused() -> None:
    check_arguments(["ml_height", "--ros-args", "-p", "range_looks:=2"])
    with pytest.raises(UserError, match="Argument 'range_looks:=2' is not known"):
        check_arguments(["ml_height", "range_looks:=2"])


def test_a_parameter_of_ros_of_another_type_is_refused_in_a_sentence(domain_id: int) -> None:
    """Those of ours are reported by the node itself."""
    program = Program(PROGRAMS, "relief_mapper", "--ros-args", "-p", "use_sim_time:=1", domain_id=domain_id)
    _, said = program.communicate()
    assert program.returncode == 2
    assert said.count("\n") == 1
    assert "'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'" in said
