"""A linear system passes, whatever its noise; one that saturates does not. The paper's comparison is shown to fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import assert_one_sentence, circular

from sal_height.errors import NotDetermined
from sal_height.figures.psf_estimators import depth_and_pedestal
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, Saturation, Target, make_tape
from sal_height.numeric.fft import frequencies
from sal_height.response.linearity import Superposition, _target_covariance, superposition
from sal_height.response.speckle_spectra import SpeckleSpectra, estimate_speckle_spectra, fejer_power, transform
from sal_height.response.speckle_tiles import find_pure_speckle

ROWS, SPECKLE_COLS, TARGETS = 256, 960, 8


def target_and_speckle(
    rng: np.random.Generator, bins: int, noise: float, level: float | None = None
) -> tuple[np.ndarray, np.ndarray, SpeckleSpectra]:
    """R from 8 targets of 40 dB with its standard error, and spectra of speckle, from one image."""
    cols = [SPECKLE_COLS + 96 + 64 * i for i in range(TARGETS)]
    image = make_tape(
        (ROWS, SPECKLE_COLS + 64 * (TARGETS + 1)),
        rng,
        tuple(Target(ROWS // 2, col, 40) for col in cols),
        RangeFault(),
        AzimuthFault(),
        noise,
        saturation=Saturation(level) if level else None,
    )
    clutter = image[:, :SPECKLE_COLS]
    speckle = estimate_speckle_spectra(clutter, find_pure_speckle(clutter))
    chips = np.fft.ifftshift(image[(ROWS - bins) // 2 :][:bins, cols], axes=0)
    target = np.mean(np.fft.fftshift(np.fft.fft(chips, axis=0), axes=0) / chips[0], axis=1)
    triangle = 1 - np.arange(64) / 64
    power = np.maximum(transform(speckle.range.covariance * triangle, frequencies(bins)), 0)
    peak = np.mean(np.abs(chips[0]) ** 2)
    error = np.sqrt(bins * power * np.mean(np.abs(clutter) ** 2) / peak / TARGETS)
    return target, error, speckle


def trials(count: int, seed: int, bins: int, noise: float, level: float | None = None) -> list[Superposition]:
    rng = np.random.default_rng(seed)
    return [superposition(*target_and_speckle(rng, bins, noise, level)) for _ in range(count)]


@pytest.mark.parametrize(("bins", "noise"), [(256, 0.6), (128, 0.6), (256, 0.0)])
def test_linear_system_passes(bins: int, noise: float) -> None:
    """Residuals are as large as expected: chi-square per degree of freedom is 1, with a standard error of 0.04 to 0.05.

    At a nominal 5 % false alarms came at 3.8 +- 0.8 % of 600 trials; of 24 the standard error is 4.4 %.
    """
    found = trials(24, 12, bins, noise)
    freedom = np.array([trial.freedom for trial in found])
    assert np.all(freedom >= 25)
    ratio = np.mean([trial.chi_square / trial.freedom for trial in found])
    assert ratio == pytest.approx(1, abs=0.13)
    assert np.mean([trial.p_value < 0.05 for trial in found]) <= 0.17
    assert 0.25 < np.median([trial.p_value for trial in found]) < 0.75
    assert np.mean([trial.noise for trial in found]) == pytest.approx(noise**2 / (1 + noise**2), abs=0.005)
    assert np.mean([trial.scale for trial in found]) == pytest.approx(1 / (1 + noise**2), abs=0.01)


def test_what_short_chips_cut_off_is_no_reason_to_fire() -> None:
    """Chips of 64 lack echoes that sub-images of 64 show: without an error for them it fires."""
    found = trials(12, 18, 64, 0.1)
    assert np.mean([trial.chi_square / trial.freedom for trial in found]) < 1.2


def test_system_that_saturates_does_not_pass() -> None:
    """Limited at 12 times the rms, where targets are spread out. In 40 trials all were seen; none at 24 times."""
    assert max(trial.p_value for trial in trials(10, 13, 128, 0.6, level=12.0)) < 1e-3


def test_what_the_paper_compares_differs_in_a_linear_system_too() -> None:
    """The paper's two differences, both as it saw them, of a system that passes the test."""
    target, error, speckle = target_and_speckle(np.random.default_rng(14), 128, 0.6)
    of_target = depth_and_pedestal(np.abs(target) ** 2 - error**2, 16.0)
    of_speckle = depth_and_pedestal(speckle.range.power, 16.0)
    assert of_speckle[0] < 0.6 * of_target[0]
    assert of_speckle[1] > 10 * of_target[1]
    assert superposition(target, error, speckle).p_value > 0.05


def test_depth_and_pedestal_of_a_response_known() -> None:
    frequency = frequencies(1024)
    saw = 2 * (16 * frequency - np.floor(16 * frequency + 0.5))
    band = np.where(np.abs(frequency) < 0.35, 1.0, 0.05)
    depth, pedestal = depth_and_pedestal((band * (1 + 0.1 * saw * (band == 1))) ** 2, 16.0)
    assert depth == pytest.approx(0.1, rel=0.02)
    assert pedestal == pytest.approx(0.05 / 1.1, rel=0.02)


def test_errors_of_the_target_are_those_of_its_convolved_spectrum() -> None:
    """1000 draws: standard error 4.5 % of a variance."""
    rng = np.random.default_rng(15)
    target = RangeFault().response(128)
    variance = 0.03**2 * (0.2 + np.abs(target) ** 2)
    drawn = []
    for _ in range(1000):
        covariance, _ = _target_covariance(target + np.sqrt(variance) * circular(rng, (128,)), variance, 64)
        drawn.append(fejer_power(covariance))
    expected, errors = _target_covariance(target, np.zeros(128), 64), _target_covariance(target, variance, 64)[1]
    tail = np.diag(expected[1])
    measured, spread = np.mean(drawn, axis=0), np.std(drawn, axis=0)
    band = np.abs(frequencies(64)) < 0.2
    assert np.max(np.abs(measured - fejer_power(expected[0])) / spread * np.sqrt(1000)) < 4.5
    np.testing.assert_allclose((np.diag(errors) - tail)[band], spread[band] ** 2, rtol=0.16)


def test_spur_is_left_out() -> None:
    rng = np.random.default_rng(16)
    image = make_tape((256, 960), rng, (), RangeFault(), AzimuthFault(), 0.6, nyquist_spur=0.3)
    found = superposition(
        RangeFault().response(256), np.full(256, 1e-6), estimate_speckle_spectra(image, find_pure_speckle(image))
    )
    assert found.freedom <= 64 - 1 - 2
    assert found.p_value > 0.01


def test_too_few_frequencies_are_refused() -> None:
    target, error, speckle = target_and_speckle(np.random.default_rng(17), 64, 0.6)
    short = replace(speckle, range=replace(speckle.range, covariance=speckle.range.covariance[:3]))
    with pytest.raises(NotDetermined) as few:
        superposition(target, error, short)
    assert_one_sentence(str(few.value), "needed")
