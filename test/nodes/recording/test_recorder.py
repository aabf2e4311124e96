"""The recorder among real publishers: nothing lost, nothing changed, and the bag complete however it ends."""

from __future__ import annotations

import inspect
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import rclpy
from helpers import assert_one_sentence, file_size_limit, publisher_of
from mcap.reader import make_reader
from programs import RECORDER, Program
from rcl_interfaces.msg import Log, ParameterDescriptor
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from sal_height.bag.reader import BagReader
from sal_height.bag.salvage import recover
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import deserialize, serialize
from sal_height.messages.parameters import parameter_of
from sal_height.messages.types import (
    ChannelFrame,
    Clock,
    DiagnosticArray,
    DiagnosticStatus,
    NodeAccount,
    Odometry,
    ParameterEvent,
)
from sal_height.nodes.accounts.account import PROGRESS, Account
from sal_height.nodes.recording import parameter_reader
from sal_height.nodes.recording import recorder as module
from sal_height.nodes.recording.parameter_reader import ParameterReader
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.recording.subscribing import (
    IDLE_PERIOD_S,
    QUEUE_DEPTH,
    TAKE_PERIOD_S,
    Arrived,
    TimedLooks,
    in_order_of_arrival,
    replaces_messages,
)
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import LATCHED_QOS
from sal_height.runs.live.record import messages_left_out

