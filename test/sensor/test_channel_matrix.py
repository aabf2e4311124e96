"""Channels that are made of the detectors: how the simulator forms them, and how whitening takes them apart."""

from __future__ import annotations

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
    multilook,
    offset_of,
    target_slc,
    whitening,
)

from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.errors import UserError
from sal_height.sensor.channels import with_powers
from sal_height.sensor.sensor import Sensor
from sal_height.sensor.waveform import spectrum_sensor
from sal_height.simulation.receiver_noise import form_channels, received, receiver_noise

LOSSLESS = np.array([[1, 1], [-1, 1]]) / np.sqrt(2)
"""Sum, and difference upper less lower, of two beams."""


def random_matrix(count: int, seed: int) -> np.ndarray:
    return circular(np.random.default_rng(seed), (count, count))


def random_covariance(count: int, seed: int) -> np.ndarray:
    root = random_matrix(count, seed)
    return root @ root.conj().T + 0.1 * np.eye(count)


def rows(matrix: np.ndarray) -> tuple[tuple[complex, ...], ...]:
    return tuple(tuple(row) for row in matrix.astype(complex).tolist())


def sensor_of_channels(matrix: np.ndarray, **changes: object) -> Sensor:
    offsets = (np.arange(len(matrix)) - (len(matrix) - 1) / 2) / 2
    values = {"elevation_boresights": tuple(elevation_at(offsets)), "noise_power": (1.0,) * len(matrix)}
    return make_sensor(**{**values, "channel_matrix": rows(matrix), **changes})


# Whitening


@pytest.mark.parametrize("count", [2, 3, 7])
def test_whitened_channels_have_equal_independent_noise(count: int) -> None:
    noise, matrix = random_covariance(count, 1), random_matrix(count, 2)
    power, transform = whitening(noise, matrix)
    np.testing.assert_allclose(transform @ noise @ transform.conj().T, power * np.eye(count), atol=1e-12 * power)


def test_whitened_channels_are_the_beams_times_a_positive_matrix() -> None:
    """Of all unitary turns of whitened channels the polar one has a Hermitian, positive matrix."""
    matrix = random_matrix(4, 4)
    made = whitening(random_covariance(4, 3), matrix)[1] @ matrix
    np.testing.assert_allclose(made, made.conj().T, atol=1e-12)
    assert np.linalg.eigvalsh(made)[0] > 0
    assert np.mean(np.sum(np.abs(made) ** 2, axis=0)) == pytest.approx(1, rel=1e-12)


def test_without_a_matrix_channels_are_scaled_to_the_harmonic_mean() -> None:
    powers = np.array([1.0, 4.0, 0.5])
    power, transform = whitening(np.diag(powers), np.eye(3))
    assert power == pytest.approx(3 / 3.25, rel=1e-14)
    np.testing.assert_allclose(transform, np.diag(np.sqrt(power / powers)), atol=1e-15)
    assert whitening(np.diag(np.full(3, 2.5)), np.eye(3))[0] == pytest.approx(2.5, rel=1e-14)


def test_a_lossless_hybrid_is_undone() -> None:
    power, transform = whitening(2.0 * np.eye(2), LOSSLESS)
    assert power == pytest.approx(2.0, rel=1e-14)
    np.testing.assert_allclose(transform @ LOSSLESS, np.eye(2), atol=1e-15)
    beams = make_beams(count=2)
    undone = beams.combined(transform @ LOSSLESS)
    assert undone.matrix is None
    assert not undone.is_complex


def test_calibration_constants_leave_real_beams_real() -> None:
    constants = np.diag([1.0, 1.1 * np.exp(0.5j), 0.9 * np.exp(-2j)])
    power, transform = whitening(np.diag([1.0, 2.0, 3.0]), constants)
    np.testing.assert_allclose(
        transform @ constants, np.diag(np.sqrt(power * np.array([1, 1.21 / 2, 0.81 / 3]))), atol=1e-15
    )
    beams = make_beams(count=3).combined(transform @ constants)
    assert beams.matrix is None
    assert not beams.is_complex


