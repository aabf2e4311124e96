"""Spectra of speckle are those of the response that made it; so is the pointing; and real speckle shows its chirp."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from alos import forest
from helpers import circular

from sal_height.figures.psf_estimators import mean_modulus
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, make_tape
from sal_height.response.speckle_spectra import (
    SpeckleSpectra,
    estimate_speckle_spectra,
    fejer_power,
    frequencies,
    periodogram_covariance,
)
from sal_height.response.speckle_tiles import find_pure_speckle


def true_covariance(response: np.ndarray) -> np.ndarray:
    """Autocovariance at lags 0 to 63 of speckle with a response, over that at 0."""
    covariance = np.fft.ifft(np.fft.ifftshift(np.abs(response) ** 2))[:64]
    return covariance / covariance[0]


def eight_images(seed: int, noise: float = 0.0, spur: float = 0.0, beam: AzimuthFault | None = None) -> np.ndarray:
    """The paper's eight images of 256 x 256, side by side."""
    rng = np.random.default_rng(seed)
    beam = beam or AzimuthFault()
    images = [make_tape((256, 256), rng, (), RangeFault(), beam, noise=noise, nyquist_spur=spur) for _ in range(8)]
    return np.concatenate(images, axis=1)


def spectra_of(image: np.ndarray, noise_power: float | None = None) -> SpeckleSpectra:
    return estimate_speckle_spectra(image, find_pure_speckle(image, noise_power=noise_power))


@pytest.mark.parametrize("noise", [0.0, 0.6])
def test_eight_images_tell_the_response(noise: float) -> None:
    """The convolved spectrum within its errors; |R| within 4 % of its greatest, |A| within 1 %, rms.

    Convolved, |R| is off by 3.8 to 4.2 %, |A| by 1.9 to 2.2 %. What is left of R are the steps of its sawtooth.
    """
    spectra, share = spectra_of(eight_images(1, noise)), noise**2 / (1 + noise**2)
    axes = ((spectra.range, RangeFault(), 0.04), (spectra.azimuth, AzimuthFault(), 0.01))
    for axis, fault, allowed in axes:
        expected = fejer_power(true_covariance(fault.response(256))) * (1 - share) + share
        z = ((axis.power - expected) / axis.standard_error)[20:44]  # beyond, errors are those of the bins' leakage
        assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
        truth = np.abs(fault.response(64)) / np.sqrt(np.mean(np.abs(fault.response(256)) ** 2))
        power, error = axis.unfolded(64)
        modulus = np.sqrt(np.maximum(power - share, 0) / (1 - share))
        assert np.sqrt(np.mean((modulus - truth) ** 2)) < allowed * truth.max()
        assert np.all((error > 0) & (error < 0.2))
    assert spectra.noise_floor == pytest.approx(share, abs=0.03)
    assert spectra.range.spur == 0


@pytest.mark.thorough
def test_standard_errors_are_the_scatter_of_images() -> None:
    """40 images: a standard deviation is known to 11 %, the mean of its ratio over 28 bins far better."""
    rng = np.random.default_rng(2)
    images = [make_tape((128, 512), rng, (), RangeFault(), AzimuthFault(), noise=0.3) for _ in range(40)]
    spectra = [spectra_of(image) for image in images]
    for of_axis in (lambda s: s.range, lambda s: s.azimuth):
        scatter = np.std([of_axis(s).power for s in spectra], axis=0)
        stated = np.mean([of_axis(s).standard_error for s in spectra], axis=0)
        assert np.mean((scatter / stated)[20:44]) == pytest.approx(1, abs=0.12)
    scatter = np.std([s.range.unfolded(64)[0] for s in spectra], axis=0)
    stated = np.mean([s.range.unfolded(64)[1] for s in spectra], axis=0)
    assert np.mean((scatter / stated)[20:44]) == pytest.approx(1, abs=0.25)


def test_covariance_of_periodograms_is_that_of_their_scatter() -> None:
    """20 000 lines of a coloured field: standard error 1 % of a variance, 0.7 % of it of a covariance."""
    image = make_tape((64, 20000), np.random.default_rng(3))
    covariance = true_covariance(RangeFault().response(256))[:16]
    gain = np.linalg.cholesky(np.array([[covariance[abs(i - j)].real for j in range(16)] for i in range(16)]))
    lines = gain @ image[:16]
    power = np.abs(np.fft.fftshift(np.fft.fft(lines, axis=0), axes=0)) ** 2 / 16
    expected = periodogram_covariance(covariance.real.astype(complex), 16)
    deviation = np.sqrt(np.diag(expected))
    assert np.max(np.abs(np.cov(power) - expected) / np.outer(deviation, deviation)) < 0.06
    np.testing.assert_allclose(np.diag(expected), fejer_power(covariance.real.astype(complex)) ** 2, rtol=1e-9)
    assert np.max(np.abs(expected / np.outer(deviation, deviation) - np.eye(16))) > 0.3


