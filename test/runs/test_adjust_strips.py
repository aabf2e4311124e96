"""`sal-height adjust` of strips to and fro: heights made again with the corrected odometry agree."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flown_passes import BORESIGHT, ERRORS

from sal_height.commands import main
from sal_height.elevation import ESTIMATORS
from sal_height.engine.image_items import Images
from sal_height.engine.stage import Product
from sal_height.geometry import sphere_coordinates
from sal_height.graph.catalogue import parameters_of
from sal_height.numeric import F64
from sal_height.pipeline import heights
from sal_height.runs.chain.chain_runs import BagRun, plan
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.simulation import load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.preset import Passes
from sal_height.simulation.scenes import street

STRIPS, BLOCKS, IMAGES = 3, 5, 3
KNOWN = ["--set", "boresight_sigma_rad=3e-5", "--set", "lever_arm_sigma_m=0.01"]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def adjusted(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("adjusted") / "out"
    assert main(["adjust", str(flight), "--out", str(out), *KNOWN]) == 0
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


def test_strips_of_a_bag_are_adjusted(adjusted: Path) -> None:
    report = json.loads((adjusted / "report.json").read_text())
    assert report["dwells"] == STRIPS * IMAGES
    assert report["dropped"] == {}
    assert report["comparisons_that_contradict"] == 0
    assert report["dwells_without_comparison"] == 0
    found = [report["parameters"][f"boresight {axis} (rad)"] for axis in "xyz"]
    off = np.array([one["error"] for one in found]) + BORESIGHT
    assert np.all(np.abs(off) < 4 * np.array([one["sigma"] for one in found]))
    assert np.all(np.array(report["sigma_between_dwells_m"]) < [0.1, 0.1, 0.02])
    assert "Without known ground all dwells together may lie off by" in " ".join(report["warnings"])


def test_a_replay_forms_strips_with_the_corrected_odometry_whose_heights_agree(flight: Path, adjusted: Path) -> None:
    """Within 1 cm; before, they lie more than 20 cm apart. All together they are within 3 sigma of the truth."""
    before, after = errors_of(flight), errors_of(adjusted / "bag")
    assert np.ptp(np.median(before[..., 0], axis=1)) > 0.2
    assert np.ptp(np.median(after[..., 0], axis=1)) < 0.01, after
    assert abs(np.median(after[..., 0])) < 3 * np.median(after[..., 1])