def test_beams_of_channels_are_the_matrix_times_those_of_detectors() -> None:
    beams, matrix = make_beams(count=3), random_matrix(3, 5)
    elevation, gains = elevation_at(np.linspace(-1, 1, 9)), np.array([1.0, 2j, -1.0])
    mixed = beams.combined(matrix)
    for mine, bare in ((mixed.response, beams.response), (mixed.slope, beams.slope)):
        np.testing.assert_allclose(mine(elevation, 0.0), bare(elevation, 0.0) @ matrix.T, rtol=1e-13)
    np.testing.assert_allclose(
        mixed.scaled(gains).response(elevation, 0.0), mixed.response(elevation, 0.0) * gains, rtol=1e-13
    )
    back = mixed.combined(np.linalg.inv(matrix))
    assert back.matrix is None
    np.testing.assert_allclose(back.response(elevation, 0.0), beams.response(elevation, 0.0), atol=1e-13)


def test_single_detectors_are_not_picked_from_mixtures() -> None:
    mixed = make_beams(count=3).combined(random_matrix(3, 6))
    for pick in (lambda: mixed.pair(0), lambda: mixed.detectors(np.array([0, 2]))):
        with pytest.raises(UserError) as refusal:
            pick()
        assert_one_sentence(str(refusal.value), "mixtures of detectors")


def test_noise_of_images_has_their_powers_and_the_correlations_of_samples() -> None:
    noise, powers = random_covariance(3, 7), np.array([2.0, 0.5, 30.0])
    scaled = with_powers(noise, powers)
    np.testing.assert_allclose(np.diag(scaled), powers, rtol=1e-14)
    for of, root in ((noise, np.sqrt(np.diag(noise).real)), (scaled, np.sqrt(powers))):
        correlation = of / np.outer(root, root)
        np.testing.assert_allclose(
            correlation[0, 1:], (noise / np.sqrt(np.outer(np.diag(noise), np.diag(noise))))[0, 1:]
        )
    unknown = with_powers(noise, np.array([0.0, 1.0, 1.0]))
    assert not unknown[0].any()
    np.testing.assert_array_equal(with_powers(np.zeros((3, 3), complex), powers), np.diag(powers))


@pytest.mark.parametrize(
    ("powers", "complaint"),
    [
        ([1.0, 0.0], "[1.0, 0.0]; all must be known, finite and greater than 0"),
        ([1.0, float("nan")], "finite and greater than 0"),
        ([1.0, float("inf")], "finite and greater than 0"),
        ([-1.0, 1.0], "finite and greater than 0"),
    ],
)
def test_unknown_noise_powers_are_refused(powers: list[float], complaint: str) -> None:
    with pytest.raises(UserError) as refusal:
        whitening(np.diag(powers), np.eye(2))
    assert_one_sentence(str(refusal.value), "noise powers", complaint)


def test_a_covariance_that_no_noise_has_is_refused() -> None:
    with pytest.raises(UserError) as refusal:
        whitening(np.array([[1.0, 2.0], [2.0, 1.0]]), np.eye(2))
    assert_one_sentence(str(refusal.value), "not positive definite")


# Sensor


@pytest.mark.parametrize(
    ("matrix", "complaint"),
    [
        (np.eye(2), "rows of [2, 2] entries; it must have 3 of 3"),
        (np.ones((1, 9)), "rows of [9] entries"),
        (np.ones((3, 3)), "condition number"),
        (np.diag([1, 1, 0]), "condition number"),
        (np.diag([1, 1, 1e-7]), "condition number 1e+07; to be inverted it must have 1e+06 or less"),
        (np.diag([1, 1, np.nan]), "NaN or infinite"),
        (np.diag([1, 1, np.inf * 1j]), "NaN or infinite"),
    ],
)
def test_a_channel_matrix_that_cannot_be_undone_is_refused(matrix: np.ndarray, complaint: str) -> None:
    with pytest.raises(UserError) as refusal:
        make_sensor(channel_matrix=rows(matrix))
    assert_one_sentence(str(refusal.value), "Sensor channel_matrix", complaint)


