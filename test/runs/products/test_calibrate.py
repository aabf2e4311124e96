"""`sal-height calibrate`: a recorded flight calibrates its sensor, and a replay with that has better heights."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence
from rosbags.highlevel import AnyReader

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.calibration.files import load_calibration, save_calibration
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS
from sal_height.runs.chain.entry import Part
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.products.calibrate import CALIBRATION, beam_width, calibrate
from sal_height.runs.replay import bag_replay
from sal_height.runs.truth.report import read_accuracy
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.flight import flight_of
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.preset import Preset, load_preset

DWELLS = 10
WIDTH = 1.05
GAINS_DB = (0.8, -0.8, 1.2, -0.5, 0.3, -1.3, 0.6, -0.3)


@pytest.fixture(scope="module")
def impaired() -> Preset:
    """A lidar whose beams are 5 % wider, and whose receivers have other gains, than described."""
    faults = Impairments(beam_width_factor=WIDTH, undescribed_gains_db=GAINS_DB)
    return dataclasses.replace(load_preset("small"), dwells=DWELLS, impairments=faults)


@pytest.fixture(scope="module")
def flown(impaired: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("impaired") / "run"
    fly(impaired, 1, out, {})
    return out


@pytest.fixture(scope="module")
def calibrated(flown: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("calibrated") / "out"
    assert main(["calibrate", str(flown / "bag"), "--out", str(out)]) == 0
    return out


def test_beams_and_gains_are_found(calibrated: Path) -> None:
    """Within 4 standard errors, which are small: .5 % of the width, .2 dB."""
    found = load_calibration(calibrated / CALIBRATION)
    assert 0 < found.width_sigma < 0.005
    assert abs(found.width_factor - WIDTH) < 4 * found.width_sigma
    gains_db = 20 * np.log10(np.abs(found.response.mean(axis=1)))
    error = gains_db - gains_db.mean() - (np.array(GAINS_DB) - np.mean(GAINS_DB))
    sigma_db = 20 / np.log(10) * found.gain_sigma
    assert np.all((sigma_db > 0) & (sigma_db < 0.2))
    assert np.all(np.abs(error) < 4 * sigma_db)
    report = json.loads((calibrated / "report.json").read_text())
    assert report["calibration"]["id"] == found.id
    assert report["calibration"]["width_factor"] == found.width_factor
    assert report["stages"]["psf_calibration"]["processed"] == 8 * DWELLS
    assert (calibrated / "calibration.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_heights_are_better_with_it(
    impaired: Preset, flown: Path, calibrated: Path, tmp_path: Path, replay: Any
) -> None:
    """Monopulse heights stretch with the width of the beams, and gains shift them; noise and layover remain.

    They leave 0.60 of the error of monopulse in this flight, and 0.86 of that of maximum likelihood.
    """
    applied = {"sar_compression": {"calibration": str(calibrated / CALIBRATION)}}
    replay(flown / "bag", tmp_path / "again", applied)
    flight = flight_of(impaired, 1)
    before, after = (
        {
            name: one["rms_m"]
            for name, one in read_accuracy(folder / "bag", flight, ["monopulse", "ml_height"]).statistics.items()
        }
        for folder in (flown, tmp_path / "again")
    )
    assert after["monopulse"] < 0.65 * before["monopulse"]
    assert after["ml"] < 0.9 * before["ml"]
    reader = BagReader(tmp_path / "again" / "bag")
    found = load_calibration(calibrated / CALIBRATION).id
    assert [reader.topics[name].count for name in ("/calibration",)] == [1]
    topics = [f"/{prefix}/height" for prefix in HEIGHTS.values()]
    images = [reader.decode(one.type_name, one.cdr) for one in reader.messages(topics)]
    assert {image.provenance.calibration_id for image in images} == {found}
    begin = Part(last=1)
    third = replay(tmp_path / "again" / "bag", tmp_path / "third", {}, part=begin)  # with the calibration in the bag
    assert len(third.compared) == 3
    assert {result.verdict for result in third.compared.values()} == {"equal"}
    report = json.loads((tmp_path / "third" / "report.json").read_text())
    assert report["parameters"]["sar_compression"]["calibration"] == "topic"
    assert report["changes_in_flight"] == [{"dwell": 0, "calibration": found, "source": "provenance"}]


def test_a_replay_with_a_calibration_has_it_in_its_bag_which_replays_equal(
    flown: Path, calibrated: Path, tmp_path: Path
) -> None:
    """Of two dwells, by calls: whose heights are other than those without it."""
    file = calibrated / CALIBRATION
    applied = {"sar_compression": {"calibration": str(file)}}
    two = Part(last=1)
    first = bag_replay.replay(flown / "bag", tmp_path / "first", applied, estimators=["ml"], jobs=1, part=two)
    assert first.compared["/ml/height"].verdict != EQUAL
    assert BagReader(tmp_path / "first" / "bag").topics["/calibration"].count == 1
    again = bag_replay.replay(tmp_path / "first" / "bag", tmp_path / "again", {}, jobs=1, part=Part(last=0))
    assert again.compared["/ml/height"].verdict == EQUAL
    report = json.loads((tmp_path / "again" / "report.json").read_text())
    assert report["parameters"]["sar_compression"]["calibration"] == "topic"
    changes = [{"dwell": 0, "calibration": load_calibration(file).id, "source": "provenance"}]
    assert report["changes_in_flight"] == changes


def test_it_is_refused_for_a_sensor_that_is_as_described(recorded: Path, calibrated: Path, tmp_path: Path) -> None:
    """Whose heights stay equal; its own measured values are those of another instrument here."""
    found = load_calibration(calibrated / CALIBRATION)
    sensor = flight_of(load_preset("small"), 3).sensor
    save_calibration(tmp_path / "other.npz", dataclasses.replace(found, config_hash=sensor.config_hash))
    applied = {"sar_compression": {"calibration": str(tmp_path / "other.npz")}}
    made = bag_replay.replay(recorded / "bag", tmp_path / "out", applied, estimators=["ml"], jobs=1)
    assert made.compared["/ml/height"].verdict == EQUAL
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["stages"]["sar_compression"]["ignored"] == {"calibration refused": 1}


def test_rosbags_reads_the_calibration_by_the_schema_in_the_bag(calibrated: Path) -> None:
    found = load_calibration(calibrated / CALIBRATION)
    with AnyReader([calibrated / "bag"]) as reader:
        (connection,) = [one for one in reader.connections if one.topic == "/calibration"]
        ((_, _, raw),) = reader.messages([connection])
        message = reader.deserialize(raw, connection.msgtype)
    assert message.id == found.id
    response = message.response.view(np.complex128)
    assert np.array_equal(response.reshape(message.channels, message.frequencies), found.response)
    assert np.array_equal(message.gain_sigma, found.gain_sigma)
    assert np.all(found.gain_sigma > 0)


def test_what_tells_too_little_says_what_is_needed(recorded: Path, tmp_path: Path) -> None:
    """Two dwells: all stays as described, with the reasons in the message."""
    calibrate(recorded / "bag", tmp_path / "out", {})
    reader = BagReader(tmp_path / "out" / "bag")
    (message,) = [reader.decode(one.type_name, one.cdr) for one in reader.messages(["/calibration"])]
    assert len(message.undetermined) == 2
    for sentence in message.undetermined:
        assert_one_sentence(sentence)
    found = load_calibration(tmp_path / "out" / CALIBRATION)
    assert beam_width(found) == "not determined"
    assert found.width_factor == 1.0
    assert np.isnan(found.width_sigma)


def test_settings_in_the_preset_reach_the_calibration_of_its_bag(tmp_path: Path) -> None:
    """They are recorded with the run, which has no use for them itself; those of the command replace them."""
    wanted = {"pixels_per_parameter": 1000, "min_energy": 60.0}
    preset = dataclasses.replace(load_preset("small"), dwells=1, processing={"psf_calibration": wanted})
    fly(preset, 1, tmp_path / "run", {})
    calibrate(tmp_path / "run" / "bag", tmp_path / "out", {"psf_calibration": {"min_energy": 70.0}})
    reader = BagReader(tmp_path / "out" / "bag")
    (message,) = [reader.decode(one.type_name, one.cdr) for one in reader.messages(["/calibration"])]
    assert any("energy of 70 noise powers or more; 17000 are needed" in sentence for sentence in message.undetermined)


def test_dwells_of_a_sensor_with_chirps_make_one_calibration(tmp_path: Path) -> None:
    """Its samples become spectra before anything is measured."""
    preset = load_preset("small")
    chirps = dataclasses.replace(
        preset.sensor, waveform="chirp", pulse_duration_s=100e-9, sampling_rate_hz=2.5e9, sample_count=329
    )
    bag = record_sensor(dataclasses.replace(preset, sensor=chirps, dwells=3), 4, tmp_path / "flight")
    _, calibration = calibrate(bag, tmp_path / "out", {})
    assert calibration is not None
    assert calibration.dwells == 3


def test_weighted_images_make_no_calibration(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"The 2 dwells of .* gave no calibration"):
        calibrate(recorded / "bag", tmp_path / "out", {"sar_compression": {"range_window": "taylor"}})
    assert BagReader(tmp_path / "out" / "bag").topics["/losses"].count == 2  # dwells
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["stages"]["psf_calibration"]["dropped"] == {"cannot be processed": 16}
    assert "gave no calibration" in report["failed"]


def test_parameters_of_nodes_that_are_not_there_are_refused(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no node 'ml_height' .* allowed are sar_compression, psf_calibration"):
        calibrate(recorded / "bag", tmp_path / "out", {"ml_height": {"objective": "numerator"}})
    assert not (tmp_path / "out").exists()
