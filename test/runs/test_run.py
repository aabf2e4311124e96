"""What a run leaves behind, read by others than its writer: of dwells, of strips, and of flights through air."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from helpers import assert_one_sentence
from mcap.reader import make_reader
from PIL import Image
from rewritten_bag import rewritten
from rosbags.highlevel import AnyReader

from sal_height import messages
from sal_height.bag.check import check_bag
from sal_height.bag.compare import CHANGED, EQUAL, compare_bags
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import EXACT
from sal_height.elevation import Validity, scatterer_count
from sal_height.errors import UserError
from sal_height.graph.catalogue import recorded_topics
from sal_height.relief.map import ReliefMap
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.runs.truth.height_picture import powers_db
from sal_height.runs.truth.profile import _profile, draw_profile
from sal_height.runs.truth.report import read_images
from sal_height.runs.truth.simulate import Flown, fly, run
from sal_height.simulation.air import SimulatedAir
from sal_height.simulation.flight import flight_of
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import Preset, load_preset

SEED = 3


@pytest.fixture(scope="module")
def recorded(two_dwells: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a run of two dwells, with its pictures."""
    out = tmp_path_factory.mktemp("runs") / "drawn"
    run(two_dwells, SEED, out, {})
    return out


@pytest.fixture(scope="module")
def changed(two_dwells: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of the run of fixture `recorded` with other parameters of two nodes."""
    out = tmp_path_factory.mktemp("changed") / "run"
    fly(two_dwells, SEED, out, {"ml_height": {"objective": "numerator"}, "relief_mapper": {"estimator": "monopulse"}})
    return out


@pytest.fixture(scope="module")
def report(recorded: Path) -> Any:
    return json.loads((recorded / "report.json").read_text())


def test_the_report_accounts_for_every_frame(report: Any) -> None:
    frames = 2 * 8
    stages = report["stages"]
    assert (stages["simulator"]["in"], stages["simulator"]["out"]) == (2, frames)
    for name, out in (("sar_compression", frames), ("monopulse", 2), ("ml_height", 2)):
        assert stages[name]["in"] == stages[name]["processed"] == frames
        assert stages[name]["out"] == out
        assert stages[name]["dropped"] == {}
        assert 0 < stages[name]["latency_p50_ms"] <= stages[name]["latency_p95_ms"]
    tracker = stages["relief_tracker"]
    assert (tracker["in"], tracker["processed"], tracker["out"], tracker["dropped"]) == (2, 2, 2, {})


def test_the_report_has_the_errors_of_each_estimator(report: Any) -> None:
    for name in ("monopulse", "ml"):
        numbers = report["estimators"][name]
        assert 0.3 < numbers["valid"] < 1
        assert numbers["surfaces"] > 100
        assert 0 < numbers["s68_m"] < 0.1
        assert abs(numbers["median_m"]) < 4 * 1.25 * numbers["s68_m"] / np.sqrt(numbers["surfaces"])
        assert 0 < numbers["crb_m"] < numbers["sigma_m"] * 2


def test_the_report_leaves_no_published_surface_uncounted(report: Any, recorded: Path) -> None:
    reader = BagReader(recorded / "bag")
    for name in ("monopulse", "ml", "tracked"):
        published = sum(
            np.count_nonzero(np.isfinite(surface.height))
            for message in reader.messages([f"/{name}/height"])
            for surface in reader.decode(message.type_name, message.cdr).surfaces
        )
        numbers = report["estimators"][name]
        assert numbers["surfaces"] == published > 100
        kinds = ("OK", "TWO_SCATTERERS", "THREE_SCATTERERS", "EXTENDED", "INTERPOLATED")
        assert sum(numbers["kinds"][kind]["surfaces"] for kind in kinds) == published
        assert np.sum(numbers["confusion"]["pixels"]) > 100
        assert 0.5 < numbers["lit_ground"]["right"] <= 1


def test_the_report_and_a_picture_show_the_ground(report: Any, recorded: Path) -> None:
    ground = report["estimators"]["ml"]["ground"]
    assert ground["right"] > 0.8
    assert ground["lit"]["measured"] > 0.8
    assert ground["measured"]["cells"] > 100
    assert (recorded / "ground.png").stat().st_size > 10_000
    assert "ground" not in report["estimators"]["tracked"]


def test_tracked_heights_have_less_noise_than_those_they_were_tracked_from(report: Any) -> None:
    tracked, ml = report["estimators"]["tracked"], report["estimators"]["ml"]
    assert tracked["surfaces"] > 0.8 * ml["surfaces"]
    assert tracked["s68_m"] < 0.8 * ml["s68_m"]


@pytest.mark.parametrize("name", ["height.png", "scene3d.png", "errors.png", "ground.png", "profile.png"])
def test_the_picture_is_a_picture(recorded: Path, name: str) -> None:
    with Image.open(recorded / name) as picture:
        pixels = np.asarray(picture.convert("L"))
    assert pixels.shape[1] == 1585
    assert pixels.shape[0] > 500
    assert np.ptp(pixels) > 200


def test_the_profile_shows_tracked_heights_with_their_band(recorded: Path, two_dwells: Preset, tmp_path: Path) -> None:
    with Image.open(recorded / "profile.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    band = (np.abs(pixels - [188, 210, 225]).max(axis=2) < 12).mean()  # light blue
    assert 0.005 < band < 0.7
    flight, images = flight_of(two_dwells, SEED), read_images(recorded / "bag")
    assert draw_profile(images, "monopulse", flight, tmp_path / "other.png")
    assert (tmp_path / "other.png").is_file()
    assert not draw_profile(images, "nothing", flight, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def test_the_profile_compares_each_surface_with_the_truth_of_its_own_pixel(recorded: Path, two_dwells: Preset) -> None:
    """Its errors are those of the report; the street is level there, so that they are the heights themselves."""
    images = read_images(recorded / "bag")["ml"]
    flight = flight_of(two_dwells, SEED)
    field, middle = messages.field_from_message(images[1]), images[1].grid.cols // 2
    found = _profile(images[1], middle, flight)
    strongest = found.number == 0
    assert len(found.height) == sum(np.count_nonzero(np.isfinite(one.height[:, middle])) for one in field.surfaces) > 5
    np.testing.assert_allclose(found.height[strongest], field.first.height[found.row[strongest], middle], rtol=1e-12)
    np.testing.assert_allclose(found.sigma[strongest], field.first.sigma[found.row[strongest], middle], rtol=1e-12)
    known = np.isfinite(found.error)
    assert known.sum() > 5
    level = flight.scene.heights(*found.place[known].T)
    np.testing.assert_allclose(found.error[known], found.height[known] - level, atol=1e-6)


def test_the_power_of_an_image_is_the_sum_of_that_of_its_surfaces(recorded: Path) -> None:
    image = read_images(recorded / "bag")["ml"][0]
    field, level = messages.field_from_message(image), powers_db(image)
    first = field.first.cnr_db
    several = scatterer_count(field.validity) > 1
    np.testing.assert_allclose(level[~several], first[~several], atol=1e-6)
    image.surfaces = [image.surfaces[0], image.surfaces[0]]
    there = field.validity == Validity.OK
    image.validity = np.where(there, Validity.TWO_SCATTERERS, field.validity).astype(np.uint8).ravel()
    np.testing.assert_allclose(powers_db(image)[there], first[there] + 10 * np.log10(2), atol=1e-5)


def test_rosbags_reads_the_heights_by_the_schema_in_the_bag(recorded: Path) -> None:
    with AnyReader([recorded / "bag"]) as reader:
        assert {c.topic for c in reader.connections} == {
            f"/{topic}" for topic in recorded_topics(["monopulse", "ml_height", "relief_tracker"], {})
        }
        dwells = []
        for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == "/ml/height"]):
            image = reader.deserialize(raw, connection.msgtype)
            dwells.append(image.dwell)
            assert len(image.surfaces[0].height) == image.grid.rows * image.grid.cols
            held = scatterer_count(np.asarray(image.validity))
            for number, surface in enumerate(image.surfaces):
                assert np.array_equal(np.isfinite(surface.height), held > number)
        assert dwells == [0, 1]


def test_foreign_readers_find_points_pictures_and_frames_in_the_bag(recorded: Path) -> None:
    """The platform at every sample of odometry, the sensor, and each frame that points are in."""
    with AnyReader([recorded / "bag"]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        found: dict[str, list[Any]] = {topic: [] for topic in kinds}
        sizes = dict.fromkeys(kinds, 0)
        for connection, _, raw in reader.messages():
            sizes[connection.topic] += len(raw)
            found[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    assert kinds["/tf"] == kinds["/tf_static"] == "tf2_msgs/msg/TFMessage"
    transforms = [one for message in found["/tf"] for one in message.transforms]
    placed = [
        one.header.stamp for one in transforms if (one.header.frame_id, one.child_frame_id) == ("map", "base_link")
    ]
    assert placed == [one.header.stamp for one in found["/platform/odometry"]]
    ((fixed,),) = (message.transforms for message in found["/tf_static"])
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("base_link", "sensor")
    for name in ("ml", "monopulse", "tracked"):
        grids = [one.grid for one in found[f"/{name}/height"]]
        assert [(one.height, one.width) for one in found[f"/{name}/image"]] == [(one.rows, one.cols) for one in grids]
        frames = [one.header.stamp for one in transforms if one.child_frame_id == f"{name}_origin"]
        assert [one.header.stamp for one in found[f"/{name}/points"]] == frames
        assert {one.header.frame_id for one in found[f"/{name}/points"]} == {f"{name}_origin"}
    views = sum(size for topic, size in sizes.items() if topic.endswith(("/image", "/points")) or topic == "/tf")
    assert views < 0.25 * sizes["/phase_history"]


def test_mcap_alone_finds_all_messages(recorded: Path) -> None:
    with (recorded / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        counts: dict[str, int] = {}
        for schema, channel, _ in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert counts["/phase_history"] == 16
    assert counts["/ml/height"] == counts["/monopulse/height"] == 2


def test_another_seed_gives_other_heights(recorded: Path, two_dwells: Preset, tmp_path: Path) -> None:
    fly(two_dwells, SEED + 1, tmp_path / "run", {})
    compared = compare_bags(BagReader(recorded / "bag"), BagReader(tmp_path / "run" / "bag"))
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    assert {result.verdict for result in compared.values()} == {CHANGED}


def test_the_same_seed_gives_the_same_heights_but_where_a_parameter_changes_them(recorded: Path, changed: Path) -> None:
    compared = compare_bags(BagReader(recorded / "bag"), BagReader(changed / "bag"), EXACT)
    assert compared["/monopulse/height"].verdict == EQUAL
    assert compared["/ml/height"].verdict == CHANGED


def test_interrupting_leaves_a_whole_bag_and_runs_go_on_side_by_side(two_dwells: Preset, tmp_path: Path) -> None:
    """While one run is going on in another process, a second one ends as if it were alone."""
    out = tmp_path / "run"
    words = ["run", "--preset", "small", "--dwells", "90", "--estimators", "ml", "--out", str(out)]
    with subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "sal_height", *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as program:
        deadline = time.monotonic() + 600
        bag = out / "bag" / "bag_0.mcap"
        while not (bag.is_file() and bag.stat().st_size > 250_000):
            assert time.monotonic() < deadline
            with pytest.raises(subprocess.TimeoutExpired):  # it runs on, and has the processors for itself
                program.wait(0.1)
        second = fly(dataclasses.replace(two_dwells, dwells=1), SEED, tmp_path / "second", {}).outcome
        assert program.poll() is None  # still going on
        program.send_signal(signal.SIGTERM)
        output, log = program.communicate(timeout=600)
    with bag.open("rb") as stream:
        assert make_reader(stream).get_summary() is not None  # its recorder had time to end it
    with rasterio.open(out / "relief_map.tif") as relief:
        assert relief.read(4).sum() > 0
    assert (second.dwells, second.losses) == (1, [])
    assert second.stages["sar_compression"].received == 8  # and nothing of the other sensor
    assert program.returncode == 130, log
    assert "Traceback" not in log
    assert "interrupted" in output
    report = json.loads((out / "report.json").read_text())
    assert report["interrupted"] is True
    assert report["losses"] == []
    assert report["stages"]["sar_compression"]["ignored"] == {}
    assert 1 <= report["dwells"] < 90
    with AnyReader([out / "bag"]) as reader:
        heights = [c for c in reader.connections if c.topic == "/ml/height"]
        assert sum(1 for _ in reader.messages(heights)) >= report["dwells"] - 1  # the last one may have been cut off


def test_odometry_of_unknown_accuracy_is_counted_in_reports_and_stated_in_bags(
    two_dwells: Preset, tmp_path: Path
) -> None:
    """Of a run by nodes, and of its replay by calls."""
    unknown = {"sar_compression": {"odometry_heading_sigma_rad": -1.0}}
    fly(two_dwells, SEED, tmp_path / "run", unknown)
    replay(tmp_path / "run" / "bag", tmp_path / "replay", {}, jobs=1)
    for out in (tmp_path / "run", tmp_path / "replay"):
        report = json.loads((out / "report.json").read_text())
        assert report["stages"]["sar_compression"]["ignored"] == {"odometry of unknown accuracy": 2}
        found = [doubt.name for image in read_images(out / "bag")["ml"] for doubt in image.doubts]
        assert found == ["odometry of unknown accuracy"] * 2


def test_the_lidar_is_as_accurate_as_theory_allows(tmp_path: Path) -> None:
    """At 20 dB and 4 looks: half the 16-84 % width within 1.3 bounds, and well below monopulse."""
    preset = dataclasses.replace(load_preset("sal_spotlight"), dwells=3)
    fly(preset, SEED, tmp_path / "run", {})
    estimators = json.loads((tmp_path / "run" / "report.json").read_text())["estimators"]
    ml, monopulse = estimators["ml"], estimators["monopulse"]
    single = ml["kinds"]["OK"]
    assert single["surfaces"] > 300
    assert single["s68_m"] < 1.3 * ml["crb_m"]
    # A bound that an efficient estimator cannot beat by more than the error of a width of n samples.
    assert single["s68_m"] > (1 - 4 / np.sqrt(single["surfaces"])) * 0.85 * ml["crb_m"]
    assert ml["s68_m"] < 0.7 * monopulse["s68_m"]


def test_the_relief_map_holds_all_dwells(recorded: Path, report: Any) -> None:
    """What the node wrote is what the heights in the bag give, read from there by somebody else."""
    assert report["relief_map"] == "relief_map.tif"
    assert report["stages"]["relief_mapper"]["processed"] == 2
    with rasterio.open(recorded / "relief_map.tif") as file:
        height, count, images = file.read(1)[::-1], file.read(4), file.tags()["images"]
        relief_map = ReliefMap(file.transform.a, 10**6)
    reader = BagReader(recorded / "bag")
    for message in reader.messages(["/ml/height"]):
        image = reader.decode(message.type_name, message.cdr)
        relief_map.add(messages.field_from_message(image))
    relief = relief_map.relief()
    assert relief is not None
    np.testing.assert_array_equal(height, relief.height)
    assert images == "2"
    assert np.mean(count) > 0.5


def test_the_relief_map_can_be_of_another_estimator_but_not_of_none(
    changed: Path, two_dwells: Preset, tmp_path: Path
) -> None:
    with rasterio.open(changed / "relief_map.tif") as file:
        assert (file.tags()["estimator"], file.tags()["images"]) == ("monopulse", "2")
    said = "estimator 'sum_difference', which relief_mapper takes, are not made here; allowed are monopulse, ml"
    with pytest.raises(UserError, match=said):
        run(two_dwells, SEED, tmp_path / "other", {"relief_mapper": {"estimator": "sum_difference"}})


def test_images_beside_the_scene_are_told_in_a_sentence(two_dwells: Preset, tmp_path: Path) -> None:
    """An attitude .1 rad off, which the odometry states, is half a kilometre: nothing to compare with, or to draw."""
    lost = Impairments(odometry=OdometryErrors(velocity_mps=5.0, attitude_rad=0.1))
    beside = dataclasses.replace(two_dwells, dwells=1, impairments=lost, estimators=("monopulse",))
    with pytest.raises(UserError, match=r"none of the images lies on the scene.*lower the errors"):
        run(beside, SEED, tmp_path / "run", {})
    assert json.loads((tmp_path / "run" / "report.json").read_text())["estimators"]["monopulse"]["s68_m"] is None


DWELLS = 4


def test_strip_images_join_and_their_heights_are_right(tmp_path: Path) -> None:
    preset = load_preset("sal_stripmap")
    preset = dataclasses.replace(
        preset,
        sensor=dataclasses.replace(preset.sensor, detectors=5, sample_count=40),
        flight=dataclasses.replace(preset.flight, gust_mps=1.0),
        image=dataclasses.replace(preset.image, rows=24, cols=64),
        dwells=DWELLS,
    )
    fly(preset, 5, tmp_path / "run", {})
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["stages"]["sar_compression"]["dropped"] == {}
    reader = BagReader(tmp_path / "run" / "bag")
    images = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/ml/height"])]
    # Pulses held: DWELLS blocks of 256, less an aperture of 310; two pulses a column, columns in multiples of 64.
    assert sum(image.grid.cols for image in images) == (DWELLS * 256 - 310) // 2 // 64 * 4
    grids = [messages.grid_from_message(image.grid) for image in images]
    for one, other in pairwise(grids):
        end = one.points(0.0, one.cols - 1 + 0.5 + 0.5 * other.col_spacing / one.col_spacing)
        np.testing.assert_allclose(end, other.origin, atol=1e-6 * one.col_spacing)
    errors = report["estimators"]["ml"]
    assert errors["valid"] > 0.6
    assert abs(errors["bias_m"]) < 3 * errors["sigma_m"] / np.sqrt(errors["surfaces"])
    assert errors["rms_m"] < 2 * errors["crb_m"]


AIR = SimulatedAir(temperature_k=300.0, pressure_pa=99_000.0, humidity=0.5, height_m=200.0, map_height_m=150.0)
HEARD = {"sar_compression": {"air": "topics", "map_height_m": 150.0}}
SMALL = load_preset("small")
PRESET = replace(SMALL, dwells=3, estimators=("ml",), processing=HEARD, impairments=replace(SMALL.impairments, air=AIR))
STRIP = load_preset("sal_stripmap")
STRIP_IN_AIR = replace(
    STRIP, dwells=4, estimators=("ml",), processing=HEARD, impairments=replace(STRIP.impairments, air=AIR)
)
TOPICS = [f"/{topic}" for topic in messages.AIR]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("air")


@pytest.fixture(scope="module")
def flown(folder: Path) -> Flown:
    return fly(PRESET, 2, folder / "run", {})


def test_the_compression_hears_the_air_of_a_run(flown: Flown, folder: Path) -> None:
    """Which is that at the platform, so that heights are right, by half a metre otherwise."""
    assert flown.outcome.losses == []
    assert abs(flown.accuracy.statistics["ml"]["bias_m"]) < 0.02
    told = flown.flight.probed_air(0)[0].values
    for image in read_images(folder / "run" / "bag")["ml"]:
        stage = messages.stages_of(image.provenance.parameters)["sar_compression"]
        assert {name: stage[f"heard_air.{name}"] for name in told if name != "air_humidity"} == pytest.approx(
            {name: value for name, value in told.items() if name != "air_humidity"}
        )


@pytest.mark.usefixtures("flown")
def test_a_replay_hears_it_again(folder: Path, replay: Any, tmp_path: Path) -> None:
    found = replay(folder / "run" / "bag", tmp_path / "replay", {})
    assert found.outcome.losses == []
    assert {one.verdict for one in found.compared.values()} == {EQUAL}


@pytest.mark.thorough
def test_a_strip_and_its_replay_hear_it(replay: Any, tmp_path: Path) -> None:
    flown = fly(STRIP_IN_AIR, 2, tmp_path / "strip", {})
    assert flown.outcome.losses == []
    assert abs(flown.accuracy.statistics["ml"]["bias_m"]) < 0.02
    found = replay(tmp_path / "strip" / "bag", tmp_path / "strip replay", {})
    assert found.outcome.losses == []
    assert {one.verdict for one in found.compared.values()} == {EQUAL}


def test_a_recorded_sensor_has_it_and_a_bag_without_it_is_found(tmp_path: Path) -> None:
    bag = record_sensor(PRESET, 2, tmp_path / "bag")
    assert all(BagReader(bag).topics[topic].count == 1 for topic in TOPICS)
    assert check_bag(bag, lambda *_: None) == []
    silent = rewritten(bag, tmp_path / "silent", lambda one, _: None if one.topic in TOPICS else one)
    (found,) = check_bag(silent, lambda *_: None)
    assert_one_sentence(found.sentence, "no messages on /air/pressure, /air/temperature, which", "air is topics")
    assert_one_sentence(found.fix, "sar_compression.air=standard")