TIMEOUT_S = 120.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def source(graph: Graph) -> Node:
    """Node to publish from."""
    return graph.add(Node("source", context=graph.context))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Folder for the bag, not made yet."""
    return tmp_path / "run"


def start(graph: Graph, bag: Path, **parameters: Any) -> Recorder:
    asked = {"node_parameters": False, **parameters}
    overrides = [Parameter(name, value=value) for name, value in asked.items()]
    return graph.add(Recorder(bag, context=graph.context, parameter_overrides=overrides))


def unspun(graph: Graph, bag: Path) -> Recorder:
    """A recorder of /note whose callbacks do not run; the topic has its publisher already."""
    assert graph.spin_until(lambda: graph.nodes[0].count_publishers("/note") == 1, TIMEOUT_S)
    overrides = [Parameter("topics", value=["/note"])]
    return Recorder(bag, context=graph.context, parameter_overrides=overrides)


def wait_until_matched(graph: Graph, *publishers: Publisher) -> None:
    assert graph.spin_until(lambda: all(p.get_subscription_count() == 1 for p in publishers), TIMEOUT_S)


def publish(graph: Graph, recorder: Recorder, publisher: Publisher, messages: list[Any]) -> None:
    """Publish and wait until the recorder has them."""
    topic = publisher.topic_name
    wait_until_matched(graph, publisher)
    goal = recorder.recorded[topic] + len(messages)
    for message in messages:
        publisher.publish(message)
    assert graph.spin_until(lambda: recorder.recorded[topic] >= goal, TIMEOUT_S), recorder.recorded


def written_texts(bag: Path) -> list[str]:
    """The texts in a complete bag, in the order in which they were written."""
    with (bag / "run_0.mcap").open("rb") as stream:
        written = [one.data for _, _, one in make_reader(stream).iter_messages(log_time_order=False)]
    return [str(deserialize_message(cdr, String).data) for cdr in written]


def test_every_message_is_recorded_byte_for_byte(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag)
    sent = [serialize_message(String(data="x" * i)) for i in range(50)]
    for cdr in sent:
        publish(graph, recorder, publisher, [cdr])
    graph.close()
    with Reader(bag) as foreign:
        assert [bytes(raw) for connection, _, raw in foreign.messages() if connection.topic == "/note"] == sent
    with (bag / "run_0.mcap").open("rb") as stream:
        times = [(m.publish_time, m.log_time) for _, _, m in make_reader(stream).iter_messages(["/note"])]
    assert all(0 <= received - published < 10**9 for published, received in times)


def test_bursts_of_large_frames_lose_nothing(graph: Graph, source: Node, bag: Path) -> None:
    publisher = publisher_of(source, ChannelFrame, "/phase_history", 32)
    recorder = start(graph, bag)
    frames = []
    for channel in range(16):
        frame = ChannelFrame(channel=channel, pulse_count=512, sample_count=512)
        frame.samples = np.full(8 * 512 * 512, channel, np.uint8)
        frames.append(serialize(frame))
    for _ in range(2):
        publish(graph, recorder, publisher, frames)
    graph.close()
    assert [message.cdr for message in BagReader(bag).messages(["/phase_history"])] == 2 * frames


def test_the_hash_in_the_bag_is_the_one_that_ros_announces(graph: Graph, source: Node, bag: Path) -> None:
    publisher = publisher_of(source, ChannelFrame, "/phase_history", 1)
    start(graph, bag)
    wait_until_matched(graph, publisher)
    (announced,) = source.get_publishers_info_by_topic("/phase_history")
    graph.close()
    assert BagReader(bag).topics["/phase_history"].definition.type_hash == str(announced.topic_type_hash)


def test_latched_messages_from_before_are_recorded_with_their_qos(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/sensor_info", LATCHED)
    publisher.publish(String(data="latched"))
    recorder = start(graph, bag)
    assert graph.spin_until(lambda: recorder.recorded.get("/sensor_info") == 1, TIMEOUT_S)
    graph.close()
    (profile,) = BagReader(bag).topics["/sensor_info"].offered_qos
    assert profile.durability == "transient_local"
    assert profile.reliability == "reliable"


def test_publishers_of_different_qos_are_all_recorded(graph: Graph, source: Node, bag: Path) -> None:
    profiles = (LATCHED, QoSProfile(depth=1), BEST_EFFORT)
    publishers = [source.create_publisher(String, "/mixed", profile) for profile in profiles]
    # The profile of the subscription is chosen once: all publishers must be known by then.
    assert graph.spin_until(lambda: len(source.get_publishers_info_by_topic("/mixed")) == 3, TIMEOUT_S)
    observer = graph.add(Node("observer", context=graph.context))
    assert graph.spin_until(lambda: len(observer.get_publishers_info_by_topic("/mixed")) == 3, TIMEOUT_S)
    recorder = start(graph, bag)
    wait_until_matched(graph, *publishers)
    for publisher in publishers:
        publish(graph, recorder, publisher, [String()])
    graph.close()
    topic = BagReader(bag).topics["/mixed"]
    assert topic.count == 3
    assert len(topic.offered_qos) == 3


def test_a_topic_that_comes_later_is_recorded_and_ros_own_ones_are_not(graph: Graph, source: Node, bag: Path) -> None:
    recorder = start(graph, bag)
    first = source.create_publisher(String, "/first", 1)
    publish(graph, recorder, first, [String(data="1")])
    second = publisher_of(source, Odometry, "/second", 1)
    publish(graph, recorder, second, [Odometry()])
    assert recorder.recorded["/first"] == recorder.recorded["/second"] == 1
    graph.close()
    assert set(BagReader(bag).topics) == {"/first", "/second", "/diagnostics"}


def test_only_the_topics_asked_for_are_recorded_by_their_full_names(graph: Graph, source: Node, bag: Path) -> None:
    wanted = [source.create_publisher(String, name, 1) for name in ("/sal/note", "/rosout_copy")]
    source.create_publisher(String, "/other", 1)
    overrides = [Parameter("topics", value=["note", "/rosout_copy"]), Parameter("node_parameters", value=False)]
    recorder = graph.add(Recorder(bag, context=graph.context, namespace="sal", parameter_overrides=overrides))
    for publisher in wanted:
        publish(graph, recorder, publisher, [String()])
    assert recorder.recorded == {"/sal/note": 1, "/rosout_copy": 1}


def test_topics_are_recorded_by_pattern_and_type(graph: Graph, source: Node, bag: Path) -> None:
    publishers = [source.create_publisher(String, name, 10) for name in ("/a/one", "/a/two", "/a/secret", "/b/one")]
    odometry = publisher_of(source, Odometry, "/somewhere/odometry", 10)
    recorder = start(graph, bag, patterns=["/a/.*"], types=["nav_msgs/msg/Odometry"], excluded=[".*secret"])
    wait_until_matched(graph, publishers[0], publishers[1], odometry)
    late = source.create_publisher(String, "/a/late", 10)
    wait_until_matched(graph, late)
    assert set(recorder.recorded) == {"/a/one", "/a/two", "/a/late", "/somewhere/odometry"}


def test_a_bag_is_cut_and_compressed_as_parameters_say(graph: Graph, source: Node, bag: Path) -> None:
    latched = source.create_publisher(String, "/info", LATCHED)
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, compression="zstd", split_mb=0.001, topics=["/info", "/note"])
    publish(graph, recorder, latched, [String(data="what is needed to read notes")])
    for number in range(3):
        publish(graph, recorder, publisher, [String(data=str(number) * 2_000_000 + str(os.urandom(2000)))])
    graph.close()
    files = sorted(bag.glob("*.mcap"))
    assert len(files) == 3
    assert max(file.stat().st_size for file in files) < 50_000
    for number, file in enumerate(files):
        texts = {m.topic: deserialize_message(m.cdr, String).data for m in BagReader(file).messages()}
        assert texts["/info"] == "what is needed to read notes"
        assert texts["/note"][0] == str(number)


def test_a_bag_is_cut_by_time_as_a_parameter_says(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, split_s=1e-9, topics=["/note"])
    for _ in range(2):
        publish(graph, recorder, publisher, [String()])
    graph.close()
    assert len(list(bag.glob("*.mcap"))) == 2


def test_the_directory_can_be_a_parameter(graph: Graph, bag: Path) -> None:
    recorder = Recorder(context=graph.context, parameter_overrides=[Parameter("directory", value=str(bag))])
    for name in ("directory", "topics"):
        descriptor = recorder.describe_parameter(name)
        assert descriptor.description
        assert descriptor.read_only
    recorder.destroy_node()
    assert BagReader(bag).message_count == 0


def test_a_recorder_that_is_started_again_begins_a_new_bag(graph: Graph, bag: Path) -> None:
    told = logged(graph, Log.INFO)
    for _ in range(3):
        Recorder(context=graph.context, parameter_overrides=[Parameter("directory", value=str(bag))]).destroy_node()
    folders = [bag, bag.with_name(f"{bag.name}_2"), bag.with_name(f"{bag.name}_3")]
    assert [BagReader(folder).message_count for folder in folders] == [0, 0, 0]
    assert sorted(bag.parent.iterdir()) == sorted(folders)
    wanted = f"{bag} contains a bag already; this one is {folders[2]}."
    assert graph.spin_until(lambda: wanted in told, TIMEOUT_S)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({}, "Parameter directory is empty"),
        ({"directory": 5}, "Parameter directory is 5; it must be a text"),
        ({"directory": "out", "topics": "/note"}, "Parameter topics is '/note'; it must be a list of texts"),
        ({"directory": "/"}, "is not empty"),
        ({"directory": "out", "topics": ["a b"]}, "Parameter topics has 'a b', which is no name of a topic"),
        ({"directory": "out", "patterns": ["*"]}, "which is no regular expression"),
    ],
)
def test_unusable_parameters_are_refused(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any], sentence: str
) -> None:
    monkeypatch.chdir(tmp_path)
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    with pytest.raises(UserError, match=sentence):
        Recorder(context=graph.context, parameter_overrides=overrides)
    assert not Path("out").exists()


def test_simulated_time_stamps_the_log(graph: Graph, source: Node, bag: Path) -> None:
    clock = publisher_of(source, Clock, "/clock", 1)
    recorder = start(graph, bag, use_sim_time=True, topics=["/note"])
    publisher = source.create_publisher(String, "/note", 1)
    wait_until_matched(graph, publisher)  # discovery goes on although this clock stands still
    publisher.publish(String(data="before the clock has begun"))
    assert graph.spin_until(lambda: recorder.topic_counts["/note"].received == 1, TIMEOUT_S)
    tick = Clock()
    tick.clock.sec = 42
    assert graph.spin_until(lambda: clock.get_subscription_count() == 1, TIMEOUT_S)
    clock.publish(tick)
    assert graph.spin_until(lambda: recorder.get_clock().now().nanoseconds == 42 * 10**9, TIMEOUT_S)
    publish(graph, recorder, publisher, [String()])
    graph.close()
    with (bag / "run_0.mcap").open("rb") as stream:
        times = [(message.log_time, message.publish_time) for _, _, message in make_reader(stream).iter_messages()]
    assert times == [(42 * 10**9, 42 * 10**9)] * 2


def test_messages_of_several_topics_are_written_in_the_order_of_their_arrival(
    graph: Graph, source: Node, bag: Path
) -> None:
    topics = [f"/note_{number}" for number in range(3)]
    publishers = [source.create_publisher(String, topic, 100) for topic in topics]
    recorder = start(graph, bag, topics=topics)
    wait_until_matched(graph, *publishers)
    for number in range(30):  # all have arrived before the recorder looks
        publishers[number * number % 3].publish(String(data=str(number)))
    assert all(one.wait_for_all_acked(Duration(seconds=TIMEOUT_S)) for one in publishers)
    assert graph.spin_until(lambda: sum(recorder.recorded.values()) == 30, TIMEOUT_S)
    graph.close()
    assert written_texts(bag) == [str(number) for number in range(30)]


def test_the_last_messages_are_written_in_the_order_of_their_arrival(graph: Graph, source: Node, bag: Path) -> None:
    """They have arrived, and the recorder ends before it looks."""
    publishers = [source.create_publisher(String, topic, 100) for topic in ("/a", "/b")]
    recorder = start(graph, bag, topics=["/a", "/b"])
    wait_until_matched(graph, *publishers)
    for number in range(10):
        publishers[number % 2].publish(String(data=str(number)))
    assert all(one.wait_for_all_acked(Duration(seconds=TIMEOUT_S)) for one in publishers)
    recorder.close_bag()
    assert written_texts(bag) == [str(number) for number in range(10)]


class Interrupted(Recorder):
    """A recorder that receives nothing further, after a first message, until `may_go_on` is set."""

    def __init__(self, **arguments: Any) -> None:
        self.may_go_on, self.at_work = Event(), Event()
        super().__init__(**arguments)

    def _receive(self, topic: str, info: dict[str, Any]) -> None:
        super()._receive(topic, info)
        self.at_work.set()
        assert self.may_go_on.wait(TIMEOUT_S)


def test_a_bag_that_is_closed_while_messages_are_received_has_them_all(graph: Graph, source: Node, bag: Path) -> None:
    """The context may be shut down in another thread than that which receives."""
    publisher = source.create_publisher(String, "/note", 100)
    parameters = [Parameter("topics", value=["/note"]), Parameter("node_parameters", value=False)]
    recorder = graph.add(Interrupted(directory=bag, context=graph.context, parameter_overrides=parameters))
    wait_until_matched(graph, publisher)
    for number in range(10):
        publisher.publish(String(data=str(number)))
    assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))

    def close() -> None:
        assert recorder.at_work.wait(TIMEOUT_S)
        ending = threading.Thread(target=recorder.close_bag)
        ending.start()
        assert recorder._ending.wait(TIMEOUT_S)
        ending.join(0.2)  # if it did not wait for the thread that receives, it would end
        recorder.may_go_on.set()
        ending.join()

    closing = threading.Thread(target=close)
    closing.start()
    assert graph.spin_until(lambda: not closing.is_alive(), TIMEOUT_S)
    assert written_texts(bag) == [str(number) for number in range(10)]


def test_a_message_that_was_sent_again_stays_before_those_that_followed_it() -> None:
    """Their publisher's numbers, out of order, would count losses."""

    def message(topic: str, number: int, received_ns: int) -> Arrived:
        return Arrived(topic, b"", {"received_timestamp": received_ns, "publication_sequence_number": number})

    sent_again = [message("/a", 1, 10), message("/a", 2, 40), message("/a", 3, 20)]
    others = [message("/b", 1, 5), message("/b", 2, 15), message("/b", 3, 50)]
    merged = list(in_order_of_arrival([sent_again, others]))
    assert [one for one in merged if one.topic == "/a"] == sent_again
    assert [one for one in merged if one.topic == "/b"] == others
    assert merged[:3] == [others[0], sent_again[0], others[1]]


