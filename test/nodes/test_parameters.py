"""Parameters of nodes: what is taken, what is refused and in what words, and what others can ask about them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from helpers import assert_one_sentence
from rcl_interfaces.msg import FloatingPointRange, IntegerRange
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.messages.types import ParameterType
from sal_height.nodes.parameters import LiveParameters
from sal_height.nodes.transport.graph import Graph
from sal_height.settings import Settings, setting


class Table(Settings):
    """One of each kind."""

    looks: int = setting(2, "pixels averaged", minimum=1, maximum=4096)
    others: int = setting(2, "the same number as looks", minimum=1)
    seed: int = setting(1, "seed", minimum=0, maximum=2**31 - 1, read_only=True)
    cnr_db: float = setting(5.0, "lowest CNR", unit="dB", minimum=-60.0, maximum=100.0)
    spacing: float = setting(1.0, "spacing", unit="m", minimum=1e-6)
    plane: str = setting("slant", "plane of the image", choices=("slant", "ground"))
    bag: str = setting("", "path", read_only=True)


class Declared(Node):
    """A node with the parameters of Table."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__("some", **arguments)
        try:
            self.live = LiveParameters(self, Table)
        except UserError:
            self.destroy_node()
            raise


def declared(graph: Graph, **arguments: Any) -> Declared:
    return graph.add(Declared(context=graph.context, **arguments))


def overridden(graph: Graph, **values: Any) -> Declared:
    return declared(graph, parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])


def test_values_are_the_defaults_or_the_overrides(graph: Graph) -> None:
    assert overridden(graph).live.current == Table()
    given = {"looks": 4096, "seed": 0, "cnr_db": -60.0, "plane": "ground", "bag": "x"}
    assert overridden(graph, **given).live.current == Table(**given)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("looks", 5000, "Parameter looks is 5000; it must be a whole number from 1 to 4096."),
        ("looks", None, "Parameter looks has no value; it must be a whole number from 1 to 4096."),
        ("cnr_db", False, "Parameter cnr_db is False; it must be a number from -60 to 100."),
        ("plane", "up", "Parameter plane is 'up'; allowed are slant, ground."),
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
        value = node.live.current.cnr_db
        assert value == 10.0
        assert isinstance(value, float)
        assert node.set_parameters([Parameter("cnr_db", value=20)])[0].successful
        assert isinstance(node.live.current.cnr_db, float)
        assert node.live.current.cnr_db == 20.0


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
    assert node.live.current == Table()


def test_parameters_describe_themselves(graph: Graph) -> None:
    node = overridden(graph, cnr_db=10)
    looks, seed, cnr, plane = (node.describe_parameter(name) for name in ("looks", "seed", "cnr_db", "plane"))
    assert (looks.description, cnr.description) == ("pixels averaged", "lowest CNR [dB]")
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


def test_a_bound_on_one_side_is_held(graph: Graph) -> None:
    node = overridden(graph, others=2**40, spacing=1e300)
    for low in (Parameter("others", value=0), Parameter("spacing", value=0.0)):
        assert not node.set_parameters([low])[0].successful


def test_parameters_set_together_are_refused_together(graph: Graph) -> None:
    node = overridden(graph)
    result = node.set_parameters_atomically([Parameter("looks", value=7), Parameter("plane", value="up")])
    assert not result.successful
    assert node.live.current == Table()
    assert node.get_parameter("looks").value == 2


def test_a_reader_never_sees_half_of_what_was_set_together(graph: Graph) -> None:
    node, done = overridden(graph), Event()
    torn: list[Table] = []
    reads = 0

    def read() -> None:
        nonlocal reads
        while not done.is_set():
            seen = node.live.current
            torn.extend([seen] if seen.looks != seen.others else [])
            reads += 1

    with ThreadPoolExecutor(1) as pool:
        reader = pool.submit(read)
        for value in range(1, 2000):
            together = [Parameter("looks", value=value), Parameter("others", value=value)]
            assert node.set_parameters_atomically(together).successful
        done.set()
        reader.result()
    assert reads > 1000
    assert not torn
