"""Budgets of presets: what sensors need and give."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from scipy.constants import speed_of_light

from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.runs.budget import Assumptions, Budget, budget_table
from sal_height.simulation import Preset, flight_of, load_preset, preset_names
from sal_height.simulation.odometry_errors import OdometryErrors


def numbers(preset: Preset, **assumed: float) -> dict[str, float]:
    return {entry.key: entry.value for entry in Budget(preset, Assumptions(**assumed)).entries()}


def test_the_lidar_of_the_paper() -> None:
    """Closed forms at 5 km, 45 degrees and 50 m/s, and the errors that the design lists."""
    found = numbers(load_preset("sal_spotlight"))
    assert found["range_cell_m"] == pytest.approx(speed_of_light / 2 / 5e9)
    assert found["along_cell_m"] == pytest.approx(0.0484, rel=1e-3)
    assert found["beam_across_m"] == pytest.approx(0.775)
    assert found["roll_m_per_urad"] == pytest.approx(3.5e-3, rel=0.02)
    assert found["velocity_m_per_mm_per_s"] == pytest.approx(0.1)
    assert found["vibration_um"] == pytest.approx(0.0247, rel=1e-2)
    assert found["radial_velocity_mps"] == pytest.approx(1.55e-6 * 40e3 / 4)
    assert found["mean_mb_per_s"] == pytest.approx(2.097152 * 50 / 0.58125)
    assert 90 < found["power_w"] < 150
    assert found["air_height_by_range_m"] == pytest.approx(-0.81, rel=0.05)


def test_air_that_is_not_known_is_left_out() -> None:
    preset = load_preset("sal_spotlight")
    high = replace(preset, flight=replace(preset.flight, slant_range_m=100e3))
    assert "air_range_m" not in numbers(high)


def test_what_the_grade_of_a_navigation_does_is_in_the_budget() -> None:
    """At 5 km, 45 degrees and 50 m/s, with 5 mm/s, 0.005 and 0.008 degrees."""
    preset = load_preset("sal_spotlight")
    assert "navigation_height_m" not in numbers(preset)
    graded = replace(preset, impairments=replace(preset.impairments, odometry=OdometryErrors(grade="navigation")))
    found = numbers(graded)
    assert found["navigation_position_m"] == pytest.approx(0.1)
    assert found["navigation_along_m"] == pytest.approx(0.5)
    assert found["navigation_height_m"] == pytest.approx(5000 * 0.5**0.5 * 0.005 * math.pi / 180)
    assert found["navigation_beams_m"] == pytest.approx(5000 * 0.5**0.5 * 0.008 * math.pi / 180)
    assert "errors of the navigation, rms, navigation grade\n" in budget_table(Budget(graded, Assumptions()).entries())


def test_power_and_cnr_are_two_views_of_one_link() -> None:
    preset = load_preset("sal_spotlight")
    usual = numbers(preset)
    assert usual["cnr_db"] == pytest.approx(preset.cnr_db)
    given = numbers(preset, power=usual["power_w"] / 10)
    assert given["cnr_db"] == pytest.approx(preset.cnr_db - 10)
    assert given["height_sigma_m"] > 2 * usual["height_sigma_m"]
    worse = numbers(preset, loss=10.0, noise_figure=2.0)
    assert worse["power_w"] == pytest.approx(20 * usual["power_w"])


@pytest.mark.parametrize("name", preset_names())
def test_the_least_pulse_repetition_frequency_is_what_a_flight_demands(name: str) -> None:
    preset = load_preset(name)
    least = numbers(preset)["least_prf_hz"]
    assert least <= preset.sensor.pulse_repetition_frequency_hz * (1 + 1e-6)
    slower = replace(preset.sensor, pulse_repetition_frequency_hz=0.999 * least)
    flight = replace(preset.flight, dwell_spacing_m=1e4) if preset.flight.dwell_spacing_m else preset.flight
    with pytest.raises(UserError, match=r"pulse_repetition_frequency_hz.* must be"):
        flight_of(replace(preset, sensor=slower, flight=flight, impairments=type(preset.impairments)()), seed=0)


def test_a_strip_resolves_half_the_antenna() -> None:
    preset = load_preset("sal_stripmap")
    antenna = preset.sensor.azimuth_aperture_m or preset.sensor.aperture_m
    assert numbers(preset)["along_cell_m"] == pytest.approx(antenna / 2)


@pytest.mark.parametrize("waveform", ["chirp", "deramped"])
def test_the_range_window_of_a_pulse_is_what_its_record_holds_beside_it(waveform: str) -> None:
    preset = load_preset("xband_relief")
    pulse_s, rate_hz = 10e-6, 16e6
    sensor = replace(
        preset.sensor,
        waveform=waveform,
        pulse_duration_s=pulse_s,
        sampling_rate_hz=rate_hz,
        sample_count=1024,
    )
    window_s = 1025 / rate_hz - pulse_s if waveform == "chirp" else rate_hz * pulse_s / sensor.bandwidth_hz
    found = numbers(replace(preset, sensor=sensor))["window_m"]
    assert found == pytest.approx(speed_of_light / 2 * window_s * 2**0.5)


def test_the_command_prints_and_draws_a_budget(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["budget", "xband_relief", "--power", "100", "--loss-db", "6", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "mean power transmitted" in printed
    content = json.loads((out / "budget.json").read_text(encoding="utf-8"))
    assert content["power_w"] == 100
    assert content["loss_db"] == pytest.approx(6)
    with Image.open(out / "budget.png") as picture:
        assert picture.size[0] > 1500


def test_what_is_not_a_preset_is_refused_and_leaves_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["budget", "no_such", "--out", str(tmp_path / "out")]) == 2
    assert "no_such" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
