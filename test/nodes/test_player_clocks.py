"""The player at the pace of the sensor and as fast as it can: the order, the time on /clock, and where it waits."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from played_bag import TIMEOUT_S, Listener, bag, odometry, played, player_of
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from written_bag import calibration, frame, key

from sal_height import messages
from sal_height.bag.reader import BagMessage
from sal_height.graph.plan import DwellChanges
from sal_height.messages.types import ChannelFrame, Clock
from sal_height.nodes.playing.player import PacedPlayer, Player
from sal_height.nodes.playing.playlist import PERIOD_S, SimulatedClock
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS

LEAST_CLOCK_HZ = 40.0
"""Messages on /clock in a second that docs/replay.md promises."""


class Event(NamedTuple):
    """What was published: a time on /clock, or a message that was due at a time; s."""

    kind: str
    time_s: float
    wall_s: float


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[Event]:
    """What the player and its clock publish, in this order."""
    told: list[Event] = []
    publish, tell = Player._publish, SimulatedClock._publish

    def noted_publish(self: Player, recorded: BagMessage) -> None:
        publish(self, recorded)
        told.append(Event("message", recorded.log_time_ns / 1e9, time.monotonic()))

    def noted_tell(self: SimulatedClock, time_ns: int) -> None:
        told.append(Event("clock", max(time_ns, self._published_ns) / 1e9, time.monotonic()))
        tell(self, time_ns)

    monkeypatch.setattr(Player, "_publish", noted_publish)
    monkeypatch.setattr(SimulatedClock, "_publish", noted_tell)
    return told


def flight(dwells: int) -> list[Any]:
    """Odometry every tenth of a second, and dwells of two channels every second, from 10 s on."""
    samples = [odometry(10 + n / 10) for n in range(10 * dwells + 1)]
    return [*samples, *(frame(10 + dwell, channel) for dwell in range(dwells) for channel in (0, 1))]


def play(graph: Graph, player: Player) -> None:
    assert graph.spin_until(lambda: player.is_ready, TIMEOUT_S)
    while player.step()[0]:
        assert graph.spin_until(lambda: not player.jobs, TIMEOUT_S)


@pytest.mark.parametrize("rate", [2.0, 10.0])
def test_messages_come_at_their_times_beside_the_clock(
    rate: float, graph: Graph, tmp_path: Path, events: list[Event]
) -> None:
    """The clock never passes what has not been published, nor runs back, and tells 40 times or more in a second."""
    heard: list[int] = []
    listener = graph.add(Listener(context=graph.context))
    subscribe(listener, Clock, "/clock", lambda m: heard.append(m.clock.sec), 10)
    player = player_of(graph, bag(tmp_path / "bag", flight(4)), clock="paced", rate=rate)
    assert events[0][:2] == ("clock", 10.0)  # tells the time before anything is played
    del events[:]
    play(graph, player)
    sent = [one for one in events if one.kind == "message"]
    assert len(sent) == 41 + 8
    assert sent[-1].time_s == 14.0
    late_s = [one.wall_s - sent[0].wall_s - (one.time_s - 10.0) / rate for one in sent]
    assert min(late_s) > -1e-3
    assert late_s[-1] < 0.5  # of a busy machine; delays do not add up
    clock = [one for one in events if one.kind == "clock"]
    assert [one.time_s for one in clock] == sorted(one.time_s for one in clock)
    assert len(clock) / (sent[-1].wall_s - sent[0].wall_s) > LEAST_CLOCK_HZ
    for n, one in enumerate(events):
        if one.kind == "clock":
            assert all(later.time_s >= one.time_s for later in events[n:] if later.kind == "message")
    assert clock[-1].time_s == 14.0
    assert graph.spin_until(lambda: heard[-1:] == [14], TIMEOUT_S)


@pytest.mark.parametrize("rate", [10.0, 1000.0])
def test_the_clock_lags_by_its_period_at_most(
    rate: float, graph: Graph, tmp_path: Path, events: list[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if the thread that tells it never comes to it."""
    monkeypatch.setattr(SimulatedClock, "_run", lambda _: None)
    player = player_of(graph, bag(tmp_path / "bag", flight(4)), clock="paced", rate=rate)
    del events[1:]
    play(graph, player)
    told_s = 0.0
    for one in events:
        told_s = one.time_s if one.kind == "clock" else told_s
        assert told_s - 1e-6 <= one.time_s <= told_s + PERIOD_S * rate + 1e-6
    assert len(events) > 49


