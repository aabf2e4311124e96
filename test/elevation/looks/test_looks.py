"""Multi-looking against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import circular, looks_in, multilook, refused

from sal_height.elevation.looks import looks as looks_module
from sal_height.elevation.looks.look_windows import Window
from sal_height.elevation.looks.looks import SlcCovariance, covariance, live_detectors
from sal_height.errors import Rejected, UserError

CHANNELS, ROWS, COLS = 3, 7, 9
HIGH, WIDE = 3, 2
SINGLE = 3e-6
"""Digits of float32 in sums of 6 products of about 1: 6e-8 each, of values up to 10."""

BLOCKS = Window.named("boxcar", HIGH), Window.named("boxcar", WIDE)
SLIDING = Window.named("boxcar", HIGH, 1), Window.named("boxcar", WIDE, 1)
WEIGHTED = Window.named("triangular", 5, 2), Window.named("hamming", 4, 3)


@pytest.fixture
def slc() -> np.ndarray:
    return circular(np.random.default_rng(10), (CHANNELS, ROWS, COLS)).astype(np.complex64)


def looks_of_pixel(index: int, window: Window, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Samples and weights of a pixel along one axis, by trying all samples."""
    first = index * window.step + (window.step - len(window.weights)) // 2
    pairs = [(s, window.weights[s - first]) for s in range(samples) if 0 <= s - first < len(window.weights)]
    return np.array([s for s, _ in pairs]), np.array([w for _, w in pairs])


