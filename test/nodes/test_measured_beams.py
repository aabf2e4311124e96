"""A preset that names a file of measured beams, from the file to heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from chain_fixture import Chain

from sal_height import beam_table, convert
from sal_height.flight import SimulatedFlight
from sal_height.nodes.graph import Graph
from sal_height.optics import pattern_named
from sal_height.preset import load_preset
from sal_height.terrain import load_scene

SMALL = Path(__file__).parents[2] / "sal_height" / "presets" / "small.yaml"


def heights_with(graph: Graph, preset_path: str) -> np.ndarray:
    """Heights of one dwell of a preset over the street."""
    preset = load_preset(preset_path)
    flight = SimulatedFlight(preset, preset.make_sensor(), load_scene(preset.scene), dwells=1, seed=7)
    chain = Chain(graph, flight, missing_after_s=20.0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    image = chain.heights["ml", 0]
    return np.array(convert.float_view(image.height, (image.grid.rows, image.grid.cols)))


@pytest.fixture
def measured(tmp_path: Path) -> Path:
    """The small preset with a table of its own beam beside it."""
    if not hasattr(beam_table, "write_beam_tables"):
        pytest.skip("there are no files of beams yet")
    beamwidth = load_preset("small").sensor.beamwidth_rad
    elevation, azimuth = np.arange(-7, 7.05, 0.1), np.arange(-2, 2.05, 0.1)
    values = pattern_named("jinc").amplitude(elevation[:, None], azimuth).ravel()
    angles = tuple((elevation * beamwidth).tolist()), tuple((azimuth * beamwidth).tolist())
    table = beam_table.BeamTable(*angles, tuple(values.tolist()), (0.0,) * len(values))
    beam_table.write_beam_tables(tmp_path / "beams.csv", [table], beamwidth)
    content = yaml.safe_load(SMALL.read_text())
    content["sensor"]["pattern"] = "beams.csv"
    path = tmp_path / "measured.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_heights_with_a_table_of_the_beam_are_those_with_its_formula(graph: Graph, measured: Path) -> None:
    with_table = heights_with(graph, str(measured))
    assert load_preset(str(measured)).make_sensor().pattern == "table"
    assert np.isfinite(with_table).mean() > 0.2
    preset = load_preset("small")
    flight = SimulatedFlight(preset, preset.make_sensor(), load_scene(preset.scene), dwells=1, seed=7)
    truth = flight.surface(0)
    assert truth.heights.min() - 0.1 < np.nanmin(with_table)
    assert np.nanmax(with_table) < truth.heights.max() + 0.1
