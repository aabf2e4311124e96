"""A preset that names a file of measured beams, from the file to heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from chain_fixture import Chain
from sal_height_msgs.msg import HeightImage

from sal_height.beam_table import BeamTable, write_beam_tables
from sal_height.flight import SimulatedFlight
from sal_height.nodes.graph import Graph
from sal_height.optics import pattern_named
from sal_height.preset import load_preset
from sal_height.terrain import load_scene

SMALL = Path(__file__).parents[2] / "sal_height" / "presets" / "small.yaml"


@pytest.fixture
def measured(tmp_path: Path) -> str:
    """The small preset with a table of its own beam beside it."""
    beamwidth = load_preset("small").sensor.beamwidth_rad
    elevation, azimuth = np.arange(-7, 7.05, 0.1), np.arange(-2, 2.05, 0.1)
    values = pattern_named("jinc").amplitude(elevation[:, None], azimuth).ravel()
    angles = tuple((elevation * beamwidth).tolist()), tuple((azimuth * beamwidth).tolist())
    table = BeamTable(*angles, tuple(values.tolist()), (0.0,) * len(values))
    write_beam_tables(tmp_path / "beams.csv", [table], beamwidth)
    content = yaml.safe_load(SMALL.read_text())
    content["sensor"]["pattern"] = "beams.csv"
    path = tmp_path / "measured.yaml"
    path.write_text(yaml.safe_dump(content))
    return str(path)


def test_heights_with_a_table_of_the_beam_are_those_with_its_formula(
    graph: Graph, measured: str, reference: dict[tuple[str, int], HeightImage]
) -> None:
    preset = load_preset(measured)
    sensor = preset.make_sensor()
    assert (sensor.pattern, len(sensor.beam_tables)) == ("table", 1)
    flight = SimulatedFlight(preset, sensor, load_scene(preset.scene), preset.dwells, seed=7)
    chain = Chain(graph, flight, missing_after_s=30.0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    for estimator in ("ml", "monopulse"):
        heights, expected = (np.array(images[estimator, 0].height) for images in (chain.heights, reference))
        assert np.mean(np.isfinite(heights) == np.isfinite(expected)) > 0.95
        both = np.isfinite(heights) & np.isfinite(expected)
        assert both.sum() > 30
        np.testing.assert_allclose(heights[both], expected[both], atol=1e-3)
