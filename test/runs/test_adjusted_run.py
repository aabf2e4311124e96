"""A run whose heights are adjusted live, and what replays make of its bag."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.graph.plan import Execution
from sal_height.runs.chain.chain_runs import plan
from sal_height.runs.chain.entry import FROM_HEIGHTS, IMAGES, Part
from sal_height.runs.truth.report import read_images
from sal_height.runs.truth.simulate import Flown, fly
from sal_height.simulation import load_preset
from sal_height.simulation.preset import Passes

pytestmark = pytest.mark.thorough  # what it joins is in nodes/test_height_adjuster.py and products/test_adjust.py

PASSES, DWELLS = 2, 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("adjusted")


@pytest.fixture(scope="module")
def flown(folder: Path) -> Flown:
    """Two passes of five dwells, with all errors of sal_realistic."""
    preset = load_preset("sal_passes")
    flight = replace(preset.flight, passes=Passes(PASSES, 120.0))
    preset = replace(preset, dwells=DWELLS, flight=flight, estimators=("ml", "adjusted"))
    return fly(preset, 2, folder / "run", {}, Execution(record=("slc",)))


def test_the_heights_of_a_run_come_together(flown: Flown, folder: Path) -> None:
    """What is left between dwells, the first ones of passes included, is three quarters of what it was, at most.

    Those show too little to be recognised. Nothing is lost, and the map is made of them.
    """
    statistics = flown.accuracy.statistics
    assert statistics["adjusted"]["s68_m"] < statistics["ml"]["s68_m"] * 0.75
    assert flown.outcome.losses == []
    images = read_images(folder / "run" / "bag")["adjusted"]
    assert [image.dwell for image in images] == list(range(DWELLS))
    parts = {one.name for one in images[-1].provenance.parameters}
    assert {"height_adjuster.pose_error", "sar_compression.placement.speed"} <= parts
    topics = BagReader(folder / "run" / "bag").topics
    assert topics["/adjusted/odometry"].count >= 2 * PASSES
    account = flown.outcome.stages["relief_mapper"]
    assert account.received == DWELLS


def test_a_replay_repeats_them_to_the_bit(flown: Flown, folder: Path, replay: Any, tmp_path: Path) -> None:
    found = replay(folder / "run" / "bag", tmp_path / "replay", {})
    assert {topic: one.verdict for topic, one in found.compared.items()} == dict.fromkeys(
        ("/ml/height", "/adjusted/height", "/tracked/height"), EQUAL
    )
    errors = [run["adjusted"]["s68_m"] for run in (found.accuracy, flown.accuracy.statistics)]
    assert errors[0] == pytest.approx(errors[1])


@pytest.mark.usefixtures("flown")
def test_a_replay_from_heights_makes_the_map_of_them(folder: Path, replay: Any, tmp_path: Path) -> None:
    found = replay(folder / "run" / "bag", tmp_path / "mapped", {}, part=Part(FROM_HEIGHTS))
    assert found.outcome.stages["relief_mapper"].received == DWELLS
    assert found.outcome.losses == []


@pytest.mark.usefixtures("flown")
def test_where_odometry_is_not_played_they_are_left_out_or_refused(folder: Path, replay: Any, tmp_path: Path) -> None:
    images = Part(IMAGES)
    with pytest.raises(UserError) as refused:
        replay(folder / "run" / "bag", tmp_path / "none", {}, estimators=("ml", "adjusted"), part=images)
    assert_one_sentence(str(refused.value), "with the odometry", "phase_history")
    found = replay(folder / "run" / "bag", tmp_path / "images", {}, part=images)
    assert "height_adjuster" not in found.outcome.stages
    assert found.compared["/ml/height"].verdict == EQUAL


@pytest.mark.usefixtures("flown")
def test_a_batch_leaves_them_out(folder: Path) -> None:
    """Its bags are tracked as before; that it refuses to make them is in test_batch."""
    scheme = plan(folder / "run" / "bag", {})
    assert "height_adjuster" not in {*scheme.chain.stages, *scheme.chain.makers}


@pytest.mark.usefixtures("flown")
def test_sigma_holds_the_errors_of_adjusted_heights(folder: Path, flown: Flown) -> None:
    """Errors of all dwells together are within 3 sigma, which is smaller than before."""
    sigmas = {
        prefix: np.nanmedian([np.nanmedian(image.surfaces[0].sigma) for image in images])
        for prefix, images in read_images(folder / "run" / "bag").items()
    }
    assert sigmas["adjusted"] < 0.9 * sigmas["ml"]
    assert abs(flown.accuracy.statistics["adjusted"]["bias_m"]) < 3 * sigmas["adjusted"]


def test_strips_of_a_run_come_together_and_a_replay_repeats_them_to_the_bit(replay: Any, tmp_path: Path) -> None:
    """Of three strips of three images, the last one is recognised while it grows: sigma falls from 53 to 31 cm."""
    preset = load_preset("sal_strips")
    flight = replace(preset.flight, passes=Passes(3, 60.0))
    preset = replace(preset, dwells=15, flight=flight, estimators=("ml", "adjusted"))
    flown = fly(preset, 4, tmp_path / "strips", {}, Execution())
    assert flown.outcome.losses == []
    images = read_images(tmp_path / "strips" / "bag")
    before, after = ([np.nanmedian(one.surfaces[0].sigma) for one in images[name]] for name in ("ml", "adjusted"))
    assert len(after) == 9
    np.testing.assert_allclose(after[:7], before[:7], rtol=0.02)
    assert after[-1] < 0.7 * before[-1]
    found = replay(tmp_path / "strips" / "bag", tmp_path / "strips_again", {})
    assert {topic: one.verdict for topic, one in found.compared.items()} == dict.fromkeys(
        ("/ml/height", "/adjusted/height", "/tracked/height"), EQUAL
    )
