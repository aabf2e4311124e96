"""The conductor of a live graph: whom it believes, and when it lets the sensor begin."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import publisher_of
from rclpy.node import Node

from sal_height.errors import UserError
from sal_height.graph.ensemble import Conductor
from sal_height.graph.plan import Plan
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, KeyValue
from sal_height.nodes.transport.graph import Graph


def status(name: str, **values: object) -> DiagnosticStatus:
    return DiagnosticStatus(name=name, values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


def test_diagnostics_of_others_are_ignored(graph: Graph) -> None:
    watching = graph.add(Conductor(Plan("simulator", ["monopulse"], [], Path("bag"), {}, 1), context=graph.context))
    publisher = publisher_of(graph.add(Node("stages", context=graph.context)), DiagnosticArray, "/diagnostics", 10)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, 10)
    ours = [status("recorder", unwritten=0), status("simulator", **{"in": 1, "out": 8, "waiting": 0, "note": "slow"})]
    foreign = [
        status("recorder", state="recording"),
        status("simulator", state="ok", temperature=40),
        status("player", **{"in": 1, "out": 1, "waiting": 0}),
    ]
    end = status("monopulse", **{"in": 8, "out": 1, "waiting": 0, "latency_p50_ms": "nan"})
    publisher.publish(DiagnosticArray(status=[*ours, *foreign, end]))
    assert graph.spin_until(lambda: "monopulse" in watching.accounts, 10)
    assert {name: account.numbers for name, account in watching.accounts.items()} == {
        "recorder": {"unwritten": 0},
        "simulator": {"in": 1, "processed": 0, "out": 8, "waiting": 0, "jobs": 0, "ready": 0},
        "monopulse": {"in": 8, "processed": 0, "out": 1, "waiting": 0, "jobs": 0, "ready": 0},
    }


def test_once_all_nodes_are_ready_no_account_is_read(graph: Graph) -> None:
    watching = graph.add(Conductor(Plan("simulator", [], [], Path("bag"), {}, 1), context=graph.context))
    publisher = publisher_of(graph.add(Node("stages", context=graph.context)), DiagnosticArray, "/diagnostics", 10)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, 10)
    watching.stop_reading()
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 0, 10)


def test_a_topic_is_unknown_once_all_nodes_are_ready(graph: Graph) -> None:
    """A node may state an account before it offers its topics, such as a player that reads its bag."""
    plan = Plan("simulator", [], ["phase_history"], Path("bag"), {}, 1)
    watching = graph.add(Conductor(plan, context=graph.context))
    publisher = publisher_of(graph.add(Node("stages", context=graph.context)), DiagnosticArray, "/diagnostics", 10)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, 10)

    def state(**values: object) -> None:
        watching.accounts.clear()
        counts = {"in": 0, "out": 0, "waiting": 0, **values}
        publisher.publish(DiagnosticArray(status=[status("recorder", unwritten=0), status("simulator", **counts)]))
        assert graph.spin_until(lambda: len(watching.accounts) == 2, 10)

    state(ready=0)
    assert not watching.connected()
    state(ready=1, **{"subscribers.sensor_info": 1})
    with pytest.raises(UserError, match=r"^No node of this run publishes topic phase_history; it has sensor_info\.$"):
        watching.connected()
