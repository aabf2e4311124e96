"""What every processing node does: no callback ends it, it says how it is, and its queues are bounded."""

from __future__ import annotations

import inspect
import os
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from helpers import make_sensor, publisher_of
from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

from sal_height import messages
from sal_height.errors import Rejected, UserError
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, KeyValue, NodeAccount, Odometry, SensorInfo
from sal_height.nodes import worker
from sal_height.nodes.accounts.account import DIAGNOSTICS, PROGRESS, Account
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport import log
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.log import log_warning
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.nodes.transport.services import ENDING
from sal_height.nodes.worker import WorkerNode

TIMEOUT_S = 120.0


class Listening(WorkerNode):
    """A stage that keeps the words it hears, in order, on its worker."""

    def __init__(self, graph: Graph) -> None:
        super().__init__("listening", context=graph.context)
        self.words: list[str] = []
        self.failing = True
        self.listen(KeyValue, "words", self._on_word)
        graph.add(self)

    def _on_word(self, message: KeyValue) -> None:
        self.tally.receive()
        self.submit(1, lambda: self._keep(message.value))

    def _keep(self, word: str) -> int:
        self.words.append(word)
        return 1

    def fail(self) -> tuple[bool, str]:
        if self.failing:
            raise ZeroDivisionError
        return True, "done"


@pytest.fixture
def listening(graph: Graph) -> Listening:
    return Listening(graph)


def ignored(node: WorkerNode) -> int:
    return int(node.tally.summary().get("ignored.internal error", 0))


def test_an_error_in_a_timer_does_not_end_the_node_nor_the_timer(graph: Graph, listening: Listening) -> None:
    listening.every(0.001, listening.fail)
    assert graph.spin_until(lambda: ignored(listening) >= 2, TIMEOUT_S)
    assert "ZeroDivisionError" in listening.last_rejection


def test_an_error_in_a_subscription_does_not_end_the_node(graph: Graph, listening: Listening) -> None:
    def refuse(_: KeyValue) -> None:
        raise ZeroDivisionError

    listening.listen(KeyValue, "numbers", refuse)
    publisher = publisher_of(graph.add(Node("source", context=graph.context)), KeyValue, "numbers", FRAMES_QOS)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, TIMEOUT_S)
    for number in range(1, 3):
        publisher.publish(KeyValue())
        assert graph.spin_until(lambda n=number: ignored(listening) == n, TIMEOUT_S)


@pytest.mark.parametrize("is_long", [False, True])
def test_an_error_in_a_service_is_answered_and_does_not_end_the_node(
    is_long: bool, graph: Graph, listening: Listening
) -> None:
    listening.serve("~/do", (lambda: listening.promise(listening.fail)) if is_long else listening.fail)
    client = graph.add(Node("asking", context=graph.context)).create_client(Trigger, "/listening/do")
    assert graph.spin_until(client.service_is_ready, TIMEOUT_S)
    answers = []
    for listening.failing in (True, False):
        answer = client.call_async(Trigger.Request())
        assert graph.spin_until(answer.done, TIMEOUT_S)
        answers.append((answer.result().success, answer.result().message))
    assert answers == [(False, "internal error; the log of the node says more"), (True, "done")]
    counted = listening.tally.summary()
    assert counted.get("dropped.internal error" if is_long else "ignored.internal error") == (0 if is_long else 1)


