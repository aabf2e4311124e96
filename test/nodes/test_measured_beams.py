"""A preset that names a file of measured beams, from the file to heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from beam_tables import write_beam_tables
from chain_fixture import StageChain

from sal_height.beams.pattern import pattern_named
from sal_height.beams.table import BeamTable
from sal_height.messages.types import HeightImage
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scenes import load_scene

SMALL = Path(__file__).parents[2] / "sal_height" / "presets" / "small.yaml"


def measured(folder: Path, tilt: float) -> str:
    """The small preset with a table of its own beam beside it, whose phase grows by `tilt` rad per beamwidth."""
    beamwidth = load_preset("small").sensor.beamwidth_rad
    elevation, azimuth = np.arange(-7, 7.05, 0.1), np.arange(-2, 2.05, 0.1)
    amplitude = pattern_named("jinc").amplitude(elevation[:, None], azimuth)
    values = (amplitude * np.exp(1j * tilt * elevation[:, None])).ravel()
    angles = tuple((elevation * beamwidth).tolist()), tuple((azimuth * beamwidth).tolist())
    table = BeamTable(*angles, tuple(values.real.tolist()), tuple(values.imag.tolist()))
    write_beam_tables(folder / "beams.csv", [table], beamwidth)
    content = yaml.safe_load(SMALL.read_text())
    content["sensor"]["pattern"] = "beams.csv"
    path = folder / "measured.yaml"
    path.write_text(yaml.safe_dump(content))
    return str(path)


def seen_with(preset_path: str) -> dict[tuple[str, int], HeightImage]:
    """Heights of the first dwell of a preset over the street."""
    preset = load_preset(preset_path)
    sensor = preset.make_sensor()
    assert (sensor.pattern, len(sensor.beam_tables)) == ("table", 1)
    flight = SimulatedFlight(preset, sensor, load_scene(preset.scene), preset.dwells, seed=7)
    chain = StageChain(flight)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    return chain.heights


ESTIMATORS = ("ml", "monopulse")


def test_heights_with_a_table_of_the_beam_are_those_with_its_formula(
    tmp_path: Path, reference: dict[tuple[str, int], HeightImage]
) -> None:
    seen = seen_with(measured(tmp_path, 0.0))
    for estimator in ESTIMATORS:
        heights, expected = (np.array(images[estimator, 0].surfaces[0].height) for images in (seen, reference))
        assert np.mean(np.isfinite(heights) == np.isfinite(expected)) > 0.95
        both = np.isfinite(heights) & np.isfinite(expected)
        assert both.sum() > 30
        np.testing.assert_allclose(heights[both], expected[both], atol=1e-3)


def test_heights_with_complex_beams_differ_by_the_noise_alone(
    tmp_path: Path, reference: dict[tuple[str, int], HeightImage]
) -> None:
    """The phases turn the noise against the echoes: two independent errors, whose median difference is .95 sigma."""
    seen = seen_with(measured(tmp_path, 0.7))
    for estimator in ESTIMATORS:
        heights, expected = (np.array(images[estimator, 0].surfaces[0].height) for images in (seen, reference))
        both = np.isfinite(heights) & np.isfinite(expected)
        assert both.sum() > 0.8 * np.isfinite(expected).sum()
        scaled = (heights - expected)[both] / np.array(reference[estimator, 0].surfaces[0].sigma)[both]
        assert abs(np.median(scaled)) < 4 * 1.25 * np.std(np.clip(scaled, -3, 3)) / np.sqrt(both.sum())
        assert np.median(np.abs(scaled)) < 1.2
