"""Impairments of the simulated sensor: each against its closed form, and nothing of them in the description."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from beam_tables import sample_pattern
from helpers import BEAMWIDTH, elevation_at, flat_scene, make_aperture, make_sensor, with_waveform
from scipy.integrate import quad
from scipy.special import fresnel, jv

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.beams.apertures import jinc
from sal_height.beams.pattern import pattern_named
from sal_height.beams.pupil import aberrated_pattern
from sal_height.geometry.frames import angles_of, look_direction
from sal_height.imaging.formers.backprojection import backproject, backproject_points
from sal_height.imaging.pixels import Processing, slant_plane_grid
from sal_height.sensor.sensor import PhaseHistory, Sensor, processed_angle
from sal_height.sensor.waveform import echo_sensor, from_spectrum, spectrum_sensor, to_spectrum
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.impairments import (
    UNIMPAIRED,
    AntennaSwing,
    ChirpRipple,
    Impairments,
    PointingJitter,
    PupilAberrations,
    RangeSawtooth,
    RangeTaper,
    Turbulence,
    through_receivers,
)
from sal_height.simulation.preset import HybridSettings, load_preset
from sal_height.simulation.receiver_noise import form_channels
from sal_height.simulation.scene import PointScatterer, Scene

REFERENCE = Path(__file__).parents[2] / "bags" / "version_3"

REACH = 5000.0

ALL = Impairments(
    range_sawtooth=RangeSawtooth(depth=0.1, teeth=8.0, receivers=(1,)),
    range_taper=RangeTaper(band_share=0.9),
    undescribed_gains_db=(0.0, 0.5, -0.5, 0, 0, 0, 0, 0),
    undescribed_phases_rad=(0.0, 0.1, -0.1, 0, 0, 0, 0, 0),
    chirp_ripple=ChirpRipple(amplitude_rad=0.2, cycles=5.0),
    nyquist_spur_over_noise=2.0,
    beam_width_factor=1.1,
    antenna_swing=AntennaSwing(amplitude_rad=2e-5, period_s=0.05),
    quartic_phase_rad=1.0,
)


def point_flight(impairments: Impairments, name: str = "small", east: float = 0.0, **sensor: Any) -> SimulatedFlight:
    """A point of 160 dB over the noise of the small preset on dark ground, abeam of the middle of three dwells."""
    preset = load_preset(name)
    preset = replace(preset, sensor=replace(preset.sensor, **sensor), cnr_db=100.0, dwells=3, impairments=impairments)
    ground = flat_scene()
    point = PointScatterer(east, 0.0, 0.0, 1e6)
    scene = replace(ground, brightness=np.zeros_like(ground.brightness), points=(point,))
    return SimulatedFlight(preset, preset.make_sensor(), scene, 3, seed=9)


def ground_flight(impairments: Impairments, name: str, **sensor: Any) -> SimulatedFlight:
    preset = load_preset(name)
    preset = replace(preset, sensor=replace(preset.sensor, **sensor), cnr_db=40.0, dwells=8, impairments=impairments)
    return SimulatedFlight(preset, preset.make_sensor(), flat_scene(), 8, seed=4)


def echoes(sensor: Sensor, cells: float, pulses: int = 2) -> np.ndarray:
    """Noise-free samples of a point of amplitude 1, `cells` range cells behind the middle, in every detector."""
    frequency = np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2
    wave = np.exp(-2j * np.pi * frequency * sensor.frequency_step / cell_bandwidth(sensor) * cells)
    return np.broadcast_to(wave, (sensor.detector_count, pulses, sensor.sample_count))


def cell_bandwidth(sensor: Sensor) -> float:
    return spectrum_sensor(sensor).bandwidth


def profile(samples: np.ndarray) -> np.ndarray:
    """Amplitude at range cells from the middle of the window onwards."""
    return np.abs(np.fft.ifft(samples, axis=-1))


# Nothing, and all of it


def test_presets_without_impairments_have_the_samples_recorded_in_the_reference_bag(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As they were before there were any, with ground one beamwidth to each side, to -80 dB of the greatest."""
    monkeypatch.setattr("sal_height.simulation.flight.lit_angle", lambda beams: beams.track_beamwidth)
    reader = BagReader(REFERENCE)
    frames = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/phase_history"])]
    flight = flight_of(replace(load_preset("small"), dwells=2), seed=1)
    for dwell in (0, 1):
        recorded = messages.history_from_messages([frame for frame in frames if frame.dwell == dwell]).samples
        made = flight.phase_history(dwell).samples
        assert np.abs(recorded).max() > 4
        np.testing.assert_allclose(made, recorded, rtol=0, atol=1e-4 * np.abs(recorded).max())


