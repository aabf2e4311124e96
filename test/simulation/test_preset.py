"""Presets: those that come with the package make sense, and a wrong one gets one sentence."""

from __future__ import annotations

import copy
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from beam_tables import sample_pattern, write_beam_tables
from helpers import RAW_SETTINGS, RAW_WAVEFORMS, assert_one_sentence, refused, whitening, with_waveform

from sal_height.beams import pattern_named
from sal_height.errors import UserError
from sal_height.imaging.pixels import slant_plane_grid
from sal_height.numeric.windows import broadening, window
from sal_height.sensor import EXACT, NOTHING_STATED, SensorUncertainty, lit_angle
from sal_height.sensor.sensor import Sensor
from sal_height.sensor.waveform import spectrum_sensor
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.impairments import UNIMPAIRED, RangeSawtooth, RangeTaper
from sal_height.simulation.preset import load_preset, parse_preset, preset_names
from sal_height.simulation.scene import PointScatterer
from sal_height.simulation.scenes import load_scene

SMALL = Path(__file__).parents[2] / "sal_height" / "presets" / "small.yaml"
SHIPPED = (
    "sal_movers",
    "sal_passes",
    "sal_realistic",
    "sal_spotlight",
    "sal_stripmap",
    "sal_strips",
    "small",
    "village",
    "woods",
    "xband_realistic",
    "xband_relief",
    "xband_sumdiff",
)


MOVER = {"east_m": 1.0, "north_m": -2.0, "height_m": 0.5, "power_db": 20.0, "radial_velocity_mps": -0.001}


def content_with(key: str, value: Any) -> dict[str, Any]:
    """Content of the small preset with another value at a dotted key."""
    content = yaml.safe_load(SMALL.read_text())
    *parents, last = key.split(".")
    inner = content
    for parent in parents:
        inner = inner[parent]
    inner[last] = value
    return content


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("name", "", "must have at least 1 character"),
        ("name", 5, "must be a text"),
        ("scene", None, "must be a text"),
        ("cnr_db", "loud", "must be a number"),
        ("cnr_db", 101, "less than or equal to 100"),
        ("cnr_db", -61, "greater than or equal to -60"),
        ("cnr_db", float("nan"), "finite"),
        ("dwells", 0, "greater than or equal to 1"),
        ("dwells", 2.5, "must be a whole number"),
        ("looks", 2, "must be a list"),
        ("looks", [2, 2, 2], "must have at most 2 items, not 3"),
        ("sensor", 3, "must be a mapping of keys to values"),
        ("sensor", None, "must be a mapping of keys to values"),
        ("sensor.look_side", "up", "'left' or 'right'"),
        ("sensor.wavelength_m", 0, "greater than "),
        ("sensor.wavelength_m", float("inf"), "finite"),
        ("sensor.wavelength_m", "red", "must be a number"),
        ("sensor.aperture_m", -1.0, "greater than "),
        ("sensor.pattern", "cosine", "'gaussian', 'sinc'"),
        ("sensor.pattern", "beams.txt", ", or the path of a .csv file of beams"),
        ("sensor.pattern", 7, "must be a text"),
        ("sensor.detector_rotation_rad", 1.6, "less than or equal to 1.57"),
        ("sensor.detector_rotation_rad", True, "not true or false"),
        ("sensor.detector_size_beamwidths", 0.5, "must be a list"),
        ("scene_extent_m", -1.0, "greater than or equal to 0"),
        ("targets", "car", "must be a list"),
        ("sensor.hybrid", "antenna", "must be a mapping of keys to values"),
        ("sensor.full_scale_over_noise_db", "loud", "must be a number"),
        ("sensor.detectors", 0, "greater than or equal to "),
        ("sensor.detectors", 129, "less than or equal to 128"),
        ("sensor.detectors", [8], "must be a whole number"),
        ("sensor.pitch_beamwidths", 0.0, "greater than "),
        ("sensor.bandwidth_hz", float("-inf"), "finite"),
        ("sensor.waveform", "noise", "'spectrum', 'chirp' or 'deramped'"),
        ("sensor.pulse_duration_s", -1e-6, "greater than or equal to 0"),
        ("sensor.pulse_duration_s", 1001, "less than or equal to 1000"),
        ("sensor.sampling_rate_hz", -1.0, "greater than or equal to 0"),
        ("sensor.sample_count", 1, "greater than or equal to 2"),
        ("sensor.sample_count", 65537, "less than or equal to 65536"),
        ("sensor.pulse_count", 1, "greater than or equal to 2"),
        ("sensor.pulse_repetition_frequency_hz", 0, "greater than "),
        ("flight.slant_range_m", 0, "greater than "),
        ("flight.look_angle_rad", 0, "greater than 0"),
        ("flight.look_angle_rad", 1.6, "less than 1.57"),
        ("flight.speed_mps", -50, "greater than "),
        ("flight.dwell_spacing_m", "far", "must be a number"),
        ("flight.odometry_rate_hz", 0, "greater than "),
        ("flight.gust_mps", -0.1, "greater than or equal to 0"),
        ("flight.gust_mps", 20.1, "less than or equal to 20"),
        ("sensor.mode", "scan", "'spotlight' or 'stripmap'"),
        ("image.rows", 0, "greater than or equal to 1"),
        ("image.cols", "many", "must be a whole number"),
    ],
)
def test_wrong_value_is_refused_naming_key_value_and_what_is_allowed(key: str, value: Any, allowed: str) -> None:
    with refused(UserError, "Preset mine.yaml: ", f"{key} is {value!r}; ", allowed):
        parse_preset(content_with(key, value), "mine.yaml")


