"""Replay: the same heights from the same bag, and what happens to bags that are not whole."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import AS_VERSION_2, assert_one_sentence, few
from PIL import Image
from rclpy.node import Node
from rclpy.parameter import Parameter
from rewritten_bag import copied
from rosbags.highlevel import AnyReader

from sal_height.bag.compare import CHANGED, EQUAL, WITHIN, compare_bags
from sal_height.bag.copies import upgrade
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.tolerance import Tolerance, Tolerances
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.graph.plan import Execution
from sal_height.graph.reporting import PARAMETERS, comparison_table
from sal_height.imports.gotcha import import_gotcha
from sal_height.messages import serialize
from sal_height.messages.types import SensorInfo
from sal_height.nodes.playing.player import Player
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import LATCHED_QOS
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.replay.bag_replay import replay

BAGS = Path(__file__).parents[3] / "bags"
REFERENCE = BAGS / "version_3"

HEIGHT = "surfaces[0].height"


def test_replay_equals_the_recording_value_for_value(recorded: Path, tmp_path: Path) -> None:
    compared = replay(recorded / "bag", tmp_path / "replay", {}).compared
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    for result in compared.values():
        assert result.verdict == EQUAL
        assert result.matched == 2
        assert result.fields[HEIGHT].values > 200


@pytest.mark.usefixtures("blank_pictures")
def test_replay_with_another_parameter_shows_the_difference(recorded: Path, tmp_path: Path, replay: Any) -> None:
    result = replay(recorded / "bag", tmp_path / "replay", {"ml_height": {"objective": "numerator"}})
    assert result.compared["/monopulse/height"].verdict == EQUAL
    assert result.compared["/ml/height"].verdict == CHANGED
    assert result.compared["/ml/height"].fields[HEIGHT].outside > 0
    assert result.accuracy.keys() == {"monopulse", "ml", "tracked"}
    accuracy = json.loads((recorded / "report.json").read_text())["estimators"]
    assert result.accuracy["monopulse"] == accuracy["monopulse"]  # by the flight in the bag
    assert result.accuracy["ml"]["s68_m"] != accuracy["ml"]["s68_m"]


@pytest.mark.usefixtures("blank_pictures")
def test_a_replay_on_another_grid_says_how_it_differs(recorded: Path, tmp_path: Path, replay: Any) -> None:
    result = replay(recorded / "bag", tmp_path / "out", {"sar_compression": {"rows": 32}})
    topics = r"\(/ml/height, /monopulse/height, /tracked/height\)"
    said = comparison_table(result.compared)
    found = re.search(rf"grid.rows is (\d+) instead of (\d+) in dwell 0 {topics}\.", said)
    assert found
    assert int(found[1]) < int(found[2])
    assert "grid.cols" not in said
    report = json.loads((tmp_path / "out" / "report.json").read_text())["comparison"]["topics"]["/ml/height"]
    assert report["verdict"] == "changed"
    assert report["fields"][HEIGHT]["greatest"] is None
    assert report["fields"][HEIGHT]["unmatched"] > 0


@pytest.mark.usefixtures("blank_pictures")
def test_the_tables_say_what_came_out(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], replay_words: list[str]
) -> None:
    """Of an estimator as recorded, and of one that finds nothing; and one more topic is recorded."""
    parameters = ["--param", "ml_height.min_cnr_db=100", "--param", "relief_tracker.estimator=monopulse"]
    topics = ["--record", "slc"]
    assert main([*replay_words, str(recorded / "bag"), "--out", str(tmp_path / "out"), *parameters, *topics]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    rows = {line[0]: line[1:] for line in lines if line}
    accuracy = json.loads((recorded / "report.json").read_text())["estimators"]["monopulse"]
    assert rows["monopulse"][:3] == ["2", "0", f"{100 * accuracy['valid']:.1f}"]
    assert float(rows["monopulse"][3]) == pytest.approx(accuracy["bias_m"], rel=5e-3)
    assert rows["monopulse"][4] == "-"  # no error is stated that all pixels share
    assert float(rows["monopulse"][5]) == pytest.approx(accuracy["s68_m"], rel=5e-3)
    assert float(rows["monopulse"][6]) == pytest.approx(100 * accuracy["within_1_sigma"], abs=0.05)
    assert float(rows["monopulse"][7]) == pytest.approx(100 * accuracy["beyond_5_sigma"], abs=0.005)
    assert rows["ml"] == ["2", "0", "0.0", "-", "-", "-", "-", "-"]
    assert float(rows["tracked"][5]) > 0
    assert rows["/monopulse/height"][:4] == ["equal", "2", "0", "0"]
    assert rows["/monopulse/height"][5:] == ["0", "0"]
    assert int(rows["/monopulse/height"][4]) > 200
    assert rows["/ml/height"][0] == "changed"
    known = BagReader(tmp_path / "out" / "bag").topics
    assert known["/slc"].count == 16


def test_a_golden_bag_is_the_judge(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], replay_words: list[str]
) -> None:
    """Also over a replay with other parameters, and over one of another bag."""
    broken = ["--param", "ml_height.objective=numerator"]
    bag, out, golden = str(recorded / "bag"), str(tmp_path / "out"), str(tmp_path / "out" / "bag")
    assert main([*replay_words, bag, "--out", out, *broken]) == 0
    assert (tmp_path / "out" / "comparison.png").is_file()
    assert main([*replay_words, bag, "--out", str(tmp_path / "same"), *broken, "--against", golden]) == 0
    assert not (tmp_path / "same" / "comparison.png").exists()
    capsys.readouterr()
    assert main([*replay_words, bag, "--out", str(tmp_path / "other"), "--against", golden]) == 1
    said = capsys.readouterr()
    assert "sal-height: Topic /ml/height differs from the golden one by more than the tolerance.\n" in said.err
    assert re.search(r"surfaces\[0\]\.height is \S+ instead of \S+ in dwell [01], value \d+ \(.*/ml/height", said.out)
    assert main([*replay_words, bag, "--out", str(tmp_path / "broken"), *broken, "--against", bag]) == 1
    report = json.loads((tmp_path / "broken" / "report.json").read_text())["comparison"]
    assert (report["verdict"], report["golden"]) == ("changed", "bag")
    assert {topic: one["verdict"] for topic, one in report["topics"].items()} == {
        "/monopulse/height": "equal",
        "/ml/height": "changed",
        "/tracked/height": "changed",
    }
    with Image.open(tmp_path / "broken" / "comparison.png") as picture:
        assert np.ptp(np.asarray(picture.convert("L"))) > 200
    assert main([*replay_words, bag, "--out", str(tmp_path / "none"), "--against", str(tmp_path / "no_bag")]) == 2
    assert not (tmp_path / "none").exists()


def test_a_topic_that_nobody_publishes_cannot_be_recorded(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^No node of this run publishes topic music; it has .*slc.*\.$"):
        replay(recorded / "bag", tmp_path / "out", {}, Execution(record=["/music"]))


@pytest.mark.usefixtures("blank_pictures")
def test_the_tolerance_of_a_file_decides(recorded: Path, tmp_path: Path, replay_words: list[str]) -> None:
    """The platform 0.1 mm higher: heights are, too, and all else moves with it."""
    reader = BagReader(recorded / "bag")
    moved = copied(recorded / "bag", tmp_path / "moved", [lifted(reader, message) for message in reader.messages()])
    file = tmp_path / "tolerances.yaml"
    words = [*replay_words, str(moved), "--against", str(recorded / "bag"), "--tolerance", str(file)]
    for height, verdict in ((1e-6, "changed"), (1e-3, "within tolerance")):
        file.write_text(
            f"surfaces.height: {{absolute: {height}}}\n'*': {{absolute: 0.001, relative: 0.01, sigma: 0.1}}"
        )
        out = tmp_path / str(height)
        status = main([*words, "--out", str(out)])
        report = json.loads((out / "report.json").read_text())["comparison"]
        assert report["tolerances"]["surfaces.height"] == {"absolute": height}
        assert report["topics"]["/monopulse/height"]["verdict"] == verdict
        assert status == (report["verdict"] == "changed")


@pytest.mark.usefixtures("blank_pictures")
def test_all_versions_of_the_reference_bag_give_the_same_heights(tmp_path: Path, replay: Any) -> None:
    """They hold one flight, which was processed with other defaults when the older ones were recorded."""
    for version in ("version_0", "version_1", "version_2", "version_3"):
        replay(BAGS / version, tmp_path / version, AS_VERSION_2)
    for version in ("version_0", "version_1", "version_2"):
        flown_later = Tolerances({"header.stamp": Tolerance(absolute=1e15)})
        compared = compare_bags(
            BagReader(tmp_path / version / "bag"), BagReader(tmp_path / "version_3" / "bag"), flown_later
        )
        assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
        for result in compared.values():
            assert {name for name, one in result.fields.items() if one.different} <= {"header.stamp"}
            assert (result.verdict, result.matched) == (WITHIN if version == "version_0" else EQUAL, 2)


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("version", few(1, [0, 1]))
def test_an_upgraded_bag_gives_the_heights_of_the_old_one(version: int, tmp_path: Path, replay: Any) -> None:
    """With the parameters of the old one, which lie in a file beside that of version 0."""
    old, new = BAGS / f"version_{version}", tmp_path / "new"
    upgrade(old, new)
    for bag in (old, new):
        replay(bag, tmp_path / f"replay_{bag.name}", {})
    bags = [BagReader(folder) for folder in (tmp_path / f"replay_{old.name}" / "bag", tmp_path / "replay_new" / "bag")]
    compared = compare_bags(*bags)
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    assert all(result.verdict == EQUAL and result.matched == 2 for result in compared.values())
    assert all(result.verdict == EQUAL for result in compare_bags(BagReader(old), BagReader(new)).values())


@pytest.mark.usefixtures("blank_pictures")
def test_the_tolerance_of_the_reference_test_notices_a_wrong_range(tmp_path: Path, replay: Any) -> None:
    """A reference range that is off by a tenth of a millimetre moves the heights by more than the tolerance."""
    reader = BagReader(REFERENCE)
    moved = copied(REFERENCE, tmp_path / "moved", [lifted(reader, message) for message in reader.messages()])
    compared = replay(moved, tmp_path / "replay", {}).compared
    assert {result.verdict for result in compared.values()} == {CHANGED}


@pytest.mark.thorough
def test_another_processor_gives_heights_within_the_default_tolerance(
    recorded: Path, tmp_path: Path, replay_words: list[str]
) -> None:
    """Matrix products as on a processor of 2008, whose sums are those of other groups of terms."""
    words = [*replay_words, str(recorded / "bag"), "--out", str(tmp_path / "replay")]
    subprocess.run(  # noqa: S603 (our program)
        [sys.executable, "-m", "sal_height", *words],
        check=True,
        timeout=6000,
        env=os.environ | {"OPENBLAS_CORETYPE": "Nehalem"},
    )
    report = json.loads((tmp_path / "replay" / "report.json").read_text())["comparison"]
    verdicts = {topic["verdict"] for topic in report["topics"].values()}
    assert verdicts <= {"equal", "within tolerance"}
    if platform.machine() == "x86_64":
        assert verdicts == {"within tolerance"}


@pytest.mark.usefixtures("blank_pictures")
def test_a_dwell_that_lost_a_frame_is_counted_and_the_others_are_exact(
    recorded: Path, tmp_path: Path, replay: Any
) -> None:
    messages = list(BagReader(recorded / "bag").messages())
    third = [message for message in messages if message.topic == "/phase_history"][2]
    torn = copied(recorded / "bag", tmp_path / "torn", [message for message in messages if message is not third])
    compared = replay(torn, tmp_path / "replay", {"sar_compression": {"timeout_s": 1.5}}).compared
    assert (compared["/ml/height"].matched, compared["/ml/height"].missing) == (1, 1)
    assert not any(one.different for one in compared["/ml/height"].fields.values())
    report = json.loads((tmp_path / "replay" / "report.json").read_text())
    assert report["stages"]["sar_compression"]["dropped"] == {"incomplete dwell": 7}


def test_dwells_that_lie_among_each_other_are_exact(recorded: Path, tmp_path: Path, replay: Any) -> None:
    """The frames of both dwells in turn, and the odometry last, as two slow writers would leave them."""
    messages = list(BagReader(recorded / "bag").messages())
    frames = [m for m in messages if m.topic == "/phase_history"]
    others = [m for m in messages if m.topic not in ("/phase_history", "/platform/odometry")]
    odometry = [m for m in messages if m.topic == "/platform/odometry"]
    half = len(frames) // 2
    in_turn = [frame for pair in zip(frames[:half], frames[half:], strict=True) for frame in pair]
    in_order = [m._replace(log_time_ns=n) for n, m in enumerate([*others, *in_turn, *odometry])]
    mixed = copied(recorded / "bag", tmp_path / "mixed", in_order)
    compared = replay(mixed, tmp_path / "replay", {}).compared
    assert all(result.verdict == EQUAL and result.matched == 2 for result in compared.values())


def test_a_replay_that_drops_everything_says_that_all_is_missing(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], replay: Any, replay_words: list[str]
) -> None:
    """Without odometry no frame can be focused."""
    messages = [m for m in BagReader(recorded / "bag").messages() if m.topic != "/platform/odometry"]
    parameters = json.dumps({"sar_compression": {"timeout_s": 0.2}})
    without = copied(recorded / "bag", tmp_path / "without", messages, custom_data={"parameters": parameters})
    out = tmp_path / "replay"
    compared = replay(without, out, {}).compared
    assert {topic: (r.matched, r.missing) for topic, r in compared.items()} == {
        "/ml/height": (0, 2),
        "/monopulse/height": (0, 2),
        "/tracked/height": (0, 2),
    }
    report = json.loads((out / "report.json").read_text())
    assert report["comparison"]["topics"]["/ml/height"]["missing"] == 2
    assert report["stages"]["sar_compression"]["dropped"] == {"odometry gap": 16}
    changed = ["--param", "sar_compression.timeout_s=0.25"]
    assert main([*replay_words, str(without), "--out", str(tmp_path / "changed"), *changed]) == 1
    said = capsys.readouterr()
    for sentence in (
        "Node sar_compression dropped 16 messages (odometry gap).",
        "No image was made.",
        "Topic /ml/height misses 2 images and has 0 more than recorded.",
    ):
        assert f"sal-height: {sentence}\n" in said.err


def test_a_damaged_chunk_ends_the_replay_at_once_and_says_so(recorded: Path, tmp_path: Path) -> None:
    """What had been published of the dwell is counted, and no frame is published twice."""
    bag = damaged_copy(recorded / "bag", tmp_path / "bag")
    with pytest.raises(UserError, match=r"is damaged .*sal-height salvage"):
        replay(bag, tmp_path / "out", {})
    stages = json.loads((tmp_path / "out" / "report.json").read_text())["stages"]
    assert stages["player"]["published"]["phase_history"] == 15
    assert stages["player"]["dropped"] == {"cannot be processed": 1}
    frames = [message.cdr for message in BagReader(tmp_path / "out" / "bag").messages(["/phase_history"])]
    assert len(frames) == len(set(frames)) == 15


def test_after_a_damaged_chunk_the_player_has_nothing_more_to_play(
    recorded: Path, tmp_path: Path, graph: Graph
) -> None:
    bag = damaged_copy(recorded / "bag", tmp_path / "bag")
    player = graph.add(Player(context=graph.context, parameter_overrides=[Parameter("bag", value=str(bag))]))
    answers = []
    for _ in range(4):
        answers.append(player.step()[0])
        assert graph.spin_until(lambda: not player.jobs, 20.0)
    assert answers == [True, True, False, False]
    assert player._outlets["/phase_history"].published == 15


def test_the_sensor_is_announced_before_the_first_step_and_once(recorded: Path, graph: Graph) -> None:
    heard: list[SensorInfo] = []
    subscribe(graph.add(Node("other", context=graph.context)), SensorInfo, "sensor_info", heard.append, LATCHED_QOS)
    bag = Parameter("bag", value=str(recorded / "bag"))
    player = graph.add(Player(context=graph.context, parameter_overrides=[bag]))
    assert graph.spin_until(lambda: bool(heard), 20.0)
    player.step()
    assert graph.spin_until(lambda: not player.jobs, 20.0)
    assert player._outlets["/sensor_info"].published == 1


def test_a_step_ends_with_a_dwell_even_if_each_lacks_a_frame(recorded: Path, tmp_path: Path, graph: Graph) -> None:
    """Nine dwells without their last channel: a step ends after as many frames as a dwell has, or more."""
    reader = BagReader(recorded / "bag")
    others = list(reader.messages(["/sensor_info", "/platform/odometry"]))
    frames = []
    for dwell in range(9):
        for recorded_frame in list(reader.messages(["/phase_history"]))[:7]:
            frame = reader.decode(recorded_frame.type_name, recorded_frame.cdr)
            frame.dwell = dwell
            frames.append(recorded_frame._replace(cdr=serialize(frame), log_time_ns=2**62 + len(frames)))
    bag = copied(recorded / "bag", tmp_path / "bag", [*others, *frames])
    player = graph.add(Player(context=graph.context, parameter_overrides=[Parameter("bag", value=str(bag))]))
    player.step()
    assert graph.spin_until(lambda: not player.jobs, 20.0)
    assert player._outlets["/phase_history"].published == 2 * 7


def test_a_failure_is_in_the_report(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise UserError("The disk is gone.")

    monkeypatch.setattr("sal_height.graph.lockstep.perform", fail)
    with pytest.raises(UserError, match="disk is gone"):
        replay(recorded / "bag", tmp_path / "out", {})
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["bag"], report["failed"]) == ("bag", "The disk is gone.")


@pytest.mark.usefixtures("blank_pictures")
def test_parameters_travel_with_the_file(recorded: Path, tmp_path: Path, replay: Any) -> None:
    """Of the bag nothing is taken but its .mcap file."""
    file = shutil.copy(recorded / "bag" / "bag_0.mcap", tmp_path / "copy.mcap")
    flown = recorded_parameters(BagReader(Path(file)))["ml_height"]
    assert (flown["range_looks"], flown["azimuth_looks"]) == (2, 2)
    replay(Path(file), tmp_path / "out", {"ml_height": {"range_looks": 4}})
    again = recorded_parameters(BagReader(tmp_path / "out" / "bag"))
    assert again["ml_height"] == {**flown, "range_looks": 4}
    assert json.loads((tmp_path / "out" / "report.json").read_text())["parameters"] == again


def test_a_bag_without_parameters_is_processed_with_the_defaults_and_that_is_said(
    recorded: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As a bag recorded in flight; one that was made with the defaults alone holds that it was."""
    known = copied(recorded / "bag", tmp_path / "known", [], custom_data={"parameters": "{}"})
    assert recorded_parameters(BagReader(known)) == {}
    assert not caplog.messages
    unknown = copied(recorded / "bag", tmp_path / "unknown", [], custom_data={"note": "no parameters"})
    assert recorded_parameters(BagReader(unknown)) == {}
    (said,) = caplog.messages
    assert_one_sentence(said, str(unknown), "defaults", "--param")


