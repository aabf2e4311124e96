"""Budgets of presets: what sensors need and give."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml
from helpers import assert_one_sentence
from PIL import Image
from scipy.constants import speed_of_light

from sal_height.budget.budget import SENSITIVITY, Assumptions, Budget
from sal_height.budget.budget_errors import GROUP, budget_table
from sal_height.commands import main
from sal_height.elevation import Looks, MlSettings, ml_elevation
from sal_height.errors import UserError
from sal_height.geometry import Atmosphere, Mounting, look_direction, path_through_air
from sal_height.imaging import ImageSettings, image_beams
from sal_height.pipeline import Compressor
from sal_height.simulation import Preset, flight_of, load_preset, preset_names
from sal_height.simulation.air import SimulatedAir
from sal_height.simulation.impairments import PointingJitter, through_receivers
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import HybridSettings, OriginSettings


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


def impaired(preset: Preset, **impairments: object) -> Preset:
    return replace(preset, impairments=replace(preset.impairments, **impairments))


def test_air_that_is_not_known_is_left_out_with_a_sentence() -> None:
    preset = load_preset("sal_spotlight")
    short = replace(preset, sensor=replace(preset.sensor, wavelength_m=3e-4, aperture_m=2.0))
    found = Budget(short, Assumptions())
    assert "air_range_m" not in {entry.key for entry in found.entries()}
    assert_one_sentence(found.notes()[-1], "The table has nothing on air", "a wavelength of 0.0003 m", "allowed")
    assert found.refusals() == []
    (refusal,) = Budget(impaired(short, air=SimulatedAir()), Assumptions()).refusals()
    with pytest.raises(UserError) as refused:
        flight_of(impaired(short, air=SimulatedAir()), seed=0).phase_history(0)
    assert_one_sentence(refusal, "a wavelength of 0.0003 m", "not known")
    assert str(refused.value) == refusal


def test_air_is_that_of_the_preset_at_the_height_of_its_map() -> None:
    preset = load_preset("sal_spotlight")
    track, standard = preset.flight, numbers(preset)
    air = SimulatedAir(temperature_k=300.0, pressure_pa=60_000.0, humidity=0.5, height_m=4200.0, map_height_m=4000.0)
    above = 4000.0 + track.slant_range_m * math.cos(track.look_angle_rad)
    known = Atmosphere.measured(4200.0, 300.0, 60_000.0, 0.5)
    way = path_through_air(preset.sensor.wavelength_m, above, 4000.0, track.look_angle_rad, known)
    found = numbers(impaired(preset, air=air))
    assert found["air_range_m"] == pytest.approx(way.delay)
    assert found["air_bend_urad"] == pytest.approx(1e6 * way.bend)
    assert found["air_map_height_m"] == 4000.0
    assert found["air_range_m"] < 0.7 * standard["air_range_m"]
    processed = replace(preset, processing={"sar_compression": {"map_height_m": 4000.0}})
    assert numbers(processed)["air_range_m"] < 0.7 * standard["air_range_m"]
    on_a_plateau = replace(preset, origin=OriginSettings(-16.5, -68.2, 4000.0))
    assert numbers(on_a_plateau)["air_range_m"] == numbers(processed)["air_range_m"]
    sea_there = impaired(on_a_plateau, air=SimulatedAir(humidity=0.5))
    assert numbers(sea_there)["air_map_height_m"] == 0.0


def test_what_the_grade_of_a_navigation_does_is_in_the_budget() -> None:
    """At 5 km, 45 degrees and 50 m/s, with 5 mm/s, 0.005 and 0.008 degrees."""
    preset = load_preset("sal_spotlight")
    assert "navigation_height_m" not in numbers(preset)
    graded = replace(preset, impairments=replace(preset.impairments, odometry=OdometryErrors(grade="navigation")))
    found = numbers(graded)
    assert found["navigation_position_m"] == pytest.approx(0.1)
    assert found["navigation_along_m"] == pytest.approx(0.5)
    assert found["navigation_height_m"] == pytest.approx(5000 * 0.5**0.5 * 0.005 * math.pi / 180, rel=2e-3)
    assert found["navigation_beams_m"] == pytest.approx(5000 * 0.5**0.5 * 0.008 * math.pi / 180)
    assert "  navigation (navigation grade): position, rms" in budget_table(Budget(graded, Assumptions()).entries())


def test_delay_and_lever_arm_move_places_and_heights() -> None:
    """At 50 m/s, as docs/error_budget.md says; what the processing is told of the delay is no error."""
    errors = OdometryErrors(delay_s=2e-3, undescribed_lever_arm_m=(0.03, 0.5, -0.02))
    preset = impaired(load_preset("sal_spotlight"), odometry=errors)
    found = numbers(preset)
    assert found["odometry_delay_along_m"] == pytest.approx(0.1)
    assert found["lever_arm_along_m"] == pytest.approx(0.03)
    assert found["lever_arm_height_m"] == pytest.approx(0.02)
    turned = replace(preset.sensor, mounting=replace(preset.sensor.mounting, boresight_rad=(0.0, 0.0, math.pi / 2)))
    assert numbers(replace(preset, sensor=turned))["lever_arm_along_m"] == pytest.approx(0.5)
    told = replace(preset, processing={"sar_compression": {"odometry_delay_s": 1.5e-3, "air": "topics"}})
    assert numbers(told)["odometry_delay_along_m"] == pytest.approx(0.025)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_boresight_moves_heights_as_the_mounting_of_the_simulator_does(side: str) -> None:
    """By the direction in which the middle of the beams is taken to look, of a mounting that is turned itself."""
    errors = OdometryErrors(undescribed_boresight_rad=(2e-5, -3e-5, 1e-5))
    preset = impaired(load_preset("sal_spotlight"), odometry=errors)
    mounting = replace(preset.sensor.mounting, boresight_rad=(0.0, 0.0, 0.4))
    preset = replace(preset, sensor=replace(preset.sensor, look_side=side, mounting=mounting))
    described: Mounting = preset.make_sensor().mounting
    look = look_direction(preset.flight.look_angle_rad, 0.0, {"right": 1, "left": -1}[side])
    body = described.axes.inv()  # whose antenna would be level
    true = (body * errors.built(described).axes).apply(look)
    moved = preset.flight.slant_range_m * (true - look)
    found = numbers(preset)
    assert found["boresight_height_m"] == pytest.approx(abs(moved[2]), rel=2e-3)
    assert found["boresight_beams_m"] == pytest.approx(abs(moved[0]), rel=1e-3)


def test_pointing_jitter_in_an_aperture_is_that_of_simulated_dwells() -> None:
    """Rms over 600 dwells, whose standard error is 3 %."""
    preset = load_preset("sal_spotlight")
    jittery = impaired(preset, pointing_jitter=PointingJitter(rms_rad=3e-6, highest_hz=900.0))
    found, flight = numbers(jittery), flight_of(jittery, seed=1)
    means = [np.mean(flight.pointing(0.1 * dwell + flight.pulse_times), axis=1) for dwell in range(600)]
    ahead, off_nadir = np.sqrt(np.mean(np.square(means), axis=0))
    assert found["jitter_beams_m"] == pytest.approx(5000 * ahead, rel=0.1)
    assert found["jitter_height_m"] == pytest.approx(5000 * 0.5**0.5 * off_nadir, rel=0.1)


def test_vibration_and_laser_and_turbulence_are_in_the_budget_of_the_realistic_lidar() -> None:
    """The phase of its dwells beside a trend is what the rows say; over 200 dwells."""
    preset = load_preset("sal_realistic")
    found, flight = numbers(preset), flight_of(preset, seed=2)
    phases = np.array([flight.pulse_phase(dwell) for dwell in range(200)])
    seconds = flight.pulse_times - flight.pulse_times.mean()
    trend, level = np.polyfit(seconds, phases.T, 1)
    rest = phases - level[:, None] - trend[:, None] * seconds
    names = ("vibration", "laser", "turbulence")
    along = 100 * preset.sensor.wavelength_m / (4 * np.pi) * np.std(trend)
    assert math.hypot(*(found[f"{name}_along_m"] for name in names)) == pytest.approx(along, rel=0.2)
    assert math.hypot(*(found[f"{name}_phase_rad"] for name in names)) == pytest.approx(np.std(rest), rel=0.2)
    assert found["laser_spread_percent"] == pytest.approx(100 * -math.expm1(-(found["laser_phase_rad"] ** 2)))


@pytest.mark.parametrize(
    ("name", "place"), [("sal_spotlight", ""), ("xband_sumdiff", "antenna"), ("xband_sumdiff", "receiver")]
)
def test_undescribed_gains_move_heights_as_they_move_estimates(
    name: str, place: Literal["", "antenna", "receiver"]
) -> None:
    """Of a target without noise, whose echoes pass the receivers of the simulator."""
    preset = load_preset(name)
    if place:
        hybrid = replace(preset.sensor.hybrid or HybridSettings("antenna"), place=place)
        preset = replace(preset, sensor=replace(preset.sensor, hybrid=hybrid))
    gains = tuple(0.005 * (-1) ** n * (n + 1) for n in range(preset.sensor.detectors))
    wrong, sensor = impaired(preset, undescribed_gains_db=gains), preset.make_sensor()
    beams = image_beams(sensor, "taylor")
    middle = float(np.mean(beams.span))
    echoes = np.tile(beams.response(middle, 0.0)[:, None, None], (1, 1, sensor.sample_count))
    gained = through_receivers(echoes.astype(np.complex128), sensor, wrong.impairments)[:, 0, 0]
    looks = Looks.of(1e6 * (gained[:, None] * gained.conj())[None, None], count=1)
    shift = float(ml_elevation(looks, beams, MlSettings(layover=False)).elevation.squeeze()) - middle
    one = numbers(wrong)
    expected = 1e6 * one["roll_m_per_urad"] * abs(shift)
    assert one["gains_height_m"] == pytest.approx(expected, rel=0.05, abs=1e-4)  # the search stops at that


def test_the_table_has_units_with_prefixes_and_the_file_the_units_in_its_names() -> None:
    """A kilometre and a micrometre of one table; ratios, decibels and rates have no prefix."""
    entries = Budget(load_preset("sal_spotlight"), Assumptions()).entries()
    lines = {tuple(line.rsplit(maxsplit=2)) for line in budget_table(entries).splitlines()}
    for title, number, unit in (
        ("  slant range", "5", "km"),
        ("  vibration with echoes of -20 dB, amplitude", "24.67", "nm"),
        ("  single-look CNR at beam centre", "20", "dB"),
        ("  dwells", "86.02", "1/s"),
        ("  during a dwell", "1.311", "GB/s"),
    ):
        assert (title, number, unit) in lines
    assert {one.key: one.value for one in entries}["slant_range_m"] == 5000.0


def test_errors_of_the_preset_have_a_group_only_where_there_are_some() -> None:
    clean = budget_table(Budget(load_preset("small"), Assumptions()).entries())
    wrong = budget_table(Budget(load_preset("sal_realistic"), Assumptions()).entries())
    assert f"{GROUP}\n" not in clean
    assert f"{GROUP}\n" in wrong
    assert f"{SENSITIVITY}\n" in clean
    assert max(map(len, wrong.splitlines())) <= 80
    for name in ("lever arm", "boresight", "vibration", "laser linewidth", "pointing jitter", "converters"):
        assert f"  {name}" in wrong or f"  undescribed {name}" in wrong


@pytest.mark.parametrize(
    ("velocity_mps", "processing", "says", "focused"),
    [
        (0.0, {}, "No autofocus is needed", False),
        (1e-3, {}, "Autofocus is needed", True),
        (1e-3, {"autofocus": "never"}, "autofocus is never", False),
        (1e-3, {"autofocus_from_beamwidths": 0.5}, "No autofocus is needed", False),
    ],
)
def test_whether_autofocus_is_needed_is_what_images_have(
    velocity_mps: float, processing: dict[str, object], says: str, focused: bool
) -> None:
    errors = OdometryErrors(velocity_mps=velocity_mps)
    preset = replace(impaired(load_preset("small"), odometry=errors), processing={"sar_compression": processing})
    (note,) = Budget(preset, Assumptions()).notes()
    assert_one_sentence(note, says, "autofocus_from_beamwidths")
    flight = flight_of(preset, seed=1)
    settings = ImageSettings(air="none", rows=46, cols=12, **processing)
    slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, settings)
    assert slc
    assert (slc.focus is not None) == focused


def test_beams_that_speckle_cannot_place_are_said_to_stay() -> None:
    preset = impaired(load_preset("small"), odometry=OdometryErrors(velocity_mps=0.1))
    wide = replace(preset, sensor=replace(preset.sensor, azimuth_aperture_m=1e-4))
    (note,) = Budget(wide, Assumptions()).notes()
    assert_one_sentence(note, "Autofocus would be needed", "speckle does not show")


def test_what_a_run_refuses_is_marked_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    preset = load_preset("xband_relief")
    slow = replace(preset.sensor, pulse_repetition_frequency_hz=100.0)
    jitter = PointingJitter(rms_rad=0.01, highest_hz=30.0)
    wrong = impaired(replace(preset, sensor=slow), pointing_jitter=jitter)
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(asdict(wrong)))), encoding="utf-8")
    assert main(["budget", str(tmp_path / "wrong.yaml"), "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr()
    (rate,) = [line for line in printed.out.splitlines() if "pulse repetition frequency" in line]
    assert rate.endswith("too low")
    (angle,) = [line for line in printed.out.splitlines() if "pointing jitter, rms" in line]
    assert angle.endswith("too much")
    with pytest.raises(UserError) as refused:
        flight_of(wrong, seed=0)
    said, swing = printed.err.splitlines()
    assert said == f"sal-height: {refused.value}"
    assert_one_sentence(swing.removeprefix("sal-height: "), "the beams swing by 0.04 rad")
    with pytest.raises(UserError, match=r"the beams swing by 0\.04 rad"):
        flight_of(impaired(preset, pointing_jitter=jitter), seed=0)


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("--power", "nan", "a number above 0, at most 1e9 (W)"),
        ("--power", "0", "a number above 0, at most 1e9 (W)"),
        ("--loss-db", "nan", "a number from 0 to 100 (dB)"),
        ("--backscatter-db", "50", "a number from -80 to 40 (dB)"),
    ],
)
def test_an_assumption_that_is_not_allowed_is_refused_with_all_that_is(
    option: str, value: str, allowed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["budget", "small", option, value, "--out", str(tmp_path / "out")]) == 2
    assert f"It must be {allowed}." in capsys.readouterr().err


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
