"""A node as a program of its own, which the console scripts run, and several nodes that share workers."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from sal_height.errors import UserError
from sal_height.nodes.accounts.usage import announce, check_arguments, check_overrides, program_name, usage
from sal_height.nodes.pooled import join
from sal_height.nodes.transport.domain import LOOK_S, LOST, Ports
from sal_height.nodes.transport.graph import events_executor
from sal_height.nodes.transport.middleware import provide_shared_memory
from sal_height.numeric import available_processors
from sal_height.workers.pool import Pool
from sal_height.workers.processes import prepare_for_messages


def run_node(make: type[Node], begin: Callable[[Node], None] = announce) -> int:
    """Run one node until SIGINT or SIGTERM, or print what it does if --help is asked for.

    Args:
        make: class of the node.
        begin: function that is called with the node once it is made.

    Returns:
        The exit status, as of `run_nodes`.
    """
    if {"--help", "-h"} & set(sys.argv[1:]):
        sys.stdout.write(usage(make, program_name()))
        return 0
    prepare_for_messages()
    return _run_nodes([make], begin, sys.argv)


def run_host(
    members: Sequence[tuple[Callable[..., Node], list[str]]],
    arguments: list[str],
    begin: Callable[[Node], None] = announce,
) -> int:
    """Run nodes of stages in this process, with workers and items in common, until SIGINT or SIGTERM.

    Args:
        members: class of each node, and its own arguments of ROS, in the order of the data: that in which they end.
        arguments: arguments of ROS for all nodes, after the name of the program.
        begin: function that is called with each node once all are made.

    Returns:
        The exit status, as of `run_nodes`.
    """
    prepare_for_messages()
    pool = Pool(available_processors())
    try:
        makes: list[Callable[[], Node]] = [partial(make, pool=pool, cli_args=own) for make, own in members]

        def prepare(nodes: Sequence[Any]) -> None:
            join(nodes)
            pool.start()

        return _run_nodes(makes, begin, arguments, prepare, lambda: pool.failure)
    finally:
        pool.close()


def _run_nodes(
    makes: Sequence[Callable[[], Node]],
    begin: Callable[[Node], None],
    arguments: list[str],
    prepare: Callable[[Sequence[Any]], None] = lambda _: None,
    failure: Callable[[], str] = str,
) -> int:
    """Run nodes until SIGINT or SIGTERM.

    A signal only ends the loop, so that it can cut neither a message nor the nodes' end.

    Args:
        makes: functions that make the nodes, in the order in which these end.
        begin: function that is called with each node once all are made.
        arguments: arguments of ROS for all nodes, after the name of the program.
        prepare: function that is called with all nodes before they receive anything.
        failure: function that says what has failed, so that the nodes end; empty: nothing has.

    Returns:
        The exit status: 0, 1 if a node ended with a `failure` or the process lost a port of shared memory, or 2 with a
        message on stderr if the arguments cannot be used.
    """
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    provide_shared_memory()
    # The thread that receives messages asks the worker for the interpreter several times for each; Python has 5 ms.
    sys.setswitchinterval(5e-4)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        check_arguments(arguments)
        nodes = list[Node]()
        for make in makes:
            nodes.append(make())
            check_overrides(nodes[-1])
        prepare(nodes)
        for node in nodes:
            begin(node)
        executor = events_executor(nodes[0].context)
        for node in nodes:
            executor.add_node(node)
        lost = _spin(executor, nodes[0], stop, failure)
        for node in nodes:
            executor.remove_node(node)
            node.destroy_node()
        executor.shutdown()
    except (UserError, RCLError, ParameterException) as error:
        sys.stderr.write(f"{' '.join(str(error).split())}\n")
        return 2
    finally:
        rclpy.try_shutdown()
    return int(lost or any(getattr(node, "failure", "") for node in nodes))


def _spin(executor: Executor, node: Node, stop: threading.Event, failure: Callable[[], str]) -> bool:
    """Run callbacks until `stop` is set, or the process has lost a port or failed; returns whether it has."""
    ports, due = Ports(), 0.0
    while not stop.is_set():
        executor.spin_once(timeout_sec=0.1)
        if time.monotonic() < due:
            continue
        due = time.monotonic() + LOOK_S
        if lost := ports.lost():
            how = "The node ends; start it again, as `sal-height live --supervise` does."
            node.get_logger().error(f"{LOST.format(lost[0])} {how}")
            return True
        if said := failure():
            node.get_logger().error(f"Unexpected failure, please report it; the nodes end: {said}")
            return True
    return False
