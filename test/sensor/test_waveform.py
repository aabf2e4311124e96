"""Range compression: raw echoes written out in time become what their frequencies written out are."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alos import forest_echoes
from helpers import (
    RAW_WAVEFORMS,
    circular,
    direct_history,
    flat_scene,
    make_aperture,
    make_sensor,
    sample_frequencies,
    with_waveform,
)
from scipy.constants import speed_of_light

from sal_height.imaging.formers.backprojection import backproject, backproject_points
from sal_height.imaging.pixels import Processing, slant_plane_grid, slc_noise_power
from sal_height.numeric.windows import broadening, window
from sal_height.sensor import waveform
from sal_height.sensor.sensor import PhaseHistory, Sensor
from sal_height.sensor.waveform import (
    echo_sensor,
    from_spectrum,
    range_compressed,
    spectrum_sensor,
    to_spectrum,
)
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset

BANDWIDTH = 2e9


def chirp_sensor(sign: int = 1, record: int = 329, **changes: object) -> Sensor:
    """A pulse of 100 ns, time-bandwidth product 200, and a window of 64 resolution cells."""
    values = {"chirp_rate": sign * BANDWIDTH / 100e-9, "pulse_duration": 100e-9, "sampling_rate": 2.5e9}
    return make_sensor(waveform="chirp", bandwidth=BANDWIDTH, sample_count=record, **{**values, **changes})


def deramped_sensor(sign: int = 1, record: int = 1100, **changes: object) -> Sensor:
    """A pulse of 10 us, time-bandwidth product 20 000, sampled for delays of 500 ns: 1000 resolution cells."""
    values = {"chirp_rate": sign * BANDWIDTH / 10e-6, "pulse_duration": 10e-6, "sampling_rate": 100e6}
    return make_sensor(waveform="deramped", bandwidth=BANDWIDTH, sample_count=record, **{**values, **changes})


def raw_echo(sensor: Sensor, delay: np.ndarray, video_sign: int = 1) -> np.ndarray:
    """Echo of a point of amplitude 1, late by tau - tau_r = `delay` (s, shape (...)), as ChannelFrame defines it."""
    time = (np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2) / sensor.sampling_rate
    rate, late = sensor.chirp_rate, np.asarray(delay)[..., None]
    lasts = np.abs(time - late) <= sensor.pulse_duration / 2
    carrier = np.exp(-2j * np.pi * speed_of_light / sensor.wavelength * late)
    if sensor.waveform == "chirp":
        return lasts * np.exp(1j * np.pi * rate * (time - late) ** 2) * carrier
    video = np.exp(video_sign * 1j * np.pi * rate * late**2)
    return lasts * np.exp(-2j * np.pi * rate * late * time) * carrier * video


def compressed(sensor: Sensor, delay: float, video_sign: int = 1) -> np.ndarray:
    """Range-compressed echo of a point over its frequencies written out: 1 where they agree."""
    raw = raw_echo(sensor, np.array(delay), video_sign)[None, None].astype(np.complex64)
    expected = np.exp(-2j * np.pi * sample_frequencies(spectrum_sensor(sensor)) * delay)
    return to_spectrum(raw, sensor)[0, 0] / expected


# Matched filter

ALONG = (np.arange(48) - 23.5) * 50 / 30e3
ANTENNA = make_aperture().position + ALONG[:, None] * np.array([1.0, 0.0, 0.0])
REFERENCE = np.full(48, 5000.0)
FORWARD = np.array([1.0, 0.0, 0.0])
SIGHT = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)


def range_cut(sensor: Sensor, beyond: float, steps: np.ndarray) -> np.ndarray:
    """Focused image of a point `beyond` the reference range (m), `steps` resolution cells around it in range."""
    point = make_aperture().position + (5000 + beyond) * SIGHT
    delay = 2 / speed_of_light * (np.linalg.norm(point - ANTENNA, axis=-1) - REFERENCE)
    raw = raw_echo(sensor, delay)[None].astype(np.complex64)
    history, focusing = range_compressed(PhaseHistory(0, np.zeros(48), REFERENCE, raw), sensor)
    pixels = point + steps[:, None] * focusing.range_resolution * SIGHT
    return backproject_points(history, ANTENNA, focusing, Processing("rectangular"), pixels, FORWARD)[0]


def peak_of(power: np.ndarray, steps: np.ndarray) -> float:
    i = int(np.argmax(power))
    low, top, high = power[i - 1 : i + 2]
    return float(steps[i] + (steps[1] - steps[0]) * (low - high) / (2 * (low - 2 * top + high)))


@pytest.mark.parametrize("sign", [1, -1], ids=["rising", "falling"])
@pytest.mark.parametrize("record", [329, 330, 331])
@pytest.mark.parametrize("beyond", [0.0, 0.813, -1.7])
def test_echo_of_a_chirp_focuses_at_its_place_with_its_amplitude(sign: int, record: int, beyond: float) -> None:
    """To a 128th of the resolution and 1 %."""
    steps = np.arange(-24, 25) / 32
    cut = range_cut(chirp_sensor(sign, record), beyond, steps)
    assert abs(peak_of(np.abs(cut) ** 2, steps)) < 1 / 128
    assert cut[24] == pytest.approx(1.0, abs=0.01)


def test_sidelobes_of_the_matched_filter_are_those_of_the_band_of_the_pulse() -> None:
    """-13.3 dB is a flat band's; ripples and edges of |S|^2 change it to -13.1, as the band written out says."""
    steps = np.arange(-10, 10, 1 / 32)
    power = np.abs(range_cut(chirp_sensor(), 0.0, steps)) ** 2
    beyond_null = np.abs(steps) > 1.0
    level = 10 * np.log10(power[beyond_null].max() / power.max())
    # |S|^2 summed up and transformed without any of our code.
    time = np.arange(-250, 250) / 500 * 100e-9 + 1e-10
    frequency = np.linspace(-1e9, 1e9, 401)
    pulse = np.exp(1j * np.pi * BANDWIDTH / 100e-9 * time**2)
    band = np.abs(np.exp(-2j * np.pi * np.outer(frequency, time)) @ pulse) ** 2
    response = np.abs(np.exp(2j * np.pi * np.outer(steps / BANDWIDTH, frequency)) @ band) ** 2
    expected = 10 * np.log10(response[beyond_null].max() / response.max())
    assert level == pytest.approx(expected, abs=0.3)
    assert -14.6 < level < -13.0