def test_a_warning_is_logged_without_a_search_for_the_line_of_the_caller(
    listening: Listening, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """All modules would be searched for it, for 300 ms."""

    def search(*_: Any) -> None:
        raise AssertionError("a caller is searched for")

    monkeypatch.setattr(inspect, "getframeinfo", search)
    listening.tally.receive()
    listening.reject(1, Rejected("overload", "It was late."))
    listening.get_logger().set_level(LoggingSeverity.ERROR)
    log_warning(listening, "This is not logged.")
    listening.get_logger().set_level(LoggingSeverity.UNSET)  # for nodes of that name that other tests make
    logged = capfd.readouterr().err
    assert "[WARN]" in logged
    assert logged.strip().endswith("[listening]: Dropped 1 (overload): It was late.")


def test_many_warnings_are_logged_and_published_once_in_a_second(
    graph: Graph, listening: Listening, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[Log] = []
    observer = graph.add(Node("observer", context=graph.context))
    rosout = observer.create_subscription(Log, "/rosout", published.append, QoSProfile(depth=100))
    assert graph.spin_until(lambda: rosout.get_publisher_count() >= 2, TIMEOUT_S)
    clock = iter([100.0, 100.0, 100.9, 101.1, 101.1])
    monkeypatch.setattr(log, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    for number in range(3):
        listening.ignore("note", UserError(f"Note {number}, 100 % of it, is not right."))
    warnings = [f"Ignored note: Note {number}, 100 % of it, is not right." for number in (0, 2)]
    assert graph.spin_until(lambda: len(published) == 2, TIMEOUT_S)
    assert [one.msg for one in published] == warnings
    assert {(one.name, one.level) for one in published} == {("listening", int(LoggingSeverity.WARN))}


def test_whoever_waits_for_a_node_that_ends_is_answered(graph: Graph, listening: Listening) -> None:
    going = threading.Event()
    listening.serve("~/do", lambda: listening.promise(listening.fail))
    client = graph.add(Node("asking", context=graph.context)).create_client(Trigger, "/listening/do")
    assert graph.spin_until(client.service_is_ready, TIMEOUT_S)
    listening.submit(0, lambda: int(not going.wait(TIMEOUT_S)))
    answer = client.call_async(Trigger.Request())
    assert graph.spin_until(lambda: listening.jobs == 2, TIMEOUT_S)
    graph.nodes.remove(listening)
    graph.executor.remove_node(listening)
    ended = threading.Thread(target=listening.destroy_node)
    ended.start()
    is_answered = graph.spin_until(answer.done, TIMEOUT_S)
    going.set()
    ended.join()
    assert is_answered
    assert (answer.result().success, answer.result().message) == ENDING
    assert listening.promise(listening.fail).result(timeout=0.0) == ENDING


def test_an_error_in_a_job_costs_its_messages_only(graph: Graph, listening: Listening) -> None:
    def fail() -> int:
        raise ZeroDivisionError

    for _ in range(3):
        listening.tally.receive()
    listening.submit(2, fail)
    listening.submit(1, lambda: listening._keep("after"))
    assert graph.spin_until(lambda: listening.words == ["after"] and not listening.jobs, TIMEOUT_S)
    summary = listening.tally.summary()
    assert (summary["dropped.internal error"], summary["processed"], summary["waiting"]) == (2, 1, 0)


def test_what_comes_while_the_node_ends_is_counted(listening: Listening) -> None:
    listening.finish()
    listening.finish()
    listening.tally.receive()
    listening.submit(1, lambda: listening._keep("late"))
    assert listening.tally.summary()["dropped.ended"] == 1
    assert listening.words == []


@pytest.mark.parametrize(("qos", "depth"), [(FRAMES_QOS, 256), (ODOMETRY_QOS, 5000)])
def test_messages_that_wait_in_the_middleware_are_bounded(
    graph: Graph, listening: Listening, qos: QoSProfile, depth: int
) -> None:
    """What the node has not taken yet when more come than the depth of the queue is lost, the oldest first."""
    heard: list[int] = []
    listening.listen(KeyValue, "numbers", lambda message: heard.append(int(message.value)), qos)
    source = graph.add(Node("source", context=graph.context))
    publisher = publisher_of(source, KeyValue, "numbers", qos)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, TIMEOUT_S)
    assert graph.spin_until(lambda: listening.count_publishers("numbers") == 1, TIMEOUT_S)
    last = depth + 150
    for number in range(last + 1):
        publisher.publish(KeyValue(value=str(number)))
    assert graph.spin_until(lambda: heard[-1:] == [last], TIMEOUT_S)
    assert len(heard) <= depth + 1


def test_of_a_latched_topic_only_the_last_message_is_kept(graph: Graph, listening: Listening) -> None:
    outlet = listening.offer(KeyValue, "state", LATCHED_QOS)
    for number in range(3):
        outlet.publish(KeyValue(value=str(number)))
    heard: list[str] = []
    late = graph.add(Node("late", context=graph.context))
    deep = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscribe(late, KeyValue, "state", lambda message: heard.append(message.value), deep)
    assert graph.spin_until(lambda: heard[-1:] == ["2"], TIMEOUT_S)
    assert heard == ["2"]


def state(graph: Graph, node: WorkerNode) -> Any:
    """The level, message and hardware that the node publishes next."""
    seen: list[DiagnosticStatus] = []
    watcher = graph.add(Node("watcher", context=graph.context))
    subscribe(watcher, DiagnosticArray, "/diagnostics", lambda message: seen.extend(message.status), 10)
    assert graph.spin_until(lambda: bool(seen), TIMEOUT_S)
    return seen[-1].level, seen[-1].message, seen[-1].hardware_id, node.get_name() == seen[-1].name


@pytest.fixture
def told(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Account]]:
    """The accounts that come on each topic, where none comes just because it is time."""
    monkeypatch.setattr(worker, "DIAGNOSTICS_PERIOD_S", 1000.0)
    accounts: dict[str, list[Account]] = {DIAGNOSTICS: [], PROGRESS: []}
    watcher = graph.add(Node("watcher", context=graph.context))
    on_diagnostics, on_progress = accounts.values()
    subscribe(
        watcher, DiagnosticArray, DIAGNOSTICS, lambda m: on_diagnostics.extend(map(Account.of_status, m.status)), 100
    )
    subscribe(
        watcher,
        NodeAccount,
        PROGRESS,
        lambda m: on_progress.append(Account.of_message(m)),
        100,
    )
    return accounts


def test_progress_is_made_only_while_somebody_subscribes(
    graph: Graph, listening: Listening, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Account] = []
    make = Account.to_progress
    monkeypatch.setattr(
        Account, "to_progress", lambda self, node, stamp_ns: made.append(self) or make(self, node, stamp_ns)
    )
    listening.tell("something")
    assert not made
    follower, followed = graph.add(Node("follower", context=graph.context)), list[NodeAccount]()
    subscribe(follower, NodeAccount, PROGRESS, followed.append, 100)
    assert graph.spin_until(lambda: bool(followed), TIMEOUT_S)
    assert made


def test_progress_is_told_at_once_to_whoever_listens(graph: Graph, told: dict[str, list[Account]]) -> None:
    listening = Listening(graph)
    assert graph.spin_until(lambda: all(told.values()), TIMEOUT_S)
    for number in range(1, 4):
        listening.tally.receive()
        listening.submit(1, lambda: 0)
        assert graph.spin_until(lambda n=number: told[PROGRESS][-1].processed == n, TIMEOUT_S)
    assert told[DIAGNOSTICS][-1].processed == 0
    assert told[PROGRESS][-1].numbers.keys() > told[DIAGNOSTICS][-1].numbers.keys()  # of which it was told nothing new


def test_subscribers_are_told_of_at_once(graph: Graph, told: dict[str, list[Account]]) -> None:
    """Whoever waits until a graph is connected need not wait for the next account."""
    Listening(graph).offer(KeyValue, "answers")
    assert graph.spin_until(lambda: all(told.values()), TIMEOUT_S)
    other = graph.add(Node("other", context=graph.context))
    for number in (1, 2):
        subscribe(other, KeyValue, "answers", lambda _: None, FRAMES_QOS)
        assert graph.spin_until(
            lambda n=number: all(those[-1].subscribers == {"answers": n, "losses": 0} for those in told.values()),
            TIMEOUT_S,
        )


@pytest.mark.parametrize("node", [PROCESSING["sar_compression"], PROCESSING["ml_height"], PROCESSING["relief_mapper"]])
def test_work_gives_way_as_its_node_says(graph: Graph, node: type[WorkerNode]) -> None:
    """Compression to the nodes after it, and to the thread that receives frames; the map to all that is late sooner."""
    made, found = graph.add(node(context=graph.context)), []

    def look() -> int:
        found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
        return 0

    made.submit(0, look)
    assert graph.spin_until(lambda: bool(found), TIMEOUT_S)
    assert found == [os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) + node.niceness]
    assert (
        PROCESSING["relief_mapper"].niceness > PROCESSING["sar_compression"].niceness > PROCESSING["ml_height"].niceness
    )


