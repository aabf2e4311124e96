"""The sensor description: derived quantities, beams, receivers, and refusal of values that make no sense."""

from __future__ import annotations

import dataclasses
import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    assert_one_sentence,
    circular,
    elevation_at,
    make_beams,
    make_sensor,
    refused,
    sample_frequencies,
)
from scipy.constants import speed_of_light
from scipy.stats import norm

from sal_height.beams.pattern import PATTERNS
from sal_height.beams.table import BeamTable
from sal_height.elevation.array.estimate import MEASURED, ElevationEstimate, Scatterer, Validity, without_saturated
from sal_height.errors import UserError
from sal_height.geometry import Mounting
from sal_height.sensor import SensorUncertainty, lit_angle
from sal_height.sensor.sensor import MAX_DETECTORS, MAX_SHARE, clipped, saturated_shares
from sal_height.simulation import load_preset
from sal_height.simulation.receiver_noise import received


@pytest.mark.parametrize("count", [64, 65])
def test_wavenumbers_are_two_way_and_centred_on_the_carrier(count: int) -> None:
    sensor = make_sensor(sample_count=count)
    order = np.arange(count) - count // 2  # as an FFT counts
    np.testing.assert_allclose(
        sensor.centre_wavenumber + order * sensor.wavenumber_step,
        4 * np.pi * sample_frequencies(sensor) / speed_of_light,
        rtol=1e-14,
    )


def test_resolution_window_and_beamwidth() -> None:
    sensor = make_sensor(bandwidth=5e9, sample_count=256)
    assert sensor.range_resolution == pytest.approx(speed_of_light / 2 / 5e9, rel=1e-15)
    assert sensor.range_window == pytest.approx(256 * speed_of_light / 2 / 5e9, rel=1e-15)
    # The window is where the phase between neighbouring frequencies goes through a full turn.
    assert sensor.range_window * sensor.wavenumber_step == pytest.approx(2 * np.pi, rel=1e-14)
    assert sensor.beamwidth == pytest.approx(1.55e-4, rel=1e-14)
    assert sensor.detector_count == 3


def test_response_is_the_pattern_seen_from_each_boresight() -> None:
    sensor = make_sensor()
    elevation, squint = elevation_at([0.3, -0.1]), 0.2 * BEAMWIDTH
    response = sensor.beams.response(elevation, squint)
    assert response.shape == (2, 3)
    expected = PATTERNS["jinc"].amplitude(np.array([[0.8, 0.3, -0.2], [0.4, -0.1, -0.6]]), 0.2)
    np.testing.assert_allclose(response, expected, atol=1e-11)


@pytest.mark.parametrize("name", sorted(PATTERNS))
def test_slope_of_the_response_is_per_radian(name: str) -> None:
    beams = make_beams(name, count=4)
    elevation, squint, step = elevation_at([-0.6, 0.1, 0.7]), 0.3 * BEAMWIDTH, 1e-4 * BEAMWIDTH
    difference = (beams.response(elevation + step, squint) - beams.response(elevation - step, squint)) / (2 * step)
    # Angles near 45 degrees are good to 1e-16 rad, hence responses to 1e-12 and the difference to 1e-8 per beamwidth.
    np.testing.assert_allclose(beams.slope(elevation, squint) * BEAMWIDTH, difference * BEAMWIDTH, atol=3e-8)


def test_domain_reaches_half_a_pitch_and_the_guard_beyond_the_boresights() -> None:
    beams = make_beams(count=16, pitch=0.5)
    assert beams.span == pytest.approx(tuple(elevation_at([-3.75, 3.75])), abs=1e-15)
    assert beams.domain(3 * BEAMWIDTH) == pytest.approx(tuple(elevation_at([-7.0, 7.0])), abs=1e-15)


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("name", 257 * "x", "256 characters or fewer"),
        ("config_hash", 257 * "x", "256 characters or fewer"),
        ("look_side", 0, "+1 (right) and -1 (left)"),
        ("wavelength", 0.0, "greater than 0"),
        ("wavelength", float("nan"), "finite"),
        ("bandwidth", -1.0, "greater than 0"),
        ("bandwidth", 4e14, "less than twice the carrier frequency"),
        ("pulse_repetition_frequency", float("inf"), "finite"),
        ("elevation_diameter", -0.01, "greater than 0"),
        ("azimuth_diameter", float("nan"), "greater than 0"),
        ("sample_count", 1, "2 or more"),
        ("pulse_count", 1, "2 or more"),
        ("elevation_boresights", (0.1, 0.1, 0.2), "increasing"),
        ("elevation_boresights", (), "one or more"),
        ("elevation_boresights", (0.1, 0.2, 1.6), "between 0 (nadir) and pi/2"),
        ("elevation_boresights", (0.0, 0.1, 0.2), "between 0 (nadir) and pi/2"),
        ("elevation_boresights", (0.1, float("nan"), 0.3), "increasing"),
        ("full_scale", -1.0, "finite and 0 or more"),
        ("full_scale", float("nan"), "finite and 0 or more"),
        ("full_scale", float("inf"), "finite and 0 or more"),
        ("noise_power", (1.0, 1.0), "3 finite numbers of 0 or more"),
        ("noise_power", (1.0, -1.0, 1.0), "3 finite numbers of 0 or more"),
        ("noise_power", (1.0, float("nan"), 1.0), "3 finite numbers of 0 or more"),
        ("noise_power", (1.0, float("inf"), 1.0), "3 finite numbers of 0 or more"),
    ],
)
def test_value_out_of_range_is_refused_in_one_sentence(key: str, value: object, allowed: str) -> None:
    with pytest.raises(UserError) as refusal:
        make_sensor(**{key: value})
    shown = f"{value:.6g}" if isinstance(value, float) and value > 1e6 else str(value)
    assert_one_sentence(str(refusal.value), key, shown.split("e+")[0], allowed)