def test_wrong_chirp_rate_loses_the_focus() -> None:
    sensor = chirp_sensor()
    raw = raw_echo(sensor, np.array(0.0))[None, None].astype(np.complex64)
    for part in (-1, 0.97):
        rate = part * sensor.chirp_rate
        wrong = replace(sensor, chirp_rate=rate, bandwidth=abs(rate) * sensor.pulse_duration)
        assert abs(to_spectrum(raw, wrong).mean()) < 0.8
    assert abs(to_spectrum(raw, sensor).mean()) == pytest.approx(1, abs=0.01)


def test_delays_at_which_the_pulse_is_not_whole_are_left_out() -> None:
    """A point just inside the window stays, one beyond it by half a pulse goes instead of appearing elsewhere."""
    sensor = chirp_sensor()
    half = spectrum_sensor(sensor).range_window / speed_of_light
    delays = np.array([0.9 * half, half + sensor.pulse_duration / 2])
    raw = raw_echo(sensor, delays)[None].astype(np.complex64)
    energy = np.mean(np.abs(to_spectrum(raw, sensor)[0]) ** 2, axis=-1)
    assert np.mean(np.abs(raw[0, 1]) ** 2) > 0.3 * np.mean(np.abs(raw[0, 0]) ** 2)
    assert energy[0] == pytest.approx(1, abs=0.1)
    assert energy[1] < 0.01


# Deramp


@pytest.mark.parametrize("sign", [1, -1], ids=["rising", "falling"])
@pytest.mark.parametrize("record", [1100, 1101])
@pytest.mark.parametrize("part", [0.0, 0.1, -0.3, 0.45])
def test_deramped_echo_is_its_frequencies_written_out(sign: int, record: int, part: float) -> None:
    """Within the middle three quarters of the band: the ends of an echo ring, as far as 1/8 of it to 0.2 %."""
    sensor = deramped_sensor(sign, record)
    window_delay = sensor.sampling_rate / abs(sensor.chirp_rate)
    ratio = compressed(sensor, part * window_delay)
    edge = len(ratio) // 8
    assert len(ratio) in (999, 1000)
    np.testing.assert_allclose(ratio[edge:-edge], 1, atol=0.005)
    assert np.sqrt(np.mean(np.abs(ratio[edge:-edge] - 1) ** 2)) < 1e-3


