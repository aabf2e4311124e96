"""A flight whose air came in messages is replayed with the same air, with and without a graph, whole and in parts."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import made_offline
import pytest
from air_messages import air_at
from chain_fixture import Chain
from helpers import assert_one_sentence, make_sensor
from rclpy.parameter import Parameter
from rewritten_bag import rewritten

from sal_height import messages
from sal_height.bag.compare import CHANGED, EQUAL
from sal_height.bag.copies import Range, cut
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.graph.air import check_air
from sal_height.messages import serialize
from sal_height.messages.types import HeightImage, Temperature
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.products.adjust import _write
from sal_height.runs.replay.bag_replay import Replay, replay
from sal_height.runs.truth.simulate import fly
from sal_height.simulation import load_preset
from sal_height.simulation.flight import SimulatedFlight

SECOND = 1_000_000_000
AIR = ["/air/pressure", "/air/temperature"]
HEIGHTS = ["/ml/height", "/monopulse/height"]
RECORDED = ["/sensor_info", "/platform/odometry", "/phase_history", *AIR, *HEIGHTS]
CELSIUS = (-7.0, -12.0, -17.0)
"""Of the air of three dwells."""


@pytest.fixture(scope="module")
def flown(flight: SimulatedFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag of three dwells, each with another temperature, which is told before the dwell and used at its time."""
    folder = tmp_path_factory.mktemp("air") / "flight"
    with free_domain() as domain, Graph(domain) as graph:
        chain = Chain(graph, flight, 30.0, image={"rows": 46, "cols": 12, "air": "topics"})
        overrides = [Parameter("topics", value=RECORDED)]
        recorder = graph.add(Recorder(folder, context=graph.context, parameter_overrides=overrides))
        chain.wait(lambda: recorder.recorded.keys() >= set(RECORDED), "the recorder")
        assert recorder._reader
        asked = {"/sar_compression", "/ml_height", "/monopulse"}
        chain.wait(lambda: recorder._reader._known.keys() >= asked, "the parameters")
        chain.publish(chain.sensor_info())
        samples = chain.stages["sar_compression"].stage._air._samples
        for dwell, celsius in enumerate(CELSIUS):
            stamp_ns = messages.to_ns(chain.frames(dwell)[0].header.stamp) - SECOND
            chain.publish(*air_at(stamp_ns, celsius), *air_at(stamp_ns + 1, 40.0), *chain.odometry(dwell))
            chain.wait(lambda count=2 * dwell + 2: all(len(samples[t[1:]]) == count for t in AIR), "the air")
            chain.publish(*chain.frames(dwell))
            chain.await_heights(dwell)
        chain.wait(lambda: all(recorder.recorded[topic] == 3 for topic in HEIGHTS), "heights in the bag")
        chain.wait(lambda: all(recorder.recorded[topic] == 6 for topic in AIR), "air in the bag")
    return folder