def test_the_identity_of_a_sensor_knows_its_channels() -> None:
    hashes = {
        sensor_of_channels(LOSSLESS).config_hash,
        sensor_of_channels(LOSSLESS.T).config_hash,
        sensor_of_channels(LOSSLESS * 1j).config_hash,
        sensor_of_channels(LOSSLESS, matrix_in_antenna=False).config_hash,
    }
    assert len(hashes) == 4


def test_noise_covariance_depends_on_where_the_receivers_are() -> None:
    matrix, powers = random_matrix(3, 8), (1.0, 4.0, 0.25)
    before = sensor_of_channels(matrix, noise_power=powers, matrix_in_antenna=False)
    np.testing.assert_array_equal(replace(before, matrix_in_antenna=True).noise_covariance, np.diag(powers))
    expected = sum(power * np.outer(column, column.conj()) for power, column in zip(powers, matrix.T, strict=True))
    np.testing.assert_allclose(before.noise_covariance, expected, rtol=1e-13)


# Simulator


def random_frames(sensor: Sensor, seed: int) -> np.ndarray:
    shape = sensor.detector_count, sensor.pulse_count, sensor.sample_count
    return circular(np.random.default_rng(seed), shape).astype(np.complex64)


def test_channels_are_the_matrix_times_the_detectors_frames() -> None:
    matrix = random_matrix(3, 9)
    for in_antenna in (True, False):
        sensor = sensor_of_channels(matrix, noise_power=(0.0,) * 3, matrix_in_antenna=in_antenna)
        frames = random_frames(sensor, 10)
        expected = sum(matrix[:, i, None, None] * frames[i] for i in range(3))
        seen = received(frames, sensor, np.random.default_rng(11))
        assert seen.dtype == np.complex64
        np.testing.assert_allclose(seen, expected, atol=1e-6 * np.abs(expected).max())


def test_noise_enters_where_the_receivers_are() -> None:
    matrix = random_matrix(3, 12)
    behind, before = (sensor_of_channels(matrix, matrix_in_antenna=place) for place in (True, False))
    noise = receiver_noise(behind, behind.pulse_count, np.random.default_rng(13))
    silence = np.zeros_like(noise)
    np.testing.assert_array_equal(received(silence, behind, np.random.default_rng(13)), noise)
    np.testing.assert_array_equal(received(silence, before, np.random.default_rng(13)), form_channels(noise, before))


@pytest.mark.parametrize("in_antenna", [True, False])
@pytest.mark.parametrize("waveform", ["spectrum", "deramped"])
def test_simulated_noise_has_the_sensors_covariance(in_antenna: bool, waveform: str) -> None:
    """Each entry of a sample covariance of N looks has the standard error sqrt(C_ii C_jj / N), 1.8 %."""
    pulse = {"waveform": waveform}
    if waveform != "spectrum":
        pulse |= {"chirp_rate": 2e15, "pulse_duration": 1e-6, "sampling_rate": 64e6, "sample_count": 68}
    sensor = sensor_of_channels(
        random_matrix(3, 14), noise_power=(1.0, 4.0, 0.25), matrix_in_antenna=in_antenna, **pulse
    )
    frames = np.zeros((3, sensor.pulse_count, sensor.sample_count), np.complex64)
    noise = received(frames, sensor, np.random.default_rng(15)).reshape(3, -1)
    power = np.sqrt(np.diag(sensor.noise_covariance).real)
    difference = (noise @ noise.conj().T / noise.shape[1] - sensor.noise_covariance) / np.outer(power, power)
    np.testing.assert_allclose(difference, 0, atol=3.5 / np.sqrt(noise.shape[1]))
    np.testing.assert_array_equal(spectrum_sensor(sensor).mixing, sensor.mixing)