@pytest.mark.parametrize("sign", [1, -1], ids=["rising", "falling"])
def test_residual_video_phase_of_the_other_sign_does_not_go(sign: int) -> None:
    """It stays twice: the test above would see it."""
    sensor = deramped_sensor(sign)
    delay = 0.1 * sensor.sampling_rate / abs(sensor.chirp_rate)
    ratio = compressed(sensor, delay, video_sign=-1)[125:-125]
    np.testing.assert_allclose(ratio, np.exp(-2j * np.pi * sensor.chirp_rate * delay**2), atol=0.005)
    assert np.abs(ratio - 1).min() > 0.1


# Both


def raw_sensor(name: str, sign: int = 1, **changes: object) -> Sensor:
    return {"chirp": chirp_sensor, "deramped": deramped_sensor}[name](sign, **changes)


@pytest.mark.parametrize("name", RAW_WAVEFORMS)
def test_noise_power_is_that_of_the_filtered_samples(name: str) -> None:
    sensor = raw_sensor(name, noise_power=(1.0, 4.0, 0.25))
    pulses = 3000 if name == "chirp" else 300
    noise = circular(np.random.default_rng(21), (3, pulses, sensor.sample_count))
    noise *= np.sqrt(sensor.noise_power)[:, None, None]
    power = np.mean(np.abs(to_spectrum(noise.astype(np.complex64), sensor)) ** 2, axis=-1)
    standard_error = np.std(power, axis=1) / np.sqrt(pulses)  # of pulses, which are independent: 0.2 to 0.3 %
    assert np.all(standard_error < 0.003 * power.mean(axis=1))
    expected = np.array(spectrum_sensor(sensor).noise_power)
    assert np.all(np.abs(power.mean(axis=1) - expected) < 3.5 * standard_error)


@pytest.mark.parametrize("name", RAW_WAVEFORMS)
def test_amplitude_ratios_between_detectors_survive(name: str) -> None:
    sensor, gains = raw_sensor(name), np.array([0.9, -0.31, 0.05 + 0.4j])
    raw = gains[:, None, None] * raw_echo(sensor, np.array([3.3e-9]))
    samples = to_spectrum(raw.astype(np.complex64), sensor)
    expected = np.broadcast_to((gains / gains[0])[:, None, None], samples.shape)
    np.testing.assert_allclose(samples / samples[0], expected, atol=1e-6)


@pytest.mark.parametrize("name", RAW_WAVEFORMS)
@pytest.mark.parametrize("sign", [1, -1], ids=["rising", "falling"])
def test_simulated_echo_is_the_one_written_out(name: str, sign: int) -> None:
    """Where the echo lasts, but for its ends; a delay of full samples from the middle has no ends to differ in."""
    sensor = raw_sensor(name, sign, **({"record": 330} if name == "chirp" else {}))
    delay = np.array([-10e-9])
    clean = np.exp(-2j * np.pi * sample_frequencies(echo_sensor(sensor)) * delay[:, None])
    raw, expected = from_spectrum(clean[None], sensor)[0], raw_echo(sensor, delay)
    assert raw.dtype == np.complex64
    inside = slice(None) if name == "chirp" else slice(180, -180)
    np.testing.assert_allclose(raw[:, inside], expected[:, inside], atol=1e-6 if name == "chirp" else 1e-3)


@pytest.mark.parametrize("name", RAW_WAVEFORMS)
@pytest.mark.parametrize("record", [0, 1])
def test_simulated_echoes_compress_to_what_they_are_made_of(name: str, record: int) -> None:
    sensor = raw_sensor(name, record=raw_sensor(name).sample_count + record)
    delay = np.array([0.0, 4e-9, -7.7e-9])
    clean = np.exp(-2j * np.pi * sample_frequencies(echo_sensor(sensor)) * delay[:, None])
    samples = to_spectrum(from_spectrum(clean[None], sensor), sensor)[0]
    ratio = samples / np.exp(-2j * np.pi * sample_frequencies(spectrum_sensor(sensor)) * delay[:, None])
    if name == "deramped":
        np.testing.assert_allclose(ratio, 1, atol=1e-6)
    else:
        np.testing.assert_allclose(ratio.mean(axis=-1), 1, atol=0.002)


def test_samples_over_frequency_pass_as_they_are() -> None:
    sensor, samples = make_sensor(), np.ones((3, 2, 64), np.complex64)
    assert to_spectrum(samples, sensor) is samples
    assert spectrum_sensor(sensor) is sensor
    assert echo_sensor(sensor) is sensor


