"""Range and azimuth response from point targets: exact without clutter, and as good as promised with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers import refused
from numpy.testing import assert_allclose

from sal_height.errors import NotDetermined
from sal_height.figures.psf_estimators import masked_spectrum, masked_transfer_function
from sal_height.figures.synthetic_tape import (
    AzimuthFault,
    RangeFault,
    TapeTarget,
    frequencies,
    make_tape,
)
from sal_height.response.point_targets import PointTarget, chip_at, find_targets
from sal_height.response.transfer_function import AxisTransfer, centred, estimate_transfer_function

COUNT = 64
RANGE, EVEN, COSINE = RangeFault(), AzimuthFault(taper=0.0), AzimuthFault(taper=1.0)
PLACES = tuple((row, col) for row in (128, 384) for col in (128, 384))


def truth(response: Callable[[int], np.ndarray], count: int = COUNT) -> np.ndarray:
    """What a chip of `count` pixels can hold of a response: its transform cut there, and transformed back."""
    pixels = np.fft.ifft(np.fft.ifftshift(response(2048)))
    return centred(np.fft.fftshift(np.fft.fft(np.concatenate([pixels[: count // 2], pixels[-(count // 2) :]]))))


def errors(response: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Rms error of the modulus, over its greatest, and of the phase (rad), where the modulus is over 0.1."""
    greatest = np.abs(expected).max()
    band = np.abs(expected) > 0.1 * greatest
    modulus = (np.abs(response) - np.abs(expected)) / greatest
    phase = np.angle(response * np.conj(expected))
    return float(np.sqrt(np.mean(modulus[band] ** 2))), float(np.sqrt(np.mean(phase[band] ** 2)))


def cyclic(rng: np.random.Generator, over_db: float, azimuth: AzimuthFault = EVEN, count: int = 4) -> list[PointTarget]:
    """Targets in the middle of pixels, each in an image as large as its chip."""
    images = (make_tape((COUNT, COUNT), rng, (TapeTarget(20, 30, over_db),), RANGE, azimuth) for _ in range(count))
    return [chip_at(image, 20, 30, clutter=1.0) for image in images]


def without_noise(range_response: np.ndarray, azimuth_response: np.ndarray) -> PointTarget:
    """A chip of nothing but the product of two responses."""
    return PointTarget(0, 0, 1e4, np.outer(range_response, azimuth_response))


def ratio(targets: Sequence[PointTarget]) -> float:
    """Power of the peaks over that of the clutter, of all targets together."""
    return sum(target.over_clutter for target in targets)


@pytest.mark.parametrize("azimuth", [EVEN, replace(COSINE, quartic=1.5)])
def test_without_clutter_the_responses_come_back(azimuth: AzimuthFault) -> None:
    # Down to where they are 0, where nothing but rounding is divided.
    expected = centred(RANGE.response(COUNT)), centred(azimuth.response(COUNT))
    made = estimate_transfer_function([without_noise(*expected), without_noise(*expected)])
    assert_allclose(made.range.response, expected[0], atol=1e-9)
    assert_allclose(made.azimuth.response, expected[1], atol=1e-9)
    assert made.range.sigma.max() < 1e-9
    assert made.targets == 2


def test_the_accuracy_promised() -> None:
    """4 targets of 40 dB in chips of 64 x 64: |R| to 0.02, arg R to 0.02 rad, rms over the band.

    Measured over 20 tapes: 0.0104 and 0.0152 (|A| 0.0172, arg A 0.0234); the standard error of the rms over 5 is 7 %.
    """
    rng = np.random.default_rng(11)
    expected = truth(RANGE.response), truth(COSINE.response)
    found = []
    for _ in range(5):
        targets = tuple(TapeTarget(*(np.array(place) + rng.uniform(-1, 1, 2)), 40.0) for place in PLACES)
        made = estimate_transfer_function(find_targets(make_tape((512, 512), rng, targets, RANGE, COSINE)).require())
        assert made.targets == 4
        found.append([*errors(made.range.response, expected[0]), *errors(made.azimuth.response, expected[1])])
    assert np.all(np.sqrt(np.mean(np.square(found), axis=0)) < [0.014, 0.02, 0.021, 0.028])