def test_targets_join_those_of_the_scene() -> None:
    preset = parse_preset(content_with("targets", [MOVER, MOVER | {"along_velocity_mps": 3.0}]), "mine.yaml")
    points, known = flight_of(preset, seed=1).scene.points, load_scene(preset.scene).points
    assert points[: len(known)] == known
    assert points[len(known) :] == (
        PointScatterer(1.0, -2.0, 0.5, 100.0, -0.001),
        PointScatterer(1.0, -2.0, 0.5, 100.0, -0.001, 3.0),
    )


@pytest.mark.parametrize("looks", [[47, 1], [1, 13]], ids=["range", "azimuth"])
def test_looks_larger_than_the_image_are_refused(looks: list[int]) -> None:
    with refused(UserError, f"looks is ({looks[0]}, {looks[1]})", "image of (46, 12) pixels"):
        parse_preset(content_with("looks", looks), "mine.yaml")


def test_dwells_that_would_overlap_are_refused_with_the_least_spacing() -> None:
    """48 pulses at 30 kHz and 50 m/s: 8 cm."""
    parse_preset(content_with("flight.dwell_spacing_m", 0.0801), "mine.yaml")
    with refused(UserError, "flight.dwell_spacing_m is 0.0799", "must be 0.08 or more"):
        parse_preset(content_with("flight.dwell_spacing_m", 0.0799), "mine.yaml")


def test_stripmap_dwells_follow_without_a_gap_and_have_no_spacing_of_their_own() -> None:
    """48 pulses at 30 kHz and 50 m/s: 8 cm."""
    content = content_with("sensor.mode", "stripmap")
    with refused(UserError, "flight.dwell_spacing_m is 0.58125", "every 0.08 m", "leave it out"):
        parse_preset(content, "mine.yaml")
    del content["flight"]["dwell_spacing_m"]
    preset = parse_preset(content, "mine.yaml")
    assert preset.dwell_spacing_m == pytest.approx(0.08, rel=1e-12)
    assert preset.make_sensor().mode == "stripmap"
    assert load_preset("small").dwell_spacing_m == 0.58125
    assert load_preset("small").make_sensor().mode == "spotlight"


@pytest.mark.parametrize(
    ("pattern", "size", "beamwidths"),
    [
        ("sinc", [0.0, 0.0], 1.0),
        ("jinc", [0.0, 0.0], 1.219670),
        ("sinc", [0.6, 0.6], 1.031678),
    ],
)
def test_prf_must_sample_the_doppler_of_the_main_lobe(pattern: str, size: list[float], beamwidths: float) -> None:
    """4 * 50 m/s / 1 cm = 20 kHz for a main lobe of one beamwidth to each side, and more for a wider one."""
    content = content_with("sensor.pattern", pattern)
    content["sensor"]["detector_size_beamwidths"] = size
    content["sensor"]["pulse_repetition_frequency_hz"] = 20e3 * beamwidths * 1.001
    flight_of(parse_preset(content, "mine.yaml"), seed=0)
    content["sensor"]["pulse_repetition_frequency_hz"] = prf = 20e3 * beamwidths * 0.999
    with refused(
        UserError,
        f"sensor.pulse_repetition_frequency_hz is {prf:g}",
        f"spans {20e3 * beamwidths:g} Hz of Doppler, {4 * beamwidths:g} times the speed over the length 0.01 m",
        f"must be {20e3 * beamwidths:g} or more",
    ):
        flight_of(parse_preset(content, "mine.yaml"), seed=0)


def test_prf_must_sample_the_main_lobe_of_a_measured_beam(tmp_path: Path) -> None:
    """A circular beam as a table that reaches well into its sidelobes."""
    beamwidth, offsets = load_preset("small").sensor.beamwidth_rad, np.arange(-60, 61) * 0.05
    table = sample_pattern(pattern_named("jinc"), offsets * beamwidth, offsets * beamwidth, beamwidth)
    write_beam_tables(tmp_path / "beams.csv", [table], beamwidth)
    content = content_with("sensor.pattern", str(tmp_path / "beams.csv"))
    content["sensor"]["pulse_repetition_frequency_hz"] = 20e3 * 1.22
    assert flight_of(parse_preset(content, "mine.yaml"), seed=0).sensor.pattern == "table"
    content["sensor"]["pulse_repetition_frequency_hz"] = 20e3 * 1.2
    with pytest.raises(UserError, match="the main lobe spans 243"):
        flight_of(parse_preset(content, "mine.yaml"), seed=0)


