"""Multi-looking against plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import assert_one_sentence, circular

from sal_height import looks as looks_module
from sal_height.errors import Rejected, UserError
from sal_height.looks import covariance, live_detectors, multilook

CHANNELS, ROWS, COLS = 3, 7, 9
HIGH, WIDE = 3, 2
SINGLE = 3e-6
"""Digits of float32 in sums of 6 products of about 1: 6e-8 each, of values up to 10."""


@pytest.fixture
def slc() -> np.ndarray:
    return circular(np.random.default_rng(10), (CHANNELS, ROWS, COLS)).astype(np.complex64)


def test_covariance_is_the_sum_over_looks_of_the_outer_product(slc: np.ndarray) -> None:
    looks, hermitian = multilook(slc, HIGH, WIDE), multilook(slc, HIGH, WIDE, hermitian=True)
    assert looks.count == HIGH * WIDE
    # One row and one column do not make a full block and are left out.
    assert looks.covariance.shape == (ROWS // HIGH, COLS // WIDE, CHANNELS, CHANNELS) == (2, 4, 3, 3)
    for row in range(2):
        for col in range(4):
            expected = np.zeros((CHANNELS, CHANNELS), complex)
            for r in range(row * HIGH, row * HIGH + HIGH):
                for c in range(col * WIDE, col * WIDE + WIDE):
                    g = slc[:, r, c].astype(complex)
                    expected += np.outer(g, g.conj())
            np.testing.assert_allclose(looks.covariance[row, col], expected.real, atol=SINGLE)
            np.testing.assert_allclose(hermitian.covariance[row, col], expected, atol=SINGLE)
    assert (looks.covariance.dtype, hermitian.covariance.dtype) == (np.float32, np.complex64)
    assert looks.finite.all()


def test_centre_of_the_looks_is_weighted_by_power(slc: np.ndarray) -> None:
    looks = multilook(slc, HIGH, WIDE)
    power = np.sum(np.abs(slc.astype(complex)) ** 2, axis=0)
    row, col = np.indices(power.shape)
    for i in range(2):
        for j in range(4):
            block = np.s_[i * HIGH : (i + 1) * HIGH, j * WIDE : (j + 1) * WIDE]
            assert looks.row[i, j] == pytest.approx(np.average(row[block], weights=power[block]), abs=SINGLE)
            assert looks.col[i, j] == pytest.approx(np.average(col[block], weights=power[block]), abs=SINGLE)


@pytest.mark.parametrize("bad", [np.nan, np.inf, complex(0, np.nan)])
def test_bad_sample_marks_its_pixel_and_leaves_the_neighbours(slc: np.ndarray, bad: complex) -> None:
    clean = multilook(slc, HIGH, WIDE)
    slc[1, 4, 5] = bad
    looks = multilook(slc, HIGH, WIDE)
    hit = np.zeros((2, 4), bool)
    hit[1, 2] = True
    np.testing.assert_array_equal(looks.finite, ~hit)
    for name in ("covariance", "row", "col"):
        np.testing.assert_array_equal(getattr(looks, name)[~hit], getattr(clean, name)[~hit])
    assert not looks.covariance[1, 2].any()
    assert (looks.row[1, 2], looks.col[1, 2]) == (4.0, 4.5)  # the block's middle


def test_the_transform_multiplies_the_channels(slc: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((len(slc), len(slc))) + 1j * rng.standard_normal((len(slc), len(slc)))
    mixed = np.tensordot(matrix, slc, axes=1).astype(np.complex64)
    transformed, plain = multilook(slc, 2, 3, True, matrix), multilook(mixed, 2, 3, True)
    largest = np.abs(plain.covariance).max()
    np.testing.assert_allclose(transformed.covariance, plain.covariance, atol=1e-6 * largest)
    np.testing.assert_allclose(transformed.row, plain.row, rtol=1e-5)


@pytest.mark.parametrize("dead", [0.0, np.nan, np.inf])
def test_detectors_without_any_sample_are_dead(slc: np.ndarray, dead: float) -> None:
    """One sample is enough to live; two live detectors are the least."""
    slc = slc.copy()
    slc[1:] = dead
    slc[-1, -1, -1] = 1e-20j
    np.testing.assert_array_equal(live_detectors(slc), [0, len(slc) - 1])
    slc[0] = dead
    with pytest.raises(Rejected) as refusal:
        live_detectors(slc)
    assert refusal.value.reason == "dead detectors"
    assert_one_sentence(str(refusal.value), f"Of {len(slc)} detectors 1 have", "2 or more")


def test_one_look_keeps_every_pixel(slc: np.ndarray) -> None:
    looks = multilook(slc, 1, 1)
    np.testing.assert_allclose(
        np.trace(looks.covariance, axis1=2, axis2=3), np.sum(np.abs(slc) ** 2, axis=0), rtol=1e-6
    )
    np.testing.assert_array_equal(looks.row, np.indices((ROWS, COLS))[0])
    np.testing.assert_array_equal(looks.col, np.indices((ROWS, COLS))[1])


def test_block_without_power_has_its_centre_in_the_middle(slc: np.ndarray) -> None:
    slc[:, :3, :2] = 0
    looks = multilook(slc, HIGH, WIDE)
    assert (looks.row[0, 0], looks.col[0, 0]) == (1.0, 0.5)


@pytest.mark.parametrize(("high", "wide"), [(0, 1), (1, 0), (8, 1), (1, 10), (-1, 1)])
def test_looks_that_do_not_fit_are_refused(slc: np.ndarray, high: int, wide: int) -> None:
    with pytest.raises(UserError) as refusal:
        multilook(slc, high, wide)
    assert_one_sentence(str(refusal.value), f"{high} x {wide}", "7 x 9 pixels", "1 or more")


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("channels", [1, 2, 16, 19])
def test_covariance_of_any_number_of_channels(channels: int, count: int) -> None:
    samples = circular(np.random.default_rng(11), (4, count, channels)).astype(np.complex64)
    exact = np.einsum("pkm,pkn->pmn", samples.astype(complex), samples.astype(complex).conj())
    np.testing.assert_allclose(covariance(samples, hermitian=False), exact.real, atol=SINGLE)
    np.testing.assert_allclose(covariance(samples, hermitian=True), exact, atol=SINGLE)


def test_blocks_and_threads_change_nothing(slc: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = multilook(slc, 1, WIDE)
    monkeypatch.setattr(looks_module, "SAMPLES_AT_ONCE", 1)
    rows = multilook(slc, 1, WIDE)
    for name in ("covariance", "row", "col", "finite"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(whole, name))