def images_of(reader: BagReader) -> list[HeightImage]:
    return [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/ml/height"])]


def celsius_of(bag: Path) -> list[float]:
    """The temperature of the air of each dwell, as the provenance of its heights says."""
    stated = [messages.stages_of(one.provenance.parameters)["sar_compression"] for one in images_of(BagReader(bag))]
    return [round(one["heard_air.air_temperature_k"] - 273.15, 6) for one in stated]


def verdicts(result: Replay) -> dict[str, tuple[str, int]]:
    assert not result.outcome.losses
    return {topic: (one.verdict, one.matched) for topic, one in result.compared.items()}


def all_equal(count: int) -> dict[str, tuple[str, int]]:
    return dict.fromkeys(HEIGHTS, (EQUAL, count))


def changed_air(bag: Path, folder: Path, change: Callable[[BagMessage, int], BagMessage | None]) -> Path:
    """A bag with other messages on the air."""
    return rewritten(bag, folder, lambda one, number: change(one, number) if one.topic in AIR else one)


def test_each_dwell_had_its_air(flown: Path) -> None:
    assert celsius_of(flown) == list(CELSIUS)


def test_a_replay_makes_the_same_heights_and_keeps_the_air(flown: Path, tmp_path: Path) -> None:
    assert verdicts(replay(flown, tmp_path / "out", {}, estimators=["ml", "monopulse"])) == all_equal(3)
    made = tmp_path / "out" / "bag"
    assert celsius_of(made) == list(CELSIUS)
    before, after = ([one.cdr for one in BagReader(bag).messages([AIR[1]])] for bag in (flown, made))
    assert before == after


def test_a_bag_with_other_names_of_the_air_is_replayed(flown: Path, tmp_path: Path) -> None:
    reader, probe = BagReader(flown), {AIR[0]: "/probe/static", AIR[1]: "/probe/outside"}
    with BagWriter(tmp_path / "bag", reader.custom_data) as bag:
        for topic in reader.topics.values():
            bag.add_topic(probe.get(topic.name, topic.name), topic.type_name)
        for one in reader.messages():
            bag.write(probe.get(one.topic, one.topic), one.cdr, one.log_time_ns, one.publish_time_ns)
    rules = [f"{new}:={old}" for old, new in probe.items()]
    result = replay(tmp_path / "bag", tmp_path / "out", {}, estimators=["ml", "monopulse"], remap=rules)
    assert verdicts(result) == all_equal(3)


@pytest.mark.parametrize("jobs", [1, 2])
def test_heights_without_a_graph_are_the_same(flown: Path, tmp_path: Path, jobs: int) -> None:
    assert made_offline.compared(flown, tmp_path, jobs) == all_equal(3)


def test_air_that_was_told_long_before_its_dwell_is_found(flown: Path, tmp_path: Path) -> None:
    early = changed_air(flown, tmp_path / "bag", lambda one, _: one._replace(log_time_ns=one.log_time_ns - 30 * SECOND))
    assert made_offline.compared(early, tmp_path, 2) == all_equal(3)


def test_another_air_gives_other_heights(flown: Path, tmp_path: Path) -> None:
    """So that the tests above would see it."""

    def warmer(one: BagMessage, _: int) -> BagMessage:
        if one.topic != "/air/temperature":
            return one
        message: Temperature = BagReader(flown).decode(one.type_name, one.cdr)
        message.temperature += 1.0
        return one._replace(cdr=serialize(message))

    bag = changed_air(flown, tmp_path / "bag", warmer)
    assert made_offline.compared(bag, tmp_path) == dict.fromkeys(HEIGHTS, (CHANGED, 3))


@pytest.mark.parametrize("jobs", [1, 2])
def test_dwells_before_the_first_message_have_its_air(flown: Path, tmp_path: Path, jobs: int) -> None:
    """The only one comes after the last dwell."""
    last_ns = max(one.log_time_ns for one in BagReader(flown).messages())
    late = changed_air(
        flown, tmp_path / "bag", lambda one, number: one._replace(log_time_ns=last_ns) if number == 5 else None
    )
    row = made_offline.make(late, tmp_path, jobs)
    assert (row["images"], row["dropped"]) == (9, 0)
    assert celsius_of(tmp_path / "made" / "bag") == [40.0] * 3


@pytest.mark.parametrize("lacking", [AIR, AIR[1:]], ids=["all", "temperature"])
def test_a_bag_without_the_air_is_refused_in_one_sentence(flown: Path, tmp_path: Path, lacking: list[str]) -> None:
    bag = changed_air(flown, tmp_path / "bag", lambda one, _: None if one.topic in lacking else one)
    missing = ", ".join(topic[1:] for topic in lacking)
    for attempt in (
        lambda: replay(bag, tmp_path / "out", {}, estimators=["ml"]),
        lambda: made_offline.make(bag, tmp_path),
    ):
        with pytest.raises(UserError) as refused:
            attempt()
        assert_one_sentence(str(refused.value), f"{bag} has no messages on {missing}, which", "set air to standard")
    assert not (tmp_path / "out").exists()
    row = made_offline.make(bag, tmp_path / "standard", sar_compression={"air": "standard"})
    assert (row["images"], row["dropped"]) == (9, 0)


def test_sensors_whose_air_cannot_be_heard_are_refused_before_anything_is_started(tmp_path: Path) -> None:
    """Radio waves without humidity; simulated ones, whose air nobody tells."""
    heard = {"sar_compression": {"air": "topics"}}
    lidar, light = make_sensor(), [topic[1:] for topic in AIR]
    check_air(heard, [lidar], light, "Bag x")
    check_air({"sar_compression": {"air": "standard"}}, [lidar], [], "Bag x")
    with pytest.raises(UserError, match="no messages on air/humidity, which"):
        check_air(heard, [make_sensor(wavelength=0.03)], light, "Bag x")
    with pytest.raises(UserError) as simulated:
        fly(load_preset("small"), 1, tmp_path / "out", heard)
    assert_one_sentence(
        str(simulated.value),
        "A simulated flight without air (impairments) has no messages on air/pressure, air/temperature",
    )
    assert not (tmp_path / "out").exists()


def test_a_message_that_cannot_be_used_is_told(flown: Path, tmp_path: Path) -> None:
    """It is as if it had not come: the dwell has the air of the one before."""
    nan = serialize(Temperature(temperature=math.nan))
    bag = changed_air(
        flown,
        tmp_path / "bag",
        lambda one, number: one._replace(cdr=nan) if one.topic == "/air/temperature" and number == 2 else one,
    )
    row = made_offline.make(bag, tmp_path)
    assert row["dropped"] == 0
    assert (
        "A message on air/temperature is not used. Temperature on air/temperature has temperature nan"
        in row["warnings"]
    )
    assert celsius_of(tmp_path / "made" / "bag")[1] == 40.0, "which is stamped one nanosecond after the first"


@pytest.mark.parametrize("number", [0, 2])
def test_a_cut_keeps_the_air_that_its_dwell_had(flown: Path, tmp_path: Path, number: int) -> None:
    """Also what was told half a minute before, and not what was told before that."""
    early = changed_air(flown, tmp_path / "bag", lambda one, _: one._replace(log_time_ns=one.log_time_ns - 30 * SECOND))
    cut(early, tmp_path / "cut", Range(dwells=(number, number)))
    assert BagReader(tmp_path / "cut").topics["/air/pressure"].count > 0
    assert made_offline.compared(tmp_path / "cut", tmp_path) == all_equal(1)


def test_a_bag_with_adjusted_odometry_has_the_air(flown: Path, tmp_path: Path) -> None:
    _write(NamespacedReader(flown, ""), tmp_path / "adjusted", {}, None)
    counts = [{topic: BagReader(bag).topics[topic].count for topic in AIR} for bag in (flown, tmp_path / "adjusted")]
    assert counts[0] == counts[1] == dict.fromkeys(AIR, 6)