def test_prf_must_sample_the_beams_that_a_turned_detector_axis_points_ahead() -> None:
    """Eight detectors half a beamwidth apart, turned by 30 degrees: 1.75 sin(30) = 0.875 beamwidths more."""
    content = content_with("sensor.detector_rotation_rad", -np.pi / 6)
    content["sensor"]["pattern"] = "sinc"
    content["sensor"]["pulse_repetition_frequency_hz"] = 20e3 * 1.876
    flight_of(parse_preset(content, "mine.yaml"), seed=0)
    content["sensor"]["pulse_repetition_frequency_hz"] = 20e3 * 1.874
    with refused(UserError, "spans 37500 Hz of Doppler, 7.5 times the speed over the length 0.01 m"):
        flight_of(parse_preset(content, "mine.yaml"), seed=0)


def test_sensor_of_a_preset_has_its_detectors_turned() -> None:
    assert load_preset("small").make_sensor().detector_rotation == 0.0
    sensor = parse_preset(content_with("sensor.detector_rotation_rad", 0.2), "mine.yaml").make_sensor()
    assert sensor.detector_rotation == sensor.beams.rotation == 0.2


def test_size_of_the_detectors_is_that_of_the_preset() -> None:
    with pytest.raises(UserError, match=r"sensor\.detector_size_beamwidths\.1 is -0\.1; .* greater than or equal to 0"):
        parse_preset(content_with("sensor.detector_size_beamwidths", [0.6, -0.1]), "mine.yaml")
    preset = parse_preset(content_with("sensor.detector_size_beamwidths", [0.6, 1.2]), "mine.yaml")
    assert preset.make_sensor().detector_size == (0.6, 1.2)
    assert load_preset("small").make_sensor().detector_size == (0.0, 0.0)


@pytest.mark.parametrize("folder", ["beside", "working"])
def test_file_of_beams_is_found_beside_the_preset_or_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    for name in ("beside", "working"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "working")
    file = tmp_path / folder / "beams.csv"
    file.write_text("")
    preset = tmp_path / "beside" / "mine.yaml"
    preset.write_text(yaml.safe_dump(content_with("sensor.pattern", "beams.csv")))
    assert load_preset(str(preset)).sensor.pattern == str(file)


def test_file_of_beams_of_the_package_has_no_path_that_other_machines_do_not_have(tmp_path: Path) -> None:
    preset = load_preset("xband_sumdiff")
    assert preset.sensor.pattern == "xband_sumdiff_beam.csv"
    copied = tmp_path / "mine.yaml"
    copied.write_text(yaml.safe_dump(json.loads(json.dumps(asdict(preset)))))
    assert load_preset(str(copied)) == preset
    assert load_preset(str(copied)).make_sensor() == preset.make_sensor()


def all_keys(content: dict[str, Any], prefix: str = "") -> list[str]:
    keys = []
    for key, value in content.items():
        keys += [prefix + key] + (all_keys(value, f"{prefix}{key}.") if isinstance(value, dict) else [])
    return keys