def test_a_node_is_ready_while_its_topics_have_publishers_and_says_so_at_once(
    graph: Graph, told: dict[str, list[Account]]
) -> None:
    """A message to a subscription that does not know of its publisher yet may take seconds."""
    Listening(graph)
    other = graph.add(Node("other", context=graph.context))
    assert graph.spin_until(lambda: all(told.values()), TIMEOUT_S)
    assert not any(those[-1].ready for those in told.values())
    publisher = publisher_of(other, KeyValue, "words", FRAMES_QOS)
    assert graph.spin_until(lambda: all(those[-1].ready for those in told.values()), TIMEOUT_S)
    other.destroy_publisher(publisher._publisher)
    assert graph.spin_until(lambda: not any(those[-1].ready for those in told.values()), TIMEOUT_S)


def test_what_is_done_without_messages_is_told_at_once(graph: Graph, told: dict[str, list[Account]]) -> None:
    """As that a node is ready."""
    listening = Listening(graph)
    publisher_of(graph.add(Node("other", context=graph.context)), KeyValue, "words", FRAMES_QOS)
    assert graph.spin_until(lambda: all(those and those[-1].ready for those in told.values()), TIMEOUT_S)
    listening.submit(0, lambda: setattr(Listening, "is_ready", False) or 0)
    try:
        assert graph.spin_until(lambda: not any(those[-1].ready for those in told.values()), TIMEOUT_S)
    finally:
        del Listening.is_ready