@pytest.mark.parametrize("name", RAW_WAVEFORMS)
def test_compressed_description_is_the_same_but_for_its_samples(name: str) -> None:
    sensor = raw_sensor(name)
    spectrum = spectrum_sensor(sensor)
    assert spectrum.config_hash == sensor.config_hash
    assert spectrum.waveform == "spectrum"
    assert spectrum.bandwidth <= BANDWIDTH * (1 + 1e-9)
    assert spectrum.bandwidth > BANDWIDTH - 2 * spectrum.frequency_step
    assert spectrum.beams.span == sensor.beams.span
    # The window in delay: the record less the pulse; or what the sampling rate tells apart.
    seconds = (329 - 250 + 1) / 2.5e9 if name == "chirp" else 100e6 / 2e14
    assert spectrum.range_window == pytest.approx(speed_of_light / 2 * seconds, rel=1e-12)


@pytest.mark.parametrize("name", RAW_WAVEFORMS)
def test_work_in_blocks_changes_nothing_and_needs_no_second_copy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = raw_sensor(name)
    samples = circular(np.random.default_rng(3), (3, 300, sensor.sample_count)).astype(np.complex64)
    before, at_once = samples.copy(), to_spectrum(samples, sensor)
    monkeypatch.setattr(waveform, "BLOCK_SAMPLES", 2**12)
    tracemalloc.start()
    try:
        in_blocks = to_spectrum(samples, sensor)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert np.array_equal(in_blocks, at_once)
    assert np.array_equal(samples, before)
    assert peak < 1.5 * samples.nbytes


@pytest.fixture(scope="module")
def image() -> Callable[[str, str], np.ndarray]:
    """Image of a dwell of the small preset over level ground, in units of its noise; CNR 100 dB."""

    def focus(name: str, window_name: str) -> np.ndarray:
        preset = replace(with_waveform(load_preset("small"), name), cnr_db=100.0)
        flight = SimulatedFlight(preset, preset.make_sensor(), flat_scene(), dwells=3, seed=4)
        history, sensor = range_compressed(flight.phase_history(1), flight.sensor)
        weights = window(window_name, sensor.sample_count)
        grid = slant_plane_grid(sensor, flight.aperture(1), 5000.0, 46, 12, broadening(weights))
        antenna = flight.position(flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times)
        processing = Processing(window_name)
        noise = np.sqrt(slc_noise_power(sensor, processing, len(antenna)))[:, None, None]
        return backproject(history, antenna, sensor, processing, grid) / noise

    return focus


@pytest.mark.parametrize(
    ("name", "window_name", "alike", "louder"),
    [
        ("deramped", "rectangular", 1e-8, 1e-5),
        ("deramped", "taylor", 1e-8, 1e-5),
        ("chirp", "rectangular", 0.0125, 0.05),
        ("chirp", "taylor", 0.0015, 0.05),
    ],
)
def test_flight_with_raw_echoes_shows_the_same_image_over_its_noise(
    image: Callable[[str, str], np.ndarray], window_name: str, name: str, alike: float, louder: float
) -> None:
    """The band of a matched filter is the signal's own, so that it gains up to 5 % (0.2 dB) on white noise.

    Its edges are soft, which a window hides: over six seeds images differ by 0.0110 +- 0.0007, with Taylor weights by
    0.0011 +- 0.0001.
    """
    expected, measured = image("spectrum", window_name), image(name, window_name)
    correlation = np.abs(np.vdot(measured, expected)) / np.linalg.norm(measured) / np.linalg.norm(expected)
    assert 1 - correlation < alike
    ratio = np.mean(np.abs(measured) ** 2) / np.mean(np.abs(expected) ** 2)
    assert -1e-5 < ratio - 1 < louder


# Real echoes

RAYLEIGH = float(np.sqrt(4 / np.pi - 1))
"""Standard deviation over mean of the amplitude of speckle: 0.5227."""


@pytest.fixture(scope="module")
def alos(shared_data: Callable[[str], Path]) -> tuple[Sensor, np.ndarray]:
    """Raw echoes of ALOS PALSAR over rain forest, and the sensor as its file describes it."""
    echoes = forest_echoes(shared_data)
    sensor = make_sensor(
        wavelength=speed_of_light / echoes.carrier,
        bandwidth=abs(echoes.slope) * echoes.duration,
        sample_count=echoes.raw.shape[1],
        pulse_count=echoes.raw.shape[0],
        pulse_repetition_frequency=2150.538,
        elevation_diameter=8.9,
        azimuth_diameter=8.9,
        elevation_boresights=(0.6,),
        noise_power=(0.0,),
        waveform="chirp",
        chirp_rate=echoes.slope,
        pulse_duration=echoes.duration,
        sampling_rate=echoes.rate,
    )
    return sensor, echoes.raw[None]