@pytest.mark.parametrize("key", all_keys(yaml.safe_load(SMALL.read_text())))
def test_missing_key_is_refused_by_its_name(key: str) -> None:
    content = copy.deepcopy(yaml.safe_load(SMALL.read_text()))
    *parents, last = key.split(".")
    inner = content
    for parent in parents:
        inner = inner[parent]
    del inner[last]
    with refused(UserError, f"Preset mine.yaml: {key} is missing"):
        parse_preset(content, "mine.yaml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "the top level is None; it must be a mapping of keys to values"),
        ("- name: small\n", "the top level is [{'name': 'small'}]; it must be a mapping of keys to values"),
        ("just words", "the top level is 'just words'; it must be a mapping of keys to values"),
        ("name: [small\nsensor:", "is not valid YAML"),
        ("name: small\n\tsensor: 1", "is not valid YAML"),
        ("name: !!python/object:os.system {}", "is not valid YAML"),
        ("scene: 2026-02-31", "is not valid YAML"),
    ],
    ids=["empty", "list", "words", "open list", "tab", "object", "impossible date"],
)
def test_file_without_a_mapping_is_refused_in_one_sentence(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with refused(UserError, "mine.yaml", complaint):
        load_preset(str(path))


def test_file_that_cannot_be_read_is_refused_with_the_presets_there_are(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\xfd")
    for name in ("no_such_preset", str(tmp_path), str(binary)):
        with refused(UserError, repr(name), ", ".join(SHIPPED)):
            load_preset(name)


def test_preset_in_a_file_equals_the_one_by_name() -> None:
    assert load_preset(str(SMALL)) == load_preset("small")


def test_sensor_of_a_preset_has_its_beams_evenly_around_the_look_angle() -> None:
    preset = parse_preset(content_with("sensor.look_side", "left"), "mine.yaml")
    sensor = preset.make_sensor()
    assert sensor.look_side == -1
    assert load_preset("small").make_sensor().look_side == 1
    assert sensor.detector_count == 8
    np.testing.assert_allclose(np.diff(sensor.elevation_boresights), 0.5 * 1.55e-4, rtol=1e-9)
    assert np.mean(sensor.elevation_boresights) == pytest.approx(np.pi / 4, abs=1e-12)
    assert sensor.noise_power == (1.0,) * 8


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"hybrid": {"place": "attic"}}, "sensor.hybrid.place is 'attic'; it must be 'antenna' or 'receiver'"),
        ({"hybrid": {}}, "sensor.hybrid.place is missing"),
        (
            {"hybrid": {"place": "antenna", "coupling": 0}},
            "sensor.hybrid.coupling is 0; it must be greater than 0",
        ),
        ({"hybrid": {"place": "antenna", "coupling": 1.1}}, "sensor.hybrid.coupling is 1.1; it must be less than"),
        ({"hybrid": {"place": "antenna", "loss_db": -1}}, "sensor.hybrid.loss_db is -1; it must be greater than"),
        ({"hybrid": {"place": "antenna", "delta_phase_rad": 4}}, "sensor.hybrid.delta_phase_rad is 4; it must be"),
        ({"hybrid": {"place": "antenna", "magic": 4}}, "sensor.hybrid.magic is not a known key"),
        ({"detector_gains_db": [0, 70]}, "sensor.detector_gains_db.1 is 70; it must be less than"),
        ({"detector_phases_rad": [0, "x"]}, "sensor.detector_phases_rad.1 is 'x'; it must be a number"),
        ({"beam_uncertainty_db": 0}, "sensor.beam_uncertainty_db is 0; it must be less than 0"),
        ({"blanked_ranges": [{"channel": 2, "first_m": 1, "last_m": 2}]}, "names channel 2; channels are numbered"),
        ({"blanked_ranges": [{"channel": 1, "first_m": 3, "last_m": 2}]}, "last_m 2; it must be first_m, 3, or more"),
        ({"blanked_ranges": [{"channel": 1, "first_m": 3}]}, "sensor.blanked_ranges.0.last_m is missing"),
        (
            {"blanked_ranges": [{"channel": 0, "first_m": 1, "last_m": 2}], "waveform": "chirp"},
            "sensor.blanked_ranges is given with sensor.waveform 'chirp'",
        ),
    ],
)
def test_a_wrong_value_of_the_channels_is_refused(changes: dict[str, Any], complaint: str) -> None:
    with refused(UserError, complaint):
        sensor_with(**changes)


def test_a_preset_states_how_well_beams_are_known_and_where_channels_are_blanked() -> None:
    sensor = sensor_with(beam_uncertainty_db=-26, blanked_ranges=[{"channel": 1, "first_m": 4999, "last_m": 5000.5}])
    assert sensor.beam_uncertainty == sensor.beams.uncertainty == pytest.approx(0.0501, abs=1e-4)
    assert sensor.blanked_ranges == ((1, 4999.0, 5000.5),)


def sensor_with(**changes: Any) -> Sensor:
    """Of the small preset with two detectors and other values of its sensor."""
    content = content_with("sensor.detectors", 2)
    content["sensor"] |= changes
    return parse_preset(content, "mine.yaml").make_sensor()


def test_a_preset_without_a_hybrid_has_its_detectors_as_channels() -> None:
    sensor = sensor_with()
    assert (sensor.channel_matrix, sensor.matrix_in_antenna, sensor.noise_power) == ((), True, (1.0, 1.0))


@pytest.mark.parametrize("place", ["antenna", "receiver"])
def test_a_lossless_hybrid_makes_sum_and_difference_with_the_noise_that_was_there(place: str) -> None:
    sensor = sensor_with(hybrid={"place": place})
    np.testing.assert_allclose(sensor.mixing, np.array([[1, 1], [-1, 1]]) / np.sqrt(2), rtol=1e-15)
    np.testing.assert_allclose(sensor.noise_covariance, np.eye(2), atol=1e-15)
    assert sensor.matrix_in_antenna == (place == "antenna")


