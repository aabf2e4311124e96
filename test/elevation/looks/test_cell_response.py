"""How alike neighbouring pixels are, and how much power of others their sidelobes bring: against drawn images."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular
from scipy.special import fdtri

from sal_height.elevation import AxisResponse, CellResponse, Looks, Window, axis_looks, windowed_looks
from sal_height.elevation.looks.cell_response import REACH
from sal_height.elevation.looks.looks import SPECKLE_RATE, is_edge_of_shadow
from sal_height.numeric import C64, C128, F64, window
from sal_height.sensor import Channels

SPACING = 1.34  # cells per pixel along range, as images have it with a Taylor window
TAYLOR = CellResponse(AxisResponse("taylor", SPACING), AxisResponse("taylor", 1.0))


def image(amplitudes: C128, response: AxisResponse, pixels: F64) -> C128:
    """Image along its first axis of scatterers at every cell, of a band of as many frequencies as there are cells."""
    cells = len(amplitudes)
    spectrum = np.fft.fft(amplitudes, axis=0, norm="ortho") * np.fft.ifftshift(window(response.window, cells))[:, None]
    frequency = np.fft.fftfreq(cells, 1 / cells)
    return np.exp(2j * np.pi * np.outer(pixels * response.spacing, frequency) / cells) @ spectrum / np.sqrt(cells)


@pytest.mark.parametrize("name", ["rectangular", "taylor", "hamming"])
@pytest.mark.parametrize("spacing", [1.0, 1.34, 0.5])
def test_pixels_are_as_alike_as_their_response_says(name: str, spacing: float) -> None:
    """Correlation of 64 frequencies' noise, 10 000 draws: its square has a standard error below .01."""
    response = AxisResponse(name, spacing)
    noise = image(circular(np.random.default_rng(5), (64, 10_000)), response, np.arange(20.0, 24.0))
    covariance = noise @ noise.conj().T
    likeness = np.abs(covariance[0]) ** 2 / (covariance[0, 0] * np.diag(covariance)).real
    np.testing.assert_allclose(response.likeness(4), likeness, atol=0.025)


@pytest.mark.parametrize("name", ["rectangular", "taylor", "hamming"])
def test_the_sidelobes_of_a_scatterer_have_the_power_that_is_expected(name: str) -> None:
    """One scatterer anywhere in its pixel, 300 of them: over 5 to 30 pixels' distance, within 10 %."""
    response, rng, cells = AxisResponse(name, 1.0), np.random.default_rng(6), 1024
    position = rng.uniform(-0.5, 0.5, 300)
    offset = np.arange(0, 31)[:, None] - position
    frequency = (np.arange(cells) - (cells - 1) / 2) / cells
    weights = window(name, cells) / cells
    power = np.mean(np.abs(np.exp(2j * np.pi * offset[..., None] * frequency) @ weights) ** 2, axis=1)
    energy = power[0] + 2 * power[1:].sum()
    whole, near = response.fractions()
    middle = len(whole) // 2
    np.testing.assert_allclose((whole - near)[middle + 5 : middle + 31].sum(), power[5:].sum() / energy, rtol=0.1)
    assert whole.sum() == pytest.approx(1)


