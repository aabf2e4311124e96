"""A simulated flight through air: a probe tells of it to the run, to its replay and to the bag of the sensor alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence
from rewritten_bag import rewritten

from sal_height import messages
from sal_height.bag.check import check_bag
from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.truth.report import read_images
from sal_height.runs.truth.simulate import Flown, fly
from sal_height.simulation import load_preset
from sal_height.simulation.air import SimulatedAir

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