@pytest.mark.parametrize(
    ("place", "changes", "gain_db"),
    [
        ("antenna", {}, 0.0),
        ("antenna", {"loss_db": 3.0}, -3.0),
        ("antenna", {"coupling": 1.0}, 10 * np.log10(2)),
        ("antenna", {"delta_gain_db": 4.0, "delta_phase_rad": 1.0}, 0.0),
        ("receiver", {"loss_db": 3.0, "coupling": 1.0, "delta_gain_db": -4.0}, 0.0),
    ],
)
def test_what_a_hybrid_does_to_the_signal_over_the_noise(place: str, changes: dict[str, float], gain_db: float) -> None:
    """A hybrid before the receivers gains 2 c^2 / loss over bare detectors; behind them nothing, nor does any gain."""
    sensor = sensor_with(hybrid={"place": place, **changes})
    power, transform = whitening(sensor.noise_covariance, sensor.mixing)
    assert power == pytest.approx(10 ** (-gain_db / 10), rel=1e-12)
    np.testing.assert_allclose(transform @ sensor.mixing, np.eye(2), atol=1e-14)


def test_gains_of_detectors_are_described_and_amplify_their_noise() -> None:
    sensor = sensor_with(detector_gains_db=[0.0, 6.0], detector_phases_rad=[0.5, -1.0])
    expected = np.array([np.exp(0.5j), 10**0.3 * np.exp(-1j)])
    np.testing.assert_allclose(sensor.mixing, np.diag(expected), rtol=1e-14)
    np.testing.assert_allclose(sensor.noise_covariance, np.diag([1, 10**0.6]), rtol=1e-14)


def test_full_scale_is_over_the_noise_in_one_part() -> None:
    assert sensor_with().full_scale == 0
    assert sensor_with(full_scale_over_noise_db=20.0).full_scale == pytest.approx(10 * np.sqrt(0.5), rel=1e-15)


def test_gains_of_detectors_come_before_the_hybrid() -> None:
    sensor = sensor_with(detector_gains_db=[0.0, 6.0], hybrid={"place": "antenna", "delta_gain_db": 20.0})
    expected = np.array([[1, 10**0.3], [-10, 10 * 10**0.3]]) / np.sqrt(2)
    np.testing.assert_allclose(sensor.mixing, expected, rtol=1e-14)
    np.testing.assert_allclose(sensor.noise_power, [1, 100], rtol=1e-14)


@pytest.mark.parametrize(
    ("key", "value", "parts"),
    [
        ("sensor.hybrid", {"place": "antenna"}, ["sensor.detectors is 8", "difference of 2"]),
        ("sensor.detector_gains_db", [1.0, 2.0], ["sensor.detector_gains_db has 2 entries", "must have 8"]),
        ("sensor.detector_phases_rad", [0.0] * 9, ["sensor.detector_phases_rad has 9 entries", "must have 8"]),
    ],
)
def test_channels_that_do_not_fit_the_detectors_are_refused(key: str, value: Any, parts: list[str]) -> None:
    with refused(UserError, "mine.yaml", *parts):
        parse_preset(content_with(key, value), "mine.yaml")


def test_the_sum_difference_radar_sees_the_middle_of_the_ground_of_the_sixteen_beams() -> None:
    """Beams of an antenna 9 times lower, whose boresights lie beyond those of the sixteen; flown the same way."""
    two, sixteen = load_preset("xband_sumdiff"), load_preset("xband_relief")
    assert (two.flight, two.scene, two.looks) == (sixteen.flight, sixteen.scene, sixteen.looks)
    assert two.image == replace(sixteen.image, rows=112)
    sensor, other = two.make_sensor(), sixteen.make_sensor()
    outer = sensor.beams.span[0] - other.beams.span[0], other.beams.span[1] - sensor.beams.span[1]
    assert max(outer) < -0.01
    reach = np.linspace(-1.2, 1.2, 25)
    elevation, squint = np.meshgrid(np.pi / 4 + 9 * reach * sensor.beamwidth / 2, reach * sensor.beamwidth / 1.2)
    for i, boresight in enumerate(sensor.elevation_boresights):
        e, a = (elevation - boresight) / (9 * sensor.beamwidth), squint / sensor.beamwidth
        expected = np.sinc(e) * np.sinc(a)
        np.testing.assert_allclose(sensor.beams.response(elevation, squint)[..., i], expected, atol=3e-5)


@pytest.mark.parametrize("waveform", RAW_WAVEFORMS)
def test_sensor_of_a_preset_with_a_pulse(waveform: str) -> None:
    content = yaml.safe_load(SMALL.read_text())
    content["sensor"] |= {"waveform": waveform, **RAW_SETTINGS[waveform]}
    preset = parse_preset(content, "mine.yaml")
    assert preset == with_waveform(load_preset("small"), waveform)
    sensor = preset.make_sensor()
    settings = preset.sensor
    assert (sensor.waveform, sensor.bandwidth) == (waveform, 2e9)
    assert (sensor.pulse_duration, sensor.sampling_rate) == (settings.pulse_duration_s, settings.sampling_rate_hz)
    assert sensor.chirp_rate == pytest.approx(2e9 / settings.pulse_duration_s, rel=1e-14)
    assert spectrum_sensor(sensor).sample_count == 64