def test_a_node_that_gets_nothing_is_stale_and_says_what_it_waits_for(graph: Graph) -> None:
    node = graph.add(PROCESSING["ml_height"](context=graph.context))
    assert state(graph, node) == (DiagnosticStatus.STALE, "waiting for /sensor_info, /slc", "", True)
    source = graph.add(Node("source", context=graph.context))
    publisher = publisher_of(source, SensorInfo, "sensor_info", LATCHED_QOS)
    publisher.publish(messages.sensor_to_message(make_sensor(), messages.to_stamp(0)))
    assert graph.spin_until(lambda: node.hardware_id == "test" and not node.jobs, TIMEOUT_S)
    node._inlets_of["slc"].heard_at = time.monotonic()
    assert state(graph, node) == (DiagnosticStatus.OK, "processing", "test", True)


def test_a_topic_that_is_published_in_another_namespace_is_named(graph: Graph, listening: Listening) -> None:
    others = graph.add(Node("source", namespace="radar", context=graph.context))
    publisher_of(others, KeyValue, "words", FRAMES_QOS)
    publisher_of(others, KeyValue, "other_words", FRAMES_QOS)
    assert graph.spin_until(lambda: listening.count_publishers("/radar/words") == 1, TIMEOUT_S)
    said = "waiting for /words (there is /radar/words: is the namespace right?)"
    assert state(graph, listening)[:2] == (DiagnosticStatus.STALE, said)
    publisher_of(others, KeyValue, "/words", FRAMES_QOS)
    assert graph.spin_until(lambda: listening.is_ready, TIMEOUT_S)
    assert state(graph, listening)[:2] == (DiagnosticStatus.STALE, "waiting for /words")


def test_two_sources_of_odometry_are_named(graph: Graph) -> None:
    node = graph.add(PROCESSING["sar_compression"](context=graph.context))
    sources = [graph.add(Node(name, context=graph.context)) for name in ("one", "other")]
    publishers = [publisher_of(source, Odometry, "platform/odometry", ODOMETRY_QOS) for source in sources]
    assert graph.spin_until(lambda: bool(node.source_warning), TIMEOUT_S)
    level, message, *_ = state(graph, node)
    assert level == DiagnosticStatus.WARN
    assert message == "2 nodes publish /platform/odometry: stop all but one. 0 dropped or ignored in all"
    sources[1].destroy_publisher(publishers[1]._publisher)
    assert graph.spin_until(lambda: not node.source_warning, TIMEOUT_S)
    assert state(graph, node)[0] == DiagnosticStatus.STALE


def test_the_level_tells_of_the_last_seconds_and_the_counts_of_all_time(
    graph: Graph, listening: Listening, monkeypatch: pytest.MonkeyPatch
) -> None:
    listening._inlets[0].heard_at = time.monotonic()
    listening.ignore("word", UserError("A word is wrong."))
    assert state(graph, listening)[:2] == (
        DiagnosticStatus.WARN,
        "1 dropped or ignored in all, last word: A word is wrong.",
    )
    monkeypatch.setattr(worker, "RECENT_S", 0.0)
    monkeypatch.setattr(listening._inlets[0], "latched", True)
    assert state(graph, listening)[:2] == (DiagnosticStatus.OK, "processing")
    assert listening.tally.summary()["ignored.word"] == 1


def test_what_speaks_against_dwells_is_logged_once_and_counted_each_time(
    listening: Listening, capfd: pytest.CaptureFixture[str]
) -> None:
    for dwell in range(3):
        listening.doubt("odometry", UserError(f"Dwell {dwell}: nobody knows."))
        listening.doubt("noise level", UserError(f"Dwell {dwell}: too loud."))
    logged = [line for line in capfd.readouterr().err.splitlines() if "[listening]" in line]
    assert [line.partition("]: ")[2].partition(" (")[0] for line in logged] == [
        "Dwell 0: nobody knows.",
        "Dwell 0: too loud.",
    ]
    summary = listening.tally.summary()
    assert (summary["ignored.odometry"], summary["ignored.noise level"]) == (3, 3)