@pytest.mark.parametrize("windows", [BLOCKS, SLIDING, WEIGHTED], ids=["blocks", "sliding", "weighted"])
def test_looks_are_weighted_sums_over_what_the_window_has_of_the_image(
    slc: np.ndarray, windows: tuple[Window, Window]
) -> None:
    down, across = windows
    looks, hermitian = looks_in(slc, windows), looks_in(slc, windows, hermitian=True)
    shape = -(-ROWS // down.step), -(-COLS // across.step)
    assert looks.covariance.shape == (*shape, CHANNELS, CHANNELS)
    real, whole = looks.covariance[:, :], hermitian.covariance[:, :]
    assert (real.dtype, whole.dtype) == (np.float32, np.complex64)
    wide = slc.astype(complex)
    for i, j in np.ndindex(shape):
        (rows, by_row), (cols, by_col) = looks_of_pixel(i, down, ROWS), looks_of_pixel(j, across, COLS)
        weights = np.outer(by_row, by_col)
        count = weights.sum() ** 2 / np.sum(weights**2)
        weights *= count / weights.sum()
        block = wide[:, rows[:, None], cols]
        expected = np.einsum("mrc,nrc,rc->mn", block, block.conj(), weights)
        np.testing.assert_allclose(real[i, j], expected.real, atol=SINGLE)
        np.testing.assert_allclose(whole[i, j], expected, atol=SINGLE)
        assert looks.count[i, j] == pytest.approx(count, rel=1e-12)
        assert looks.power[i, j] == pytest.approx(np.trace(expected).real, rel=1e-6)
        power = weights * np.sum(np.abs(block) ** 2, axis=0)
        assert looks.row[i, j] == pytest.approx(np.sum(power * rows[:, None]) / power.sum(), abs=SINGLE)
        assert looks.col[i, j] == pytest.approx(np.sum(power * cols) / power.sum(), abs=SINGLE)
    assert looks.finite.all()


def test_blocks_at_the_edges_have_what_is_left(slc: np.ndarray) -> None:
    looks = multilook(slc, HIGH, WIDE)
    np.testing.assert_array_equal(looks.count, np.outer([3, 3, 1], [2, 2, 2, 2, 1]))


def test_noise_in_weighted_looks_has_mean_and_variance_of_so_many_looks() -> None:
    """Of one channel in unit noise: K and K, with 40 000 pixels to 3.5 standard errors."""
    noise = circular(np.random.default_rng(12), (1, 800, 800)).astype(np.complex64)
    looks = looks_in(noise, (Window.named("triangular", 4), Window.named("hamming", 4)))
    count = looks.count[0, 0]
    assert 4 < count < 14
    assert np.ptp(looks.count) < 1e-9
    assert np.mean(looks.power) == pytest.approx(count, abs=3.5 * np.sqrt(count / 40_000))
    assert np.var(looks.power) == pytest.approx(count, rel=3.5 * np.sqrt((2 + 6 / count * 1.6) / 40_000))


def test_pixels_are_indexed_as_those_of_an_array(slc: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """The covariance of a small image is held, that of a large one computed from its samples when it is indexed."""
    whole = multilook(slc, 2, 2, hermitian=True).covariance
    monkeypatch.setattr(looks_module, "NUMBERS_KEPT", math.prod(whole.shape) - 1)
    on_demand = multilook(slc, 2, 2, hermitian=True).covariance
    assert isinstance(whole, np.ndarray)
    assert isinstance(on_demand, SlcCovariance)
    row, col = np.array([3, 0, 1]), np.array([4, 4, 2])
    for index in ((row, col), (slice(1, 3), col), (row, slice(None)), (row[:, None], col), (slice(2, 2), slice(0, 3))):
        np.testing.assert_array_equal(on_demand[index], whole[index])


def test_middle_of_a_pixel_is_that_of_its_window() -> None:
    assert [Window.named("boxcar", n, step).middle for n, step in ((3, 3), (4, 4), (3, 1), (1, 3), (5, 2))] == [
        1.0,
        1.5,
        0.0,
        1.0,
        0.0,
    ]


@pytest.mark.parametrize("bad", [np.nan, np.inf, complex(0, np.nan)])
def test_bad_sample_marks_its_pixel_and_leaves_the_neighbours(slc: np.ndarray, bad: complex) -> None:
    clean = multilook(slc, HIGH, WIDE)
    slc[1, 4, 5] = bad
    looks = multilook(slc, HIGH, WIDE)
    hit = np.zeros((3, 5), bool)
    hit[1, 2] = True
    np.testing.assert_array_equal(looks.finite, ~hit)
    for name in ("row", "col", "power"):
        np.testing.assert_array_equal(getattr(looks, name)[~hit], getattr(clean, name)[~hit])
    np.testing.assert_array_equal(looks.covariance[np.nonzero(~hit)], clean.covariance[np.nonzero(~hit)])
    assert not looks.covariance[1:2, 2:3].any()
    assert (looks.row[1, 2], looks.col[1, 2]) == (4.0, 4.5)  # the block's middle


@pytest.mark.parametrize("mixed", [False, True], ids=["gains", "hybrid"])
def test_the_transform_multiplies_the_channels(slc: np.ndarray, mixed: bool) -> None:
    matrix = circular(np.random.default_rng(4), (len(slc), len(slc)))
    matrix = matrix if mixed else np.diag(np.diag(matrix))
    product = np.tensordot(matrix, slc, axes=1).astype(np.complex64)
    transformed, plain = multilook(slc, 2, 3, True, matrix), multilook(product, 2, 3, True)
    largest = np.abs(plain.covariance[:, :]).max()
    np.testing.assert_allclose(transformed.covariance[:, :], plain.covariance[:, :], atol=1e-6 * largest)
    np.testing.assert_allclose(transformed.row, plain.row, rtol=1e-5)


@pytest.mark.parametrize("dead", [0.0, np.nan, np.inf])
def test_detectors_without_any_sample_are_dead(slc: np.ndarray, dead: float) -> None:
    """One sample is enough to live; two live detectors are the least."""
    slc = slc.copy()
    slc[1:] = dead
    slc[-1, -1, -1] = 1e-20j
    np.testing.assert_array_equal(live_detectors(slc), [0, len(slc) - 1])
    slc[0] = dead
    with refused(Rejected, f"Of {len(slc)} detectors 1 have", "2 or more", reason="dead detectors"):
        live_detectors(slc)


def test_one_look_keeps_every_pixel(slc: np.ndarray) -> None:
    looks = multilook(slc, 1, 1)
    np.testing.assert_allclose(
        np.trace(looks.covariance[:, :], axis1=2, axis2=3), np.sum(np.abs(slc) ** 2, axis=0), rtol=1e-6
    )
    np.testing.assert_array_equal(looks.row, np.indices((ROWS, COLS))[0])
    np.testing.assert_array_equal(looks.col, np.indices((ROWS, COLS))[1])


def test_block_without_power_has_its_centre_in_the_middle(slc: np.ndarray) -> None:
    slc[:, :3, :2] = 0
    looks = multilook(slc, HIGH, WIDE)
    assert (looks.row[0, 0], looks.col[0, 0]) == (1.0, 0.5)


@pytest.mark.parametrize(("high", "wide"), [(8, 1), (1, 10)])
def test_looks_that_do_not_fit_are_refused(slc: np.ndarray, high: int, wide: int) -> None:
    with refused(UserError, f"{high} x {wide}", "7 x 9 pixels"):
        multilook(slc, high, wide)


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("channels", [1, 2, 16, 19])
def test_covariance_of_any_number_of_channels(channels: int, count: int) -> None:
    samples = circular(np.random.default_rng(11), (4, count, channels)).astype(np.complex64)
    exact = np.einsum("pkm,pkn->pmn", samples.astype(complex), samples.astype(complex).conj())
    np.testing.assert_allclose(covariance(samples, hermitian=False), exact.real, atol=SINGLE)
    np.testing.assert_allclose(covariance(samples, hermitian=True), exact, atol=SINGLE)