@pytest.mark.parametrize("key", ["pulse_duration_s", "sampling_rate_hz"])
@pytest.mark.parametrize("waveform", RAW_WAVEFORMS)
def test_pulse_without_all_that_describes_it_is_refused(waveform: str, key: str) -> None:
    settings = {"waveform": waveform, **RAW_SETTINGS[waveform], key: 0.0}
    content = yaml.safe_load(SMALL.read_text())
    content["sensor"] |= settings
    with refused(UserError, "Sensor ", f"with waveform {waveform!r} it must be"):
        parse_preset(content, "mine.yaml").make_sensor()


@pytest.mark.parametrize("look_angle", [1e-4, 1.5707], ids=["nadir", "horizon"])
def test_beams_beyond_nadir_or_horizon_are_refused(look_angle: float) -> None:
    with refused(UserError, "elevation_boresights", "between 0 (nadir) and pi/2 rad"):
        parse_preset(content_with("flight.look_angle_rad", look_angle), "mine.yaml").make_sensor()


def test_presets_that_come_with_the_package() -> None:
    assert tuple(preset_names()) == SHIPPED
    assert all(load_preset(name).name == name for name in SHIPPED)


@pytest.fixture(scope="module", params=SHIPPED)
def flight(request: pytest.FixtureRequest) -> SimulatedFlight:
    preset = load_preset(request.param)
    return SimulatedFlight(preset, preset.make_sensor(), load_scene(preset.scene), preset.dwells, seed=0)


def test_pulses_sample_the_doppler_of_all_ground_that_is_lit(flight: SimulatedFlight) -> None:
    sensor = flight.sensor
    if sensor.mode == "stripmap":  # each pulse lights its own ground
        doppler = 4 * flight.preset.flight.speed_mps * np.sin(lit_angle(sensor.beams))
        assert doppler / sensor.wavelength <= sensor.pulse_repetition_frequency * (1 + 1e-9)
        return
    for dwell in (0, flight.dwells - 1):
        surface = flight.surface(dwell)
        sine = np.sin(surface.squint[~surface.deterministic])
        doppler = 2 * flight.preset.flight.speed_mps * np.ptp(sine) / sensor.wavelength
        assert doppler < sensor.pulse_repetition_frequency


def test_image_lies_within_the_range_window_in_every_pulse(flight: SimulatedFlight) -> None:
    sensor, image, reach = flight.sensor, flight.preset.image, flight.preset.flight.slant_range_m
    widened = broadening(window("taylor", sensor.sample_count))
    grid = slant_plane_grid(sensor, flight.aperture(0), reach, image.rows, image.cols, widened)
    antenna = flight.position(flight.dwell_start_ns(0) * 1e-9 + flight.pulse_times[[0, -1]])
    delay = np.linalg.norm(grid.pixels() - antenna[:, None, None, :], axis=-1) - reach
    assert np.abs(delay).max() <= sensor.range_window / 2


def test_images_of_successive_dwells_join(flight: SimulatedFlight) -> None:
    preset = flight.preset
    grid = slant_plane_grid(
        flight.sensor, flight.aperture(0), preset.flight.slant_range_m, preset.image.rows, preset.image.cols, 1.0
    )
    assert preset.dwell_spacing_m == pytest.approx(grid.cols * grid.col_spacing, rel=0.01)


def test_looks_fit_in_the_image_and_range_is_mostly_seen_by_the_beams(flight: SimulatedFlight) -> None:
    preset, sensor = flight.preset, flight.sensor
    assert preset.image.rows >= preset.looks[0]
    assert preset.image.cols >= preset.looks[1]
    first, last = sensor.beams.span
    # Level ground from the first to the last boresight, and not much more, in slant range.
    reach, angle = preset.flight.slant_range_m, preset.flight.look_angle_rad
    swath = (last - first) * reach * np.tan(angle)
    assert 0.5 * swath < sensor.range_window < 2 * swath


