"""`sal-height adjust`: passes and strips of a recorded flight come together, and what cannot be done is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_passes import BORESIGHT, EAST_M, ERRORS, preset_of
from helpers import assert_one_sentence
from rewritten_bag import copied, rewritten
from rosbags.highlevel import AnyReader

from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.commands.adjust import DEFAULT_SIGMA_M, LEAST_SIGMA_M, MOST_SIGMA_M
from sal_height.elevation import ESTIMATORS
from sal_height.engine.image_items import Images
from sal_height.engine.results import Product
from sal_height.geometry import sphere_coordinates
from sal_height.graph.catalogue import parameters_of
from sal_height.graph.reporting import PARAMETERS
from sal_height.io import bag_name
from sal_height.nodes.processing import PROCESSING
from sal_height.numeric import F64
from sal_height.pipeline import heights
from sal_height.runs.chain.chain_runs import BagRun, plan
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.products.adjust import ADJUSTED_FROM
from sal_height.settings import settings_of
from sal_height.simulation import load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.preset import Passes
from sal_height.simulation.scenes import street

BAG = str(Path(__file__).parents[3] / "bags" / "sal_spotlight")
KNOWN = ["--set", "boresight_sigma_rad=3e-5", "--set", "lever_arm_sigma_m=0.01"]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag of a sensor in five passes."""
    return record_sensor(preset_of(5, 3), 1, tmp_path_factory.mktemp("passes") / "bag")