def range_profiles(sensor: Sensor, raw: np.ndarray) -> np.ndarray:
    """Amplitude of every pulse over range, one sample per resolution cell."""
    return np.abs(np.fft.fftshift(np.fft.ifft(to_spectrum(raw, sensor)[0], axis=1), axes=1))


def contrast(amplitude: np.ndarray) -> float:
    """Standard deviation over mean, in windows of 100 x 100 in which brightness is level, averaged."""
    rows, cols = (size // 100 for size in amplitude.shape)
    windows = amplitude[: 100 * rows, : 100 * cols].reshape(rows, 100, cols, 100)
    return float(np.mean(windows.std(axis=(1, 3)) / windows.mean(axis=(1, 3))))


def test_real_echoes_become_speckle(alos: tuple[Sensor, np.ndarray]) -> None:
    """Contrast 0.5231, over the whole swath with its brightness gradient 0.5279; the raw samples have 0.492."""
    sensor, raw = alos
    amplitude = range_profiles(sensor, raw)
    assert amplitude.shape == (1000, 1547)
    assert contrast(amplitude) == pytest.approx(RAYLEIGH, abs=0.002)
    assert amplitude.std() / amplitude.mean() == pytest.approx(RAYLEIGH, abs=0.02)
    assert abs(contrast(np.abs(raw[0])) - RAYLEIGH) > 0.02


def relief(power: np.ndarray) -> np.ndarray:
    """Mean power over range less its slow course, a cubic."""
    place = np.linspace(-1, 1, power.shape[1])
    profile = power.mean(axis=0) / power.mean()
    return profile - np.polyval(np.polyfit(place, profile, 3), place)


def test_real_ground_shows_with_the_slope_of_the_pulse_only(alos: tuple[Sensor, np.ndarray]) -> None:
    """Speckle has the contrast of speckle whatever the slope: it cannot tell. The ground under it can.

    The first and the last 500 pulses have other speckle over the same ground: their mean power over range correlates
    by what is sharp. Measured: 0.164 with the slope as stated, 0.048 with 0.8 of it, -0.022 with the other sign. A
    slope within 2 % cannot be told from the right one.
    """
    sensor, raw = alos
    correlation = {}
    for part in (1.0, 0.8, -1.0):
        rate = part * sensor.chirp_rate
        wrong = replace(sensor, chirp_rate=rate, bandwidth=abs(rate) * sensor.pulse_duration)
        power = range_profiles(wrong, raw) ** 2
        assert contrast(np.sqrt(power)) == pytest.approx(RAYLEIGH, abs=0.002)
        correlation[part] = np.corrcoef(relief(power[:500]), relief(power[500:]))[0, 1]
    standard_error = 1 / np.sqrt(1547)  # of the correlation of independent cells: 0.025
    assert correlation[1.0] > 5 * standard_error
    assert correlation[0.8] < 3 * standard_error
    assert abs(correlation[-1.0]) < 3 * standard_error


def test_direct_history_and_raw_echoes_share_their_signs() -> None:
    """One point in `direct_history`, which all tests of focusing use, and through the receiver."""
    sensor = deramped_sensor()
    point = make_aperture().position + 5002.0 * SIGHT
    delay = 2 / speed_of_light * (np.linalg.norm(point - ANTENNA, axis=-1) - REFERENCE)
    samples = to_spectrum(raw_echo(sensor, delay)[None].astype(np.complex64), sensor)[0]
    expected = direct_history(spectrum_sensor(sensor), point[None], np.ones(1), ANTENNA, REFERENCE)
    np.testing.assert_allclose(samples[:, 125:-125], expected[:, 125:-125], atol=0.005)


def test_gains_of_a_matched_filter_are_computed_once_for_equal_sensors() -> None:
    """Range compression asks for them three times in each dwell; they take 56 ms of 4096 samples."""
    described = spectrum_sensor(chirp_sensor())
    assert spectrum_sensor(chirp_sensor()) is described
    assert spectrum_sensor(chirp_sensor(sign=-1)) is not described