NUMBERS = [
    *(f"sensor.{key}" for key in ("wavelength_m", "aperture_m", "detectors", "pitch_beamwidths", "bandwidth_hz")),
    *(f"sensor.{key}" for key in ("sample_count", "pulse_count", "pulse_repetition_frequency_hz")),
    *(f"flight.{key}" for key in ("slant_range_m", "look_angle_rad", "speed_mps", "dwell_spacing_m")),
    *("sensor.pulse_duration_s", "sensor.sampling_rate_hz"),
    *("flight.odometry_rate_hz", "image.rows", "image.cols", "cnr_db", "dwells"),
]


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("sensor.wavelength_m", 1e-10, "is 1e-10; it must be greater than or equal to 1e-09"),
        ("sensor.wavelength_m", 1e300, "is 1e+300; it must be less than or equal to 100"),
        ("sensor.aperture_m", 2e4, "less than or equal to 10000"),
        ("sensor.bandwidth_hz", 0.5, "greater than or equal to 1"),
        ("sensor.bandwidth_hz", 1e16, "less than or equal to 1e+15"),
        ("sensor.sampling_rate_hz", 2e15, "is 2e+15; it must be less than or equal to 1e+15"),
        ("sensor.pitch_beamwidths", 1e4, "less than or equal to 1000"),
        ("sensor.pulse_repetition_frequency_hz", 2e9, "less than or equal to 1e+09"),
        ("flight.slant_range_m", 2e7, "less than or equal to 1e+07"),
        ("flight.look_angle_rad", 1.5707963267948966, "is 1.5708; it must be less than 1.5708"),
        ("flight.speed_mps", 0.001, "greater than or equal to 0.01"),
        ("flight.speed_mps", 20001, "less than or equal to 20000"),
        ("flight.dwell_spacing_m", 1e-7, "greater than or equal to 1e-06"),
        ("flight.dwell_spacing_m", 2e6, "less than or equal to 1000000"),
        ("flight.odometry_rate_hz", 10001, "less than or equal to 10000"),
        ("dwells", 1_000_001, "less than or equal to 1000000"),
        ("cnr_db", 100.00000123456, "is 100; "),
        ("dwells", 2.000000123456, "is 2; "),
        pytest.param("dwells", 16**6000, "dwells is a number of thousands of digits; ", id="huge"),
        ("dwells", list(range(10**4)), "is [0, 1, 2, 3"),
        ("flight.dwell_spacing_m", 0.1 * 0.3 + 1e-17, "flight.dwell_spacing_m is 0.03, "),
        ("looks", [2, 0], "looks.1 is 0; it must be greater than or equal to 1"),
        ("looks", [2, True], "looks.1 is True; it must be a number"),
        ("targets", [MOVER | {"power_db": 101.0}], "targets.0.power_db is 101.0; it must be less than or equal to 100"),
        *((key, True, f"{key} is True; it must be a number, not true or false") for key in NUMBERS),
        *(
            (key, 1, f"{key} is not a known key")
            for key in ("colour", "sensor.aperture", "flight.altitude_m", "image.depth")
        ),
    ],
)
def test_wrong_values_are_named_by_their_place_and_shown_short(key: str, value: Any, said: str) -> None:
    with pytest.raises(UserError) as refusal:
        parse_preset(content_with(key, value), "mine.yaml")
    assert_one_sentence(str(refusal.value), key, said)
    assert len(str(refusal.value)) < 250


def test_deeply_nested_file_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: " + "[" * 5000)
    with refused(UserError, "mine.yaml", "nested too deeply"):
        load_preset(str(path))


def test_unknown_key_of_two_lines_is_refused_in_one() -> None:
    with refused(UserError, "two lines is not a known key"):
        parse_preset(content_with("two\nlines", 1), "mine.yaml")


@pytest.mark.parametrize("name", ["a" * 5000, "a\0b"], ids=["too long", "zero"])
def test_preset_name_that_no_file_can_have_is_refused(name: str) -> None:
    with pytest.raises(UserError, match="neither a readable file nor one of"):
        load_preset(name)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"magic": 1}, "impairments.magic is not a known key"),
        ({"range_sawtooth": {"depth": 0.1}}, "impairments.range_sawtooth.teeth is missing"),
        ({"range_sawtooth": {"depth": 1.1, "teeth": 4}}, "range_sawtooth.depth is 1.1; it must be less than"),
        ({"range_sawtooth": {"depth": 0, "teeth": 4}}, "range_sawtooth.depth is 0; it must be greater than 0"),
        ({"range_sawtooth": {"depth": 0.1, "teeth": 33}}, "range_sawtooth.teeth is 33; 64 samples show at most 32"),
        (
            {"chirp_ripple": {"amplitude_rad": 0.1, "cycles": 33}},
            "chirp_ripple.cycles is 33; 64 samples show at most 32",
        ),
        (
            {"range_sawtooth": {"depth": 0.1, "teeth": 4, "receivers": [0, 8]}},
            "range_sawtooth.receivers names 8; receivers are numbered from 0 to 7",
        ),
        (
            {"range_sawtooth": {"depth": 0.1, "teeth": 4, "receivers": [-1]}},
            "impairments.range_sawtooth.receivers.0 is -1; it must be greater than or equal to 0",
        ),
        ({"range_taper": {"sidelobe_db": 12}}, "range_taper.sidelobe_db is 12; it must be greater than"),
        ({"range_taper": {"band_share": 1.1}}, "range_taper.band_share is 1.1; it must be less than"),
        ({"undescribed_gains_db": [0, 1]}, "impairments.undescribed_gains_db has 2 entries; it must have 8"),
        ({"undescribed_phases_rad": [0]}, "impairments.undescribed_phases_rad has 1 entries; it must have 8"),
        ({"undescribed_gains_db": [61] * 8}, "undescribed_gains_db.0 is 61; it must be less than"),
        ({"undescribed_phases_rad": [4] * 8}, "undescribed_phases_rad.0 is 4; it must be less than"),
        ({"nyquist_spur_over_noise": -1}, "nyquist_spur_over_noise is -1; it must be greater than"),
        ({"beam_width_factor": 2.1}, "beam_width_factor is 2.1; it must be less than"),
        ({"beam_width_factor": True}, "beam_width_factor is True; it must be a number, not true or false"),
        ({"antenna_swing": {"amplitude_rad": 1e-5}}, "antenna_swing.period_s is missing"),
        ({"antenna_swing": {"amplitude_rad": 1e-5, "period_s": 0}}, "antenna_swing.period_s is 0; it must be"),
        ({"quartic_phase_rad": 101}, "quartic_phase_rad is 101; it must be less than"),
    ],
)
def test_a_wrong_impairment_is_refused(changes: dict[str, Any], complaint: str) -> None:
    with refused(UserError, complaint):
        parse_preset(content_with("impairments", changes), "mine.yaml")