def test_in_a_burst_nothing_waits_and_there_is_no_clock(graph: Graph, tmp_path: Path, events: list[Event]) -> None:
    listener = graph.add(Listener(context=graph.context))
    player = player_of(graph, bag(tmp_path / "bag", flight(100)), clock="burst")
    began = time.monotonic()
    play(graph, player)
    assert time.monotonic() - began < 20  # of 100 s
    assert {one.kind for one in events} == {"message"}
    assert graph.spin_until(lambda: len(listener.dwells) == 200, TIMEOUT_S)
    assert listener.dwells == sorted(listener.dwells)
    assert player.tally.summary()["dwells"] == 100


def test_a_repetition_has_later_stamps_and_the_same_numbers(graph: Graph, tmp_path: Path) -> None:
    stamps: list[float] = []
    listener = graph.add(Listener(context=graph.context))
    subscribe(listener, ChannelFrame, "phase_history", lambda m: stamps.append(m.header.stamp.sec), 100)
    player = player_of(graph, bag(tmp_path / "bag", flight(2)), clock="burst", loops=3)
    play(graph, player)
    assert graph.spin_until(lambda: len(stamps) == len(listener.dwells) == 12, TIMEOUT_S)
    assert listener.dwells == [10, 10, 11, 11] * 3
    assert stamps == [10, 10, 11, 11, 12, 12, 13, 13, 14, 14, 15, 15]
    assert player.tally.summary()["dwells"] == 6


@pytest.mark.parametrize("clock", ["paced", "burst"])
def test_a_step_ends_before_a_dwell_with_another_calibration(
    clock: str, graph: Graph, tmp_path: Path, events: list[Event]
) -> None:
    """So that the nodes can finish the dwells before; the clock stands still meanwhile."""
    order = [*flight(4), calibration("a")]
    listener = graph.add(Listener(context=graph.context))
    path = bag(tmp_path / "bag", order)
    player = player_of(graph, path, DwellChanges(key(12), calibrations=("a",)), clock=clock, rate=20.0)
    steps = played(graph, player, listener)
    assert steps == [[10, 10, 11, 11], [], [12, 12, 13, 13]]
    times = [one.time_s for one in events if one.kind == "clock"]
    assert times == sorted(times)


def test_a_node_that_ends_waits_for_nothing(graph: Graph, tmp_path: Path) -> None:
    player = player_of(graph, bag(tmp_path / "bag", flight(4)), clock="paced", rate=1e-3)
    assert player.step()[0]
    began = time.monotonic()
    graph.nodes.remove(player)
    graph.executor.remove_node(player)
    player.destroy_node()
    assert time.monotonic() - began < 5


def paced_player(graph: Graph, rate: float) -> PacedPlayer:
    values = {"bag": str(Path(__file__).parents[2] / "bags" / "version_3"), "rate": rate}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return graph.add(PacedPlayer(context=graph.context, parameter_overrides=overrides))


def test_a_repeated_start_is_answered_alike(graph: Graph) -> None:
    """An answer may be lost: a server that has just started may not know yet who has asked."""
    paced_player(graph, 0.01)
    asker = graph.add(Node("asker", context=graph.context))
    stamps: list[int] = []
    subscribe(
        asker,
        ChannelFrame,
        "phase_history",
        lambda frame: stamps.append(messages.to_ns(frame.header.stamp)),
        FRAMES_QOS,
    )
    client = asker.create_client(Trigger, "paced_player/start")
    assert graph.spin_until(client.service_is_ready, TIMEOUT_S)
    answers = [client.call_async(Trigger.Request()) for _ in range(3)]
    assert graph.spin_until(lambda: all(answer.done() for answer in answers), TIMEOUT_S)
    assert all(answer.result().success for answer in answers)
    (first_ns,) = {int(answer.result().message) for answer in answers}
    assert graph.spin_until(lambda: bool(stamps), TIMEOUT_S)
    assert stamps[0] >= first_ns


def test_time_goes_on_while_a_paced_player_is_inactive(graph: Graph) -> None:
    player = paced_player(graph, 1.0)
    frames = player._outlets["phase_history"]
    answer = player.step()
    assert graph.spin_until(lambda: frames.published > 0, TIMEOUT_S)
    player.trigger_deactivate()
    assert not player.step()[0]
    for _ in range(2):  # the first message may have been on its way
        published, later_ns = frames.published, player._time._limit_ns + player.playlist.period_ns
        assert graph.spin_until(lambda due_ns=later_ns: player._time._limit_ns > due_ns, TIMEOUT_S)
    assert frames.published == published
    player.trigger_activate()
    assert player.step() == answer
    assert graph.spin_until(lambda: frames.published > published, TIMEOUT_S)