@pytest.mark.parametrize("use_sim_time", [False, True])
def test_an_executor_waits_for_messages_only_if_their_time_is_that_of_a_callback(
    graph: Graph, source: Node, bag: Path, use_sim_time: bool
) -> None:
    source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, use_sim_time=use_sim_time, topics=["/note"])
    assert graph.spin_until(lambda: "/note" in recorder.recorded, TIMEOUT_S)
    assert ("/note" in {one.topic_name for one in recorder.subscriptions}) is use_sim_time


def test_the_recorder_looks_less_often_while_nothing_arrives(graph: Graph, source: Node) -> None:
    taken: list[bool] = [True]
    looks = TimedLooks(source, lambda: taken.append(taken[0]) or taken[0])  # type: ignore[func-returns-value]
    for arrives, period_s in ((True, TAKE_PERIOD_S), (False, IDLE_PERIOD_S), (True, TAKE_PERIOD_S)):
        taken[0], before = arrives, len(taken)
        assert graph.spin_until(lambda before=before: len(taken) > before + 21, TIMEOUT_S)  # type: ignore[misc]
        assert looks.period_s == pytest.approx(period_s)


class SlowDisk(Recorder):
    """A recorder whose disk stands still until `may_write` is set."""

    def __init__(self, **arguments: Any) -> None:
        self.may_write, self.at_work = Event(), Event()
        super().__init__(**arguments)

    def _write(self, topic: str, cdr: bytes, times: tuple[int, int]) -> None:
        self.at_work.set()
        assert self.may_write.wait(TIMEOUT_S)
        super()._write(topic, cdr, times)