@pytest.mark.parametrize(
    ("source", "storage"), few(1, [("fresh", "sqlite3"), ("version_3", "mcap"), ("fresh", "mcap")])
)
def test_a_bag_that_rosbags_convert_has_written_gives_the_heights_recorded_in_it(
    source: str, storage: str, recorded: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, replay: Any
) -> None:
    """It has no custom data any more; the parameters are in the provenance of its heights."""
    bag = recorded / "bag" if source == "fresh" else REFERENCE
    convert = [str(Path(sys.executable).with_name("rosbags-convert")), "--src", str(bag)]
    converted = tmp_path / "converted"
    subprocess.run([*convert, "--dst", str(converted), "--dst-storage", storage], check=True, timeout=600)  # noqa: S603
    assert PARAMETERS not in BagReader(converted).custom_data
    compared = replay(converted, tmp_path / "replay", {}).compared
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    for topic, result in compared.items():
        assert result.matched == 2
        assert result.verdict == EQUAL or (source != "fresh" and result.verdict == WITHIN), topic
    assert not caplog.messages


@pytest.mark.parametrize("beside", [False, True])
def test_parameters_of_a_bag_are_checked(beside: bool, recorded: Path, tmp_path: Path) -> None:
    """Those in the bag, and those in a file beside it, as older bags have them."""
    messages = [m for m in BagReader(recorded / "bag").messages() if m.topic in ("/sensor_info", "/phase_history")]
    for number, (text, said) in enumerate(
        {
            "ml_height: {min_cnr_db: 2020-01-01}": "Node ml_height: Parameter min_cnr_db",
            "ml_height: {min_cnr_db: 2020-13-01}": "cannot be read",
            "ml_height: {range_looks: }": "it must be a whole number from 1",
            "ml_height": "must map node names",
        }.items()
    ):
        bag = copied(
            recorded / "bag", tmp_path / str(number), messages, custom_data={} if beside else {"parameters": text}
        )
        if beside:
            (bag / "parameters.yaml").write_text(text)
        with pytest.raises(UserError, match=said):
            replay(bag, tmp_path / "out", {})
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["missing", "empty", "not_a_bag"])
def test_what_is_no_bag_is_refused_in_one_sentence(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name != "missing":
        path.mkdir()
    if name == "not_a_bag":
        (path / "metadata.yaml").write_text("hello")
    with pytest.raises(UserError) as error:
        replay(path, tmp_path / "out", {})
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_bag_without_phase_history_is_refused(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    foreign = shared_data("rosbag2_mcap") / "rosbag2_py_test_resources_mcap_talker_talker.mcap"
    with pytest.raises(UserError, match="/sensor_info"):
        replay(foreign, tmp_path / "out", {})


def test_gotcha_focuses_as_well_as_published(shared_data: Callable[[str], Path], tmp_path: Path, replay: Any) -> None:
    """Three files: resolution by theory .306 m in ground range, .379 m in cross-range; plain backprojection 48.9 dB."""
    files = sorted(shared_data("afrl_gotcha").glob("*.mat"))
    assert import_gotcha(files, tmp_path / "bag") == 352
    replay(tmp_path / "bag", tmp_path / "out", {})
    (image,) = json.loads((tmp_path / "out" / "report.json").read_text())["images"]
    assert image["peak_over_median_db"] >= 48.5
    assert np.hypot(*(np.array(image["brightest_east_north_up_m"][:2]) - (-15.6, 21.6))) < 0.3
    assert image["row_width_3db_m"] == pytest.approx(0.306, rel=0.1)
    assert image["col_width_3db_m"] == pytest.approx(0.379, rel=0.1)
    assert (tmp_path / "out" / "image_0.png").stat().st_size > 10_000


def test_rosbags_reads_an_imported_gotcha_bag_by_the_schema_in_it(
    shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    """It writes the same bytes again: nothing follows the last field, and no padding is left as it was in memory."""
    import_gotcha(sorted(shared_data("afrl_gotcha").glob("*.mat"))[:1], tmp_path / "bag")
    found = {}
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            found[connection.topic] = reader.deserialize(raw, connection.msgtype)
            assert bytes(reader.typestore.serialize_cdr(found[connection.topic], connection.msgtype)) == raw
    info, frame = found["/sensor_info"], found["/phase_history"]
    assert (info.contract_version, info.name, info.waveform.kind) == (3, "afrl_gotcha_HH", "spectrum")
    assert (info.waveform.sample_count, info.pulse_count) == (424, frame.pulse_count)
    assert len(frame.samples) == 8 * 424 * frame.pulse_count
    assert set(found) == {"/sensor_info", "/platform/odometry", "/phase_history"}


def test_what_is_not_gotcha_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(os.urandom(500))
    with pytest.raises(UserError, match=r"a\.mat"):
        import_gotcha([tmp_path / "a.mat"], tmp_path / "bag")


def damaged_copy(bag: Path, copy: Path) -> Path:
    """A bag with one bit of its last frame turned."""
    copied(bag, copy)
    *_, last = BagReader(copy).messages(["/phase_history"])
    (file,) = copy.glob("*.mcap")
    content = bytearray(file.read_bytes())
    content[content.index(last.cdr) + len(last.cdr) // 2] ^= 1
    file.write_bytes(content)
    return copy


def lifted(reader: BagReader, message: BagMessage) -> BagMessage:
    """The message; odometry with the platform 0.1 mm higher."""
    if message.topic != "/platform/odometry":
        return message
    odometry = reader.decode(message.type_name, message.cdr)
    odometry.pose.pose.position.z += 1e-4
    return message._replace(cdr=serialize(odometry))