def smoothed_in_range(seed: int, side: int) -> np.ndarray:
    """Speckle whose neighbours correlate by 0.4 along range, and not along azimuth."""
    white = circular(np.random.default_rng(seed), (side + 1, side))
    return (white[1:] + 0.5 * white[:-1]).astype(np.complex64)


def test_mean_modulus_is_that_of_rayleigh_amplitudes() -> None:
    """sqrt(pi) / 2 of the root of the mean periodogram: of an axis without a response, and in the shape of R."""
    smooth = smoothed_in_range(4, 512)
    across = mean_modulus(smooth, find_pure_speckle(smooth, noise_power=0.0))[1]
    np.testing.assert_allclose(across / across.mean(), 1, rtol=0.035)
    image = eight_images(5)
    tiles = find_pure_speckle(image)
    modulus, _ = mean_modulus(image, tiles)
    expected = np.sqrt(fejer_power(true_covariance(RangeFault().response(256))))
    ratio = modulus / expected
    assert np.max(np.abs(ratio[20:44] / ratio[20:44].mean() - 1)) < 0.03


def test_pointing_follows_the_antenna() -> None:
    """Errors are as large as stated: 48 columns of tiles, the rms known to 10 %."""
    rng, beam, z = np.random.default_rng(6), AzimuthFault(swing=0.1, swing_period=1024), []
    for _ in range(3):
        pointing = spectra_of(make_tape((256, 1024), rng, (), RangeFault(), beam)).pointing
        assert pointing is not None
        np.testing.assert_array_equal(pointing.cols, np.arange(16) * 64 + 31.5)
        z.extend((pointing.displacement - beam.pointing(pointing.cols)) / pointing.sigma)
        assert np.all(pointing.sigma < 0.005)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.35)


def test_azimuth_response_is_not_smeared_by_the_swing() -> None:
    """|A| within 1.5 % of that of a still antenna; averaged over the swing it is 5 % off."""
    beam, still = AzimuthFault(swing=0.15, swing_period=1024), np.abs(AzimuthFault().response(64))
    image = make_tape((256, 1024), np.random.default_rng(7), (), RangeFault(), beam)
    power, _ = spectra_of(image).azimuth.unfolded(64)
    truth = still / np.sqrt(np.mean(still**2))
    smeared = np.mean([np.abs(beam.response(64, p)) ** 2 for p in beam.pointing(np.arange(1024))], axis=0)
    smeared = np.sqrt(smeared / smeared.mean())
    error = np.sqrt(np.mean((np.sqrt(np.maximum(power, 0)) - truth) ** 2)) / truth.max()
    assert error < 0.015
    assert np.sqrt(np.mean((smeared - truth) ** 2)) / truth.max() > 0.05


def test_a_flat_azimuth_response_has_no_pointing() -> None:
    assert spectra_of(smoothed_in_range(8, 256), noise_power=0.0).pointing is None


def test_spur_at_half_a_cycle_is_named_and_taken_out() -> None:
    """Amplitude 0.3 of the rms: 0.09 / 1.09 of the power. R and A are then as without it, within their errors."""
    found = spectra_of(eight_images(9, spur=0.3))
    assert found.range.spur == pytest.approx(0.09 / 1.09, rel=0.05)
    for axis, fault in ((found.range, RangeFault()), (found.azimuth, AzimuthFault())):
        expected = fejer_power(true_covariance(fault.response(256)))
        assert np.max(np.abs(axis.power - expected) / axis.standard_error) < 4.5


def test_tiles_count_alike_whatever_their_brightness() -> None:
    image = eight_images(10)
    tiles = find_pure_speckle(image)
    bright = image * np.repeat(np.geomspace(0.01, 100, 32), 64).astype(np.float32)
    expected, found = estimate_speckle_spectra(image, tiles), spectra_of(bright)
    np.testing.assert_allclose(found.range.covariance, expected.range.covariance, atol=1e-5)


def test_real_echoes_show_the_band_of_their_chirp(shared_data: Callable[[str], Path]) -> None:
    """ALOS PALSAR over rain forest: 27 us of 0.5185 MHz/us make 14 MHz of 16 MHz.

    At the ends of a chirp's band its amplitude is a half (Fresnel), with its matched filter a quarter.
    """
    image, band = forest(shared_data)
    found = find_pure_speckle(image.astype(np.complex64))
    assert found.pure.mean() > 0.5
    power, _ = estimate_speckle_spectra(image.astype(np.complex64), found).range.unfolded(64)
    inside = np.abs(frequencies(64)) < 0.4
    level = np.median(power[inside])
    occupied = np.flatnonzero(power > level / 16)
    assert len(occupied) / 64 == pytest.approx(band, abs=1.5 / 64)
    assert abs(frequencies(64)[occupied].mean()) < 1 / 64
    assert np.std(power[inside]) < 0.2 * level