def test_messages_that_wait_for_the_disk_are_bounded_by_memory(
    graph: Graph, source: Node, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left out is logged without a search for the line of the caller, in which more messages would be lost."""
    monkeypatch.delattr(inspect, "getframeinfo")
    warnings = logged(graph, Log.WARN)
    overrides = [Parameter("topics", value=["/note"]), Parameter("max_memory_mb", value=10)]
    recorder = graph.add(SlowDisk(directory=bag, context=graph.context, parameter_overrides=overrides))
    status: dict[str, str] = {}
    subscribe(source, DiagnosticArray, "/diagnostics", lambda message: status.update(values(message)), 10)
    publisher = source.create_publisher(String, "/note", 100)
    wait_until_matched(graph, publisher)
    for number in range(8):  # the first is at the disk, and of the others there is room for three
        publisher.publish(String(data=str(number) + "x" * 3_000_000))
        assert graph.spin_until(recorder.at_work.is_set, TIMEOUT_S)
    assert graph.spin_until(lambda: status.get("dropped.queue full") == "4", TIMEOUT_S), status
    assert status["level"] == str(DiagnosticStatus.ERROR)
    assert_one_sentence(status["last_drop"], "10 MB (max_memory_mb)")
    assert graph.spin_until(lambda: set(warnings) == {recorder.failure}, TIMEOUT_S), warnings
    recorder.may_write.set()
    assert graph.spin_until(lambda: recorder.recorded["/note"] == 4, TIMEOUT_S)
    publish(graph, recorder, publisher, [String(data="after")])
    assert recorder.dropped == 4
    graph.close()
    written = [deserialize_message(message.cdr, String).data[:1] for message in BagReader(bag).messages(["/note"])]
    assert written == ["0", "1", "2", "3", "a"]


def test_memory_is_given_back_until_the_end(graph: Graph, bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a thread of its own: the disk may make it wait, but not the one that writes, nor timers."""
    given: list[str] = []
    monkeypatch.setattr(BagWriter, "give_back", lambda _: given.append(threading.current_thread().name))
    recorder = start(graph, bag)
    assert graph.spin_until(lambda: len(given) > 3, TIMEOUT_S)
    recorder.close_bag()
    assert set(given) == {"give back"}
    assert "give back" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.parametrize(
    ("owner", "part"),
    [
        ("", "get_topic_names_and_types"),
        ("", "_times"),
        ("_account_publisher", "publish"),
        ("_bag", "flush"),
        ("_bag", "write"),
    ],
)
def test_an_error_in_a_callback_does_not_end_the_recorder(
    graph: Graph, source: Node, bag: Path, monkeypatch: pytest.MonkeyPatch, owner: str, part: str
) -> None:
    failed: list[str] = []

    def fail(*_: Any) -> None:
        failed.append(part)
        raise ZeroDivisionError(part)

    publisher = source.create_publisher(String, "/note", 1)
    recorder = start(graph, bag, topics=["/note", "/not_yet"])  # it goes on looking for the other
    wait_until_matched(graph, publisher)
    with monkeypatch.context() as broken:
        broken.setattr(getattr(recorder, owner, recorder), part, fail)
        publisher.publish(String(data="now"))
        assert graph.spin_until(lambda: bool(failed), TIMEOUT_S)
    publish(graph, recorder, publisher, [String(data="after")])
    assert recorder.failures == len(failed)
    assert recorder.unwritten == (1 if part == "write" else 0)


def test_what_is_in_the_bag_is_told_at_once_to_whoever_listens(
    graph: Graph, source: Node, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DIAGNOSTICS_PERIOD_S", 1000.0)
    publisher = source.create_publisher(String, "/note", 1)
    recorder = start(graph, bag, topics=["/note", PROGRESS])
    told: list[Account] = []
    subscribe(source, NodeAccount, PROGRESS, lambda message: told.append(Account.of_message(message)), 10)
    assert graph.spin_until(lambda: recorder._account_publisher.followers == 2, TIMEOUT_S)
    for number in (1, 2):
        publish(graph, recorder, publisher, [String()])
        assert graph.spin_until(lambda n=number: bool(told) and told[-1].recorded.get("note") == n, TIMEOUT_S)
    so_far = recorder.recorded[PROGRESS]
    assert not graph.spin_until(lambda: recorder.recorded[PROGRESS] > so_far + 1, 0.2), "accounts of accounts"


def test_the_times_of_transport_come_from_every_executor(graph: Graph, source: Node, bag: Path) -> None:
    """They are no later than now, and no earlier than the message."""
    publisher = source.create_publisher(String, "/note", 1)
    recorder = unspun(graph, bag)
    wait_until_matched(graph, publisher)
    executor, before = SingleThreadedExecutor(context=graph.context), time.time_ns()
    executor.add_node(recorder)
    publisher.publish(String())
    while not recorder.recorded["/note"] and time.time_ns() < before + TIMEOUT_S * 1e9:
        executor.spin_once(timeout_sec=0.1)
    executor.remove_node(recorder)
    recorder.destroy_node()
    executor.shutdown()
    with (bag / "run_0.mcap").open("rb") as stream:
        ((_, _, message),) = make_reader(stream).iter_messages()
    assert before <= message.publish_time <= message.log_time <= time.time_ns()


def test_a_bag_gets_no_times_before_1970(graph: Graph, bag: Path) -> None:
    """It cannot hold them, and a half-written message would make all of it unreadable."""
    received, published = start(graph, bag)._times({"received_timestamp": -5, "source_timestamp": -7})
    assert received == published > 0


def test_messages_that_wait_in_the_middleware_are_bounded(graph: Graph, source: Node, bag: Path) -> None:
    """The oldest are lost."""
    publisher = source.create_publisher(String, "/note", 5000)
    recorder = unspun(graph, bag)
    wait_until_matched(graph, publisher)
    for number in range(1100):
        publisher.publish(String(data=str(number)))
    assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))
    recorder.destroy_node()
    written = [deserialize_message(message.cdr, String).data for message in BagReader(bag).messages(["/note"])]
    assert written == [str(number) for number in range(100, 1100)]