@pytest.fixture(scope="module")
def adjusted(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("adjusted") / "out"
    assert main(["adjust", str(flight), "--out", str(out), *KNOWN]) == 0
    return out


def report_of(folder: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def test_report_tells_what_was_found_and_what_stays_open(adjusted: Path) -> None:
    report = report_of(adjusted)
    assert report["dwells"] == 15
    assert report["comparisons"] > 20
    assert report["comparisons_with_known_ground"] == 0
    assert report["dropped"] == report["warned"] == {}
    found = [report["parameters"][f"boresight {axis} (rad)"] for axis in "xyz"]
    off = np.array([one["error"] for one in found]) + BORESIGHT
    assert np.all(np.abs(off) < 4 * np.array([one["sigma"] for one in found]))
    assert found[0]["sigma"] < 0.9 * 3e-5
    covariance = np.array(report["parameter_covariance"])
    np.testing.assert_allclose(np.sqrt(covariance.diagonal())[:3], [one["sigma"] for one in found], rtol=1e-6)
    assert covariance.shape == (6, 6)
    assert "odometry delay (s)" not in report["parameters"], "it was known exactly"
    said = " ".join(report["warnings"])
    assert "These dwells do not determine: " in said
    assert "lever arm x (m)" in said
    assert "Without known ground all dwells together may lie off by" in said
    assert np.all(np.array(report["sigma_between_dwells_m"]) < [0.1, 0.1, 0.02])
    assert np.all(np.array(report["sigma_of_all_dwells_m"]) > 0.05)
    assert (adjusted / "adjustment.png").read_bytes()[:4] == b"\x89PNG"


def test_new_bag_has_what_the_sensor_delivered_and_better_odometry(flight: Path, adjusted: Path) -> None:
    """As a foreign reader sees it."""
    before, after = BagReader(flight), BagReader(adjusted / "bag")
    assert after.custom_data[ADJUSTED_FROM] == bag_name(flight)
    compression = json.loads(after.custom_data[PARAMETERS])["sar_compression"]
    assert compression["boresight_sigma_rad"] == compression["lever_arm_sigma_m"] == 0.0
    frames = [[one.cdr for one in reader.messages(["/phase_history"])] for reader in (before, after)]
    assert frames[0] == frames[1]
    with AnyReader([adjusted / "bag"]) as reader:
        (connection,) = [one for one in reader.connections if one.topic == "/platform/odometry"]
        assert connection.msgcount == before.topics["/platform/odometry"].count
        covariances = [
            reader.deserialize(raw, one.msgtype).pose.covariance.reshape(6, 6)
            for one, _, raw in reader.messages([connection])
        ]
    assert np.all(np.linalg.eigvalsh(covariances[:4]) >= 0)
    assert np.sqrt(covariances[0][3, 3]) < 3e-5


@pytest.mark.thorough
def test_a_second_adjustment_finds_the_dwells_together(adjusted: Path, tmp_path: Path) -> None:
    """They lay 50 cm apart; what is left is below a pixel, and 1 cm in height."""
    exact = ["--set", "boresight_sigma_rad=0", "--set", "lever_arm_sigma_m=0"]
    assert main(["adjust", str(adjusted / "bag"), "--out", str(tmp_path / "again"), *exact]) == 0
    apart = [np.std(report_of(folder)["shifts_m"], axis=0) for folder in (adjusted, tmp_path / "again")]
    assert np.all(apart[0] > 0.1)
    assert np.all(apart[1] < [0.09, 0.09, 0.01]), apart[1]


def elevation_model(folder: Path, too_high: float = 0.0) -> Path:
    """Of the street, as far east as it is flown over, and too high by so much (m); its middle is the origin."""
    west = np.full((len(street().north), round(2 * EAST_M / 0.02)), 0.0)
    height = np.concatenate([west, street().height], axis=1) + too_high
    np.savez(folder / "street.npz", elevation=height[::-1], dx=0.02, dy=0.02)
    return folder / "street.npz"


@pytest.mark.usefixtures("blank_pictures")
def test_known_ground_that_is_not_there_is_left_out(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A metre too high, where odometry and mounting know the height of all dwells to 14 cm."""
    out, ground = tmp_path / "out", elevation_model(tmp_path, too_high=1.0)
    assert main(["adjust", str(flight), "--out", str(out), *KNOWN, "--terrain", str(ground)]) == 0
    assert report_of(out)["comparisons_with_known_ground"] == 0
    (said,) = [line for line in capsys.readouterr().err.splitlines() if "The elevation model contradicts" in line]
    assert_one_sentence(said.removeprefix("sal-height: "), "m too high", "--terrain-sigma", "the result is without it")
    too_high = float(said.split(" m too high")[0].split()[-1])
    assert too_high == pytest.approx(1.0, abs=0.5)


@pytest.mark.usefixtures("blank_pictures")
def test_known_ground_is_used(flight: Path, tmp_path: Path) -> None:
    ground = elevation_model(tmp_path)
    out = tmp_path / "out"
    assert main(["adjust", str(flight), "--out", str(out), *KNOWN, "--terrain", str(ground)]) == 0
    report = report_of(out)
    assert report["comparisons_with_known_ground"] >= 12
    # The model may be off as a whole by its 10 cm, and the dwells by 14 cm, each way.
    np.testing.assert_allclose(report["sigma_of_all_dwells_m"], [0.09, 0.08, 0.08], atol=0.015)
    assert not any("Without known ground" in sentence for sentence in report["warnings"])


@pytest.mark.usefixtures("blank_pictures")
def test_what_is_not_there_is_said_and_the_result_is_without_it(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ground = tmp_path / "elsewhere.npz"
    np.savez(ground, elevation=np.full((10, 10), 500.0), dx=1.0, dy=1.0)
    out = tmp_path / "out"
    file = tmp_path / "targets.csv"
    file.write_text("east_m,north_m,height_m\n900,3,1\n", encoding="utf-8")
    options = ["--terrain", str(ground), "--target", "-2000,3,1", "--targets", str(file)]
    assert main(["adjust", str(flight), "--out", str(out), *KNOWN, *options]) == 0
    said = capsys.readouterr().err
    assert "None of the 2 targets was seen" in said
    assert "The elevation model has no heights where the dwells lie, or agrees with none" in said
    assert report_of(out)["comparisons_with_known_ground"] == 0


@pytest.mark.usefixtures("blank_pictures")
def test_passes_that_do_not_overlap_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    preset = preset_of(1, 4)
    apart = replace(preset, flight=replace(preset.flight, dwell_spacing_m=3.0))
    bag = record_sensor(apart, 1, tmp_path / "bag")
    assert main(["adjust", str(bag), "--out", str(tmp_path / "out")]) == 0
    assert "No two dwells were found to show the same ground" in capsys.readouterr().err
    report = report_of(tmp_path / "out")
    assert report["comparisons"] == 0
    assert report["dwells_without_comparison"] == 4
    before, after = BagReader(bag), BagReader(tmp_path / "out" / "bag")
    odometry = [[one.cdr for one in reader.messages(["/platform/odometry"])] for reader in (before, after)]
    assert odometry[0] == odometry[1]
    given = [json.loads(reader.custom_data[PARAMETERS])["sar_compression"] for reader in (before, after)]
    assert given[0].items() <= given[1].items()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([BAG, "--target", "1,2"], "Option --target is '1,2'; it must be EAST,NORTH,HEIGHT"),
        ([BAG, "--target", "nan,0,0"], "Option --target is 'nan,0,0'; numbers must be at most"),
        ([BAG, "--target", "0,0,1e300"], "'0,0,1e300'; numbers must be at most 1e+06 m"),
        ([BAG, "--target", "-inf,0,0"], "Option --target is '-inf,0,0'; numbers must be at most"),
        ([BAG, "--terrain", "x.npz", "--terrain-sigma", "-1"], "Must be >= 0.0001"),
        ([BAG, "--terrain", "x.npz", "--terrain-sigma", "0"], "Must be >= 0.0001"),
        ([BAG, "--terrain", "x.npz", "--terrain-sigma", "nan"], "--terrain-sigma"),
        ([BAG, "--terrain", "x.npz", "--terrain-sigma", "1001"], "Must be <= 1000"),
        ([BAG, "--terrain-sigma", "0.1"], "Option --terrain-sigma has no meaning without"),
        ([BAG, "--set", "boresight=1"], "boresight"),
        ([BAG, "--set", "correlation_s=0"], "correlation_s"),
        ([BAG, "--terrain", "nowhere.tif"], "Elevation model nowhere.tif is not a readable"),
        ([BAG, "--terrain", "README.md"], "Elevation model README.md has the suffix '.md'"),
        ([BAG, "--targets", "nowhere.csv"], "Cannot read nowhere.csv with targets"),
        (
            [BAG, "--estimator", "mll"],
            "Estimator 'mll' does not exist (did you mean 'ml'?); allowed are monopulse, ml, ",
        ),
        ([BAG, "--estimator", "movers"], "Estimator 'movers' does not exist; allowed are monopulse, ml, "),
        ([BAG, "--estimator", "adjusted"], "Estimator 'adjusted' does not exist; allowed are monopulse"),
        (["nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_adjusted_gets_one_sentence(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["adjust", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert says in error
    assert_one_sentence(error.removeprefix("sal-height: "))
    assert "adjusted, movers" not in error


def test_a_sensor_with_one_detector_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    preset = preset_of(1, 1)
    bag = record_sensor(replace(preset, sensor=replace(preset.sensor, detectors=1)), 1, tmp_path / "bag")
    assert main(["adjust", str(bag), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: ")
    assert_one_sentence(error, "one detector", "no heights")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("blank_pictures")
def test_what_stays_as_it_was_has_no_value(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Dwells of one pass: Doppler centroids tell a boresight that is known badly, and none that is known well."""
    preset = preset_of(1, 4)
    bag = record_sensor(replace(preset, flight=replace(preset.flight, dwell_spacing_m=3.0)), 1, tmp_path / "bag")
    for sigma, status in (("1e-3", 0), ("1e-9", 1)):
        out = tmp_path / sigma
        given = ["--set", f"boresight_sigma_rad={sigma}", "--set", "lever_arm_sigma_m=0.01"]
        assert main(["adjust", str(bag), "--out", str(out), *given]) == status
        lines = capsys.readouterr().out.splitlines()
        determined = {name: one["determined"] for name, one in report_of(out)["parameters"].items()}
        assert any(determined.values()) == (status == 0)
        for name, told in determined.items():
            (row,) = [line for line in lines if line.startswith(name)]
            assert (row.split()[-2:] == ["-", "-"]) == (not told)
        assert "0 comparisons of dwells with others, 0 with known ground" in lines
        assert lines[-1].endswith("has the odometry as it was")
        assert (out / "bag").is_dir()


@pytest.mark.thorough
def test_known_ground_is_enough_where_no_two_dwells_overlap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    preset = preset_of(1, 4)
    bag = record_sensor(replace(preset, flight=replace(preset.flight, dwell_spacing_m=3.0)), 1, tmp_path / "bag")
    ground = elevation_model(tmp_path)
    assert main(["adjust", str(bag), "--out", str(tmp_path / "out"), *KNOWN, "--terrain", str(ground)]) == 0
    said = capsys.readouterr()
    assert report_of(tmp_path / "out")["comparisons_with_known_ground"] > 0
    assert "they were compared with known ground, but not with each other" in said.err
    assert "nothing could be compared" not in said.err
    assert "heights with the corrected odometry: sal-height replay" in said.out


def test_why_no_dwell_can_be_adjusted_is_said_reason_by_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = record_sensor(preset_of(1, 3), 1, tmp_path / "whole")
    bag = rewritten(
        whole, tmp_path / "bag", lambda one, number: one if number or one.topic != "/phase_history" else None
    )
    assert main(["adjust", str(bag), "--out", str(tmp_path / "out"), "--param", "ml_height.min_cnr_db=90"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "has no dwell that can be adjusted. 1 of 3 dwells was left out (sar_compression: incomplete dwell)." in error
    assert "2 of 3 dwells were left out (ml_height: few heights). A dwell has 0 heights; 20 are needed" in error
    report = report_of(tmp_path / "out")
    assert report["dropped"] == {"sar_compression: incomplete dwell": 1, "ml_height: few heights": 2}
    assert report["dwells"] == 0


def test_known_ground_may_be_what_the_node_and_files_allow() -> None:
    sigma = settings_of(PROCESSING["height_adjuster"].parameters)["terrain_sigma_m"]
    assert (sigma.minimum, sigma.default, sigma.maximum) == (LEAST_SIGMA_M, DEFAULT_SIGMA_M, MOST_SIGMA_M)


@pytest.mark.usefixtures("blank_pictures")
def test_faults_together_cost_a_dwell_and_a_sample(flight: Path, tmp_path: Path) -> None:
    """In a namespace, with a frame missing and a sample of the odometry that cannot be read."""
    reader, broken = BagReader(flight), tmp_path / "bag"
    messages = list(reader.messages())
    frames = [one for one in messages if one.topic == "/phase_history"]
    first = next(one for one in messages if one.topic == "/platform/odometry")
    kept = [one for one in messages if one is not frames[4 * 16 + 3]]
    kept[kept.index(first)] = first._replace(cdr=first.cdr[:40])
    copied(flight, broken, kept, names=lambda topic: [f"/left{topic}"])
    assert main(["adjust", str(broken), "--out", str(tmp_path / "out"), *KNOWN]) == 0
    report = report_of(tmp_path / "out")
    assert report["dwells"] == 14
    assert report["dropped"] == {"sar_compression: incomplete dwell": 1}
    assert report["ignored"] == {"sar_compression: odometry": 1}
    assert any("channels [3] did not arrive" in sentence for sentence in report["warnings"])
    assert report["comparisons"] > 15
    after = BagReader(tmp_path / "out" / "bag")
    assert after.topics["/platform/odometry"].count == reader.topics["/platform/odometry"].count - 1
    assert after.topics["/phase_history"].count == reader.topics["/phase_history"].count - 1


STRIPS, BLOCKS, IMAGES = 3, 5, 3


@pytest.fixture(scope="module")
def strips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag of a sensor in three strips of five blocks, of which three complete images, in a swath of 6 m."""
    preset = load_preset("sal_stripmap")
    preset = replace(
        preset,
        dwells=STRIPS * BLOCKS,
        flight=replace(preset.flight, passes=Passes(STRIPS, 100.0)),
        sensor=replace(preset.sensor, detectors=16, sample_count=128),
        image=replace(preset.image, rows=92),
        impairments=Impairments(odometry=ERRORS),
    )
    return record_sensor(preset, 1, tmp_path_factory.mktemp("strips") / "bag")


@pytest.fixture(scope="module")
def adjusted_strips(strips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("adjusted") / "out"
    assert main(["adjust", str(strips), "--out", str(out), *KNOWN]) == 0
    return out


def errors_of(bag: Path) -> F64:
    """Median errors of the heights of all images of a bag, where they are said to be, and their median sigmas, m.

    Shape (strips, images, 2).
    """
    scheme, ml = plan(bag, {}, ("ml",)), ESTIMATORS["ml"]
    settings = parameters_of(ml.node, scheme.values.get(ml.node, {}))
    found: list[tuple[float, float]] = []
    for made in BagRun(scheme, ["sar_compression"]).results():
        if isinstance(made.result, Product) and isinstance(images := made.result.item, Images):
            assert images.source
            first = heights(images.slc, images.source.sensor, ml, settings).first
            east, north, height = sphere_coordinates(first.positions)
            error = np.nanmedian(height - street().heights(east, north))
            found.append((float(error), float(np.nanmedian(first.sigma))))
    return np.array(found).reshape(STRIPS, IMAGES, 2)


@pytest.mark.thorough
def test_strips_of_a_bag_are_adjusted(adjusted_strips: Path) -> None:
    report = json.loads((adjusted_strips / "report.json").read_text())
    assert report["dwells"] == STRIPS * IMAGES
    assert report["dropped"] == {}
    assert report["comparisons_that_contradict"] == 0
    assert report["dwells_without_comparison"] == 0
    found = [report["parameters"][f"boresight {axis} (rad)"] for axis in "xyz"]
    off = np.array([one["error"] for one in found]) + BORESIGHT
    assert np.all(np.abs(off) < 4 * np.array([one["sigma"] for one in found]))
    assert np.all(np.array(report["sigma_between_dwells_m"]) < [0.1, 0.1, 0.02])
    assert "Without known ground all dwells together may lie off by" in " ".join(report["warnings"])


@pytest.mark.thorough
def test_a_replay_forms_strips_with_the_corrected_odometry_whose_heights_agree(
    strips: Path, adjusted_strips: Path
) -> None:
    """Within 1 cm; before, they lie more than 20 cm apart. All together they are within 3 sigma of the truth."""
    before, after = errors_of(strips), errors_of(adjusted_strips / "bag")
    assert np.ptp(np.median(before[..., 0], axis=1)) > 0.2
    assert np.ptp(np.median(after[..., 0], axis=1)) < 0.01, after
    assert abs(np.median(after[..., 0])) < 3 * np.median(after[..., 1])