def test_the_errors_are_those_of_clutter_through_the_system() -> None:
    """Variance of R's bins: rows |R|^2 / (mean |R|^2 TCR), over 200 trials to 1 % in the mean over the band."""
    rng = np.random.default_rng(12)
    expected = centred(RANGE.response(COUNT))
    band = np.abs(expected) > 0.1 * np.abs(expected).max()
    trials = [cyclic(rng, 40.0) for _ in range(200)]
    made, over_clutter = [estimate_transfer_function(targets) for targets in trials], np.mean(list(map(ratio, trials)))
    power = np.abs(expected) ** 2
    theory = COUNT * power / (np.mean(power) * over_clutter)
    variance = np.mean([np.abs(one.range.response - expected) ** 2 for one in made], axis=0)
    assert np.mean(variance[band] / theory[band]) == pytest.approx(1, abs=0.06)
    assert np.mean([one.range.sigma**2 for one in made], axis=0)[band] / theory[band] == pytest.approx(1, abs=0.15)
    azimuth_error = np.mean([np.abs(one.azimuth.response - 1) ** 2 for one in made], axis=0)
    sigma = np.mean([one.azimuth.sigma**2 for one in made], axis=0)
    assert np.mean(azimuth_error / sigma) == pytest.approx(1, abs=0.06)
    assert np.median([one.range.disagreement for one in made]) == pytest.approx(1, abs=0.05)


def test_phases_cost_nothing() -> None:
    """The error of R under an even beam whose phase bends by 3 rad is what it is without: |A|, of mean A 1, is greater.

    60 trials of 4 targets: the variance is known to 3 %.
    """
    rng = np.random.default_rng(19)
    expected = centred(RANGE.response(COUNT))
    bent = centred(replace(EVEN, quartic=3.0).response(COUNT))
    trials = [cyclic(rng, 40.0, replace(EVEN, quartic=3.0)) for _ in range(60)]
    made = [estimate_transfer_function(targets) for targets in trials]
    over_clutter = np.mean(list(map(ratio, trials))) * np.mean(np.abs(bent) ** 2)
    square = mean_square([one.range.response for one in made], expected)
    assert square == pytest.approx(COUNT / over_clutter, rel=0.1)


@pytest.mark.parametrize("fraction", [0.1, 0.45, 0.5])
def test_a_full_band_between_the_pixels(fraction: float) -> None:
    """Power over half of the peak's lies on both sides, and falls off so slowly that the chip's context cuts some."""
    image = make_tape((512, 512), np.random.default_rng(20), (TapeTarget(200.3, 250 + fraction, 70.0),), RANGE, EVEN)
    made = estimate_transfer_function(find_targets(image).require())
    assert np.sqrt(np.mean(np.abs(made.azimuth.response - 1) ** 2)) < 0.045


def test_outside_of_the_band_the_error_is_that_of_noise() -> None:
    """White noise lifts |R| where it is 0; sigma says by how much."""
    rng = np.random.default_rng(13)
    images = [make_tape((COUNT, COUNT), rng, (TapeTarget(20, 30, 40.0),), RANGE, EVEN, noise=0.5) for _ in range(40)]
    made = estimate_transfer_function([chip_at(image, 20, 30, clutter=1.25) for image in images])
    outside = np.abs(RANGE.response(COUNT)) == 0
    square = np.mean(np.abs(made.range.response[outside]) ** 2)
    assert square == pytest.approx(np.mean(made.range.sigma[outside] ** 2), rel=0.5)
    assert square > 1e-6


def test_a_faint_target_counts_by_its_ratio_to_clutter() -> None:
    """40 and 30 dB: variances add as 1 / (TCR1 + TCR2), not as those of a mean, which is 2.8 times as much."""
    rng = np.random.default_rng(14)
    expected = centred(RANGE.response(COUNT))
    square, sigma = [], []
    for _ in range(150):
        targets = [*cyclic(rng, 40.0, count=1), *cyclic(rng, 30.0, count=1)]
        made = estimate_transfer_function(targets)
        square.append(np.sum(np.abs(made.range.response - expected) ** 2))
        sigma.append(COUNT**2 / ratio(targets))
    assert np.mean(square) == pytest.approx(np.mean(sigma), rel=0.1)


def test_targets_that_disagree_are_told_and_the_error_is_theirs() -> None:
    """A beam that points elsewhere for each target."""
    rng = np.random.default_rng(15)
    beams = [COSINE.response(COUNT, pointing) for pointing in (-0.05, 0.0, 0.05)]
    steady, swinging = (
        [
            replace(target, spectrum=target.spectrum / COSINE.response(COUNT).clip(0.02) * beam)
            for target, beam in zip(cyclic(rng, 50.0, COSINE, 3), made, strict=True)
        ]
        for made in ([beams[1]] * 3, beams)
    )
    agreed, told = estimate_transfer_function(steady), estimate_transfer_function(swinging)
    assert agreed.azimuth.disagreement < 1.2
    assert told.azimuth.disagreement > 3
    assert np.mean(told.azimuth.sigma) > 2.5 * np.mean(agreed.azimuth.sigma)
    assert told.range.disagreement < 1.3
    assert np.isnan(estimate_transfer_function(steady[:1]).range.disagreement)


