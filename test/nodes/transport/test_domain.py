"""Domains: one that nobody uses, and nodes that stay among themselves."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack
from pathlib import Path

import pytest
from rclpy.node import Node
from std_msgs.msg import String

from sal_height.errors import UserError
from sal_height.nodes.transport import domain as domains
from sal_height.nodes.transport.domain import DOMAINS, first_port, free_domain, ros_domain
from sal_height.nodes.transport.graph import Graph

VARIABLES = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")


def test_domains_held_at_the_same_time_are_different() -> None:
    with free_domain() as one, free_domain() as other:
        assert one != other
        assert {one, other} <= set(DOMAINS)


def test_a_domain_in_which_somebody_has_a_node_is_passed_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node of another program, which knows nothing of our locks; its process has nodes in other domains, too."""
    with ExitStack() as kept, free_domain() as elsewhere:
        domain = kept.enter_context(free_domain())
        with Graph(elsewhere) as before, Graph(domain) as graph:
            before.add(Node("before", context=before.context))
            graph.add(Node("somebody", context=graph.context))
            kept.close()
            monkeypatch.setattr(domains, "DOMAINS", [domain])
            with pytest.raises(UserError, match="in use"), free_domain():
                pass


def test_when_all_domains_are_held_this_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with ExitStack() as stack:
        monkeypatch.setattr(domains, "DOMAINS", [stack.enter_context(free_domain()) for _ in range(2)])
        with pytest.raises(UserError, match=r"^All ROS domains from \d+ to \d+ are in use; wait"), free_domain():
            pass


def test_ports_of_all_domains_lie_below_those_that_linux_hands_out() -> None:
    lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    assert first_port(DOMAINS[-1] + 1) <= max(lowest, 32768)


def test_a_domain_is_given_back_with_its_port() -> None:
    with free_domain() as domain, socket.socket() as other, pytest.raises(OSError, match="in use"):
        other.bind(("127.0.0.1", first_port(domain)))
    with socket.socket() as other:
        other.bind(("127.0.0.1", first_port(domain)))


def test_the_environment_is_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    monkeypatch.setenv("ROS_STATIC_PEERS", "192.0.2.1")
    before = {name: os.environ.get(name) for name in VARIABLES}
    with ros_domain(7):
        assert [os.environ[name] for name in VARIABLES] == ["7", "LOCALHOST", ""]
    assert {name: os.environ.get(name) for name in VARIABLES} == before
    with ros_domain("environment"):
        assert {name: os.environ.get(name) for name in VARIABLES} == before
    assert {name: os.environ.get(name) for name in VARIABLES} == before


def test_nodes_of_two_free_domains_do_not_see_each_other() -> None:
    with ros_domain("free"), Graph() as one:
        here = one.add(Node("here", context=one.context))
        here.create_publisher(String, "/note", 1)
        with ros_domain("free"), Graph() as other:
            there = other.add(Node("there", context=other.context))
            there.create_publisher(String, "/note", 1)
            other.spin_until(lambda: there.count_publishers("/note") > 1, 1.0)
            assert there.count_publishers("/note") == here.count_publishers("/note") == 1
            with Graph(int(os.environ["ROS_DOMAIN_ID"])) as same:  # or else this proves nothing
                late = same.add(Node("late", context=same.context))
                assert same.spin_until(lambda: late.count_publishers("/note") == 1, 10.0)
