"""Nodes have a life cycle, forget when they are asked to, and save what they have."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest
import rasterio
from chain_fixture import DETECTORS, Chain, next_dwell_is_exact, same_heights
from helpers import publisher_of
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from sal_height.engine.results import FileProduct
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, HeightImage
from sal_height.nodes import host
from sal_height.nodes.accounts.account import DIAGNOSTICS, Account
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.simulator import Simulator
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.nodes.worker import WorkerNode
from sal_height.simulation import SimulatedFlight
from sal_height.stage_files import write_product

TIMEOUT_S = 120.0


class Manager:
    """Calls the services of nodes, as a lifecycle manager or a user does."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.node = graph.add(Node("manager", context=graph.context))

    def call(self, kind: Any, service: str, **request: Any) -> Any:
        client = self.node.create_client(kind, service)
        assert self.graph.spin_until(client.service_is_ready, TIMEOUT_S)
        answer = client.call_async(kind.Request(**request))
        assert self.graph.spin_until(answer.done, TIMEOUT_S)
        self.node.destroy_client(client)
        return answer.result()

    def change(self, node: str, transition: int) -> None:
        assert self.call(ChangeState, f"{node}/change_state", transition=Transition(id=transition)).success

    def state(self, node: str) -> int:
        return int(self.call(GetState, f"{node}/get_state").current_state.id)

    def trigger(self, service: str) -> tuple[bool, str]:
        answer = self.call(Trigger, service)
        return answer.success, answer.message


@pytest.fixture
def manager(graph: Graph) -> Manager:
    return Manager(graph)


def counts(node: WorkerNode) -> dict[str, Any]:
    return node.tally.summary()


@pytest.mark.parametrize("name", ["sar_compression", "ml_height"])
def test_an_inactive_node_drops_and_counts_and_begins_at_once_when_it_is_activated(
    name: str, chain: Chain, manager: Manager, reference: dict[tuple[str, int], HeightImage]
) -> None:
    """Description and odometry that come meanwhile are taken."""
    stage = chain.stages[name]
    assert manager.state(name) == State.PRIMARY_STATE_ACTIVE
    manager.change(name, Transition.TRANSITION_DEACTIVATE)
    assert not stage.is_ready
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_drops(name, "inactive", DETECTORS)
    assert "not active" in stage.last_drop
    manager.change(name, Transition.TRANSITION_ACTIVATE)
    next_dwell_is_exact(chain, reference)
    assert (name, 0) not in chain.heights


def test_a_node_that_does_not_start_by_itself_waits_for_its_manager(graph: Graph, manager: Manager) -> None:
    node = graph.add(
        PROCESSING["relief_tracker"](context=graph.context, parameter_overrides=[Parameter("autostart", value=False)])
    )
    assert manager.state("relief_tracker") == State.PRIMARY_STATE_UNCONFIGURED
    status = node.diagnostics().status[0]
    assert (status.level, status.message) == (DiagnosticStatus.OK, "inactive")
    manager.change("relief_tracker", Transition.TRANSITION_CONFIGURE)
    assert not node.is_active
    manager.change("relief_tracker", Transition.TRANSITION_ACTIVATE)
    assert node.is_active
    assert graph.spin_until(lambda: "waiting for" in node.diagnostics().status[0].message, TIMEOUT_S)


def test_a_source_that_is_inactive_delivers_nothing(graph: Graph, manager: Manager) -> None:
    overrides = [
        Parameter("autostart", value=False),
        Parameter("preset", value="small"),
        Parameter("period_s", value=0.0),
    ]
    graph.add(Simulator(context=graph.context, parameter_overrides=overrides))
    done, said = manager.trigger("simulator/step")
    assert not done
    assert "not active" in said
    manager.change("simulator", Transition.TRANSITION_CONFIGURE)
    manager.change("simulator", Transition.TRANSITION_ACTIVATE)
    assert manager.trigger("simulator/step")[0]