def test_unknown_pattern_is_refused() -> None:
    with pytest.raises(UserError, match="'cosine'"):
        make_sensor(pattern="cosine")


CHIRP = {"waveform": "chirp", "chirp_rate": -2e15, "pulse_duration": 1e-6, "sampling_rate": 2.5e9, "sample_count": 2600}
DERAMPED = CHIRP | {"waveform": "deramped", "sampling_rate": 64e6, "sample_count": 67}


@pytest.mark.parametrize("pulse", [CHIRP, DERAMPED], ids=["chirp", "deramped"])
@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("chirp_rate", 0.0, "finite and not 0"),
        ("chirp_rate", float("nan"), "finite and not 0"),
        ("pulse_duration", 0.0, "greater than 0"),
        ("pulse_duration", float("inf"), "finite"),
        ("sampling_rate", 0.0, "greater than 0"),
        ("sampling_rate", -1e9, "greater than 0"),
        ("sampling_rate", float("nan"), "finite"),
        ("bandwidth", 2.03e9, "|chirp_rate| * pulse_duration = 2e+09 Hz within 1 %"),
        ("bandwidth", 1.97e9, "|chirp_rate| * pulse_duration = 2e+09 Hz within 1 %"),
        ("sampling_rate", 2.9e6, " Hz or more"),
        ("sample_count", 66, " or more"),
    ],
)
def test_pulse_that_makes_no_sense_is_refused_in_one_sentence(
    pulse: dict[str, object], key: str, value: object, allowed: str
) -> None:
    make_sensor(**pulse)
    with refused(UserError, f"Sensor {key} is ", allowed):
        make_sensor(**pulse | {key: value})


def test_chirp_sampled_below_its_bandwidth_is_refused() -> None:
    with refused(UserError, "sampling_rate is 1990000000.0", "must be 2e+09 Hz or more"):
        make_sensor(**CHIRP | {"sampling_rate": 1.99e9})


@pytest.mark.parametrize(("pulse", "least"), [(CHIRP, 2503), (DERAMPED, 67)], ids=["chirp", "deramped"])
def test_record_must_hold_the_pulse_and_a_window(pulse: dict[str, object], least: int) -> None:
    """2500 samples of pulse and two resolution cells; 64 samples and 32 ns."""
    make_sensor(**pulse | {"sample_count": least})
    with refused(UserError, f"sample_count is {least - 1}", f"must be {least} or more"):
        make_sensor(**pulse | {"sample_count": least - 1})


@pytest.mark.parametrize("key", ["chirp_rate", "pulse_duration", "sampling_rate"])
def test_frequencies_have_no_pulse(key: str) -> None:
    with refused(UserError, f"{key} is 1.0; with waveform 'spectrum' it must be 0"):
        make_sensor(**{key: 1.0})


@pytest.mark.parametrize("derived", ["frequency_step", "wavenumber_step", "centre_wavenumber", "range_window"])
def test_samples_in_time_have_no_frequencies(derived: str) -> None:
    assert make_sensor(**CHIRP).range_resolution == make_sensor().range_resolution
    with pytest.raises(ValueError, match="use its spectrum_sensor"):
        getattr(make_sensor(**CHIRP), derived)


