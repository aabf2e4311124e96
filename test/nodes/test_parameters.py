"""Parameters of nodes: what is taken, what is refused and in what words, and what others can ask about them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.nodes.graph import Graph
from sal_height.nodes.parameters import declare_parameters, parameter, read_parameters


@dataclass(frozen=True)
class Table:
    """One of each kind."""

    looks: int = parameter(2, "pixels averaged", minimum=1, maximum=4096)
    seed: int = parameter(1, "seed", minimum=0, maximum=2**31 - 1, read_only=True)
    cnr_db: float = parameter(5.0, "least CNR, dB", minimum=-60.0, maximum=100.0)
    plane: str = parameter("slant", "plane of the image", choices=("slant", "ground"))
    bag: str = parameter("", "path", read_only=True)


def declared(graph: Graph, **arguments: Any) -> Node:
    node = graph.add(Node("some", context=graph.context, **arguments))
    declare_parameters(node, Table)
    return node


def overridden(graph: Graph, **values: Any) -> Node:
    return declared(graph, parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])


def test_values_are_the_defaults_or_the_overrides(graph: Graph) -> None:
    assert read_parameters(overridden(graph), Table) == Table()
    given = {"looks": 4096, "seed": 0, "cnr_db": -60.0, "plane": "ground", "bag": "x"}
    assert read_parameters(overridden(graph, **given), Table) == Table(**given)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("looks", 5000, "Parameter looks is 5000; it must be a whole number from 1 to 4096."),
        ("looks", "9", "Parameter looks is '9' (string, not integer); it must be a whole number from 1 to 4096."),
        ("looks", 2.0, "Parameter looks is 2.0 (double, not integer); it must be a whole number from 1 to 4096."),
        ("looks", True, "Parameter looks is True (bool, not integer); it must be a whole number from 1 to 4096."),
        ("looks", None, "Parameter looks has no value; it must be a whole number from 1 to 4096."),
        ("seed", -1, "Parameter seed is -1; it must be a whole number from 0 to 2147483647."),
        ("cnr_db", 101, "Parameter cnr_db is 101.0; it must be a number from -60 to 100."),
        ("cnr_db", float("nan"), "Parameter cnr_db is nan; it must be a number from -60 to 100."),
        ("cnr_db", False, "Parameter cnr_db is False (bool, not double); it must be a number from -60 to 100."),
        ("plane", "up", "Parameter plane is 'up'; allowed are slant, ground."),
        ("plane", None, "Parameter plane has no value; allowed are slant, ground."),
        ("bag", 7, "Parameter bag is 7 (integer, not string); it must be a text."),
    ],
)
def test_wrong_override_gets_one_clear_sentence(graph: Graph, name: str, value: Any, sentence: str) -> None:
    with pytest.raises(UserError) as refusal:
        overridden(graph, **{name: value})
    assert str(refusal.value) == sentence


def test_wrong_value_on_the_command_line_gets_one_clear_sentence(graph: Graph, tmp_path: Path) -> None:
    file = tmp_path / "values.yaml"
    file.write_text("some:\n  ros__parameters:\n    looks: [1, 2]\n")
    for arguments in (["-p", "looks:=[]"], ["-p", "looks:=many"], ["--params-file", str(file)]):
        with pytest.raises(UserError) as refusal:
            declared(graph, cli_args=["--ros-args", *arguments])
        assert_one_sentence(str(refusal.value), "Parameter looks ", "; it must be a whole number from 1 to 4096.")


def test_whole_number_is_taken_for_a_float(graph: Graph) -> None:
    for node in (overridden(graph, cnr_db=10), declared(graph, cli_args=["--ros-args", "-p", "cnr_db:=10"])):
        value = read_parameters(node, Table).cnr_db
        assert value == 10.0
        assert isinstance(value, float)
        assert node.set_parameters([Parameter("cnr_db", value=20)])[0].successful
        assert isinstance(read_parameters(node, Table).cnr_db, float)
        assert read_parameters(node, Table).cnr_db == 20.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("looks", 4097),
        ("looks", 2.0),
        ("looks", None),
        ("cnr_db", 101),
        ("cnr_db", -60.1),
        ("cnr_db", "loud"),
        ("plane", "up"),
        ("plane", 3),
        ("seed", 2),
    ],
)
def test_wrong_value_at_run_time_changes_nothing(graph: Graph, name: str, value: Any) -> None:
    node = overridden(graph)
    result = node.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful
    assert result.reason
    assert "\n" not in result.reason
    assert read_parameters(node, Table) == Table()


def test_parameters_describe_themselves(graph: Graph) -> None:
    node = overridden(graph, cnr_db=10)
    looks, seed, cnr, plane = (node.describe_parameter(name) for name in ("looks", "seed", "cnr_db", "plane"))
    assert looks.description == "pixels averaged"
    assert looks.integer_range == [IntegerRange(from_value=1, to_value=4096, step=1)]
    assert cnr.floating_point_range == [FloatingPointRange(from_value=-60.0, to_value=100.0)]
    assert [d.type for d in (looks, cnr, plane)] == [
        ParameterType.PARAMETER_INTEGER,
        ParameterType.PARAMETER_DOUBLE,
        ParameterType.PARAMETER_STRING,
    ]
    assert plane.additional_constraints == "allowed are slant, ground"
    assert (looks.read_only, seed.read_only) == (False, True)
    assert not any(d.dynamic_typing for d in (looks, seed, cnr, plane))


def test_other_parameters_of_the_node_stay_free(graph: Graph) -> None:
    node = overridden(graph)
    node.declare_parameter("other", 1)
    assert node.set_parameters([Parameter("other", value=5)])[0].successful
    assert node.get_parameter("other").value == 5