@pytest.mark.parametrize("name", ["small", "xband_sumdiff"])
def test_receivers_as_described_leave_every_bit_of_the_echoes(name: str) -> None:
    sensor = load_preset(name).make_sensor()
    rng = np.random.default_rng(1)
    shape = (sensor.detector_count, 3, sensor.sample_count)
    clean = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    np.testing.assert_array_equal(through_receivers(clean, sensor, UNIMPAIRED), clean)


@pytest.mark.parametrize("name", ["small", "sal_stripmap"])
def test_impaired_samples_are_reproducible_and_the_description_does_not_tell(name: str) -> None:
    small = {"pulse_count": 16, "sample_count": 64}
    plain, impaired = (ground_flight(impairments, name, **small) for impairments in (UNIMPAIRED, ALL))
    samples = impaired.phase_history(1).samples
    assert ground_flight(ALL, name, **small).phase_history(1).samples.tobytes() == samples.tobytes()
    assert np.abs(samples - plain.phase_history(1).samples).max() > 1
    assert impaired.sensor == plain.sensor
    assert impaired.sensor.config_hash == plain.sensor.config_hash
    for ours, theirs in zip(impaired.platform_states(1), plain.platform_states(1), strict=True):
        np.testing.assert_array_equal(ours.orientation, theirs.orientation)
        np.testing.assert_array_equal(ours.position, theirs.position)


# Receivers


def relative_image(impairments: Impairments) -> np.ndarray:
    """Amplitude of the image of a point over that in its middle row, shape (detectors, 63)."""
    flight = point_flight(impairments)
    history = flight.phase_history(1)
    grid = slant_plane_grid(flight.sensor, flight.aperture(1), REACH, 63, 1, 1.0)
    antenna = flight.position(history.stamp_ns * 1e-9 + history.pulse_times)
    image = np.abs(backproject(history, antenna, flight.sensor, Processing("rectangular"), grid)[..., 0])
    return np.asarray(image / image[:, [31]])


