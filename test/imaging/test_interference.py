"""Narrow-band emitters in the samples of a dwell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.narrow_band import Emitter, emitter_of, samples_of
from sal_height.imaging import NARROW_BAND, narrow_band_doubts
from sal_height.imaging.interference import power_spectrum, tail
from sal_height.sensor import range_compressed
from sal_height.simulation import flight_of, load_preset


def test_the_power_of_a_frequency_is_the_mean_over_channels_and_pulses() -> None:
    samples = np.random.default_rng(1).standard_normal((4, 6, 2 * 50)).astype(np.float32).view(np.complex64)
    for some in (samples, samples[::2, ::3]):
        assert power_spectrum(some) == pytest.approx(np.mean(np.abs(some) ** 2, axis=(0, 1)), rel=1e-5)


@pytest.mark.parametrize("shape", [1.0, 20.0, 300.0])
def test_the_greatest_of_gamma_deviates_is_not_said_to_be_rarer_than_it_is(shape: float) -> None:
    """Of 1000 trials with a probability of .02, 20 +- 4.5."""
    powers = np.random.default_rng(2).gamma(shape, size=(1000, 256))
    rare = sum(tail(row / np.median(row), row.max() / np.median(row), 10**6) < 0.02 for row in powers)
    assert rare < 30
    row = powers[0] / np.median(powers[0])
    assert tail(row, 1 + 60 / np.sqrt(shape), 10**6) < 1e-4


@pytest.mark.parametrize("scene", ["level", "street", "slope -40 deg"])
@pytest.mark.parametrize("cnr_db", [-100, 10, 40])
@pytest.mark.parametrize("bright_points", [0, 1, 2, 3])
def test_scenes_without_an_emitter_are_not_in_doubt(scene: str, cnr_db: float, bright_points: int) -> None:
    """Two or three points of 40 dB over the noise of a pixel make ripples in the spectrum."""
    samples, sensor = samples_of(scene, cnr_db, bright_points=bright_points)
    assert narrow_band_doubts(samples, sensor) == ()


@pytest.mark.parametrize(("pulse_duration", "record"), [(100e-9, 329), (200e-9, 580)])
@pytest.mark.parametrize("cnr_db", [3.0, 40.0])
def test_ripples_and_edges_of_the_band_of_a_chirp_are_no_emitter(
    pulse_duration: float, record: int, cnr_db: float
) -> None:
    preset = load_preset("small")
    chirp = replace(
        preset.sensor,
        waveform="chirp",
        pulse_duration_s=pulse_duration,
        sampling_rate_hz=2.5e9,
        sample_count=record,
    )
    for seed in range(3):
        flight = flight_of(replace(preset, cnr_db=cnr_db, sensor=chirp), seed)
        history, sensor = range_compressed(flight.phase_history(0), flight.sensor)
        assert narrow_band_doubts(history.samples, sensor) == ()


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize(("cnr_db", "power_db"), [(-100, -10), (5, -10), (10, 0), (20, 0), (30, 10)])
@pytest.mark.parametrize("in_beams", [True, False])
def test_an_emitter_is_found_with_its_power_and_frequency(
    scene: str, cnr_db: float, power_db: float, in_beams: bool
) -> None:
    samples, sensor = samples_of(scene, cnr_db)
    frequencies = samples.shape[2]
    one = Emitter(power_db, frequency=frequencies // 4, in_beams=in_beams)
    (doubt,) = narrow_band_doubts(samples + emitter_of(one, samples.shape, sensor), sensor)
    assert doubt.name == NARROW_BAND
    assert doubt.size == pytest.approx(power_db, abs=2.5)
    assert doubt.unit == "dB"
    offset = sensor.frequency_step * (frequencies // 4 - (frequencies - 1) / 2)
    assert f"{offset / 1e6:+.4g} MHz from the middle" in doubt.sentence


def test_what_cannot_be_compared_is_not_tested() -> None:
    """Noise of unknown power, few frequencies, channels without samples, and samples that are no numbers."""
    samples, sensor = samples_of("level", 5)
    seen = samples + emitter_of(Emitter(10.0), samples.shape, sensor)
    assert narrow_band_doubts(seen, sensor)
    unknown = replace(sensor, noise_power=(0.0,) * len(samples), config_hash="")
    assert narrow_band_doubts(seen, unknown) == ()
    assert narrow_band_doubts(seen[..., 40:80], sensor) == ()
    assert narrow_band_doubts(0 * seen, sensor) == ()
    greatest = np.finfo(np.float32).max
    for one in (np.nan, np.inf, greatest):
        spoilt = seen.copy()
        spoilt[0, 0, 3] = one
        with np.errstate(invalid="raise"):
            assert narrow_band_doubts(spoilt, sensor) == ()


@pytest.mark.parametrize("frequencies", [48, 256])
@pytest.mark.parametrize("extent", [1.0, 0.1, 0.02])
@pytest.mark.parametrize("pulses", [1, 8])
def test_bright_points_that_all_pulses_and_channels_receive_alike_are_no_emitter(
    frequencies: int, extent: float, pulses: int
) -> None:
    """Two to eight points of equal power within a part of the range window.

    Of dwells with two points in a tenth of the window 3 % were in doubt by the median alone.
    """
    _, sensor = samples_of("level", 5)
    rng = np.random.default_rng(4)
    at = np.arange(frequencies) - (frequencies - 1) / 2
    for points in (2, 3, 8):
        for _ in range(100):
            delays, phases = extent * rng.random((points, 1)), rng.random((points, 1))
            echo = 10 * np.exp(2j * np.pi * (delays * at + phases)).sum(axis=0)
            noise = rng.standard_normal((2, pulses, 2 * frequencies)).view(np.complex128) / np.sqrt(2)
            assert narrow_band_doubts((echo + noise).astype(np.complex64), sensor) == ()


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize("frequency", [0, 1, 120, 254])
def test_an_emitter_of_three_frequencies_or_between_two_is_found(scene: str, frequency: int) -> None:
    samples, sensor = samples_of(scene, 10)
    one = emitter_of(Emitter(0.0, frequency), samples.shape, sensor)
    rng, pulses = np.random.default_rng(6), samples.shape[1]
    turns = np.exp(2j * np.pi * rng.random((2, pulses, 1)))
    three = (one + turns[0] * np.roll(one, 1, axis=2) + turns[1] * np.roll(one, -1, axis=2)) / np.sqrt(3)
    leakage = np.sinc(np.arange(samples.shape[2]) - frequency - 0.5)
    between = one[:, :, frequency, None] * leakage
    for seen in (three, between):
        (doubt,) = narrow_band_doubts((samples + seen).astype(np.complex64), sensor)
        assert doubt.size == pytest.approx(-4, abs=2.5), "the power of the strongest frequency"