def test_the_papers_cross_has_no_effect_on_the_range_response() -> None:
    """The mean over k_a is the transform of the line through the peak, which the cross lets through."""
    targets = cyclic(np.random.default_rng(16), 30.0)
    masked, _ = masked_transfer_function(targets)
    lines = np.mean([np.fft.fftshift(np.fft.fft(target.chip[:, 0])) for target in targets], axis=0)
    assert_allclose(masked, centred(lines), atol=1e-12)


def test_the_papers_way_too_takes_the_phase_of_the_range_response_away() -> None:
    """With it A errs by no more than without that phase, but for what the peak, which is lower, stands less out."""
    rng = np.random.default_rng(21)
    bend = np.exp(12j * (2 * frequencies(COUNT)) ** 2)[:, None]
    plain, bent = [], []
    for _ in range(20):
        targets = cyclic(rng, 40.0)
        plain.append(masked_transfer_function(targets, 63, 63)[1])
        turned = [target.spectrum * bend for target in targets]
        made = [replace(target, spectrum=one / one.mean()) for target, one in zip(targets, turned, strict=True)]
        bent.append(masked_transfer_function(made, 63, 63)[1])
    assert mean_square(bent, np.ones(COUNT)) == pytest.approx(mean_square(plain, np.ones(COUNT)), rel=0.3)


def test_the_cross_is_the_papers() -> None:
    chip = np.fft.ifft2(np.fft.ifftshift(masked_spectrum(cyclic(np.random.default_rng(17), 30.0)[0])))
    left = np.fft.fftshift(np.abs(chip) > 1e-12)
    assert np.array_equal(np.flatnonzero(left[:, 0]), [31, 32, 33])
    assert np.array_equal(np.flatnonzero(left[0]), [30, 31, 32, 33, 34])
    assert np.count_nonzero(left) == 3 * 64 + 5 * 64 - 15


def mean_square(found: list[np.ndarray], expected: np.ndarray) -> float:
    return float(np.mean(np.abs(np.array(found) - expected) ** 2))


def test_dividing_errs_less_than_the_papers_means_and_without_clutter_much_less() -> None:
    # Variances over 60 trials; they are correlated, their ratios therefore known to some percent.
    rng = np.random.default_rng(18)
    expected = truth(COSINE.response)
    ours, masked, cleaned = [], [], []
    for _ in range(60):
        target = TapeTarget(*(128 + rng.uniform(-1, 1, 2)), 40.0)
        found = find_targets(make_tape((256, 256), rng, (target,), RANGE, COSINE)).require()
        made = estimate_transfer_function(found)
        ours.append(made.azimuth.response)
        masked.append(masked_transfer_function(found)[1])
        cleaned.append(made.azimuth.without_clutter())
    assert mean_square(ours, expected) < 0.93 * mean_square(masked, expected)
    assert mean_square(cleaned, expected) < 0.5 * mean_square(ours, expected)


@pytest.mark.parametrize("shift", [0.0, 0.4, -0.7])
def test_a_centred_response_has_its_peak_in_pixel_0(shift: float) -> None:
    expected = centred(RANGE.response(COUNT))
    moved = 3j * expected * np.exp(-2j * np.pi * frequencies(COUNT) * shift)
    assert_allclose(centred(moved), expected, atol=1e-9)
    assert np.mean(expected) == pytest.approx(1, abs=1e-12)
    near = [abs(np.mean(expected * np.exp(2j * np.pi * frequencies(COUNT) * place))) for place in (-0.02, 0.02)]
    assert max(near) < 1


def test_a_band_across_the_ends_of_the_frequencies_is_centred_too() -> None:
    response = np.roll(centred(RANGE.response(COUNT)), 32)
    moved = response * np.exp(-2j * np.pi * (frequencies(COUNT) % 1) * 0.3)
    assert_allclose(centred(moved), response, atol=1e-9)


def test_what_clutter_explains_is_taken_out() -> None:
    response = centred(RANGE.response(COUNT))
    assert_allclose(AxisTransfer(response, np.zeros(COUNT), 1.0).without_clutter(), response, atol=1e-12)
    faint = np.fft.fft(np.where(np.arange(COUNT) == 5, 0.01, np.arange(COUNT) == 0))
    noisy = AxisTransfer(faint, np.full(COUNT, 0.011 * np.sqrt(COUNT)), 1.0)
    assert_allclose(noisy.without_clutter(), np.ones(COUNT), atol=1e-12)


def test_no_target_is_not_enough() -> None:
    for estimate in (estimate_transfer_function, masked_transfer_function):
        with refused(NotDetermined, "needed"):
            estimate([])
