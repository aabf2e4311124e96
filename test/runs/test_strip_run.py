"""A stripmap flight through the nodes: images join, heights are right, also in gusts."""

from __future__ import annotations

import dataclasses
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import load_preset

DWELLS = 4


def test_strip_images_join_and_their_heights_are_right(tmp_path: Path, replay: Any) -> None:
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
    assert abs(errors["bias_m"]) < 3 * errors["sigma_m"] / np.sqrt(errors["cells"])
    assert errors["rms_m"] < 2 * errors["crb_m"]
    compared = replay(tmp_path / "run" / "bag", tmp_path / "again", {}).compared
    assert [result.verdict for result in compared.values()] == ["equal"] * 3