def test_messages_that_wait_in_the_queue_are_written_before_the_bag_is_closed(
    graph: Graph, source: Node, bag: Path
) -> None:
    publisher = source.create_publisher(String, "/note", 100)
    recorder = unspun(graph, bag)
    wait_until_matched(graph, publisher)
    for i in range(100):
        publisher.publish(String(data=str(i)))
    assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))
    assert recorder.recorded["/note"] == 0
    recorder.destroy_node()
    assert BagReader(bag).topics["/note"].count == 100


def test_what_was_received_is_written_at_once_on_demand(
    graph: Graph, source: Node, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs in lockstep wait for it; the thread that writes waits for more messages."""
    monkeypatch.setattr(module, "GATHER_S", 3600.0)
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, topics=["/note"])
    wait_until_matched(graph, publisher)
    for number in range(5):
        publisher.publish(String(data=f"{number}"))
    assert graph.spin_until(lambda: recorder.topic_counts["/note"].received == 5, TIMEOUT_S)
    assert recorder.recorded["/note"] == 0
    recorder.write_received()
    assert recorder.recorded["/note"] == 5
    graph.close()
    assert [BagReader(bag).decode(one.type_name, one.cdr).data for one in BagReader(bag).messages(["/note"])] == [
        f"{number}" for number in range(5)
    ]


def test_a_bag_is_closed_while_somebody_has_what_waits_written(graph: Graph, source: Node, bag: Path) -> None:
    """Whoever closes it waits for the turn to write first and for the bag then, as all who write."""
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, topics=["/note"])
    wait_until_matched(graph, publisher)
    closing = threading.Thread(target=recorder.close_bag, daemon=True)
    writing = threading.Thread(target=recorder.write_received, daemon=True)

    def is_taken() -> bool:
        if is_free := recorder._turn.acquire(blocking=False):
            recorder._turn.release()
        return not is_free

    with recorder._lock:
        closing.start()
        recorder._worker.join(TIMEOUT_S)
        recorder._put("/note", serialize_message(String()), (1, 1))
        assert graph.spin_until(is_taken, TIMEOUT_S)
        writing.start()
    for thread in (closing, writing):
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()
    assert BagReader(bag).topics["/note"].count == 1


def test_the_bag_says_what_became_of_all_messages(
    graph: Graph, source: Node, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """500 are overwritten in the middleware by later ones, of which two find no memory."""
    publisher = source.create_publisher(String, "/note", QUEUE_DEPTH)
    other = source.create_publisher(String, "/other", 10)
    recorder = start(graph, bag, topics=["/note", "/other"])
    publish(graph, recorder, publisher, [String()])
    publish(graph, recorder, other, [String()])
    for _ in range(QUEUE_DEPTH + 500):
        publisher.publish(String())
    assert graph.spin_until(lambda: recorder.recorded["/note"] == 1 + QUEUE_DEPTH, TIMEOUT_S)
    assert "lost on the way" in recorder.failure  # the program ends with status 1
    monkeypatch.setattr(recorder, "_put_bytes", recorder._put_bytes + 10**12)  # much waits
    for _ in range(2):
        publisher.publish(String())
    assert graph.spin_until(lambda: recorder.dropped == 2, TIMEOUT_S)
    (status,) = recorder.diagnostics().status
    counts = {value.key: value.value for value in status.values}
    assert (counts["dropped.queue full"], counts["ignored.lost on the way"]) == ("2", "500")
    assert status.level == DiagnosticStatus.ERROR
    graph.close()
    with (bag / "run_0.mcap").open("rb") as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    account = {topic: json.loads(text) for topic, text in records["sal_height.account"].items()}
    left_out = {"lost on the way": 500, "queue full": 2}
    assert account == {
        "/note": {"received": 1003, "written": 1001, "left_out": left_out},
        "/other": {"received": 1, "written": 1, "left_out": {}},
    }
    assert messages_left_out(bag) == 502


def parameters_in(file: Path) -> dict[str, dict[str, Any]]:
    """What the parameter events of a bag amount to, by node."""
    known: dict[str, dict[str, Any]] = {}
    for message in BagReader(file).messages(["/parameter_events"]):
        event = deserialize(message.cdr, ParameterEvent)
        values = known.setdefault(event.node, {})
        for parameter in (*event.new_parameters, *event.changed_parameters):
            values[parameter.name] = Parameter.from_parameter_msg(parameter).value
        for parameter in event.deleted_parameters:
            del values[parameter.name]
    return known


def test_the_parameters_of_all_nodes_are_in_the_bag(graph: Graph, source: Node, bag: Path) -> None:
    """Of those that were there before the recorder, of those that come later, and all changes."""
    publisher = source.create_publisher(String, "/note", 10)
    source.declare_parameters("", [("before", 1.5), ("gone", "x", ParameterDescriptor(dynamic_typing=True))])
    recorder = start(graph, bag, topics=["/note"], node_parameters=True)
    publish(graph, recorder, publisher, [String()])

    def told(node: str) -> Callable[[], bool]:
        return lambda: node in recorder._reader._known

    assert graph.spin_until(told("/source"), TIMEOUT_S)
    late = graph.add(Node("late", namespace="left", context=graph.context))
    late.declare_parameter("names", ["a", "b"])
    assert graph.spin_until(told("/left/late"), TIMEOUT_S)
    source.set_parameters([Parameter("before", value=2.5)])
    source.set_parameters([Parameter("gone")])  # without a type: it is deleted
    known = recorder._reader._known
    assert graph.spin_until(
        lambda: "gone" not in {parameter.name for parameter in known["/source"].new_parameters}, TIMEOUT_S
    )
    graph.close()
    found = parameters_in(bag)
    assert found["/left/late"]["names"] == ["a", "b"]
    assert found["/source"]["before"] == 2.5
    assert "gone" not in found["/source"]
    assert "/recorder" not in found


def test_a_node_that_is_started_again_is_asked_again(graph: Graph, bag: Path) -> None:
    recorder = start(graph, bag, topics=["/note"], node_parameters=True)
    for value in (1, 2):
        node = graph.add(Node("one", context=graph.context))
        node.declare_parameter("value", value)

        def told(value: int = value) -> bool:
            known = recorder._reader._known.get("/one")
            return known is not None and any(p.value.integer_value == value for p in known.new_parameters)

        assert graph.spin_until(told, TIMEOUT_S)
        graph.executor.remove_node(node)
        graph.nodes.remove(node)
        node.destroy_node()
    graph.close()
    assert parameters_in(bag)["/one"]["value"] == 2


def test_every_file_of_a_bag_holds_the_parameters(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/note", 10)
    source.declare_parameter("before", 1.5)
    recorder = start(graph, bag, topics=["/note"], split_mb=0.001, node_parameters=True)
    assert graph.spin_until(lambda: "/source" in recorder._reader._known, TIMEOUT_S)
    source.set_parameters([Parameter("before", value=2.5)])
    for _ in range(3):
        publish(graph, recorder, publisher, [String(data="x" * 2_000_000)])
    graph.close()
    files = sorted(bag.glob("*.mcap"))
    assert len(files) == 3
    assert [parameters_in(file)["/source"]["before"] for file in files] == [2.5] * 3


@pytest.mark.usefixtures("source")
def test_a_node_that_answers_nonsense_costs_nothing(graph: Graph, bag: Path) -> None:
    """It has other values than names; another one does not know the names of its own."""
    strange = graph.add(Node("strange", context=graph.context, start_parameter_services=False))

    def names(_: Any, response: Any) -> Any:
        response.result.names = ["a", "b"]
        return response

    strange.create_service(ListParameters, "strange/list_parameters", names)
    strange.create_service(GetParameters, "strange/get_parameters", lambda _, response: response)
    recorder = start(graph, bag, topics=["/note"], node_parameters=True)
    known = recorder._reader._known
    assert graph.spin_until(lambda: {"/strange", "/source"} <= known.keys(), TIMEOUT_S)
    assert len(known["/strange"].new_parameters) == 0
    assert len(known["/source"].new_parameters) > 0
    assert recorder.failures == 0
    graph.close()


@pytest.mark.usefixtures("source")
def test_a_node_whose_answer_is_lost_is_asked_again(graph: Graph, bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lost: list[Any] = []
    take = parameter_reader._Question._take_names

    def lose_the_first(question: Any, answer: Any) -> None:
        take(question, answer) if question in lost else lost.append(question)

    monkeypatch.setattr(parameter_reader._Question, "_take_names", lose_the_first)
    monkeypatch.setattr(parameter_reader, "ANSWER_S", 0.5)
    recorder = start(graph, bag, topics=["/note"], node_parameters=True)
    assert graph.spin_until(lambda: "/source" in recorder._reader._known, TIMEOUT_S)
    assert len(lost) == 1
    graph.close()


@pytest.mark.usefixtures("source")
def test_a_node_is_asked_once_its_name_is_known(graph: Graph) -> None:
    """The middleware tells of a publisher before it tells of its node."""
    told: list[bytes] = []
    asker = graph.add(Node("asker", context=graph.context))
    found = asker.get_publishers_info_by_topic

    def without_names(topic: str) -> list[Any]:
        publishers = found(topic)
        for publisher in publishers:
            publisher.node_name, publisher.node_namespace = "_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_"
        return publishers

    reader = ParameterReader(asker, told.append, print)
    asker.get_publishers_info_by_topic = without_names
    assert graph.spin_until(lambda: len(found("/parameter_events")) == 2, TIMEOUT_S)
    reader.look()
    asker.get_publishers_info_by_topic = found
    assert graph.spin_until(lambda: reader.look() or bool(told), TIMEOUT_S)
    assert deserialize(told[0], ParameterEvent).node == "/source"


def test_no_more_is_held_of_parameters_than_a_node_has(monkeypatch: pytest.MonkeyPatch, graph: Graph) -> None:
    monkeypatch.setattr(parameter_reader, "MOST_BYTES", 1000)
    monkeypatch.setattr(parameter_reader, "MOST_NODES", 2)
    reader = ParameterReader(graph.add(Node("asker", context=graph.context)), print, print)

    def event(node: str, text: str) -> bytes:
        parameter = parameter_of("name", text)
        return serialize(ParameterEvent(node=node, new_parameters=[parameter]))

    assert [reader.take(event(name, "x")) is not None for name in ("/a", "/b", "/c")] == [True, True, False]
    assert reader.take(event("/a", "x" * 1000)) is None
    assert reader.take(b"no event") is None
    assert {name: known.new_parameters[0].value.string_value for name, known in reader._known.items()} == {
        "/a": "x",
        "/b": "x",
    }


def test_parameters_are_left_out_on_request(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, topics=["/note"], node_parameters=False)
    publish(graph, recorder, publisher, [String()])
    graph.close()
    assert set(BagReader(bag).topics) == {"/note"}


def test_shutting_the_context_down_completes_the_bag(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/note", 1)
    recorder = start(graph, bag)
    publish(graph, recorder, publisher, [String()])
    rclpy.shutdown(context=graph.context)
    assert BagReader(bag).topics["/note"].count == 1
    graph.close()


def test_messages_after_the_bag_was_closed_are_ignored(graph: Graph, source: Node, bag: Path) -> None:
    publisher = source.create_publisher(String, "/note", 1)
    recorder = start(graph, bag, topics=["/note"])
    publish(graph, recorder, publisher, [String()])
    recorder.close_bag()
    publisher.publish(String())
    assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))
    handled: list[str] = []
    source.create_timer(0.0, lambda: handled.append("later"))
    assert graph.spin_until(lambda: len(handled) > 10, TIMEOUT_S)
    assert recorder.recorded == {"/note": 1}
    assert BagReader(bag).message_count == 1


def test_what_was_recorded_can_be_salvaged_while_the_recorder_runs(
    graph: Graph, source: Node, bag: Path, tmp_path: Path
) -> None:
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, topics=["/note"])
    publish(graph, recorder, publisher, [String(data=str(i)) for i in range(5)])
    file = bag / "run_0.mcap"
    size = file.stat().st_size
    assert graph.spin_until(lambda: file.stat().st_size > size, TIMEOUT_S), "flushed at regular times"
    assert recover(bag, tmp_path / "saved").count == 5


def test_a_type_that_is_not_installed_is_left_out(
    graph: Graph, source: Node, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    warnings = logged(graph, Log.WARN)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    source.create_publisher(String, "/note", 1)
    recorder = start(graph, bag)
    assert graph.spin_until(
        lambda: any("Topic /note is not recorded. Message type" in text for text in warnings), TIMEOUT_S
    )
    assert recorder.recorded.keys() <= {"/diagnostics"}, "whose definition comes with the program"
    graph.close()
    assert "/note" not in BagReader(bag).topics


def test_a_full_disk_is_reported_once_and_the_node_lives_on(
    graph: Graph, source: Node, bag: Path, tmp_path: Path
) -> None:
    errors = logged(graph, Log.ERROR)
    status: dict[str, str] = {}
    subscribe(source, DiagnosticArray, "/diagnostics", lambda message: status.update(values(message)), 10)
    publisher = source.create_publisher(String, "/note", 10)
    recorder = start(graph, bag, topics=["/note"])
    message = String(data="x" * 2**20)
    publish(graph, recorder, publisher, [message])
    assert graph.spin_until(lambda: status.get("recorded./note") == "1", TIMEOUT_S)
    assert (status["unwritten"], status["level"]) == ("0", str(DiagnosticStatus.OK))
    with file_size_limit(8 * 2**20):
        for received in range(2, 22):
            publisher.publish(message)
            assert graph.spin_until(
                lambda received=received: recorder.recorded["/note"] + recorder.unwritten == received, TIMEOUT_S
            )
    assert graph.spin_until(lambda: bool(errors), TIMEOUT_S)
    graph.executor.spin_once(timeout_sec=0.1)
    assert len(errors) == 1
    assert "File too large" in errors[0]
    assert recorder.unwritten >= 12
    assert graph.spin_until(lambda: status["unwritten"] == str(recorder.unwritten), TIMEOUT_S)
    assert status["level"] == str(DiagnosticStatus.ERROR)
    recorded = recorder.recorded["/note"]
    graph.close()
    assert recorded - 1 <= recover(bag, tmp_path / "saved").count <= recorded


def values(message: DiagnosticArray) -> dict[str, str]:
    """Level and values of the one status in the message."""
    (status,) = message.status
    return {"level": str(status.level)} | {entry.key: entry.value for entry in status.values}


def logged(graph: Graph, level: int) -> list[str]:
    """Texts that nodes of the graph log at `level` from now on."""
    texts: list[str] = []
    listener = graph.add(Node("listener", context=graph.context))
    listener.create_subscription(
        Log,
        "/rosout",
        lambda log: texts.append(log.msg) if log.level == level else None,
        QoSProfile(depth=100),
    )
    return texts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_program_with_a_complete_bag(
    graph: Graph, source: Node, bag: Path, domain_id: int, number: signal.Signals
) -> None:
    publisher = source.create_publisher(String, "/note", 100)
    process = run_main("--ros-args", "-p", f"directory:={bag}", domain_id=domain_id)
    wait_until_matched(graph, publisher)
    for i in range(100):
        publisher.publish(String(data=str(i)))
    assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S))
    process.send_signal(number)
    process.send_signal(number)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, errors) == (0, "")
    assert BagReader(bag).topics["/note"].count == 100


def test_the_program_ends_with_status_2_and_one_sentence_without_a_directory(domain_id: int) -> None:
    process = run_main(domain_id=domain_id)
    _, errors = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 2
    assert errors == "Parameter directory is empty; it must name a new folder for the bag.\n"


def run_main(*arguments: str, domain_id: int) -> Program:
    return Program(RECORDER, "recorder", *arguments, domain_id=domain_id)


@pytest.mark.parametrize(
    ("profiles", "replaces"),
    [
        ([LATCHED_QOS], True),
        (
            [QoSProfile(history=HistoryPolicy.UNKNOWN, depth=0, durability=DurabilityPolicy.TRANSIENT_LOCAL)],
            True,
        ),  # no depth is told
        ([QoSProfile(depth=9, durability=DurabilityPolicy.TRANSIENT_LOCAL)], False),
        ([LATCHED_QOS, QoSProfile(depth=1)], False),
    ],
)
def test_only_the_last_message_of_a_publisher_that_keeps_one_replaces_others(
    profiles: list[QoSProfile], replaces: bool
) -> None:
    assert replaces_messages(profiles) is replaces
