"""Fixtures for the tests of nodes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from bag_feeder import BAG, Feeder
from chain_fixture import Chain, StageChain

from sal_height.messages.types import HeightImage
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph, events_executor
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scenes import load_scene


class SharedGraph:
    """The graph whose context the tests of a module share; one that a test has ended is replaced."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self._graph: Graph | None = None

    def current(self) -> Graph:
        if self._graph is None or not self._graph.context.ok():
            self._graph = self._stack.enter_context(Graph(self._stack.enter_context(free_domain())))
        return self._graph


@pytest.fixture(scope="module")
def shared_graph() -> Iterator[SharedGraph]:
    with ExitStack() as stack:
        yield SharedGraph(stack)


@pytest.fixture
def graph(request: pytest.FixtureRequest, shared_graph: SharedGraph) -> Iterator[Graph]:
    """A graph without nodes, which meets no other; a test with programs has a DDS domain of its own."""
    if "domain_id" in request.fixturenames:
        with Graph(request.getfixturevalue("domain_id")) as alone:
            yield alone
    else:
        graph = shared_graph.current()
        yield graph
        graph.clear()
        graph.executor.shutdown()
        graph.executor = events_executor(graph.context)


@pytest.fixture(scope="session")
def flight() -> SimulatedFlight:
    """Three dwells of the small preset."""
    preset = load_preset("small")
    return SimulatedFlight(preset, preset.make_sensor(), load_scene(preset.scene), preset.dwells, seed=7)


@pytest.fixture
def chain(graph: Graph, flight: SimulatedFlight) -> Chain:
    """A connected chain that drops what misses something after 0.5 s."""
    return Chain(graph, flight, missing_after_s=0.5)


@pytest.fixture(scope="session")
def reference(flight: SimulatedFlight) -> dict[tuple[str, int], HeightImage]:
    """Heights of dwells 0 and 1 when all is well; stages that are joined without ROS make them."""
    chain = StageChain(flight)
    chain.publish(chain.sensor_info())
    for dwell in (0, 1):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
    return dict(chain.heights)


@pytest.fixture(scope="session")
def bag_heights() -> dict[int, HeightImage]:
    """Heights of the dwells of the newest reference bag, as they are today, when rclpy publishes it here."""
    with free_domain() as domain, Graph(domain) as graph:
        graph.add(PROCESSING["sar_compression"](context=graph.context))
        graph.add(PROCESSING["ml_height"](context=graph.context))
        return Feeder(graph).heights_of(BAG)