def test_level_ground_leaks_the_integrated_sidelobes() -> None:
    """Equally bright ground without end: what is outside the main lobe, at the edges of an image as in its middle."""
    (_, near), leakage = TAYLOR.down.fractions(), axis_looks(Window.named("boxcar", 1), 40, TAYLOR.down).leakage
    assert leakage
    ground = np.full((40, 3), 2.0)
    np.testing.assert_allclose(leakage.near.down(ground), 2 * near.sum(), rtol=1e-9)
    np.testing.assert_allclose(leakage.whole.down(ground), 2.0, rtol=1e-9)
    np.testing.assert_allclose(leakage.own.down(ground), 2 * near[len(near) // 2], rtol=1e-9)


@pytest.mark.parametrize("window", [Window.named("boxcar", 2), Window.named("triangular", 5, 2)])
@pytest.mark.parametrize("samples", [5, 31, 200])
def test_leakage_into_looks_is_a_convolution_that_goes_on_beyond_the_edges(window: Window, samples: int) -> None:
    """Sums over all samples one by one, along either axis."""
    rng, taps = np.random.default_rng(16), len(window.weights)
    power = rng.exponential(size=(samples, 3))
    axis, (whole, near) = axis_looks(window, samples, TAYLOR.down), TAYLOR.down.fractions()
    assert axis.leakage
    expected = np.zeros((4, window.pixels(samples), 3))
    for pixel, look in np.ndindex(window.pixels(samples), taps):
        place, weight = window.first + pixel * window.step + look, window.weights[look]
        if not 0 <= place < samples:
            continue
        for offset in range(-REACH, REACH + 1):
            there = power[np.clip(place + offset, 0, samples - 1)]
            expected[:2, pixel] += weight * np.outer([near[REACH + offset], whole[REACH + offset]], there)
            if 0 <= place + offset - (place - look) < taps and 0 <= place + offset < samples:
                expected[2, pixel] += weight * near[REACH + offset] * there
        expected[3, pixel] += weight * place * power[place]
    bands = axis.leakage.near, axis.leakage.whole, axis.leakage.own, axis.moments
    np.testing.assert_allclose([one.down(power) for one in bands], expected, rtol=1e-12)
    np.testing.assert_allclose([one.across(power.T).T for one in bands], expected, rtol=1e-12)


def test_edges_of_a_shadow_are_those_of_their_brightest_and_darkest_neighbour() -> None:
    """The compiled loop, and its formula in NumPy."""
    rng = np.random.default_rng(17)
    down, across = (axis_looks(Window.named("boxcar", n, 2), 2 * pixels, None) for n, pixels in ((2, 30), (4, 20)))
    power, noise = rng.exponential(size=(30, 20)) ** 3, rng.uniform(0, 0.02, (30, 20))
    count = np.multiply.outer(down.count, across.count)
    around = np.pad(power, [(down.apart,) * 2, (across.apart,) * 2], mode="edge")
    assert (down.apart, across.apart) == (1, 2)
    beside = np.stack([around[:-2, 2:-2], around[2:, 2:-2], around[1:-1, :-4], around[1:-1, 4:]])
    contrast = fdtri(2 * count, 2 * count, 1 - SPECKLE_RATE)
    expected = beside.max(axis=0) - noise > contrast * (beside.min(axis=0) + noise)
    np.testing.assert_array_equal(is_edge_of_shadow(power, down, across, noise), expected)
    assert 0.02 < expected.mean() < 0.98


@pytest.mark.parametrize(("name", "spacing"), [("taylor", 1.34), ("taylor", 1.0), ("rectangular", 1.0)])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_place_of_speckle_is_as_uncertain_as_stated(name: str, spacing: float, count: int) -> None:
    """Of 20 000 draws of scatterers an eighth of a cell apart, by the main lobe alone; standard error 2 %."""
    axis, rng = AxisResponse(name, spacing), np.random.default_rng(8)
    scatterers, nodes = np.arange(-8, 8, 1 / 8), 512
    looks = (np.arange(count) - (count - 1) / 2) * spacing
    offset = scatterers - looks[:, None]
    frequency = (np.arange(nodes) - (nodes - 1) / 2) / nodes
    weights = window(name, nodes) / nodes
    response = np.cos(2 * np.pi * offset[..., None] * frequency) @ weights
    first_null = {"taylor": 1.6, "rectangular": 1.0}[name]
    response = np.where(np.abs(offset) < first_null, response, 0.0)
    drawn = circular(rng, (len(scatterers), 20_000))
    samples, moments = response @ drawn, (response * offset / spacing) @ drawn
    place = np.sum(moments * samples.conj(), axis=0).real / np.mean(np.sum(np.abs(samples) ** 2, axis=0))
    pairs = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    assert place.var() == pytest.approx(axis.position_error(count)[pairs].mean(), rel=0.08)


def test_looks_count_as_many_as_the_mean_of_their_powers_fluctuates() -> None:
    """Its variance over the mean squared is 1 / K: 3000 pixels of 4 x 3 looks give K with a standard error of 3.5 %."""
    rng = np.random.default_rng(7)
    rows = image(circular(rng, (64, 24 * 3000)), TAYLOR.down, np.arange(40.0, 44.0)).reshape(4, 3000, 24)
    samples = image(rows.reshape(-1, 24).T, TAYLOR.across, np.arange(9.0, 12.0)).reshape(3, 4, 3000)
    power = np.mean(np.abs(samples) ** 2, axis=(0, 1))
    looks = in_windows(np.ones((2, 4, 3), np.complex64), 4, 3)
    assert looks.count[0, 0] == pytest.approx(power.mean() ** 2 / power.var(), rel=0.12)
    assert looks.count[0, 0] < 0.7 * 12


def test_two_looks_count_as_two_less_their_likeness() -> None:
    looks = in_windows(np.ones((2, 2, 1), np.complex64), 2, 1)
    assert looks.count[0, 0] == pytest.approx(2 / (1 + TAYLOR.down.likeness(2)[1]), rel=1e-12)
    assert looks.power[0, 0] == pytest.approx(2 * looks.count[0, 0], rel=1e-6)


@pytest.mark.parametrize("rows", [1, 4])
def test_ranges_of_a_pixel_are_those_of_its_rows_and_within_them(rows: int) -> None:
    """Rows as wide as their spacing have the variance n^2 / 12 together; a main lobe has its second moment."""
    windows, same = (Window.named("boxcar", rows), Window.named("boxcar", 1)), np.eye(2)
    slc, squint, channels = np.ones((2, 4, 4), np.complex64), np.zeros(4), Channels(same, same, np.ones(2))
    looks = windowed_looks(slc, windows, squint, channels, hermitian=False, response=TAYLOR, level_turn=0.1)
    offset = np.arange(-512, 512) / 256 / SPACING
    frequency = (np.arange(1024) - 511.5) / 1024
    lobe = np.cos(2 * np.pi * SPACING * np.outer(offset, frequency)) @ window("taylor", 1024)
    energy = np.where(np.cumprod(np.flip(lobe[:513] > 0)).sum() / 256 / SPACING > np.abs(offset), lobe**2, 0.0)
    within = np.average(offset**2, weights=energy)
    between = (rows**2 - 1) / 12
    assert looks.level_spread == pytest.approx(0.1 * np.sqrt(between + within), rel=1e-2)
    assert looks.unplaced == pytest.approx(within / (between + within), rel=2e-2)


def in_windows(slc: C64, high: int, wide: int) -> Looks:
    """Looks of two channels of noise power 4."""
    windows, same = (Window.named("boxcar", high), Window.named("boxcar", wide)), np.eye(2)
    channels, squint = Channels(same, same, np.full(2, 4.0)), np.zeros(windows[1].pixels(slc.shape[2]))
    return windowed_looks(slc, windows, squint, channels, hermitian=False, response=TAYLOR)


def test_a_bright_pixel_raises_the_floor_around_it_and_not_its_own() -> None:
    slc = np.zeros((2, 60, 40), np.complex64)
    slc[:, 30, 20] = 1000.0
    looks = in_windows(slc, 1, 1)
    (whole, near), middle = TAYLOR.down.fractions(), 64
    sidelobe = (whole - near)[middle + 5] * TAYLOR.across.fractions()[0][middle]
    assert looks.floor[35, 20] == pytest.approx(1 + 2e6 / 4 * sidelobe, rel=1e-4)
    assert looks.floor[30, 20] < 2.0
    np.testing.assert_allclose(looks.noise_power, 4 * looks.floor)


def test_the_first_pixel_of_a_shadow_has_a_floor_of_main_lobes_and_lit_ground_has_not() -> None:
    """2 x 2 looks at 40 dB: shadow from column 30 on, whose first columns hold the main lobes of those before."""
    rng = np.random.default_rng(9)
    power = np.where(np.arange(60) < 30, 1e4, 0.0)
    drawn = circular(rng, (2, 60, 64)) * np.sqrt(np.append(power, np.zeros(4)))
    columns = np.stack([image(channel.T, TAYLOR.across, np.arange(60.0)).T for channel in drawn])
    slc = columns + 2 * circular(rng, columns.shape)
    looks = in_windows(slc.astype(np.complex64), 2, 2)
    signal = looks.power / looks.count - 8
    edge, inner, ground = looks.floor[1:-1, 15], looks.floor[1:-1, 18:25], looks.floor[1:-1, 2:13]
    assert np.median(4 * (edge - 1) / signal[1:-1, 15]) > 0.5
    assert np.mean(4 * (ground - 1) > 0.1 * 2e4) < 0.02
    assert np.median(4 * (inner - 1)) < 0.01 * 2e4
    last_lit = looks.floor[1:-1, 14]
    assert np.mean(4 * (last_lit - 1) > 0.1 * 2e4) < 0.1