OTHER_VALUES = {
    "name": "other",
    "look_side": -1,
    "wavelength": 1.5e-6,
    "bandwidth": 1e9,
    "sample_count": 65,
    "pulse_count": 49,
    "pulse_repetition_frequency": 31e3,
    "elevation_diameter": 0.02,
    "azimuth_diameter": 0.02,
    "pattern": "sinc",
    "elevation_boresights": (0.1, 0.2, 0.3),
    "noise_power": (1.0, 2.0, 1.0),
    "channel_matrix": ((1j, 0j, 0j), (0j, 1 + 0j, 0j), (0j, 0j, 2 + 0j)),
    "matrix_in_antenna": False,
    "full_scale": 2.5,
    "mode": "stripmap",
    "detector_size": (0.5, 0.0),
    "detector_rotation": 0.1,
    "mounting": Mounting(lever_arm=(0.0, 1.0, 0.0)),
    "calibration_id": "2026-01",
    "beam_uncertainty": 0.05,
    "uncertainty": SensorUncertainty(range_delay=0.1),
    "blanked_ranges": ((1, 5000.0, 5010.0),),
}
OTHER_PULSE = {
    "waveform": "deramped",
    "chirp_rate": 2e15,
    "pulse_duration": 1.001e-6,
    "sampling_rate": 2.6e9,
}

OTHER_TABLES = {
    "beam_tables": (BeamTable((-1e-3, -1e-4, 1e-4, 1e-3), (0.0,), (0.1, 1.0, 1.0, 0.1), (0.0, 0.2, 0.2, 0.0)),),
}


@pytest.mark.parametrize("key", OTHER_VALUES)
def test_any_other_value_gives_another_hash(key: str) -> None:
    assert make_sensor(**{key: OTHER_VALUES[key]}).config_hash != make_sensor().config_hash


@pytest.mark.parametrize("key", OTHER_PULSE)
def test_any_other_pulse_gives_another_hash(key: str) -> None:
    pulse = CHIRP | {"sample_count": 6000}
    assert make_sensor(**pulse | {key: OTHER_PULSE[key]}).config_hash != make_sensor(**pulse).config_hash


@pytest.mark.parametrize("part", ["elevation", "azimuth", "real", "imaginary"])
def test_any_other_table_gives_another_hash(part: str) -> None:
    (table,) = tables = OTHER_TABLES["beam_tables"]
    other = dataclasses.replace(table, **{part: tuple(value + 1e-5 for value in getattr(table, part))})
    measured = make_sensor(pattern="table", beam_tables=tables)
    assert make_sensor(pattern="table", beam_tables=(other,)).config_hash != measured.config_hash


def test_every_field_has_been_varied_and_equal_sensors_agree() -> None:
    assert {*OTHER_VALUES, *OTHER_PULSE, *OTHER_TABLES, "config_hash"} == {
        field.name for field in dataclasses.fields(make_sensor())
    }
    assert make_sensor().config_hash == make_sensor().config_hash
    assert len(make_sensor().config_hash) == 16


def test_stated_hash_is_kept() -> None:
    assert make_sensor(config_hash="of the driver").config_hash == "of the driver"


def test_too_many_detectors_are_refused() -> None:
    count = MAX_DETECTORS + 1
    with refused(UserError, f"{count} detectors", f"at most {MAX_DETECTORS}"):
        make_sensor(elevation_boresights=tuple(np.linspace(0.1, 0.2, count)), noise_power=(1.0,) * count)


@pytest.mark.parametrize("name", ["small", "xband_sumdiff"])
def test_copies_in_another_process_are_one_object_with_all_values(name: str) -> None:
    """With beams by a formula, and with measured ones."""
    sensor = load_preset(name).make_sensor()
    first, second = (pickle.loads(pickle.dumps(sensor)) for _ in range(2))  # noqa: S301 (our own)
    assert first is second
    assert (first, hash(first)) == (sensor, hash(sensor))
    assert pickle.loads(pickle.dumps(dataclasses.replace(sensor, name="another"))) != sensor  # noqa: S301


MIXTURE = ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1j))
"""Two mixtures of the first two detectors; the third by itself."""


def gaussian(seed: int, *shape: int) -> np.ndarray:
    return circular(np.random.default_rng(seed), shape).astype(np.complex64)


def test_clipping_stops_real_and_imaginary_parts_at_full_scale() -> None:
    samples = np.array([[0.5 - 3j, 2 + 0.1j], [-2 - 2j, 1j]], np.complex64)
    expected = np.array([[0.5 - 1j, 1 + 0.1j], [-1 - 1j, 1j]], np.complex64)
    np.testing.assert_array_equal(clipped(samples, 1.0), expected)
    assert clipped(samples, 0.0) is samples


def distortion(share: float) -> float:
    """Power that clipping adds to Gaussian samples over that of what is left of them, where `share` is clipped.

    Of a circular Gaussian sample x a multiple alpha x is left, and the rest does not correlate with it (Bussgang 1952).
    In standard deviations of a part, with the limit c, Q(c) = share / 2 and the density phi, Price's theorem gives
    alpha = 1 - 2 Q(c), and the clipped part has the power 1 - 2 Q(c) - 2 c phi(c) + 2 c^2 Q(c).
    """
    limit, left = norm.isf(share / 2), 1 - share
    return float((left - 2 * limit * norm.pdf(limit) + limit**2 * share) / left**2 - 1)


