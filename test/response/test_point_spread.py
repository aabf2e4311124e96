"""The point-spread function: its figures against closed forms, and the sidelobes that a fault makes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import circular
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, TapeTarget, make_tape
from sal_height.numeric.transforms import frequencies
from sal_height.response.impulse import measure_brightest
from sal_height.response.point_spread import FINENESS, anomalous_sidelobes, cut_through, estimate_point_spread
from sal_height.response.point_targets import find_targets
from sal_height.response.transfer_function import AxisTransfer, TransferFunction, centred, estimate_transfer_function

COUNT = 64
TAYLOR = RangeFault(sawtooth=0.0).response(COUNT)
HANN = np.pad(np.hanning(29), (18, 17))
"""Of so small sidelobes that they do not matter beside an echo."""


def transfer(range_response: np.ndarray, azimuth_response: np.ndarray, sigma: float = 1e-6) -> TransferFunction:
    """A transfer function that is known well."""
    ranges, azimuths = centred(range_response), centred(azimuth_response)
    errors = np.full(len(ranges), sigma), np.full(len(azimuths), sigma)
    return TransferFunction(AxisTransfer(ranges, errors[0], 1.0), AxisTransfer(azimuths, errors[1], 1.0), 4)


def half_power_of_taylor() -> float:
    """Distance from the peak (pixels), from the sum of cosines."""
    weights = TAYLOR.real / TAYLOR.real.sum()
    return brentq(lambda x: np.sum(weights * np.cos(2 * np.pi * frequencies(COUNT) * x)) ** 2 - 0.5, 0.1, 3)


def test_a_flat_band_makes_a_sinc_and_taylor_weights_what_they_are_made_for() -> None:
    spread = estimate_point_spread(transfer(TAYLOR, np.ones(COUNT)))
    assert spread.azimuth.cut.width == pytest.approx(0.8859, rel=0.002)
    assert spread.azimuth.cut.pslr_db == pytest.approx(-13.26, abs=0.1)
    assert spread.azimuth.cut.islr_db == pytest.approx(-10.2, abs=0.1)
    assert spread.range.cut.pslr_db == pytest.approx(-35, abs=1)  # with 28 bins in the band
    assert spread.range.cut.width == pytest.approx(2 * half_power_of_taylor(), rel=0.001)
    assert not spread.azimuth.sidelobes


@pytest.mark.parametrize("shift", [0, 32])
def test_the_pixels_are_the_transform_of_the_product_interpolated(shift: int) -> None:
    given = transfer(np.roll(TAYLOR, shift), AzimuthFault().response(48))
    pixels = estimate_point_spread(given).pixels
    assert pixels.shape == (FINENESS * COUNT, FINENESS * 48)
    product = np.outer(given.range.response, given.azimuth.response)
    coarse = np.fft.fftshift(np.fft.ifft2(np.fft.ifftshift(product)))
    assert_allclose(pixels[::FINENESS, ::FINENESS], coarse, atol=1e-12)
    assert pixels[2 * COUNT, 2 * 48] == pytest.approx(1)
    assert np.abs(pixels).max() == pytest.approx(1)


def test_between_the_pixels_the_band_stays_where_it_is() -> None:
    shifted = np.roll(TAYLOR, 32)
    assert_allclose(np.abs(cut_through(shifted, 8)), np.abs(cut_through(TAYLOR, 8)), atol=1e-12)


@pytest.mark.parametrize("place", [11, 16])
@pytest.mark.parametrize("phase", [0.0, np.pi / 2, 1.0])
def test_a_ripple_makes_paired_echoes(place: int, phase: float) -> None:
    """1 + 2 e cos(2 pi n k): echoes of amplitude e, n pixels to both sides; as a ripple of the phase (j e) too."""
    level = 0.05
    ripple = 1 + 2 * level * np.exp(1j * phase) * np.cos(2 * np.pi * place * frequencies(COUNT))
    found = anomalous_sidelobes(centred(HANN * ripple), np.full(COUNT, 0.01))
    assert_allclose(sorted(one.position for one in found), [-place, place], atol=0.4)
    assert_allclose([one.level_db for one in found], 20 * np.log10(level), atol=0.3)
    assert all(one.significance > 10 for one in found)


@pytest.mark.parametrize(("band", "level", "place"), [(TAYLOR, 0.05, 12), (np.ones(COUNT), 0.025, 20)])
def test_an_echo_among_sidelobes_is_one_pair(band: np.ndarray, level: float, place: int) -> None:
    # Its own sidelobes, and those of a flat band nearer to the peak, are no echoes.
    ripple = 1 + 2 * level * np.cos(2 * np.pi * place * frequencies(COUNT))
    found = anomalous_sidelobes(centred(band * ripple), np.full(COUNT, 0.04))
    assert_allclose(sorted(one.position for one in found), [-place, place], atol=1.5)


def test_an_echo_to_one_side_is_told_from_a_pair() -> None:
    echo = 1 + 0.05 * np.exp(-2j * np.pi * 16 * frequencies(COUNT))
    (found,) = anomalous_sidelobes(centred(HANN * echo), np.full(COUNT, 0.01))
    assert found.position == pytest.approx(16, abs=0.2)
    assert found.level_db == pytest.approx(20 * np.log10(0.05), abs=0.3)


def test_significance_is_in_standard_errors() -> None:
    blackman = np.pad(np.blackman(29), (18, 17))
    response = centred(blackman * (1 + 2 * 0.05 * np.cos(2 * np.pi * 20 * frequencies(COUNT))))
    sure, unsure = (anomalous_sidelobes(response, np.full(COUNT, sigma)) for sigma in (0.01, 0.02))
    error = 0.01 / np.sqrt(2 * COUNT)  # of a pixel, and of the root of the mean power of two
    assert [one.significance * error for one in sure] == pytest.approx([0.05, 0.05], abs=0.003)
    assert [one.significance for one in sure] == pytest.approx([2 * one.significance for one in unsure])
    assert not anomalous_sidelobes(response, np.full(COUNT, 0.3))


def test_noise_is_not_taken_for_a_fault() -> None:
    """Of 1000 smooth responses with errors, hardly one shows an anomaly (1 of 12000 measured)."""
    rng = np.random.default_rng(21)
    sigma = 0.05 * np.abs(centred(TAYLOR)) + 0.005
    noisy = (centred(TAYLOR) + sigma * circular(rng, (COUNT,)) for _ in range(1000))
    assert sum(bool(anomalous_sidelobes(centred(one), sigma)) for one in noisy) <= 1


def test_the_echoes_of_a_sawtooth_on_a_tape() -> None:
    """Of 4 targets of 50 dB: the error of an echo's level is 0.4 dB rms; 1.3 dB are three times that."""
    rng = np.random.default_rng(22)
    fault = RangeFault()
    targets = tuple(TapeTarget(row + 0.3, col - 0.2, 50.0) for row in (128, 384) for col in (128, 384))
    made = estimate_transfer_function(find_targets(make_tape((512, 512), rng, targets, fault)).require())
    spread = estimate_point_spread(made)
    pixels = np.fft.fftshift(np.fft.ifft(np.fft.ifftshift(fault.response(2048))))
    fine = np.abs(cut_through(np.fft.fftshift(np.fft.fft(np.fft.ifftshift(pixels[1024 - 32 : 1024 + 32]))), 32))
    for sign in (-1, 1):
        middle = 32 * 32 + sign * 16 * 32
        expected = 20 * np.log10(fine[middle - 48 : middle + 49].max() / fine.max())
        (echo,) = (one for one in spread.range.sidelobes if abs(one.position - sign * 16) < 1.5)
        assert echo.level_db == pytest.approx(expected, abs=1.3)
        assert expected == pytest.approx(-29.9, abs=0.3)
    assert not spread.azimuth.sidelobes


def test_a_real_corner_reflector(shared_data: Callable[[str], Path]) -> None:
    """ALOS PALSAR, HH: widths and sidelobes of the pixels themselves, and those of the image as `irf` measures them."""
    h5py = pytest.importorskip("h5py")
    (path,) = shared_data("alos_palsar").glob("calib_RSLC*.h5")
    with h5py.File(path) as file:
        stored = file["science/LSAR/RSLC/swaths/frequencyA/HH"][()]
    image = (stored["r"].astype(np.float32) + 1j * stored["i"].astype(np.float32)).astype(np.complex64).T
    survey = find_targets(image, (48, 64))
    assert len(survey.candidates) == 1
    spread, whole = estimate_point_spread(estimate_transfer_function(survey.require())), measure_brightest(image)
    for cut, irf, width, pslr in (
        (spread.range.cut, whole.row_cut, 1.07, -12.6),
        (spread.azimuth.cut, whole.col_cut, 1.30, -14.8),
    ):
        assert cut.width == pytest.approx(width, rel=0.03)
        assert cut.width == pytest.approx(irf.width, rel=0.01)
        assert cut.pslr_db == pytest.approx(pslr, abs=0.5)
        assert cut.pslr_db == pytest.approx(irf.pslr_db, abs=0.3)
