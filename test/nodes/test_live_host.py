"""The program `live_host`: nodes in one process that are named, remapped and set as the arguments say."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from programs import PROCESSING, Program
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from sal_height.nodes.transport.graph import Graph

LIVE_HOST = "sal_height.nodes.live_host"

TIMEOUT_S = 120.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "Name the nodes to run, each once"),
        (["ml_height", "ml_height"], "Name the nodes to run, each once"),
        (["recorder"], "'recorder' is not NODE or NODE=KIND; KIND is one of navigation, sar_compression"),
        (["two words=ml_height"], "'two words=ml_height' is not NODE or NODE=KIND"),
        (["ml_height", "--ros-args", "-p", "wors:=3"], "Node ml_height has no parameter 'wors'"),
    ],
)
def test_what_cannot_be_run_is_refused_with_one_message(words: list[str], said: str, domain_id: int) -> None:
    program = Program(LIVE_HOST, "live_host", *words, domain_id=domain_id)
    _, errors = program.communicate(timeout=TIMEOUT_S)
    assert program.returncode == 2
    assert said in errors
    assert "Traceback" not in errors


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="this system has no such scheduling")
@pytest.mark.parametrize(
    ("module", "words"), [("sal_height.nodes.live_host", ["live_host", "ml_height"]), (PROCESSING, ["ml_height"])]
)
def test_programs_of_nodes_do_not_preempt_others_when_messages_arrive(
    module: str, words: list[str], graph: Graph, domain_id: int
) -> None:
    program = Program(module, *words, domain_id=domain_id)
    assert graph.spin_until(lambda: os.sched_getscheduler(program.pid) == os.SCHED_BATCH, TIMEOUT_S)
    program.kill()


def test_help_says_how_nodes_are_named() -> None:
    command = [sys.executable, "-m", LIVE_HOST, "--help"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=True)  # noqa: S603 (ours)
    assert "coarse=ml_height" in done.stdout
    assert "KIND is one of navigation, sar_compression" in done.stdout


def test_two_nodes_of_a_kind_have_names_topics_and_parameters_of_their_own(graph: Graph, domain_id: int) -> None:
    names = ["sar_compression", "ml_height", "coarse=ml_height", "relief_tracker"]
    rules = ["-r", "coarse:ml/height:=coarse/height", "-p", "coarse:range_looks:=5"]
    program = Program(LIVE_HOST, "live_host", *names, "--ros-args", *rules, domain_id=domain_id)
    client = graph.add(Node("client", context=graph.context))

    def looks_of(node: str) -> Any:
        service = client.create_client(GetParameters, f"/{node}/get_parameters")
        assert graph.spin_until(service.service_is_ready, TIMEOUT_S)
        answer = service.call_async(GetParameters.Request(names=["range_looks"]))
        assert graph.spin_until(answer.done, TIMEOUT_S)
        return answer.result().values[0].integer_value

    def until(condition: Callable[[], bool]) -> None:
        assert graph.spin_until(lambda: condition() or program.poll() is not None, TIMEOUT_S)
        assert condition()

    try:
        topics = ("/ml/height", "/coarse/height", "/slc", "/tracked/height")
        until(lambda: all(client.count_publishers(one) == 1 for one in topics))
        until(lambda: client.count_subscribers("/phase_history") == 1)
        # What a node of the same process publishes is handed over as it is.
        until(lambda: not any(client.count_subscribers(one) for one in topics))
        assert (looks_of("coarse"), looks_of("ml_height") != 5) == (5, True)
    finally:
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=TIMEOUT_S)
    assert program.returncode == 0, errors
    assert "Traceback" not in errors