@pytest.mark.parametrize("share", [0.3, 0.05, 8e-3])
def test_distortion_is_what_a_gain_does_not_explain(share: float) -> None:
    """Of 2 10^6 Gaussian numbers; the standard error of the sums of squares is that of their 100 parts."""
    samples = np.random.default_rng(1).standard_normal((100, 20_000))
    limit = norm.isf(share / 2)
    seen = clipped((samples + 1j * samples).astype(np.complex64), limit).real
    gain = np.sum(seen * samples) / np.sum(samples**2)
    parts = np.mean((seen - gain * samples) ** 2, axis=1) / gain**2
    assert gain == pytest.approx(1 - share, abs=3.5 * np.sqrt(2 / samples.size))
    assert np.mean(parts) == pytest.approx(distortion(share), abs=3.5 * np.std(parts) / np.sqrt(len(parts)))


def test_the_greatest_share_keeps_distortion_40_db_below_the_signal() -> None:
    assert 10 * np.log10(distortion(MAX_SHARE)) == pytest.approx(-40, abs=0.1)


def test_shares_are_of_parts_at_or_beyond_full_scale() -> None:
    """1 %, 10 % and none of the parts of Gaussian samples; standard error of a share p of N parts: sqrt(p / N)."""
    sensor = make_sensor(full_scale=2.0)
    limits = np.array([norm.isf(0.005), norm.isf(0.05), 10.0])
    samples = gaussian(2, 3, 500, 200) * (2.0 * np.sqrt(2) / limits[:, None, None]).astype(np.float32)
    shares = saturated_shares(clipped(samples, 2.0), sensor)
    np.testing.assert_allclose(shares, [0.01, 0.1, 0.0], atol=3.5 * np.sqrt(0.1 / 2e5))
    np.testing.assert_array_equal(saturated_shares(samples, sensor), shares)
    assert np.isnan(saturated_shares(samples, replace(sensor, full_scale=0.0))).all()


@pytest.mark.parametrize("in_antenna", [True, False])
def test_the_simulators_receivers_clip_where_they_are(in_antenna: bool) -> None:
    """Behind the matrix they clip channels; before it detectors, whose share all channels made of them have."""
    sensor = make_sensor(channel_matrix=MIXTURE, matrix_in_antenna=in_antenna, noise_power=(1e-6,) * 3, full_scale=0.7)
    frames = gaussian(3, 3, sensor.pulse_count, sensor.sample_count)
    frames[1] *= 0.5
    channels = received(frames, sensor, np.random.default_rng(4))
    mixed = np.tensordot(np.array(MIXTURE), frames, axes=1).astype(np.complex64)
    expected = [np.mean(np.abs(f.view(np.float32)) >= 0.7) for f in (mixed if in_antenna else frames)]
    shares = saturated_shares(channels, sensor)
    if in_antenna:
        assert np.abs(channels.view(np.float32)).max() == np.float32(0.7)
    else:
        assert np.abs(channels.view(np.float32)).max() > 0.7
        expected[1] = expected[0]
    np.testing.assert_allclose(shares, expected, atol=0.002)  # noise carries a few parts over the edge
    assert min(shares) > 0.1


def test_only_what_was_usable_becomes_saturated() -> None:
    validity = np.array([[v for v in Validity if v is not Validity.SATURATED]], np.uint8)
    values = np.ones(validity.shape)
    one = Scatterer(values, values, values, values)
    result = without_saturated(ElevationEstimate((one, one), validity))
    usable = np.isin(validity, MEASURED)
    assert np.all(result.validity[usable] == Validity.SATURATED)
    np.testing.assert_array_equal(result.validity[~usable], validity[~usable])
    assert len(result.scatterers) == 1


@pytest.mark.parametrize("name", sorted(PATTERNS))
@pytest.mark.parametrize("rotation", [0.0, 0.4])
def test_the_main_lobes_of_all_beams_are_lit(name: str, rotation: float) -> None:
    """Eight detectors half a beamwidth apart: the last one looks 1.75 sin(psi) beamwidths ahead."""
    beams = replace(make_beams(name, 8), rotation=rotation)
    expected = PATTERNS[name].main_lobe + 1.75 * np.sin(rotation)
    assert lit_angle(beams) / BEAMWIDTH == pytest.approx(expected, rel=1e-9)


def test_the_widest_main_lobe_counts() -> None:
    beams = replace(make_beams(count=2), patterns=(PATTERNS["sinc"], PATTERNS["jinc"]))
    assert lit_angle(beams) / BEAMWIDTH == pytest.approx(PATTERNS["jinc"].main_lobe, rel=1e-9)