# Heights


def estimated(channels: np.ndarray, sensor: Sensor) -> ElevationEstimate:
    """By maximum likelihood from images (channels, pixels, looks), with what the sensor says about its channels."""
    power, transform = whitening(sensor.noise_covariance, sensor.mixing)
    seen = sensor.beams.combined(transform @ sensor.mixing)
    looks = multilook(channels, 1, channels.shape[2], seen.is_complex, transform, noise_power=power)
    return ml_elevation(looks, seen, MlSettings(min_cnr_db=0.0, layover=False))


@pytest.mark.parametrize("scale", [1.0, np.sqrt(2), 10 ** (-1.5 / 20)])
def test_a_sum_and_a_difference_give_the_elevations_of_the_bare_pair(scale: float) -> None:
    """Receivers before the hybrid: whatever its gain, it is undone with the noise that was there."""
    matrix = scale * LOSSLESS
    bare = sensor_of_channels(np.eye(2))
    slc = target_slc(bare.beams, np.linspace(-0.5, 0.5, 200)[:, None], 200, 8, 100.0, np.random.default_rng(16))
    slc = slc.astype(np.complex64)
    mixed = sensor_of_channels(matrix, matrix_in_antenna=False)
    expected, seen = estimated(slc, bare), estimated(form_channels(slc, mixed), mixed)
    np.testing.assert_allclose(offset_of(seen.elevation), offset_of(expected.elevation), atol=1e-6)
    np.testing.assert_allclose(seen.sigma, expected.sigma, rtol=1e-4)
    np.testing.assert_allclose(seen.cnr, expected.cnr, rtol=1e-4)
    np.testing.assert_array_equal(seen.validity, expected.validity)
    assert np.mean(expected.validity == Validity.OK) > 0.4


def test_any_matrix_behind_the_receivers_changes_nothing() -> None:
    """The likelihood of M times the beams in noise M N M^H is that of the beams in noise N."""
    bare = sensor_of_channels(np.eye(3), noise_power=(1.0, 2.0, 0.5))
    noise = np.sqrt(bare.noise_power)[:, None, None] * circular(np.random.default_rng(18), (3, 100, 16))
    response = bare.beams.response(elevation_at(np.linspace(-0.5, 0.5, 100)), 0.0).T[..., None]
    slc = (10 * response * circular(np.random.default_rng(17), (100, 16)) + noise).astype(np.complex64)
    mixed = replace(bare, channel_matrix=rows(random_matrix(3, 19)), matrix_in_antenna=False)
    expected, seen = estimated(slc, bare), estimated(form_channels(slc, mixed), mixed)
    np.testing.assert_allclose(offset_of(seen.elevation), offset_of(expected.elevation), atol=1e-5)


def test_calibration_constants_change_nothing_when_described() -> None:
    rng = np.random.default_rng(20)
    constants = 10 ** (rng.normal(0, 1, 3) / 20) * np.exp(1j * np.radians(rng.normal(0, 30, 3)))
    bare = sensor_of_channels(np.eye(3))
    told = sensor_of_channels(np.diag(constants), matrix_in_antenna=False)
    slc = target_slc(bare.beams, 0.3, 300, 16, 100.0, rng).astype(np.complex64)
    expected, seen = estimated(slc, bare), estimated(form_channels(slc, told), told)
    np.testing.assert_allclose(offset_of(seen.elevation), offset_of(expected.elevation), atol=1e-6)
    untold = estimated(form_channels(slc, told), bare)
    bias = offset_of(untold.elevation) - offset_of(expected.elevation)
    assert np.abs(np.mean(bias)) > 5 * np.mean(expected.sigma) / BEAMWIDTH / np.sqrt(300)
