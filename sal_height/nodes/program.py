"""A node as a program of its own, which the console scripts run."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from sal_height.errors import UserError
from sal_height.nodes.accounts.usage import announce, check_arguments, check_overrides, program_name, usage
from sal_height.nodes.transport.domain import LOOK_S, LOST, Ports
from sal_height.nodes.transport.executors import executor_for
from sal_height.nodes.transport.middleware import provide_shared_memory


def run_node(make: type[Node], begin: Callable[[Node], None] = announce) -> int:
    """Run one node until SIGINT or SIGTERM, or print what it does if --help is asked for.

    A signal only ends the loop, so that it can cut neither a message nor the node's end.

    Args:
        make: class of the node.
        begin: function that is called with the node once it is made.

    Returns:
        The exit status: 0, 1 if the node ended with a `failure` or lost a port of shared memory, or 2 with a message
        on stderr if the arguments cannot be used.
    """
    if {"--help", "-h"} & set(sys.argv[1:]):
        sys.stdout.write(usage(make, program_name()))
        return 0
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    provide_shared_memory()
    # Longest time for which the worker keeps the interpreter from the thread that receives messages, s; 5 ms in Python
    # otherwise: it asks for it several times for every message.
    switch_interval_s = 5e-4
    sys.setswitchinterval(switch_interval_s)
    try:
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        check_arguments(sys.argv)
        node = make()
        check_overrides(node)
        begin(node)
        executor = executor_for(node)
        lost = _spin(executor, node, stop)
        executor.remove_node(node)
        node.destroy_node()
        executor.shutdown()
    except (UserError, RCLError, ParameterException) as error:
        sys.stderr.write(f"{' '.join(str(error).split())}\n")
        return 2
    finally:
        rclpy.try_shutdown()
    return int(lost or bool(getattr(node, "failure", "")))


def _spin(executor: Executor, node: Node, stop: threading.Event) -> bool:
    """Run callbacks until `stop` is set or the process has lost a port; returns whether it has."""
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
    return False