def test_a_reset_drops_what_is_unfinished_and_the_next_dwell_is_exact(
    graph: Graph, flight: SimulatedFlight, manager: Manager, reference: dict[tuple[str, int], HeightImage]
) -> None:
    chain = Chain(graph, flight, missing_after_s=30.0)
    compression = chain.stages["sar_compression"]
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0)[:3])
    chain.wait(lambda: counts(compression)["in"] == 3, "the frames")
    assert manager.trigger("sar_compression/reset")[0]
    assert chain.dropped("sar_compression") == {"reset": 3}
    assert counts(compression)["waiting"] == 0
    chain.publish(*chain.odometry(0), *chain.frames(0))  # the same dwell is no late one after it
    chain.await_heights(0)
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])
    next_dwell_is_exact(chain, reference)


def test_odometry_from_before_a_reset_is_forgotten(chain: Chain, manager: Manager) -> None:
    chain.publish(chain.sensor_info(), *chain.odometry(0))
    chain.wait(lambda: len(chain.stages["sar_compression"].stage._odometry) > 0, "the odometry")
    manager.trigger("sar_compression/reset")
    chain.publish(*chain.frames(0))
    chain.await_drops("sar_compression", "odometry gap", DETECTORS)


class Heights:
    """A node that takes heights, and somebody who publishes them."""

    def __init__(self, graph: Graph, node: WorkerNode, image: HeightImage) -> None:
        self.graph, self.node, self.image, self.fed = graph, node, image, 0
        feeder = graph.add(Node("feeder", context=graph.context))
        self.publisher = publisher_of(feeder, HeightImage, "ml/height", FRAMES_QOS)
        assert graph.spin_until(lambda: self.publisher.get_subscription_count() == 1, TIMEOUT_S)

    def feed(self) -> None:
        self.publisher.publish(self.image)
        self.fed += 1
        assert self.graph.spin_until(lambda: counts(self.node)["processed"] == self.fed, TIMEOUT_S)


@pytest.mark.parametrize("way", ["reset", "clean up"])
def test_a_map_begins_anew_when_it_is_reset(
    way: str, graph: Graph, manager: Manager, reference: dict[tuple[str, int], HeightImage], tmp_path: Path
) -> None:
    file = tmp_path / "map.tif"
    mapper = graph.add(
        PROCESSING["relief_mapper"](context=graph.context, parameter_overrides=[Parameter("file", value=str(file))])
    )
    heights = Heights(graph, mapper, reference["ml", 0])
    heights.feed()
    heights.feed()
    assert manager.trigger("relief_mapper/save") == (True, str(file))
    assert images_in(file) == 2
    if way == "reset":
        assert manager.trigger("relief_mapper/reset")[0]
    else:
        manager.change("relief_mapper", Transition.TRANSITION_DEACTIVATE)
        manager.change("relief_mapper", Transition.TRANSITION_CLEANUP)
        manager.change("relief_mapper", Transition.TRANSITION_CONFIGURE)
        manager.change("relief_mapper", Transition.TRANSITION_ACTIVATE)
    assert graph.spin_until(lambda: mapper.stage._map is None, TIMEOUT_S)
    assert manager.trigger("relief_mapper/save") == (False, "no height was seen")
    heights.feed()
    assert manager.trigger("relief_mapper/save")[0]
    assert images_in(file) == 1


def images_in(file: Path) -> int:
    with rasterio.open(file) as relief:
        assert relief.read(4).sum() > 0
        return int(relief.tags()["images"])


def test_a_map_without_a_file_is_not_saved(graph: Graph, manager: Manager) -> None:
    node = graph.add(PROCESSING["relief_mapper"](context=graph.context))
    assert manager.trigger(f"{node.get_name()}/save") == (
        False,
        "parameter file is empty; it must be the path of a GeoTIFF",
    )


