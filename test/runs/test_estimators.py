"""Which estimators a run makes heights with, and with which parameters: by default, by preset, when asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.elevation import ESTIMATORS
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS, SETTABLE, consumers, suited
from sal_height.graph.node_classes import NODES
from sal_height.nodes.processing import PROCESSING
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.truth.simulate import fly, run
from sal_height.settings import settings_of
from sal_height.simulation import load_preset, parse_preset

SMALL = load_preset("small").make_sensor()
PAIR = load_preset("xband_sumdiff").make_sensor()


def test_every_estimator_has_a_node_with_its_settings_and_topics() -> None:
    for name, estimator in ESTIMATORS.items():
        node = NODES[estimator.node]
        assert node is PROCESSING[estimator.node]
        assert HEIGHTS[estimator.node] == node.product == name
        assert estimator.node in SETTABLE
        assert {*settings_of(estimator.settings), "timeout_s"} <= {*settings_of(node.parameters)}
        assert name in settings_of(NODES["relief_tracker"].parameters)["estimator"].choices
        assert name in settings_of(NODES["relief_mapper"].parameters)["estimator"].choices


def test_by_default_those_run_that_suit_the_sensor_and_need_not_be_asked_for() -> None:
    assert suited(SMALL) == ["monopulse", "ml_height"]
    assert suited(PAIR) == ["monopulse", "ml_height", "sum_difference_height"]
    one = replace(SMALL, elevation_boresights=SMALL.elevation_boresights[:1], noise_power=(1.0,), config_hash="")
    assert suited(one) == []


def test_those_that_are_asked_for_run_in_the_order_of_the_registry() -> None:
    assert suited(SMALL, ["music", "ml", "capon"]) == ["ml_height", "capon_height", "music_height"]


@pytest.mark.parametrize(("name", "words"), [("capn", "does not exist"), ("sum_difference", "does not suit")])
def test_an_estimator_that_cannot_be_had_is_refused(name: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        suited(SMALL, ["ml", name])
    assert_one_sentence(str(refused.value), name, words, "allowed are monopulse, ml, capon, music")


def test_tracker_and_mapper_take_heights_that_are_made() -> None:
    assert consumers(["monopulse", "ml_height", "capon_height"]) == {}
    assert consumers([]) == {}
    assert consumers(["capon_height", "music_height"]) == {
        "relief_tracker": {"estimator": "capon"},
        "height_adjuster": {"estimator": "capon"},
        "relief_mapper": {"estimator": "capon"},
        "ground_mapper": {"estimator": "capon"},
    }


def test_adjusted_heights_are_asked_for_as_if_they_were_of_an_estimator() -> None:
    """The adjuster takes those of ml or of the first, and mappers take the adjusted ones."""
    assert suited(SMALL, ["adjusted", "capon"]) == ["capon_height", "height_adjuster"]
    assert suited(SMALL, ["adjusted"]) == ["monopulse", "ml_height", "height_adjuster"]
    adjusted = {"relief_mapper": {"estimator": "adjusted"}, "ground_mapper": {"estimator": "adjusted"}}
    assert consumers(["ml_height", "height_adjuster"]) == adjusted
    assert consumers(["capon_height", "height_adjuster"]) == {
        "relief_tracker": {"estimator": "capon"},
        "height_adjuster": {"estimator": "capon"},
        **adjusted,
    }


def test_a_preset_names_estimators_and_parameters_and_a_replay_repeats_them(tmp_path: Path, replay: Any) -> None:
    """Parameters that are given with the run override those of the preset."""
    processing = {"sar_compression": {"range_window": "hamming"}, "capon_height": {"loading": 2.0, "min_cnr_db": 8.0}}
    preset = replace(load_preset("small"), dwells=1, estimators=("music", "capon"), processing=processing)
    fly(preset, 1, tmp_path / "run", {"capon_height": {"min_cnr_db": 6.0}})
    reader = BagReader(tmp_path / "run" / "bag")
    assert {topic for topic in reader.topics if topic.endswith("/height")} == {
        "/capon/height",
        "/music/height",
        "/tracked/height",
    }
    values = recorded_parameters(reader)
    assert values["sar_compression"]["range_window"] == "hamming"
    assert (values["capon_height"]["loading"], values["capon_height"]["min_cnr_db"]) == (2.0, 6.0)
    assert values["relief_tracker"]["estimator"] == "capon"
    compared = replay(tmp_path / "run" / "bag", tmp_path / "replay", {}).compared
    assert set(compared) == {"/capon/height", "/music/height", "/tracked/height"}
    assert {result.verdict for result in compared.values()} == {EQUAL}


@pytest.mark.parametrize(
    ("processing", "words"),
    [
        ({"sar_compression": {"former": "none"}}, ("sar_compression", "former", "auto")),
        ({"ml_height": {"looks": 2}}, ("ml_height", "looks", "range_looks")),
        ({"recorder": {"topics": "slc"}}, ("recorder", "ml_height")),
    ],
)
def test_a_preset_with_wrong_parameters_is_refused_before_anything_is_made(
    tmp_path: Path, processing: dict[str, dict[str, object]], words: tuple[str, ...]
) -> None:
    preset = replace(load_preset("small"), processing=processing)
    with pytest.raises(UserError) as refused:
        run(preset, 1, tmp_path / "run", {})
    assert_one_sentence(str(refused.value), *words)
    assert not (tmp_path / "run").exists()


def test_a_preset_file_may_hold_both() -> None:
    import dataclasses

    given = dataclasses.asdict(load_preset("small"))
    read = parse_preset({**given, "estimators": ["ml"], "processing": {"ml_height": {"layover": False}}}, "a file")
    assert read.estimators == ("ml",)
    assert read.processing == {"ml_height": {"layover": False}}
    with pytest.raises(UserError, match="processing"):
        parse_preset({**given, "processing": {"ml_height": 7}}, "a file")