def test_a_swing_beyond_half_a_beamwidth_is_refused() -> None:
    """Along the flight: with the detector axis turned by 90 degrees that is a beamwidth of `aperture_m`."""
    swing = {"antenna_swing": {"amplitude_rad": 7.8e-5, "period_s": 1}}
    content = content_with("impairments", swing)
    content["sensor"] |= {"azimuth_aperture_m": 0.0098, "pulse_repetition_frequency_hz": 1e5}
    flight_of(parse_preset(content, "mine.yaml"), seed=0)
    content["sensor"]["detector_rotation_rad"] = np.pi / 2
    with pytest.raises(UserError) as refusal:
        flight_of(parse_preset(content, "mine.yaml"), seed=0)
    said = "the beams swing by 7.8e-05 rad", "must be 7.75e-05, 0.5 beamwidths, or less"
    assert_one_sentence(str(refusal.value), *said)


def test_a_key_that_is_no_text_is_refused() -> None:
    with refused(UserError, "Preset mine.yaml: 5 is not a known key"):
        parse_preset(content_with("image", {"rows": 46, "cols": 12}) | {5: 1}, "mine.yaml")


@pytest.mark.parametrize(
    "changes", [*(RAW_SETTINGS[name] | {"waveform": name} for name in RAW_WAVEFORMS), {"sample_count": 63}]
)
def test_a_spur_needs_an_even_number_of_frequencies(changes: dict[str, Any]) -> None:
    content = content_with("impairments", {"nyquist_spur_over_noise": 1.0})
    parse_preset(content, "mine.yaml")
    content["sensor"] |= changes
    with refused(UserError, "impairments.nyquist_spur_over_noise is 1; ", "'spectrum'", "must be 0"):
        parse_preset(content, "mine.yaml")


def test_impairments_are_off_and_at_their_limits_accepted() -> None:
    assert load_preset("small").impairments == UNIMPAIRED
    limits = {
        "range_sawtooth": {"depth": 1, "teeth": 32, "receivers": [7]},
        "range_taper": {},
        "antenna_swing": {"amplitude_rad": 7.7499e-5, "period_s": 1},
    }
    preset = parse_preset(content_with("impairments", limits), "mine.yaml")
    assert preset.impairments.range_sawtooth == RangeSawtooth(1, 32, (7,))
    assert preset.impairments.range_taper == RangeTaper(35.0, 1.0)


def test_impairments_survive_the_file_that_a_run_leaves(tmp_path: Path) -> None:
    """`run` writes the preset with all its keys, of which those that are not set are null."""
    changes = {"range_sawtooth": {"depth": 0.1, "teeth": 4, "receivers": [3]}, "beam_width_factor": 1.1}
    changes["pupil_aberrations_waves"] = {"coma": 0.05}
    preset = parse_preset(content_with("impairments", changes), "mine.yaml")
    path = tmp_path / "preset.yaml"
    path.write_text(yaml.safe_dump(json.loads(json.dumps(asdict(preset)))))
    assert load_preset(str(path)) == preset


def test_a_preset_is_exact_unless_it_states_an_uncertainty() -> None:
    """What a given one leaves out is not stated."""
    sensor = sensor_with()
    assert sensor.uncertainty == EXACT
    assert (sensor.mounting.lever_arm_covariance, sensor.mounting.rotation_covariance) == ((0.0,) * 9, (0.0,) * 9)
    sensor = sensor_with(uncertainty={})
    assert sensor.uncertainty == NOTHING_STATED
    assert (sensor.mounting.lever_arm_covariance, sensor.mounting.rotation_covariance) == (None, None)
    sensor = sensor_with(uncertainty={"channel_gain_db": 1.0, "boresight_rad": 0.001})
    gain = sensor.uncertainty.channel_gain
    assert gain == pytest.approx(0.1151, abs=1e-4)
    assert sensor.uncertainty == SensorUncertainty(channel_gain=gain)
    assert sensor.mounting.rotation_covariance == pytest.approx((1e-6, 0, 0, 0, 1e-6, 0, 0, 0, 1e-6))