@pytest.mark.parametrize("teeth", [4, 8, 16])
def test_sawtooth_makes_paired_echoes_in_the_image_of_a_point(teeth: int) -> None:
    """Coefficients of a ramp of M samples from -1 to 1: 1 / (M sin(pi n / M)), n teeth before and behind."""
    depth, width = 0.1, 64 / teeth
    sawtooth = RangeSawtooth(depth=depth, teeth=teeth, receivers=(3,))
    relative = relative_image(Impairments(range_sawtooth=sawtooth))
    for order in range(1, 31 // teeth + 1):
        expected = depth / (width * np.sin(np.pi * order / width))
        for side in (-1, 1):
            assert relative[3, 31 + side * order * teeth] == pytest.approx(expected, abs=3e-4)
    others = np.delete(relative, 3, axis=0)
    assert np.delete(others, 31, axis=1).max() < 5e-4


@pytest.mark.parametrize("amplitude", [0.1, 0.7, 1.5])
def test_chirp_that_is_not_linear_makes_paired_echoes(amplitude: float) -> None:
    """Of the amplitudes J_n over J_0, n times 6 range cells before and behind, in all channels alike."""
    relative = relative_image(Impairments(chirp_ripple=ChirpRipple(amplitude_rad=amplitude, cycles=6)))
    for order in range(1, 4):
        expected = jv(order, amplitude) / jv(0, amplitude)
        for side in (-1, 1):
            np.testing.assert_allclose(relative[:, 31 + side * order * 6], expected, atol=0.01 * max(1.0, expected))


def test_chirp_that_is_linear_changes_nothing() -> None:
    sensor = load_preset("small").make_sensor()
    clean = echoes(sensor, 3.0).copy()
    still = through_receivers(clean, sensor, Impairments(chirp_ripple=ChirpRipple(amplitude_rad=0.0, cycles=4)))
    np.testing.assert_allclose(still, clean, atol=1e-12)


@pytest.mark.parametrize("waveform", ["chirp", "deramped"])
def test_sawtooth_is_over_the_frequencies_of_the_echo_whatever_the_waveform(waveform: str) -> None:
    """After range compression the echoes of a point have the response that those over frequency have."""
    sensor = with_waveform(load_preset("small"), waveform).make_sensor()
    impairments = Impairments(range_sawtooth=RangeSawtooth(depth=0.1, teeth=8, receivers=(3,)))
    clean = echoes(echo_sensor(sensor), 0.0).copy()
    compressed = [
        to_spectrum(from_spectrum(samples, sensor), sensor)
        for samples in (clean, through_receivers(clean, sensor, impairments))
    ]
    count = compressed[0].shape[-1]
    place = (np.arange(count) - (count - 1) / 2) / count
    tooth = 8 * place
    expected = 1 + 0.1 * 2 * (tooth - np.floor(tooth + 0.5))
    ratio = compressed[1][3, 0] / compressed[0][3, 0]
    inner = np.abs(tooth - np.floor(tooth) - 0.5) > 0.15  # away from the teeth's flanks, which ripple
    edge = np.abs(place) < 0.45
    np.testing.assert_allclose(ratio[inner & edge], expected[inner & edge], atol=0.012)
    np.testing.assert_array_equal(compressed[1][2], compressed[0][2])
    echo = profile(compressed[1] - compressed[0])[3, 0, [8, -8]] / profile(compressed[0])[3, 0, 0]
    np.testing.assert_allclose(echo, 0.1 / (8 * np.sin(np.pi / 8)), rtol=0.06)


@pytest.mark.parametrize("level", [25.0, 35.0])
def test_taylor_weights_have_the_stated_sidelobes_over_their_share_of_the_band(level: float) -> None:
    sensor = make_sensor(sample_count=256)
    widths = []
    for share in (1.0, 0.5):
        taper = RangeTaper(sidelobe_db=level, band_share=share)
        response = Impairments(range_taper=taper).receiver_response(sensor)
        assert np.all(response == response[0])
        fine = np.abs(np.fft.fft(response[0], 256 * 64))
        power = 20 * np.log10(fine[: 256 * 32] / fine[0])
        first_null = int(np.flatnonzero(np.diff(power) > 0)[0])
        assert power[first_null:].max() == pytest.approx(-level, abs=0.6)
        widths.append(first_null)
        np.testing.assert_allclose(np.abs(response[0]).max(), 1, atol=1e-3)
        assert np.all(response[0][np.abs(np.arange(256) - 127.5) > 128 * share] == 0)
    assert widths[1] / widths[0] == pytest.approx(2, rel=0.02)


def test_undescribed_gains_and_phases_are_on_the_echoes_and_not_on_the_noise() -> None:
    gains, phases = (0.0, 1.0, -2.0, 0, 0, 0, 0, 3.0), (0.3, 0.0, -1.0, 0, 0, 0, 0, 0.0)
    impairments = Impairments(undescribed_gains_db=gains, undescribed_phases_rad=phases)
    loud, plain = (point_flight(i).phase_history(1).samples for i in (impairments, UNIMPAIRED))
    expected = 10 ** (np.array(gains) / 20) * np.exp(1j * np.array(phases))
    np.testing.assert_allclose(loud / plain, np.broadcast_to(expected[:, None, None], plain.shape), rtol=1e-4)
    quiet = replace(point_flight(impairments), scene=dark())
    still = replace(point_flight(UNIMPAIRED), scene=dark())
    np.testing.assert_array_equal(quiet.phase_history(1).samples, still.phase_history(1).samples)


def dark() -> Scene:
    ground = flat_scene()
    return replace(ground, brightness=np.zeros_like(ground.brightness))


@pytest.mark.parametrize("place", ["antenna", "receiver"])
def test_receivers_are_behind_a_hybrid_in_the_antenna_and_before_one_that_is_not(place: Any) -> None:
    hybrid = HybridSettings(place=place, delta_gain_db=2.0, delta_phase_rad=0.4)
    preset = load_preset("small")
    sensor = replace(preset, sensor=replace(preset.sensor, detectors=2, hybrid=hybrid)).make_sensor()
    impairments = Impairments(undescribed_gains_db=(0.0, 1.5), nyquist_spur_over_noise=2.0)
    rng, gain = np.random.default_rng(2), np.array([1, 10 ** (1.5 / 20)])[:, None, None]
    clean = rng.standard_normal((2, 3, 64)) + 1j * rng.standard_normal((2, 3, 64))
    spur = np.zeros((2, 1, 64))
    spur[:, 0, 0] = 2 * np.sqrt(sensor.noise_power)
    channels = form_channels(through_receivers(clean, sensor, impairments).astype(np.complex64), sensor)
    mixed = np.tensordot(sensor.mixing, clean, axes=1)
    expected = gain * mixed + spur if place == "antenna" else np.tensordot(sensor.mixing, gain * clean + spur, axes=1)
    np.testing.assert_allclose(channels, expected, atol=2e-6 * np.abs(expected).max())


# The spur


def spur_history(sensor: Sensor, pulses: int, level: float) -> PhaseHistory:
    nothing = np.zeros((sensor.detector_count, pulses, sensor.sample_count), complex)
    samples = through_receivers(nothing, sensor, Impairments(nyquist_spur_over_noise=level))
    return PhaseHistory(0, np.zeros(pulses), np.full(pulses, REACH), samples.astype(np.complex64))


def track(pulses: int, spacing: float) -> np.ndarray:
    along = (np.arange(pulses) - (pulses - 1) / 2) * spacing
    return make_aperture().position + along[:, None] * np.array([1.0, 0.0, 0.0])


def without_carrier(image: np.ndarray, sensor: Sensor, ranges: np.ndarray) -> np.ndarray:
    """The image without the phase that the frequency which an FFT counts as zero has at the ranges of rows."""
    return np.asarray(image * np.exp(-1j * sensor.centre_wavenumber * (ranges - REACH))[:, None])


def fresnel_mean(half_aperture: float, wavelength: float) -> float:
    """Modulus of the mean of exp(j 2 pi x^2 / (wavelength REACH)) over an aperture."""
    end = 2 * half_aperture / np.sqrt(wavelength * REACH)
    sine, cosine = fresnel(end)
    return float(np.hypot(sine, cosine) / end)


def test_spur_is_half_a_cycle_per_row_abeam_of_a_dwell() -> None:
    """Level: that of a sample over their number, times the mean of the phases that the pixel takes back."""
    level, noise = 5.0, (1.0, 4.0, 0.25)
    sensor = make_sensor(noise_power=noise)
    grid = slant_plane_grid(sensor, make_aperture(), REACH, 32, 1, 1.0)
    image = backproject(spur_history(sensor, 48, level), track(48, 50 / 30e3), sensor, Processing("rectangular"), grid)[
        ..., 0
    ]
    expected = level * np.sqrt(noise) / 64 * fresnel_mean(24 * 50 / 30e3, sensor.wavelength)
    np.testing.assert_allclose(np.abs(image), np.broadcast_to(expected[:, None], image.shape), rtol=2e-3)
    ranges = angles_of(grid.pixels(), make_aperture(), 1)[0][:, 0]
    wave = without_carrier(image.T, sensor, ranges)
    np.testing.assert_allclose(wave[1:] / wave[:-1], -1, atol=3e-3)


def test_spur_has_the_same_amplitude_all_over_a_strip() -> None:
    """A stripmap pixel is the mean over its aperture, which takes back the phase of a target there."""
    level, spacing, pulses = 5.0, 0.0025, 800
    sensor = make_sensor(mode="stripmap", pattern="sinc", sample_count=16, pulse_repetition_frequency=20e3)
    ranges, places = REACH + (np.arange(9) - 4) * sensor.range_resolution, np.array([-0.4, 0.0, 0.4])
    points = make_aperture().position + ranges[:, None, None] * look_direction(np.pi / 4, 0.0, 1)
    points = points + places[:, None] * np.array([1.0, 0.0, 0.0])
    processing = Processing("rectangular", angle=processed_angle(sensor))
    image = backproject_points(
        spur_history(sensor, pulses, level), track(pulses, spacing), sensor, processing, points.reshape(-1, 3),
        np.array([1.0, 0.0, 0.0]),
    ).reshape(3, 9, 3)  # fmt: skip
    expected = level / 16 * fresnel_mean(BEAMWIDTH * REACH / 2, sensor.wavelength)
    np.testing.assert_allclose(np.abs(image), expected, rtol=0.02)
    wave = without_carrier(image[0], sensor, ranges)
    np.testing.assert_allclose(wave[1:] / wave[:-1], -1, atol=0.03)


def test_spur_of_a_flight_stands_beside_the_noise_in_the_first_frequency() -> None:
    spurred, plain = (point_flight(Impairments(nyquist_spur_over_noise=s)) for s in (7.0, 0.0))
    change = spurred.phase_history(0).samples - plain.phase_history(0).samples
    np.testing.assert_allclose(change[..., 0], 7.0, rtol=1e-3)
    assert np.abs(change[..., 1:]).max() == 0


# The antenna

SWING = AntennaSwing(amplitude_rad=0.4 * BEAMWIDTH, period_s=0.02, phase_rad=0.3)


def swung(seconds: np.ndarray) -> np.ndarray:
    """The swing in beamwidths."""
    return np.asarray(0.4 * np.sin(2 * np.pi * seconds / 0.02 + 0.3))


STRIP = {"pulse_count": 128, "detectors": 2, "sample_count": 16}


@pytest.mark.parametrize(
    ("name", "east", "changes"),
    [
        ("small", 0.0, {}),
        ("small", 0.2, {}),
        ("sal_stripmap", 0.0, STRIP | {"look_side": "left"}),
        ("sal_stripmap", 0.0, STRIP | {"look_side": "right"}),
    ],
)
def test_swinging_beams_weigh_a_point_by_the_pattern_along_the_flight(
    name: str, east: float, changes: dict[str, Any]
) -> None:
    """In spotlight beams follow the scene but for the swing: the squint is that in mid-dwell. A strip passes by."""
    swinging, still = (
        point_flight(Impairments(antenna_swing=swing), name, pattern="gaussian", east=east, **changes)
        for swing in (SWING, AntennaSwing(0, 1))
    )
    times = swinging.dwell_start_ns(1) * 1e-9 + swinging.pulse_times
    in_strip = name == "sal_stripmap"
    squint = (-swinging.position(times)[:, 0] if in_strip else east) / REACH / BEAMWIDTH
    pattern = pattern_named("gaussian")
    expected = pattern.amplitude(0.0, squint - swung(times)) / pattern.amplitude(0.0, squint)
    ratio = swinging.phase_history(1).samples / still.phase_history(1).samples
    np.testing.assert_allclose(ratio, np.broadcast_to(expected[:, None], ratio.shape), rtol=1e-3 if in_strip else 2e-4)
    assert np.ptp(expected) > (0.05 if in_strip else 0.01)


JITTER = PointingJitter(rms_rad=0.05 * BEAMWIDTH, highest_hz=500.0)


def test_jitter_has_its_rms_in_both_axes_and_nothing_above_its_highest_frequency() -> None:
    """Within 3 %: over 400 flights of 100 lines each, at 5 times; the spectrum beyond is that of a window."""
    seconds = np.arange(0.0, 0.05, 1e-4)
    angles = np.array([JITTER.drawn(np.random.default_rng(s)).velocity(seconds) for s in range(400)])
    np.testing.assert_allclose(np.sqrt(np.mean(angles[:, ::100] ** 2, axis=(0, 1))), JITTER.rms_rad, rtol=0.03)
    spectrum = np.mean(np.abs(np.fft.rfft(angles * np.blackman(len(seconds))[:, None], axis=1)) ** 2, axis=(0, 2))
    frequency = np.fft.rfftfreq(len(seconds), 1e-4)
    assert spectrum[frequency > 600].max() < 1e-4 * spectrum[frequency < 400].mean()


@pytest.mark.parametrize("preset", ["small", "sal_stripmap"])
@pytest.mark.parametrize("look_side", ["left", "right"])
def test_beams_that_jitter_weigh_a_point_by_their_pattern_in_both_axes(preset: str, look_side: str) -> None:
    """Each detector by its own: farther off nadir, those that look there see it sooner."""
    size = {} if preset == "small" else {"pulse_count": 128, "sample_count": 16}
    jittering, still = (
        point_flight(
            Impairments(pointing_jitter=jitter), preset, pattern="gaussian", look_side=look_side, detectors=2, **size
        )
        for jitter in (JITTER, PointingJitter(0.0, 1.0))
    )
    times = jittering.dwell_start_ns(1) * 1e-9 + jittering.pulse_times
    ahead, off_nadir = (angle / BEAMWIDTH for angle in jittering.pointing(times))
    along = -jittering.position(times)[:, 0] / REACH / BEAMWIDTH if preset == "sal_stripmap" else 0.0 * times
    middle = np.mean(jittering.sensor.elevation_boresights)
    across = -(np.array(jittering.sensor.elevation_boresights)[:, None] - middle) / BEAMWIDTH
    pattern = pattern_named("gaussian")
    expected = pattern.amplitude(across - off_nadir, along - ahead) / pattern.amplitude(across, along)
    ratio = jittering.phase_history(1).samples / still.phase_history(1).samples
    np.testing.assert_allclose(ratio, np.broadcast_to(expected[..., None], ratio.shape), rtol=2e-3)
    assert np.ptp(expected[1] / expected[0]) > 0.01


def doppler_centroid(pointing: float, reach: tuple[float, float], rate: float) -> float:
    """Phase from pulse to pulse of ground lit between two angles, by sinc beams that point ahead, over 2 pi; in Hz.

    Ground at the angle y has the Doppler 2 v sin(y) / wavelength. Angles in beamwidths, `rate` in Hz.
    """
    angle = np.linspace(*reach, 2001)
    doppler = 2 * 50 * angle * BEAMWIDTH / 1.55e-6
    products = np.sum(np.sinc(angle - pointing) ** 2 * np.exp(2j * np.pi * doppler / rate))
    return float(np.angle(products)) / (2 * np.pi) * rate


@pytest.mark.parametrize(("name", "cells"), [("small", 32), ("sal_stripmap", 16)])
def test_doppler_centroid_follows_the_beams(name: str, cells: int) -> None:
    """2500 Hz at a quarter of a beamwidth; a little less in a dwell, whose ground is not cut around the beam."""
    squinted = AntennaSwing(amplitude_rad=0.25 * BEAMWIDTH, period_s=1e9, phase_rad=np.pi / 2)
    found = []
    for swing in (squinted, AntennaSwing(0, 1)):
        changes = {"detectors": 2, "pulse_count": 64, "sample_count": cells, "pattern": "sinc"}
        flight = ground_flight(Impairments(antenna_swing=swing), name, **changes)
        rate, products = flight.sensor.pulse_repetition_frequency, []
        for dwell in range(8):
            samples = flight.phase_history(dwell).samples.astype(np.complex128)
            products.append(np.vdot(samples[:, :-1], samples[:, 1:]))
        found.append(np.angle(np.array(products)) / (2 * np.pi) * rate)
    # Both beams saw the same ground, of which blocks of a strip share some.
    shift = found[0] - found[1]
    standard_error = float(np.std(shift, ddof=1) / np.sqrt(len(shift)))
    assert standard_error < 100
    reach = (-0.75, 1.25) if name == "sal_stripmap" else (-1.25, 1.25)
    assert np.mean(shift) == pytest.approx(doppler_centroid(0.25, reach, rate), abs=3.5 * standard_error)


@pytest.mark.parametrize("pattern", ["sinc", "table"])
def test_wider_beams_change_the_ratio_of_a_pair(pattern: str) -> None:
    """h(t) = sinc(t / w), with the boresights where they were."""
    factor, offset = 1.2, 0.3
    sensor = make_sensor(pattern="sinc")
    if pattern == "table":
        nodes = np.linspace(-2, 2, 401) * BEAMWIDTH
        table = sample_pattern(pattern_named("sinc"), nodes, [0.0], BEAMWIDTH)
        sensor = make_sensor(pattern="table", beam_tables=(table,))
    built = sensor.widened(factor)
    lower, _, upper = built.beams.response(elevation_at(offset), 0.0)
    expected = [np.sinc((offset - q) / factor) for q in (-0.5, 0.5)]
    assert upper / lower == pytest.approx(expected[1] / expected[0], abs=1e-6)
    assert built.config_hash == sensor.config_hash
    assert built.elevation_boresights == sensor.elevation_boresights


def test_flight_sees_a_point_through_the_aberrated_pupil() -> None:
    """Amplitudes, and phases between detectors, of the far field behind the pupil."""
    faults = Impairments(pupil_aberrations_waves=PupilAberrations(defocus=0.07, coma=0.05))
    flight = point_flight(faults, "small", pattern="jinc", pulse_count=64)
    samples = flight.phase_history(1).samples
    across = np.mean(samples * samples[3].conj(), axis=(1, 2))
    steps = (np.arange(8) - 3.5) / 2
    field = aberrated_pattern((0.07, 0.0, 0.0, 0.05, 0.0, 0.0)).amplitude(-steps, 0.0)
    np.testing.assert_allclose(across / across[3], field / field[3], atol=5e-4)
    assert np.abs(field / field[3] - jinc(-steps, 0.0) / jinc(-steps[3], 0.0)).max() > 0.1
    assert flight.built.config_hash == flight.sensor.config_hash


@pytest.mark.parametrize("name", ["small", "sal_stripmap"])
def test_flight_sees_a_point_through_the_wider_beams(name: str) -> None:
    flight = point_flight(Impairments(beam_width_factor=1.2), name, pattern="sinc", pulse_count=64)
    samples = np.abs(flight.phase_history(1).samples).mean(axis=(1, 2))
    steps = (np.arange(8) - 3.5) / 2
    expected = np.abs(np.sinc(steps / 1.2))
    np.testing.assert_allclose(samples / samples[3], expected / expected[3], atol=2e-4)
    assert np.abs(expected / expected[3] - np.abs(np.sinc(steps)) / np.sinc(0.25)).max() > 0.1


@pytest.mark.parametrize("width", [1.0, 1.5])
def test_wider_or_swinging_beams_light_more_ground(width: float) -> None:
    swing = AntennaSwing(amplitude_rad=0.4 * BEAMWIDTH, period_s=1.0)
    flight = ground_flight(Impairments(beam_width_factor=width, antenna_swing=swing), "small")
    along = flight.surface(0).positions[:, 0] - flight.aperture(0).position[0]
    assert along.max() == pytest.approx((1.22 * width + 0.4) * BEAMWIDTH * REACH, abs=0.04)
    assert along.min() == pytest.approx(-(1.22 * width + 0.4) * BEAMWIDTH * REACH, abs=0.04)


# The phase over the aperture


def test_quartic_phase_over_the_pulses_of_a_dwell() -> None:
    turned, still = (point_flight(Impairments(quartic_phase_rad=phase)) for phase in (2.5, 0.0))
    phase = np.unwrap(np.angle(turned.phase_history(1).samples / still.phase_history(1).samples), axis=1)
    along = turned.pulse_times - turned.pulse_times.mean()
    half = 48 / 30e3 / 2  # of the dwell
    np.testing.assert_allclose(phase, np.broadcast_to((2.5 * (along / half) ** 4)[:, None], phase.shape), atol=2e-4)


def test_quartic_phase_over_the_angle_to_swinging_beams_in_a_strip() -> None:
    impairments = Impairments(antenna_swing=SWING)
    turned, still = (
        point_flight(
            replace(impairments, quartic_phase_rad=phase),
            "sal_stripmap",
            pattern="gaussian",
            detectors=2,
            sample_count=16,
        )
        for phase in (2.5, 0.0)
    )
    times = turned.dwell_start_ns(1) * 1e-9 + turned.pulse_times
    offset = -turned.position(times)[:, 0] / REACH / BEAMWIDTH - swung(times)
    ratio = turned.phase_history(1).samples / still.phase_history(1).samples
    expected = np.exp(2.5j * (2 * offset) ** 4)
    near = np.abs(offset) < 0.7
    assert np.count_nonzero(near) > 100
    assert np.abs(offset[near]).max() > 0.6
    np.testing.assert_allclose(ratio[:, near], np.broadcast_to(expected[near, None], ratio[:, near].shape), atol=2e-3)


def test_hufnagel_valley_5_7_is_what_its_name_says() -> None:
    """At 0.5 um from the zenith: a coherence length of 5 cm and an isoplanatic angle of 7 urad, within 5 %."""
    air, k = Turbulence(ground_cn2=1.7e-14), 2 * np.pi / 0.5e-6

    def moment(power: float) -> float:
        return float(
            quad(lambda h: h**power * float(air.cn2(np.array(h))), 0, 30_000, limit=400, points=[100, 1500])[0]
        )

    assert (0.423 * k**2 * moment(0)) ** (-3 / 5) == pytest.approx(0.05, rel=0.05)
    assert (2.914 * k**2 * moment(5 / 3)) ** (-3 / 5) == pytest.approx(7e-6, rel=0.05)


def test_structure_of_a_way_is_the_integral_with_its_weight() -> None:
    """From an antenna 1000 m up, 2000 m away: by adaptive integration from the ground on."""
    air = Turbulence(ground_cn2=3e-14, wind_mps=10.0)
    expected = quad(lambda s: float(air.cn2(np.array(1000 * (1 - s)))) * (1 - s) ** (5 / 3), 0, 1)[0]
    expected *= 4 * 2.914 * (2 * np.pi / 1.55e-6) ** 2 * 2000
    assert air.structure(1.55e-6, 2000.0, 1000.0) == pytest.approx(expected, rel=1e-6)


def test_phases_have_the_structure_function() -> None:
    """Over distances from 1 cm to 10 m, as the mean of 3000 flights: within 4 standard errors, 10 %."""
    rng, distances = np.random.default_rng(4), np.array([0.0, 0.01, 0.1, 1.0, 10.0])
    drawn = [Turbulence(1e-14).drawn(0.3, 50.0, rng).displacement(distances / 50.0)[:, 0] for _ in range(3000)]
    found = np.mean((np.array(drawn) - np.array(drawn)[:, :1]) ** 2, axis=0)
    np.testing.assert_allclose(found[1:], 0.3 * distances[1:] ** (5 / 3), rtol=0.1)


def test_all_dwells_fly_through_the_same_air() -> None:
    preset = replace(load_preset("small"), impairments=Impairments(turbulence=Turbulence(ground_cn2=1.7e-14)))
    flight = flight_of(preset, seed=3)
    np.testing.assert_array_equal(flight.pulse_phase(1), flight_of(preset, seed=3).pulse_phase(1))
    assert np.any(flight.pulse_phase(0) != flight_of(preset, seed=4).pulse_phase(0))