def test_a_map_that_cannot_be_written_says_so(
    graph: Graph, manager: Manager, reference: dict[tuple[str, int], HeightImage], tmp_path: Path
) -> None:
    folder = tmp_path / "maps"
    folder.mkdir()
    file = [Parameter("file", value=str(folder / "map.tif"))]
    heights = Heights(
        graph,
        graph.add(PROCESSING["relief_mapper"](context=graph.context, parameter_overrides=file)),
        reference["ml", 0],
    )
    heights.feed()
    folder.rmdir()
    done, said = manager.trigger("relief_mapper/save")
    assert not done
    assert "map.tif" in said
    folder.mkdir()
    assert manager.trigger("relief_mapper/save")[0]


def test_while_a_map_is_saved_its_process_receives_frames_and_publishes_heights(
    graph: Graph, chain: Chain, manager: Manager, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map is that of the heights before; those of the next dwell wait for it."""
    begun, going = Event(), Event()

    def write_late(product: FileProduct) -> None:
        begun.set()
        assert going.wait(TIMEOUT_S)
        write_product(product)

    monkeypatch.setattr(host, "write_product", write_late)
    file = tmp_path / "map.tif"
    mapper = graph.add(
        PROCESSING["relief_mapper"](context=graph.context, parameter_overrides=[Parameter("file", value=str(file))])
    )
    client = manager.node.create_client(Trigger, "relief_mapper/save")
    chain.wait(lambda: mapper.is_ready and client.service_is_ready(), "the mapper")
    chain.fly(0)
    chain.wait(lambda: counts(mapper)["processed"] == 1, "the map")
    answer = client.call_async(Trigger.Request())
    try:
        chain.wait(begun.is_set, "the file")
        chain.fly(1)
        chain.wait(lambda: counts(mapper)["in"] == 2, "the heights")
        assert (answer.done(), counts(mapper)["waiting"]) == (False, 1)
    finally:
        going.set()
    chain.wait(answer.done, "the answer")
    assert (answer.result().success, answer.result().message) == (True, str(file))
    assert images_in(file) == 1
    chain.wait(lambda: counts(mapper)["processed"] == 2, "the map")


def test_at_its_end_a_node_accounts_for_all_that_came(graph: Graph, flight: SimulatedFlight, manager: Manager) -> None:
    """For what waits for its sensor info, for the rest of its dwell, or for its turn, here behind the rehearsal."""
    told: dict[str, Account] = {}

    def keep(message: DiagnosticArray) -> None:
        told.update({status.name: Account.of_status(status) for status in message.status})

    subscribe(manager.node, DiagnosticArray, DIAGNOSTICS, keep, 100)
    chain = Chain(graph, flight, missing_after_s=30.0)
    compression, going = chain.stages["sar_compression"], Event()
    compression.submit(0, lambda: int(not going.wait(TIMEOUT_S)))
    strange = chain.frames(2)[0]
    strange.config_hash = "stranger"
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0), *chain.frames(1)[:3], strange)
    chain.wait(lambda: counts(compression)["in"] == DETECTORS + 4 and compression.jobs == 3, "the frames")
    assert counts(compression)["waiting"] == DETECTORS + 4
    chain.wait(lambda: "sar_compression" in told, "an account")
    graph.nodes.remove(compression)
    graph.executor.remove_node(compression)
    for _ in range(50):  # rclpy fails on a handle that it found ready before the node was removed, and is gone now
        graph.executor.spin_once(timeout_sec=0)
    ended = Thread(target=compression.destroy_node)
    ended.start()
    chain.wait(lambda: counts(compression)["waiting"] == 0, "the drops")
    going.set()
    ended.join()
    chain.wait(lambda: told["sar_compression"].dropped == {"ended": DETECTORS + 4}, "the last account")
    account = told["sar_compression"]
    assert account.received == sum(account.dropped.values())
    assert account.waiting == 0
