"""Heights that are made of a bag without a graph are those of the graph."""

from __future__ import annotations

import json
import math
import mmap
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import made_offline
import numpy as np
import pytest
from helpers import assert_one_sentence
from rewritten_bag import copied, rewritten
from same_items import difference

from sal_height.bag.compare import CHANGED, EQUAL, WITHIN, compare_bags
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.calibration import Calibration as Measured
from sal_height.calibration import save_calibration
from sal_height.engine.results import Product
from sal_height.errors import UserError
from sal_height.messages import deserialize, sensor_from_message, serialize
from sal_height.messages.types import Calibration, Header, HeightImage, SensorInfo, TFMessage, TransformStamped, Vector3
from sal_height.runs.campaign.batch import Case
from sal_height.runs.chain import side_by_side
from sal_height.runs.chain.chain_runs import BagRun, plan
from sal_height.runs.chain.timeline import FlightRecord
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.simulation import load_preset

BAGS = Path(__file__).parents[2] / "bags"
HEIGHTS = ["/ml/height", "/monopulse/height", "/tracked/height"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_the_graph_and_jobs_side_by_side_make_the_same_heights(recorded: Path, tmp_path: Path, jobs: int) -> None:
    expected = {f"/{name}/height": (EQUAL, 2) for name in ("ml", "monopulse", "tracked")}
    assert made_offline.compared(recorded / "bag", tmp_path, jobs) == expected


def test_many_dwells_by_several_jobs_are_those_of_one_byte_for_byte(tmp_path: Path) -> None:
    """Heights of three estimators and tracked ones, in their order; workers are there from the second dwell on."""
    preset = replace(load_preset("small"), dwells=8)
    bag = record_sensor(preset, 3, tmp_path / "flight")
    made = {}
    for jobs in (1, 3):
        row = made_offline.process_case(Case(bag, tmp_path / f"{jobs}", {}, {}, ("ml", "monopulse", "capon")), jobs)
        assert (row["dwells"], row["dropped"]) == (8, 0)
        reader = BagReader(tmp_path / f"{jobs}" / "bag")
        made[jobs] = {topic: [one.cdr for one in reader.messages([topic])] for topic in reader.topics}
    assert [len(messages) for messages in made[1].values()] == [8] * 4
    assert made[1] == made[3]


def test_images_of_several_jobs_have_the_data_that_they_were_compressed_from(tmp_path: Path) -> None:
    """As the products need them which look at phase histories again."""
    scheme = plan(record_sensor(replace(load_preset("small"), dwells=4), 3, tmp_path / "flight"), {})
    one, two = ([made.result.item for made in BagRun(scheme, ["sar_compression"], jobs=n).results()] for n in (1, 2))
    assert len(one) == 4
    for alone, together in zip(one, two, strict=True):
        assert not difference(together.source.frames, alone.source.frames)
        assert not difference(together.source.states, alone.source.states)
        assert not difference(together.source.slc, alone.source.slc)


def test_workers_are_spawned_where_there_is_no_fork(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = record_sensor(replace(load_preset("small"), dwells=5), 3, tmp_path / "flight")
    made = {}
    monkeypatch.setattr(side_by_side, "can_keep_workers", lambda: False)
    for jobs in (1, 2):
        made_offline.process_case(Case(bag, tmp_path / f"{jobs}", {}, {}, ("ml",)), jobs)
        reader = BagReader(tmp_path / f"{jobs}" / "bag")
        made[jobs] = [one.cdr for one in reader.messages(["/ml/height"])]
    assert len(made[1]) == 5
    assert made[1] == made[2]


def test_jobs_and_results_that_are_larger_than_pipes_do_not_wait_for_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Samples go through pipes here, and all images come back."""
    monkeypatch.setattr(side_by_side, "MEMORY_BYTES", mmap.PAGESIZE)
    bag = record_sensor(replace(load_preset("sal_spotlight"), dwells=24), 3, tmp_path / "flight")
    scheme = plan(bag, {})

    def give_up(*_: object) -> None:
        raise TimeoutError("The processes wait for each other.")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(120)
    try:
        run = BagRun(scheme, scheme.chain.stages, jobs=2)
        ports = [made.result.port for made in run.results() if isinstance(made.result, Product)]
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert (ports.count("slc"), ports.count("ml/height")) == (24, 24)


def test_parameters_that_are_given_hold(recorded: Path, tmp_path: Path) -> None:
    given = {"ml_height": {"range_looks": 2}, "sar_compression": {"cols": 10}}
    replay(recorded / "bag", tmp_path / "replay", given)
    again = made_offline.make(recorded / "bag", tmp_path, 1, **given)
    assert (again["dwells"], again["images"], again["against_recorded"]) == (2, 6, CHANGED)
    assert set(made_offline.compared(tmp_path / "replay" / "bag", tmp_path / "again").values()) == {(EQUAL, 2)}


def test_a_dwell_without_a_frame_is_counted_and_those_after_it_are_made(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "lacking",
        lambda message, number: None if message.topic == "/phase_history" and number == 3 else message,
    )
    row = made_offline.make(bag, tmp_path, 2)
    assert (row["dwells"], row["images"], row["dropped"]) == (2, 3, 1)
    assert row["drops"] == '{"sar_compression: incomplete dwell": 1}'
    assert "Dwell 0: channels [3] did not arrive before the source went on" in row["warnings"]
    proceeding = made_offline.make(bag, tmp_path / "proceed", 2, sar_compression={"missing_channels": "proceed"})
    assert (proceeding["images"], proceeding["dropped"]) == (6, 0)


def test_a_broken_frame_is_counted(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "broken",
        lambda message, number: (
            message._replace(cdr=message.cdr[:100]) if message.topic == "/phase_history" and number == 3 else message
        ),
    )
    row = made_offline.make(bag, tmp_path, 2)
    assert row["drops"] == '{"sar_compression: broken message": 1, "sar_compression: incomplete dwell": 1}'


def test_what_cannot_be_decoded_is_left_out_of_the_new_bag_and_counted_as_by_nodes(
    recorded: Path, tmp_path: Path
) -> None:
    broken = {("/phase_history", 3), ("/platform/odometry", 1)}
    bag = rewritten(
        recorded / "bag",
        tmp_path / "broken",
        lambda one, number: one._replace(cdr=one.cdr[:100]) if (one.topic, number) in broken else one,
    )
    seen = {}
    for jobs in (None, 1, 2):
        outcome = replay(bag, tmp_path / f"{jobs}", {}, jobs=jobs).outcome
        made = BagReader(tmp_path / f"{jobs}" / "bag")
        played = {topic: [one.cdr for one in made.messages([topic])] for topic in sorted({one for one, _ in broken})}
        counts = {name: (dict(one.dropped), dict(one.ignored)) for name, one in outcome.stages.items()}
        seen[jobs] = counts, played
    assert seen[None] == seen[1] == seen[2]
    assert seen[None][0]["player"] == ({}, {"broken /phase_history": 1, "broken /platform/odometry": 1})
    assert seen[None][0]["sar_compression"] == ({"incomplete dwell": 7}, {})


def test_without_odometry_no_dwell_is_made(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "blind",
        lambda message, number: None if message.topic == "/platform/odometry" and number > 0 else message,
    )
    row = made_offline.make(bag, tmp_path, 2)
    assert (row["images"], row["drops"]) == (0, '{"sar_compression: odometry gap": 2}')


def test_odometry_far_from_its_dwells_in_the_bag_is_found(recorded: Path, tmp_path: Path) -> None:
    """As when it was recorded by another program."""
    hour_ns = 3600 * 10**9
    bag = rewritten(
        recorded / "bag",
        tmp_path / "apart",
        lambda message, _: (
            message
            if message.topic == "/platform/odometry"
            else message._replace(log_time_ns=message.log_time_ns + hour_ns)
        ),
    )
    assert set(made_offline.compared(bag, tmp_path).values()) == {(EQUAL, 2)}


FROM_TF: dict[str, Any] = {"sar_compression": {"mounting_from_tf": True}}


def test_a_mounting_that_nothing_states_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError) as refused:
        made_offline.make(BAGS / "version_3", tmp_path, **FROM_TF)
    assert_one_sentence(str(refused.value), "has no topic /tf_static", "mounting_from_tf to false")


@pytest.mark.parametrize(("up_m", "verdicts"), [(0.0, {EQUAL, WITHIN}), (0.5, {CHANGED})])
def test_the_mounting_is_that_on_tf_static(up_m: float, verdicts: set[str], recorded: Path, tmp_path: Path) -> None:
    """By one job and by two; where it states the mounting of the description, heights stay as they were."""
    reader = BagReader(recorded / "bag")
    (described,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages(["/sensor_info"]))
    mounting = described.mounting
    transform = TransformStamped(header=Header(frame_id="base_link"), child_frame_id=mounting.frame_id)
    arm = mounting.lever_arm
    transform.transform.translation = Vector3(x=arm.x, y=arm.y, z=arm.z + up_m)
    transform.transform.rotation = mounting.rotation
    static = serialize(TFMessage(transforms=[transform]))
    rewritten(
        recorded / "bag",
        tmp_path / "bag",
        lambda message, _: message._replace(cdr=static) if message.topic == "/tf_static" else message,
    )
    for jobs in (1, 2):
        row = made_offline.make(tmp_path / "bag", tmp_path / f"{jobs}", jobs, **FROM_TF)
        assert (row["dwells"], row["dropped"]) == (2, 0)
        assert row["against_recorded"] in verdicts


def test_dwells_that_lack_a_frame_are_not_held_for_ever(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is given up before the next one begins, as no more of its frames can come."""
    bag = rewritten(
        recorded / "bag",
        tmp_path / "lacking",
        lambda message, number: None if message.topic == "/phase_history" and number % 8 == 3 else message,
    )
    run, held = BagRun(plan(bag, {}), ["sar_compression"]), []
    stage = run.stages["sar_compression"]
    accept = stage.accept

    def accepted(port: str, item: Any, now_s: float = 0.0) -> Any:
        decisions = accept(port, item, now_s)
        held.append(len(stage._assembler.unfinished()))
        return decisions

    monkeypatch.setattr(stage, "accept", accepted)
    assert not any(isinstance(made.result, Product) for made in run.results())
    assert max(held) == 1
    assert run.losses.dropped == {"sar_compression: incomplete dwell": 2}


def of_topic(reader: BagReader, topic: str) -> tuple[BagMessage, Any]:
    """The first message on a topic, and what is in it."""
    recorded = next(reader.messages([topic]))
    return recorded, reader.decode(recorded.type_name, recorded.cdr)


def with_more(bag: Path, folder: Path, *more: BagMessage) -> Path:
    """A bag with more messages, which come before those that are as late."""
    messages = sorted([*more, *BagReader(bag).messages()], key=lambda message: message.log_time_ns)
    new = {one.topic: one.type_name for one in more if one.topic not in BagReader(bag).topics}
    return copied(bag, folder, messages, more=new)


def test_the_first_of_contradictory_descriptions_stays_in_force_and_those_that_are_none_are_told(
    recorded: Path, tmp_path: Path
) -> None:
    message, info = of_topic(BagReader(recorded / "bag"), "/sensor_info")
    info.waveform.wavelength *= 2
    contradiction = message._replace(cdr=serialize(info), log_time_ns=message.log_time_ns + 1)
    info.waveform.wavelength = math.nan
    bag = with_more(
        recorded / "bag",
        tmp_path / "disputed",
        contradiction,
        message._replace(cdr=serialize(info), log_time_ns=message.log_time_ns + 2),
    )
    assert set(made_offline.compared(bag, tmp_path).values()) == {(EQUAL, 2)}
    (warning,) = json.loads(made_offline.make(bag, tmp_path / "again", 1)["warnings"])
    assert_one_sentence(warning, "contradicts the earlier one")


def test_a_calibration_that_cannot_be_used_is_told(recorded: Path, tmp_path: Path) -> None:
    first, bare = next(BagReader(recorded / "bag").messages()), Calibration(id="bare", config_hash="of nothing")
    times = first.log_time_ns, first.publish_time_ns
    one = BagMessage("/calibration", "sal_height_msgs/msg/Calibration", serialize(bare), *times)
    bag = with_more(recorded / "bag", tmp_path / "uncalibrated", one)
    row = made_offline.make(bag, tmp_path, 1, sar_compression={"calibration": "topic"})
    assert (row["images"], row["dropped"]) == (6, 0)
    assert_one_sentence(json.loads(row["warnings"])[-1], "width factor")


def test_a_calibration_that_the_data_contradict_is_in_no_image_of_any_job(tmp_path: Path) -> None:
    """By several jobs, too, where the first dwell decides for those that others process."""
    bag = record_sensor(replace(load_preset("small"), dwells=5), 3, tmp_path / "flight")
    (described,) = BagReader(bag).messages(["/sensor_info"])
    sensor = sensor_from_message(deserialize(described.cdr, SensorInfo))
    gains = 10 ** (3.0 * np.random.default_rng(5).standard_normal(8) / 20)
    zeros, response = np.zeros(8), np.repeat(gains[:, None], sensor.sample_count, axis=1).astype(complex)
    save_calibration(tmp_path / "foreign.npz", Measured(sensor.config_hash, response, zeros, zeros, zeros))
    given = {"sar_compression": {"calibration": str(tmp_path / "foreign.npz")}}
    made, warned = {}, {}
    for jobs, parameters in ((1, {}), (2, given), (3, given)):
        row = made_offline.process_case(Case(bag, tmp_path / f"{jobs}", {}, parameters, ("ml",)), jobs)
        assert (row["dwells"], row["dropped"]) == (5, 0)
        reader = BagReader(tmp_path / f"{jobs}" / "bag")
        made[jobs] = [deserialize(one.cdr, HeightImage) for one in reader.messages(["/ml/height"])]
        warned[jobs] = json.loads(row["warnings"])
    for jobs in (2, 3):
        for one, plain in zip(made[jobs], made[1], strict=True):
            assert one.surfaces == plain.surfaces
            assert one.provenance.calibration_id == ""
        (warning,) = (text for text in warned[jobs] if text not in warned[1])
        assert_one_sentence(warning, "is refused: with it the gains")


def test_a_bag_without_a_frame_that_can_be_read_is_refused(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "mute",
        lambda message, _: message._replace(cdr=b"\0\1\0\0") if message.topic == "/phase_history" else message,
    )
    with pytest.raises(UserError) as error:
        made_offline.make(bag, tmp_path, 1)
    assert_one_sentence(str(error.value), str(bag), "bag check")


def test_a_bag_is_read_once_for_its_plan(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readings, read = [], FlightRecord._read
    monkeypatch.setattr(FlightRecord, "_read", lambda *given: (readings.append(given), read(*given)))
    assert len(plan(recorded / "bag", {}).frames) == 2
    assert len(readings) == 1


def test_a_dwell_that_waits_for_a_frame_is_not_overtaken(recorded: Path, tmp_path: Path) -> None:
    """Heights of a replay without nodes, tracked ones too, and their order are those of nodes step by step."""
    bag = rewritten(
        recorded / "bag",
        tmp_path / "lacking",
        lambda message, number: None if message.topic == "/phase_history" and number == 3 else message,
    )
    proceed = {"sar_compression": {"missing_channels": "proceed"}}
    made = [tmp_path / name for name in ("in_step", "side_by_side")]
    for folder, jobs in zip(made, (None, 2), strict=True):
        assert not replay(bag, folder, proceed, jobs=jobs).outcome.losses
    bags = [BagReader(folder / "bag") for folder in made]
    compared = compare_bags(*bags, topics=HEIGHTS)
    assert {topic: (one.verdict, one.matched) for topic, one in compared.items()} == dict.fromkeys(HEIGHTS, (EQUAL, 2))
    orders = [
        [reader.decode(one.type_name, one.cdr).dwell for one in reader.messages(["/ml/height"])] for reader in bags
    ]
    assert orders == [[0, 1], [0, 1]]
